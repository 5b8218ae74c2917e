"""Hashes of lockstep runs, here or in every situation that must not change them.

    python -m tests.support.hashes [--ticks N] [--runs "a;b"]
        hashes of this interpreter, as JSON
    python -m tests.support.hashes --everywhere [--build] [--ticks N]
        the same runs idle, loaded, with other hash seeds, with an older processor's arithmetic, on Python 3.11 to 3.13

A hash covers, of every tick, the frames received and sent with their virtual times, the telemetry record (whatever the
cycle measured, estimated and decided) and the stage's true state: one bit anywhere changes it.
"""

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tests.support.paths import ROOT

VERSIONS = ("3.11", "3.12", "3.13")
RUNS: dict[str, tuple[str, tuple[str, ...]]] = {
    "paper": ("paper.toml", ()),
    "structured-kalman, hard": (
        "paper.toml",
        ("law.name=structured-kalman", "plant.ripple_amplitude=0.05", "plant.stribeck_scale=0.2"),
    ),
    "microscope-ideal": ("microscope-ideal.toml", ()),
    "microscope-ideal, losses": ("microscope-ideal.toml", ("wire.jitter=50e-6", "wire.drop_probability=0.003")),
    "microscope": ("microscope.toml", ()),
    "microscope-ideal, cia402": ("microscope-ideal.toml", ("bus.protocol=cia402",)),
    "paper-dbc": ("paper-dbc.toml", ()),
}


class Situation(NamedTuple):
    """Where and how the runs are made. environment: added variables. loaded: beside two busy processes per core."""

    name: str
    python: Path
    environment: dict[str, str]
    loaded: bool = False


class NoInterpreterError(Exception):
    """A Python version that cannot be asked; the text says why, and what would help."""


def hashes(names: Sequence[str], ticks: int) -> dict[str, str]:
    """Hash of each of these runs in this process."""
    return {name: run_hash(*RUNS[name], ticks) for name in names}


def run_hash(rig_file: str, overrides: Sequence[str], ticks: int) -> str:
    """SHA-256 of `ticks` ticks of a rig."""
    from hil.rig.file import load_rig
    from hil.virtual.lockstep import LockstepRun

    folder = ROOT / "deploy" / "rigs"
    more = hashlib.sha256()
    run = LockstepRun(
        load_rig(folder / rig_file, overrides),
        folder,
        observer=lambda _tick, _frames, result: more.update(result.record.tobytes()),
    )
    for _ in range(ticks):
        run.tick()
        more.update(run.true_position.tobytes() + run.true_velocity.tobytes())
    more.update(run.trace_sha256.encode())
    return more.hexdigest()


def ask(situation: Situation, names: Sequence[str], ticks: int) -> dict[str, str]:
    """Hashes that a process in that situation finds."""
    command = [situation.python, "-m", "tests.support.hashes", "--ticks", str(ticks), "--runs", ";".join(names)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **situation.environment}
    with neighbours(2 * (os.cpu_count() or 1) if situation.loaded else 0):
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{situation.name}: {done.stderr}")
    return json.loads(done.stdout)  # type: ignore[no-any-return]


@contextmanager
def neighbours(count: int) -> Iterator[None]:
    """So many processes that keep the processor and its caches busy."""
    spin = "data = bytearray(1 << 20)\nwhile True:\n    data = data[::-1]"
    busy = [subprocess.Popen([sys.executable, "-c", spin]) for _ in range(count)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def situations() -> list[Situation]:
    """What this interpreter can be put through."""
    here = Path(sys.executable)
    return [
        Situation("idle", here, {"PYTHONHASHSEED": "0"}),
        Situation("another hash seed", here, {"PYTHONHASHSEED": "20261121"}),
        Situation("a random hash seed, loaded", here, {"PYTHONHASHSEED": "random"}, loaded=True),
        Situation(
            "arithmetic of an older processor",  # no wide vectors, no fused multiply-add: numpy, BLAS, C library
            here,
            {
                "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F AVX512_SKX",
                "OPENBLAS_CORETYPE": "Prescott",
                "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F",
            },
        ),
    ]


def interpreter(version: str, *, build: bool = False) -> Path:
    """A Python of that version with this project's packages: this one, or that of .venv-VERSION beside the sources.

    build: make that environment if it is missing. Raises NoInterpreterError.
    """
    if version == f"{sys.version_info.major}.{sys.version_info.minor}":
        return Path(sys.executable)
    python = ROOT / f".venv-{version}" / "bin" / "python"
    if not python.exists():
        bare = bare_interpreter(version)
        if not build:
            raise NoInterpreterError(
                f"{bare} has not the packages; `make hashes` puts them into {python.parent.parent}"
            )
        build_environment(bare, python)
    return python


def bare_interpreter(version: str) -> Path:
    """An installed Python of that version, from PATH or pyenv. Raises NoInterpreterError."""
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    found = [shutil.which(f"python{version}"), *sorted(root.glob(f"versions/{version}.*/bin/python"))]
    for candidate in filter(None, found):
        probe = [candidate, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        if subprocess.run(probe, capture_output=True, text=True, check=False).stdout.strip() == version:
            return Path(candidate)
    raise NoInterpreterError(f"python{version} is not installed")


def build_environment(bare: Path, python: Path) -> None:
    """A virtual environment with exactly the locked packages."""
    print(f"installing pinned packages into {python.parent.parent}", flush=True)
    subprocess.run([bare, "-m", "venv", python.parent.parent], check=True)
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--require-hashes", "-r", ROOT / "requirements.lock"], check=True)


def everywhere(names: Sequence[str], ticks: int, *, build: bool) -> int:
    """Print the hashes of every situation. Returns how many situations differ from the first."""
    plan = situations()
    for version in VERSIONS:
        try:
            plan.append(Situation(f"Python {version}", interpreter(version, build=build), {}))
        except NoInterpreterError as reason:
            print(f"{f'Python {version}':34} left out: {reason}")
    first: dict[str, str] = {}
    different = 0
    for situation in plan:
        found = ask(situation, names, ticks)
        first = first or found
        wrong = [name for name in names if found[name] != first[name]]
        different += bool(wrong)
        print(f"{situation.name:34} {'DIFFERENT in ' + ', '.join(wrong) if wrong else 'same'}", flush=True)
    for name in names:
        print(f"{name:34} {ticks} ticks {first[name]}")
    return different


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.support.hashes", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--ticks", type=int, default=2000)
    parser.add_argument("--runs", default=";".join(RUNS), help="names, separated by semicolons")
    parser.add_argument("--everywhere", action="store_true", help="in every situation, instead of here")
    parser.add_argument("--build", action="store_true", help="make the environments of other Python versions")
    arguments = parser.parse_args()
    names = arguments.runs.split(";")
    if unknown := [name for name in names if name not in RUNS]:
        parser.error(f"no run {', '.join(unknown)}; there are {'; '.join(RUNS)}")
    if arguments.everywhere:
        return 1 if everywhere(names, arguments.ticks, build=arguments.build) else 0
    print(json.dumps(hashes(names, arguments.ticks), indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
