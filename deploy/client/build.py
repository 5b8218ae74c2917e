"""Builds hil-client: what another machine needs to watch and move a rig, from the same sources as hil.

python -m deploy.client.build FOLDER

It holds the modules that a client loads, and no others: they are found by being one, for every shipped rig. There is no
control process, no emulated stage and no command line in it, and nothing to compile. It installs the package `hil`, and
so is not for a machine that has hil itself.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
NEEDS: Final = ("numpy", "mypy-extensions", "eclipse-zenoh", "protobuf", "pydantic")  # of hil's own
PACKAGES: Final = ("hil", "drivers", "sim_plant")
# What a client does, without a rig to do it to: its modules are what it loads.
STORY: Final = """
import json, sys
import hil.connection, hil.runs.remote, hil.telemetry.tick_codec
from hil.live.task_loading import rig_with_task
from hil.rig.file import build_rig
from hil.rig.schema import RigError
from hil.runs.mover import motion_limits, motion_windows
from hil.telemetry.motion_watch import MotionWatch
hil.connect, hil.Mover, hil.Move, hil.GoalRefusedError, hil.MotionError, hil.Event
for rig in map(json.loads, sys.stdin):
    config = build_rig(rig, carried=True)
    motion_limits(config), motion_windows(config)
    names = list(config.axes)
    points = [[0.0] * len(names), [1e-4] * len(names), [0.0] * len(names)]
    task = {"kind": "waypoints", "axes": names, "waypoints": points, "speed": 1e-3, "acceleration": 0.1, "jerk": 10.0}
    for blend in (0.0, 1e-5):
        try:
            rig_with_task(config, json.dumps({**task, "blend": blend}))
        except RigError:
            pass
for name, module in list(sys.modules.items()):
    if name.split(".")[0] in ("hil", "drivers", "sim_plant"):
        print(module.__file__)
"""


def modules() -> list[Path]:
    """Files of the modules that a client loads, relative to the checkout."""
    code = (
        "import json, pathlib, sys\nfrom hil.rig.file import load_rig\n"
        "for path in sorted(pathlib.Path('deploy/rigs').glob('*.toml')):\n"
        "    print(json.dumps(load_rig(path).model_dump(mode='json')))"
    )
    rigs = _said([sys.executable, "-c", code], "")
    return sorted(
        {Path(line).resolve().relative_to(ROOT) for line in _said([sys.executable, "-c", STORY], rigs).split()}
    )


def _said(line: list[str], text: str) -> str:
    """Of the sources here, not of an installed hil."""
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    return subprocess.run(line, cwd=ROOT, env=clean, input=text, capture_output=True, text=True, check=True).stdout


def project() -> str:
    """The wheel's pyproject.toml, of the main one's version and the pins that a client needs."""
    whole = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needs = [need for need in whole["dependencies"] if need.split(">=")[0] in NEEDS]
    assert len(needs) == len(NEEDS), needs
    lines = [
        "[build-system]",
        'requires = ["hatchling"]',
        'build-backend = "hatchling.build"',
        "[project]",
        'name = "hil-client"',
        f"version = {json.dumps(whole['version'])}",
        'description = "Watch and move a rig that hil controls, from another machine"',
        f"license = {json.dumps(whole['license'])}",
        'license-files = ["LICENSE"]',
        f"requires-python = {json.dumps(whole['requires-python'])}",
        f"dependencies = {json.dumps(needs)}",
        "[tool.hatch.build.targets.wheel]",
        f"packages = {json.dumps(list(PACKAGES))}",
    ]
    return "\n".join(lines) + "\n"


def build(folder: Path) -> Path:
    """The wheel, in `folder`."""
    folder = folder.resolve()
    with tempfile.TemporaryDirectory(prefix="hil-client-") as name:
        stage = Path(name)
        files = [
            *modules(),
            Path("hil/__init__.pyi"),
            Path("hil/rig/reference.json"),
            *(Path(package) / "py.typed" for package in PACKAGES),
        ]
        for file in [*files, Path("LICENSE")]:
            (stage / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / file, stage / file)
        (stage / "pyproject.toml").write_text(project(), encoding="utf-8")
        line = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
        subprocess.run(line, cwd=stage, check=True, stdout=subprocess.DEVNULL)
    (wheel,) = folder.glob("hil_client-*.whl")
    return wheel


def main() -> None:
    """Print where it is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    print(build(parser.parse_args().folder))


if __name__ == "__main__":
    main()
