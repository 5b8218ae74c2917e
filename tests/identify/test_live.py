"""Experiments in real time: what is agreed to, what is kept, ticks that are lost; and a push on a live stage."""

import contextlib
import io
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from rich.console import Console

from hil.cycle.fault_table import Fault
from hil.identify import live
from hil.identify.experiments import EXPERIMENTS, Known, rig_document
from hil.identify.findings import Findings
from hil.identify.live import (
    LiveError,
    LiveExperiments,
    declared_anywhere,
    live_document,
    live_runtime,
    what_moves,
)
from hil.identify.lockstep import APPROACH_S, Trial, identify
from hil.operate.dead_man import Handle
from hil.operate.demo_live import Scene, Signals
from hil.rig.home_table import HomeConfig
from hil.runs.api import Run, load_run, simulate
from hil.runs.rigs import Rig
from tests.identify import rigs


@pytest.fixture
def no_signals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # those of this process are pytest's


def a_trial(experiment: str, interface: str, folder: Path) -> Trial:
    rig = rigs.one_axis(bus={"interface": interface}).config
    axis = rig.axes["x"]
    plan = EXPERIMENTS[experiment](axis, Known(axis.model.mass), APPROACH_S)
    document, seconds = rig_document(rig, "x", plan, APPROACH_S)
    return Trial("x", experiment, plan, document, folder, seconds)


def a_push(interface: str, folder: Path) -> Trial:
    return a_trial("push", interface, folder)


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


def recorded(spoil: Callable[[Run], None]) -> Callable[[Path], Run]:
    """Reads a recording as if this had happened to it."""

    def read(folder: Path) -> Run:
        run = load_run(folder)
        spoil(run)
        return run

    return read


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
    def holed(run: Run) -> None:
        run.columns = {name: column[::2] for name, column in run.columns.items()}

    monkeypatch.setattr(live, "load_run", recorded(holed))
    with pytest.raises(LiveError, match=r"x, push: \d+ of \d+ ticks are missing; limit 0\.5 %"):
        experiments(tmp_path, [])(a_push("local", tmp_path))
    assert len(starts) == live.TRIES
    assert [path.name for path in tmp_path.iterdir()] == ["x-push.part"]


class Whole(Short):
    """A demo that records all of it."""

    def run(self, seconds: float) -> None:
        simulate(Rig.build(self._scene.rig.model_dump(mode="json")), seconds, record=self._scene.out / "run.mcap")


@pytest.mark.long
@pytest.mark.replaces_methods
@pytest.mark.usefixtures("no_signals")
def test_a_frequency_response_that_is_held_up_in_most_passes_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A few ticks are missing, too few to count, but in nearly every pass."""

    def held_up(run: Run) -> None:
        whole = np.arange(len(run.time)) % 800 >= 3
        run.columns = {name: column[whole] for name, column in run.columns.items()}

    monkeypatch.setattr(live, "Demo", Whole)
    monkeypatch.setattr(live, "TRIES", 1)
    monkeypatch.setattr(live, "load_run", recorded(held_up))
    with pytest.raises(LiveError, match=r"x, frequency: \d pairs of passes with the multisine \(at least 4\)"):
        experiments(tmp_path, [])(a_trial("frequency", "local", tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["x-frequency.part"]


@pytest.mark.replaces_methods
@pytest.mark.usefixtures("no_signals")
def test_an_experiment_that_ended_in_a_fault_runs_again_at_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, starts: list[Path]
) -> None:
    def faulty(run: Run) -> None:
        run.columns["fault"] = np.full_like(run.columns["fault"], int(Fault.RECEIVE_FLOOD))

    trial = a_push("local", tmp_path)
    monkeypatch.setattr(live, "load_run", recorded(faulty))
    assert experiments(tmp_path, [])(trial)[0].summary()["faults"] == ["RECEIVE_FLOOD"]
    assert [path.name for path in tmp_path.iterdir()] == ["x-push.part"]
    monkeypatch.setattr(live, "load_run", load_run)
    assert experiments(tmp_path, [])(trial)[0].summary()["faults"] == []
    assert len(starts) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["x-push"]


@pytest.mark.parametrize("at", [0.0, 0.01])
def test_an_axis_that_is_declared_where_it_stands_has_to_be_declared_where_experiments_end(at: float) -> None:
    rig = rigs.one_axis().config
    home = {"home": HomeConfig(by="here", at=at)}
    axes = {"x": rig.axes["x"].model_copy(update=home)}
    words = declared_anywhere("x", rig.model_copy(update={"axes": axes}))
    assert ("leaves the axis at 0" in words) is (at == 0.01)


def test_what_homes_before_an_experiment_is_said(tmp_path: Path) -> None:
    trial = a_push("can0", tmp_path)
    assert "homes" not in what_moves(trial, Rig.build(trial.document).config)
    trial.document["axes"]["x"]["home"] = {"by": "index", "farthest": 0.03, "speed": 2e-3}
    words = what_moves(trial, Rig.build(trial.document).config)
    assert "Before that x homes by index, up to 0.03 m at 0.002 m/s." in words


# A shared machine stops a core for 50 ms. How soon such a stop ends a run is tried elsewhere: here the experiment is,
# and it has room for a few.
LATE = {"overrun_zero_s": 0.15, "overrun_streak": 75, "silent_stop_ticks": 50, "silent_zero_ticks": 75}


def pushed(tmp_path: Path, said: io.StringIO, handle: Handle | None = None, **tables: Any) -> Findings:
    """One on a live emulated stage."""
    bus, drives = {"interface": "local"}, {"watchdog_s": 0.15}
    rig = rigs.one_axis(**{"bus": bus, "rate_hz": 500, "safety": LATE, "drives": drives, **tables})
    with live_runtime(rig.config) as runtime:
        runner = LiveExperiments(tmp_path, Console(file=said), Signals(), lambda _: False, runtime, handle)
        return identify(rig.config, tmp_path, ["x"], lambda _: None, ["push"], runner)["x"]


@pytest.mark.live
@pytest.mark.usefixtures("no_signals")
def test_a_push_on_a_live_emulated_stage_finds_its_friction(tmp_path: Path) -> None:
    """Also where it has to be homed before each experiment."""
    plant = {"mass": [rigs.MASS], "coulomb": [rigs.COULOMB], "viscous": [rigs.VISCOUS], "presliding": [rigs.LENGTH],
             "torque_lag": [2e-4], "switches": [{"axis": "x", "home": 0.002, "zero": 0.1}]}  # fmt: skip
    home = {"by": "switch", "farthest": 0.03, "speed": 5e-3, "latch_speed": 1e-3, "at": 0.002, "move_to": 0.0}
    axis = rigs.one_axis().config.axes["x"].model_dump(mode="json", exclude_none=True)
    found = pushed(tmp_path, io.StringIO(), plant=plant, axes={"x": axis | {"home": home}})
    assert found.refused == {}
    assert found.found["push_coulomb"].holds(rigs.COULOMB)
    assert [path.name for path in tmp_path.iterdir()] == ["x-push"]


@pytest.mark.live
@pytest.mark.usefixtures("no_signals")
def test_a_key_that_is_let_go_ends_a_live_experiment(tmp_path: Path) -> None:
    """The recording is not kept, and the drives have zero torque within the heartbeat's time."""
    said, looks = io.StringIO(), list[bool]()

    def held() -> bool:
        """For a while after it has begun to move."""
        looks.extend([True] * ("activated" in said.getvalue()))
        return len(looks) < 40

    with pytest.raises(LiveError, match="the space bar was let go, and the stage stopped"):
        pushed(tmp_path, said, lambda: contextlib.nullcontext(held), safety=LATE | {"heartbeat_s": 1.0})
    run = load_run(tmp_path / "x-push.part")
    assert run.summary()["faults"] == ["HEARTBEAT_LOST"]
    assert np.abs(run.columns["force"][-1]).max() == 0.0
    assert not (tmp_path / "x-push").exists()
