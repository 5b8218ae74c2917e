"""Translates modules to C with mypyc and compiles them, in the folder of the copies: build.py runs it there.

    python extensions.py MODULE.py ...

A C file a module, as many at a time as there are processors: in one file, the compiler took four times as long. What an
earlier build compiled stays where neither its C file nor a header changed; mypyc leaves files alone that would be the
same.
"""

import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from mypyc.build import mypycify
from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

# The same bits as the interpreter's: no multiplication and addition fused into one rounding, as compilers do unasked
# where the processor can (arm64), no instructions beyond the architecture's base, no -ffast-math. What no other library
# may replace, the compiler may put in place of its call.
FLAGS = ["-ffp-contract=off", "-g0", "-fvisibility=hidden"]
NATIVE = "drivers.native.path"  # written in C
_HOW = (Path(__file__), Path(__file__).resolve().parents[2] / "requirements.lock")  # what changes every object


class SideBySide(build_ext):
    """build_ext with a compiler that takes many sources at a time."""

    def build_extensions(self) -> None:
        """See build_ext."""
        self.compiler.compile = partial(_compile, self.compiler, self.compiler.compile)
        super().build_extensions()


def _compile(compiler: Any, one: Callable[..., list[str]], sources: list[str], **keywords: Any) -> list[str]:
    """What is not there yet of the sources' objects, whose paths are returned."""
    headers = max(path.stat().st_mtime_ns for path in (*_HOW, *Path("build").rglob("*.h")))

    def compiled(source: str) -> list[str]:
        made: list[str] = compiler.object_filenames([source], output_dir=keywords["output_dir"])
        newest = max(headers, Path(source).stat().st_mtime_ns)
        is_fresh = all(Path(name).exists() and Path(name).stat().st_mtime_ns > newest for name in made)
        return made if is_fresh else one([source], **keywords)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return [name for names in pool.map(compiled, sources) for name in names]


def main() -> None:
    """Command line."""
    options = ["--follow-imports=silent", "--no-warn-unused-configs", *sys.argv[1:]]
    extensions = mypycify(options, opt_level="2", multi_file=True)
    for extension in extensions:
        extension.extra_compile_args = extension.extra_compile_args + FLAGS  # a list that all of them share
    extensions.append(Extension(NATIVE, [NATIVE.replace(".", "/") + ".c"], extra_compile_args=["-O2", *FLAGS]))
    setup(
        name="hil-compiled", packages=[], py_modules=[], ext_modules=extensions, cmdclass={"build_ext": SideBySide},
        script_args=["-q", "build_ext", "--inplace"],
    )  # fmt: skip


if __name__ == "__main__":
    main()
