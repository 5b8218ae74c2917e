"""Compiles the hot path with mypyc into a virtual environment of its own: `make compiled`.

    python deploy/compiled/build.py DIRECTORY     make DIRECTORY/bin/hil
    python deploy/compiled/build.py --check       only say whether this machine can (exit status 1: why not)

The sources are copied first: nothing compiled ever lies beside a source file, where Python would prefer it to the file
however much that is edited. The environment shares its other packages with .venv, takes tests/, deploy/ and docs/ from
the checkout by links, and starts with Python's safe path, in all its children too, so that it never loads the sources
of a checkout it happens to stand in.
"""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))  # run as a script, it finds its own folder only

from deploy.compiled.flag_members import find_flags, hoist  # noqa: E402
from deploy.compiled.named_tuples import find_named_tuples, rewrite  # noqa: E402
from sim_plant.native import library  # noqa: E402

WORK = ROOT / "build" / "compiled"
PACKAGES = ("hil", "drivers", "sim_plant")
LINKED = ("tests", "deploy", "docs")

# Every module a tick runs through, in three tables. Not among them:
# what defines ctypes structures (drivers/bus/recvmmsg.py), which mypyc cannot compile; what users, tests and the fault
# campaign replace or inherit from (hil/virtual/lockstep.py, drivers/wire/faults.py), which compiled
# classes do not allow; what runs once a run.

# Written once for floats and arrays (number.py of either package). The build has them twice: compiled for a rig as
# hil/floats and sim_plant/floats, where `Number` is `float`, because numbers of any type are Python's objects even in
# compiled code; and for batches as they are, interpreted, because their time is numpy's. *: all of the folder, so that
# a new law is compiled with the others.
FOR_BOTH = """
hil/control: number setpoints
hil/control/estimator: motion_filter
hil/control/laws: *
sim_plant/physics: number axis disturbance dynamics encoder membrane structure terms
"""
HOMES = {"hil/control/": "hil/floats/", "sim_plant/physics/": "sim_plant/floats/"}  # of the sources, and the copies

# What works for one rig alone, and so imports those modules from the copies.
ONE_RIG = """
hil/cycle: axes command_desk commissioning damped_stop decided_motion drive_clock fault_evidence fault_monitor
hil/cycle: fault_table gate goal_desk guards inbox limits oscillation output_gate reading_faults readings record_builder
hil/cycle: rest_watch sampling state_machine step supervisor tick travel withdrawal
hil/live: loop miss_ledger pacing timing_record
sim_plant/physics: events native_axis real_axis single_axis single_stage
"""

OTHERS = """
hil/control: reading
hil/control/plans: *
hil/control/trajectories: base blends chosen_axes displaced figures minimum_jerk paths rows segments
hil/cycle: axis_homing goal homing press_watch record
hil/cycle/faults: number row
hil/live: mailbox ring stop_line
drivers: arbitration frame frame_length
drivers/bus: port segmented_port counters local_link local_medium receive_block socketcan
drivers/outputs: hil_frame
drivers/families/cia402: host master node
drivers/families/stage: common stage_classic stage_fd
drivers/protocols: base checksum common sampling_clock
drivers/sensors: base hil_frame
drivers/wire: node segment wire
sim_plant: emulator
sim_plant/drives: lines servo stage
sim_plant/physics: exact_trigonometry noise
"""

# There once, interpreted, with the laws for arrays: what makes arrays of floats, and what runs the laws of users.
SEAM = ("hil/control/laws/coupled.py", "hil/control/laws/users.py")
# Imports of FOR_BOTH, and what leads to the copies
IMPORTS = (
    (
        r"\bhil\.control\.(number|setpoints|estimator\.motion_filter|laws)\b(?!\.(?:coupled|users)\b|\w)",
        r"hil.floats.\1",
    ),
    (
        r"\bsim_plant\.physics\.(number|axis|disturbance|dynamics|encoder|membrane|structure|terms)\b",
        r"sim_plant.floats.\1",
    ),
)
HIDDEN_IMPORT = re.compile(
    r"^from (?:hil(?:\.control(?:\.estimator|\.laws)?)?|sim_plant(?:\.physics)?) import "
    r".*\b(?:control|motion_filter|number|setpoints|laws|coupled|physics|axis|dynamics|encoder|structure|terms)\b",
    re.MULTILINE,
)

LAUNCHER = """#!{python} -P
import os

os.environ["PYTHONSAFEPATH"] = "1"  # for the programs this one starts

from hil.__main__ import main

if __name__ == "__main__":  # worker processes of a sweep read this file too
    main()
"""


def listed(table: str) -> list[str]:
    """Paths of a table's modules, below the root."""
    lines = [line.partition(": ") for line in table.strip().splitlines()]
    patterns = [f"{folder}/{name}.py" for folder, _, names in lines for name in names.split()]
    found = [path.relative_to(ROOT).as_posix() for pattern in patterns for path in sorted(ROOT.glob(pattern))]
    return [name for name in found if name not in SEAM]


def on_floats(name: str) -> str:
    """Path of a module's copy for floats."""
    home = next(home for home in HOMES if name.startswith(home))
    return name.replace(home, HOMES[home], 1)


def modules() -> list[str]:
    """Paths of the modules to compile, below the folder of the copies."""
    found = [on_floats(name) for name in listed(FOR_BOTH)] + listed(ONE_RIG) + listed(OTHERS)
    return [name for name in found if not name.endswith("__init__.py")]


def missing() -> str:
    """What this machine lacks, and how to get it; empty where it lacks nothing."""
    lacks = []
    if shutil.which("cc") is None:
        lacks.append("a C compiler (Debian: apt install gcc)")
    header = Path(sysconfig.get_path("include"), "Python.h")
    if not header.exists():
        lacks.append(f"{header} (Debian: apt install python3-dev)")
    return " and ".join(lacks)


def copy_sources() -> None:
    """The packages as they are now, beside the objects of an earlier build, but without its libraries."""
    for library_file in WORK.glob("*.so"):
        library_file.unlink()
    for package in PACKAGES:
        shutil.rmtree(WORK / package, ignore_errors=True)
        shutil.copytree(ROOT / package, WORK / package, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    shutil.copy(ROOT / "pyproject.toml", WORK)  # mypy's options


def instantiate() -> None:
    """Add the second copy, of floats, and let what works for one rig import it."""
    for name in listed(FOR_BOTH):
        copy = WORK / on_floats(name)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(WORK / name, copy)
        for folder in (copy.parent, copy.parent.parent):
            (folder / "__init__.py").touch()
    for home in HOMES.values():
        change(WORK / home / "number.py", r"^Number = Any\b", "Number = float")
    for name in [*map(on_floats, listed(FOR_BOTH)), *listed(ONE_RIG)]:
        text = (WORK / name).read_text()
        if HIDDEN_IMPORT.search(text):
            sys.exit(f"compiled: {name}: `from hil import ...` is not led to the copies; import from the module itself")
        for imported, copied in IMPORTS:
            text = re.sub(imported, copied, text)
        (WORK / name).write_text(text)


def make_flags_ints() -> None:
    """Spare the modules to compile the operators of flags (flag_members.py says why)."""
    known = find_flags(WORK, PACKAGES)
    for name in modules():
        path = WORK / name
        path.write_text(hoist(path.read_text(), name.removesuffix(".py").replace("/", "."), known))


def make_tuples_directly() -> None:
    """Spare the modules to compile the constructors of NamedTuples (named_tuples.py says why)."""
    known = find_named_tuples(WORK, PACKAGES)
    for name in modules():
        path = WORK / name
        path.write_text(rewrite(path.read_text(), name.removesuffix(".py").replace("/", "."), known))


def change(path: Path, pattern: str, text: str) -> None:
    """Replace what a pattern finds in a file. Exits where it finds nothing, so that no build is quietly another."""
    changed, times = re.subn(pattern, text, path.read_text(), flags=re.MULTILINE)
    if not times:
        sys.exit(f"compiled: {path}: nothing there is like {pattern}")
    path.write_text(changed)


def compile_modules() -> None:
    """Put an extension module beside every copy in modules(). Exits where mypyc gives up or has to guess."""
    command = [sys.executable, ROOT / "deploy" / "compiled" / "extensions.py", *modules()]
    done = subprocess.run(command, cwd=WORK, capture_output=True, text=True, check=False)
    told = (done.stdout + done.stderr).splitlines()
    # A default that mypyc leaves out would be an attribute that is missing.
    left_out = [line for line in told if "Unsupported default attribute value" in line]
    if done.returncode or left_out:
        sys.exit("\n".join(["compiled: mypyc or the C compiler failed", *(left_out or told[-40:])]))


def compile_kernel() -> None:
    """Put the native kernel of the emulated stage beside the copies of its sources."""
    try:
        library.build(WORK / "sim_plant" / "native")
    except library.BuildError as error:
        sys.exit(f"compiled: {error}")


def make_environment(directory: Path) -> None:
    """The copies and what was compiled from them as an environment with `bin/hil`."""
    shutil.rmtree(directory, ignore_errors=True)
    venv.create(directory, symlinks=True, with_pip=False)
    packages = Path(sysconfig.get_path("purelib", "venv", {"base": str(directory), "platbase": str(directory)}))
    for folder in (*WORK.glob("*.so"), *(WORK / package for package in PACKAGES)):
        shutil.move(folder, packages / folder.name)
    for name in LINKED:
        (packages / name).symlink_to(ROOT / name)
    # Behind our own on the path. Its .pth files do not count there, so that the sources it is installed from stay out.
    (packages / "shared.pth").write_text(sysconfig.get_path("purelib") + "\n")
    launcher = directory / "bin" / "hil"
    launcher.write_text(LAUNCHER.format(python=directory / "bin" / "python"))
    launcher.chmod(0o755)


def main() -> None:
    """Command line."""
    if lacking := missing():
        sys.exit(f"compiled: needs {lacking}")
    if sys.argv[1:] == ["--check"]:
        return
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    directory = ROOT / sys.argv[1]
    print(f"compiling {len(modules())} modules (a minute and a half)", flush=True)
    copy_sources()
    instantiate()
    make_flags_ints()
    make_tuples_directly()
    compile_modules()
    compile_kernel()
    make_environment(directory)
    environment = {**os.environ, "PYTHONSAFEPATH": "1"}
    subprocess.run([directory / "bin" / "hil", "--version"], env=environment, check=True)
    (directory / ".built").touch()


if __name__ == "__main__":
    main()
