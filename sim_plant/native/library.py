"""Builds, finds and loads the kernel: a plain shared library, called through ctypes, that needs no header of Python.

It lies beside the sources in a wheel of one platform and in the Debian package, else among the packages of the
environment, where `python -m sim_plant.native` puts it. Its name is the hash of its sources: one of other sources is
not found. Without it everything is computed in Python.
"""

import ctypes
import hashlib
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

from drivers.native import OFF  # in the environment, set to 0: compute in Python all the same

SOURCES = ("arithmetic.h", "dynamics.h", "kernel.c")
# No multiplication and addition in one rounding, no -ffast-math: the bits of Python. A root sets no errno.
FLAGS = ("-O2", "-std=c11", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared")
COMPILERS = ("cc", "gcc", "clang")
LONGEST_BUILD_S = 120.0

_HERE = Path(__file__).resolve().parent


class BuildError(Exception):
    """The kernel cannot be built here; the text says why."""


class Kernel(NamedTuple):
    """The loaded library (kernel.c says what they do). advance: (axes, how many, begin, h, pieces, pieces before).
    show: (axis, now, samples before).
    """

    advance: Callable[[int, int, float, float, int, int], int]
    show: Callable[[int, float, int], float]
    size_of_axis: int
    path: Path


def name() -> str:
    """Of the library of these sources on this platform."""
    digest = hashlib.sha256(" ".join((*FLAGS, sysconfig.get_platform())).encode())
    for source in SOURCES:
        digest.update((_HERE / source).read_bytes())
    return f"kernel-{digest.hexdigest()[:16]}.so"


def home() -> Path:
    """The folder of the environment that a build goes to."""
    return Path(sysconfig.get_path("platlib")) / "hil_native"


def compiler() -> list[str]:
    """The C compiler's command: $CC, one on the path, or the one in the `ziglang` package. Empty: there is none."""
    if stated := shlex.split(os.environ.get("CC", "")):
        return stated
    found = next(filter(None, map(shutil.which, COMPILERS)), None)
    if found:
        return [found]
    return [sys.executable, "-m", "ziglang", "cc"] if importlib.util.find_spec("ziglang") else []


def build(folder: Path | None = None) -> Path:
    """The library in `folder` (default: `home`), made where it is not there yet. Raises BuildError.

    Two builds at once do no harm: each one's result takes its place whole.
    """
    place = (folder or home()) / name()
    if place.exists():
        return place
    command = compiler()
    if not command:
        raise BuildError("there is no C compiler (Debian: apt install gcc; or: pip install ziglang)")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".kernel-", dir=place.parent) as work:
            made = Path(work, place.name)
            arguments = [*command, *FLAGS, "-o", str(made), str(_HERE / "kernel.c"), "-lm"]
            done = subprocess.run(arguments, capture_output=True, text=True, timeout=LONGEST_BUILD_S, check=False)
            if done.returncode:
                raise BuildError(f"{command[0]}: {done.stderr.strip() or f'exit status {done.returncode}'}")
            _loaded(made)
            os.replace(made, place)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BuildError(f"{place}: {error}") from None
    return place


def _loaded(path: Path) -> Kernel:
    """Raises OSError where it is no such library."""
    # PyDLL: a call is shorter than handing the interpreter's lock on
    library = ctypes.PyDLL(str(path))
    try:
        advance, show, size = library.hil_advance, library.hil_show, library.hil_size_of_axis
    except AttributeError as error:
        raise OSError(str(error)) from None
    whole, real = ctypes.c_int64, ctypes.c_double
    advance.argtypes, advance.restype = [ctypes.c_void_p, whole, real, real, whole, whole], whole
    show.argtypes, show.restype = [ctypes.c_void_p, real, whole], real
    size.argtypes, size.restype = [], whole
    return Kernel(advance, show, size(), path)


@cache
def found() -> tuple[Kernel | None, str]:
    """The kernel, or none and why."""
    if os.environ.get(OFF) == "0":
        return None, f"{OFF}=0"
    try:
        for place in (_HERE / name(), home() / name()):
            if place.exists():
                return _loaded(place), ""
    except OSError as error:
        return None, str(error)
    return None, "not built"


def kernel() -> Kernel | None:
    """The kernel, where there is one."""
    return found()[0]
