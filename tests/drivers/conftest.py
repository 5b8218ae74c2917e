"""The extension in C that a tick's frames go through, for the tests that hold it to its twins in Python."""

import importlib.util
import shutil
import subprocess
import sysconfig
from pathlib import Path
from types import ModuleType

import pytest

from tests.support.paths import ROOT

SOURCE = ROOT / "drivers" / "native" / "path.c"
FLAGS = ("-O2", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared", "-ffp-contract=off")


@pytest.fixture(scope="session")
def c(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    """The extension, compiled from its source."""
    include = sysconfig.get_path("include")
    if shutil.which("cc") is None or not Path(include, "Python.h").exists():
        pytest.skip("no C compiler, or no headers of Python")
    built = tmp_path_factory.mktemp("native") / "path.so"
    subprocess.run(["cc", *FLAGS, "-I", include, "-o", str(built), str(SOURCE), "-lm"], check=True)
    spec = importlib.util.spec_from_file_location("path", built)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
