"""Experiments in real time: what is agreed to, what is kept, ticks that are lost; and a push on a live stage."""

import io
import signal
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from rich.console import Console

from hil.cycle.fault_table import Fault
from hil.identify import live
from hil.identify.experiments import EXPERIMENTS, Known, rig_document
from hil.identify.live import LiveError, LiveExperiments, live_document, live_runtime
from hil.identify.lockstep import APPROACH_S, Trial, identify
from hil.operate.demo_live import Scene, Signals
from hil.runs.api import Run, load_run, simulate
from hil.runs.rigs import Rig
from tests.identify import rigs


@pytest.fixture
def no_signals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # those of this process are pytest's


def a_push(interface: str, folder: Path) -> Trial:
    rig = rigs.one_axis(bus={"interface": interface}).config
    axis = rig.axes["x"]
    plan = EXPERIMENTS["push"](axis, Known(axis.model.mass), APPROACH_S)
    document, seconds = rig_document(rig, "x", plan, APPROACH_S)
    return Trial("x", "push", plan, document, folder, seconds)


def experiments(out: Path, asked: list[str], *, agrees: bool = False) -> LiveExperiments:
    def ask(words: str) -> bool:
        asked.append(words)
        return agrees

    return LiveExperiments(out, Console(file=io.StringIO()), Signals(), ask, out)


@pytest.mark.usefixtures("no_signals")
def test_nothing_moves_on_a_rig_without_the_operator(tmp_path: Path) -> None:
    asked: list[str] = []
    with pytest.raises(LiveError, match="not agreed to"):
        experiments(tmp_path, asked)(a_push("can0", tmp_path))
    (words,) = asked
    for said in ("x, push: 12 s", "travel -0.02 to 0.02", "at most 15 N", "hil estop one"):
        assert said in words
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
@pytest.mark.usefixtures("no_signals")
def test_an_experiment_that_was_recorded_is_not_run_again_for_the_same_rig_and_plan(tmp_path: Path) -> None:
    trial, asked = a_push("can0", tmp_path), list[str]()
    kept = tmp_path / "x-push"
    kept.mkdir()
    simulate(Rig.build(live_document(trial.document)), 0.5, record=kept / "run.mcap")
    run, digest = experiments(tmp_path, asked)(trial)
    assert (len(run.time), len(digest), asked) == (500, 64, [])
    other = a_push("can1", tmp_path)
    with pytest.raises(LiveError):
        experiments(tmp_path, asked)(other)
    assert len(asked) == 1


class Short:
    """A demo that records 50 ms in virtual time."""

    busy, troubles = "", list[str]()
    starts: ClassVar[list[Path]] = []

    def __init__(self, scene: Scene, *_: object, **__: object) -> None:
        self._scene = scene

    def run(self, _: float) -> None:
        self.starts.append(self._scene.out)
        simulate(Rig.build(self._scene.rig.model_dump(mode="json")), 0.05, record=self._scene.out / "run.mcap")


@pytest.fixture
def starts(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    monkeypatch.setattr(live, "Demo", Short)
    monkeypatch.setattr(Short, "starts", [])
    return Short.starts


@pytest.mark.replaces_methods
@pytest.mark.usefixtures("no_signals")
def test_an_experiment_that_lost_too_many_ticks_is_tried_again_and_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, starts: list[Path]
) -> None:
    def holed(folder: Path) -> Run:
        run = load_run(folder)
        run.columns = {name: column[::2] for name, column in run.columns.items()}
        return run

    monkeypatch.setattr(live, "load_run", holed)
    with pytest.raises(LiveError, match=r"x, push: \d+ of \d+ ticks are missing; limit 0\.5 %"):
        experiments(tmp_path, [])(a_push("local", tmp_path))
    assert len(starts) == live.TRIES
    assert [path.name for path in tmp_path.iterdir()] == ["x-push.part"]


@pytest.mark.replaces_methods
@pytest.mark.usefixtures("no_signals")
def test_an_experiment_that_ended_in_a_fault_runs_again_at_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, starts: list[Path]
) -> None:
    def faulty(folder: Path) -> Run:
        run = load_run(folder)
        run.columns["fault"] = np.full_like(run.columns["fault"], int(Fault.RECEIVE_FLOOD))
        return run

    trial = a_push("local", tmp_path)
    monkeypatch.setattr(live, "load_run", faulty)
    assert experiments(tmp_path, [])(trial)[0].summary()["faults"] == ["RECEIVE_FLOOD"]
    assert [path.name for path in tmp_path.iterdir()] == ["x-push.part"]
    monkeypatch.setattr(live, "load_run", load_run)
    assert experiments(tmp_path, [])(trial)[0].summary()["faults"] == []
    assert len(starts) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["x-push"]


@pytest.mark.live
@pytest.mark.usefixtures("no_signals")
def test_a_push_on_a_live_emulated_stage_finds_its_friction(tmp_path: Path) -> None:
    # A shared machine stops a core for 50 ms. How soon such a stop ends a run is tried elsewhere: here the experiment
    # is, and it has room for a few.
    late = {"overrun_zero_s": 0.15, "overrun_streak": 75, "silent_stop_ticks": 50, "silent_zero_ticks": 75}
    rig = rigs.one_axis(bus={"interface": "local"}, rate_hz=500, safety=late, drives={"watchdog_s": 0.15})
    with live_runtime(rig.config) as runtime:
        runner = LiveExperiments(tmp_path, Console(file=io.StringIO()), Signals(), lambda _: False, runtime)
        found = identify(rig.config, tmp_path, ["x"], lambda _: None, ["push"], runner)["x"]
    assert found.refused == {}
    assert found.found["push_coulomb"].holds(rigs.COULOMB)
    assert [path.name for path in tmp_path.iterdir()] == ["x-push"]
