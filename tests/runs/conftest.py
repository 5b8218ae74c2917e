"""Recordings that are made once, and a folder of runs to put them in."""

from pathlib import Path

import pytest

import hil
from tests.support.paths import RIGS

QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1"]
DEAD = '[[fault]]\nkind = "encoder_silent"\naxis = "x"\nat_s = 0.6\n'


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    hil.simulate(RIGS / "paper.toml", 0.5, overrides=QUICK, record=path)
    return path


@pytest.fixture(scope="session")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("faulty")
    (folder / "dead.toml").write_text(DEAD)
    hil.simulate(
        RIGS / "paper.toml", 1.0, overrides=QUICK, scenario=folder / "dead.toml", law="pid", record=folder / "run.mcap"
    )
    return folder / "run.mcap"


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("CACHE_DIRECTORY", raising=False)


@pytest.fixture
def runs(own_cache: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    return tmp_path / "runs"
