"""What every test may lean on: the two rig files, invariants on every tick, private runtime folders."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.virtual.invariants import Invariants
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


@pytest.fixture(autouse=True)
def private_runtime_dir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No test meets another's local bus, ring or mailbox."""
    folder = tmp_path / "run"
    folder.mkdir(mode=0o700)
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(folder))
    return folder


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
