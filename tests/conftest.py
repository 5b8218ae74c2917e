"""What every test may lean on: the two rig files, invariants on every tick, private runtime folders."""

import gc
import itertools
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from drivers.base.runtime import runtime_dir
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.virtual.invariants import Invariants
from tests.support.command_line import CommandLine, command_line
from tests.support.lanes import (
    pytest_addoption,
    pytest_collection_modifyitems,
    pytest_configure,
    pytest_terminal_summary,
)
from tests.support.paths import RIGS, ROOT

if TYPE_CHECKING:
    from hil.virtual.lockstep import LockstepRun

# hooks
__all__ = ["pytest_addoption", "pytest_collection_modifyitems", "pytest_configure", "pytest_terminal_summary"]

settings.register_profile("repository", deadline=None, derandomize=True)
settings.load_profile("repository")

_RUNTIME_NUMBERS = itertools.count()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Thousands of tests and their modules live as long as the process: no search for garbage goes through them."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(autouse=True)
def runtime_of_its_own(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """No test meets another's local bus, ring or mailbox. A process that needs the folder makes it."""
    folder = tmp_path_factory.getbasetemp() / f"run-{next(_RUNTIME_NUMBERS)}"
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(folder))


@pytest.fixture
def private_runtime_dir(runtime_of_its_own: None) -> Path:
    """The runtime folder of this test, made."""
    return runtime_dir()


@pytest.fixture
def hil_here(capsys: pytest.CaptureFixture[str]) -> CommandLine:
    """`hil WORDS` in this process."""
    return command_line(capsys)


@pytest.fixture
def examples_are_a_package(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where Python keeps out of the working directory, and at the end: a compiled build is not to be shadowed."""
    monkeypatch.setattr(sys, "path", [*sys.path, str(ROOT)])


@pytest.fixture(scope="session")
def filterpy_loaded() -> None:
    """Once per worker: the filter design then needs no child process."""
    import filterpy.kalman  # noqa: F401


@pytest.fixture
def paper(filterpy_loaded: None) -> RigConfig:
    return load_rig(RIGS / "paper.toml")


@pytest.fixture
def ideal_microscope(filterpy_loaded: None) -> RigConfig:
    return load_rig(RIGS / "microscope-ideal.toml")


@pytest.fixture
def lockstep(filterpy_loaded: None) -> Callable[..., "LockstepRun"]:
    """Makes lockstep runs whose every tick is checked against the invariants."""

    from hil.virtual.lockstep import LockstepRun

    def make(rig: RigConfig, **keywords: object) -> "LockstepRun":
        invariants = Invariants(rig, RIGS)
        return LockstepRun(rig, RIGS, observer=invariants.observe, **keywords)  # type: ignore[arg-type]

    return make


@pytest.fixture
def short_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches are as long as their trials: these look at less than half a second."""
    monkeypatch.setattr("hil.studies.tune.objective.SETTLE_S", 0.2)
    monkeypatch.setattr("hil.studies.tune.objective.WINDOW_S", 0.2)
    monkeypatch.setattr("hil.studies.tune.stage_trials.MOVE_S", 0.03)
    monkeypatch.setattr("hil.studies.tune.stage_trials.DWELL_S", 0.01)
