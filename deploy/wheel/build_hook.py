"""What hatchling does beyond packing the packages (pyproject.toml names this file).

Every wheel carries the shipped rig files, scenarios and systemd units as `hil/deploy`. With HIL_COMPILED=1 in the
environment it is a wheel for this platform and Python, its hot path compiled by deploy/compiled/build.py: that needs a
C compiler, Python's headers and a minute and a half.

    pip install .                   the interpreted source
    HIL_COMPILED=1 pip install .    the same, compiled
"""

import importlib.util
import os
import shutil
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SHIPPED = ("rigs", "scenarios", "systemd")


class CompleteWheel(BuildHookInterface[Any]):
    """Found by hatchling as the only hook of this file."""

    def dependencies(self) -> list[str]:
        """What an isolated build installs first: mypyc reads the types of all that the hot path imports."""
        if not _compiled():
            return []
        return [*self.metadata.core.dependencies, "mypy>=1.13", "setuptools>=70", "types-protobuf>=5"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add files to the wheel; `version` is "editable" where nothing is packed."""
        if version == "editable":
            return
        root = Path(self.root)
        included = build_data["force_include"]
        included |= {str(root / "deploy" / kind): f"hil/deploy/{kind}" for kind in SHIPPED}
        if _compiled():
            build_data |= {"pure_python": False, "infer_tag": True}
            included |= self._compile(root)

    def finalize(self, _version: str, _build_data: dict[str, Any], _artifact: str) -> None:
        """Remove the compiled tree."""
        if folder := getattr(self, "_folder", None):
            shutil.rmtree(folder)

    def _compile(self, root: Path) -> dict[str, str]:
        """The compiled packages, file by file: a file from outside the project takes the place of the source's."""
        build = _load(root / "deploy" / "compiled" / "build.py")
        if lacking := build.missing():
            raise RuntimeError(f"HIL_COMPILED=1 needs {lacking}")
        build.copy_sources()
        build.instantiate()
        build.make_flags_ints()
        build.make_tuples_directly()
        build.compile_modules()
        build.compile_kernel()
        self._folder = tempfile.mkdtemp(prefix="hil-wheel-")
        tree = Path(self._folder)
        for item in (*build.WORK.glob("*.so"), *(build.WORK / package for package in build.PACKAGES)):
            shutil.move(item, tree / item.name)
        kept = (path for path in tree.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
        return {str(path): str(path.relative_to(tree)) for path in kept}


def _compiled() -> bool:
    return os.environ.get("HIL_COMPILED") == "1"


def _load(path: Path) -> ModuleType:
    """The module of a file outside every package."""
    spec = importlib.util.spec_from_file_location("hil_compiled_build", path)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
