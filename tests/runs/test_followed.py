"""Setpoint and error are absent where nothing is followed, and pictures' time axis is the run's own."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from numpy.typing import NDArray

import hil
from hil.cli.pictures import axis_svg
from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import State

FIELDS = ("setpoint_position", "setpoint_velocity", "following_error")


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> tuple[hil.Simulation, Path]:
    """A run that ends in FAULT while its task's plan would go on; its recording beside it."""
    folder = tmp_path_factory.mktemp("stopped")
    (folder / "jump.toml").write_text('[[fault]]\nkind = "encoder_jump"\naxis = "y"\nat_s = 0.25\nvalue = 5e-2\n')
    path = folder / "run.mcap"
    return hil.simulate("paper", 0.5, scenario=folder / "jump.toml", record=path), path


@pytest.fixture(scope="module")
def recorded(stopped: tuple[hil.Simulation, Path]) -> hil.Run:
    """Its recording."""
    return hil.load_run(stopped[1])


@pytest.fixture(scope="module")
def run(stopped: tuple[hil.Simulation, Path]) -> hil.Simulation:
    """The run itself."""
    return stopped[0]


def test_no_setpoint_and_no_error_where_nothing_is_followed(run: hil.Simulation, recorded: hil.Run) -> None:
    for one in (run, recorded):
        state = one.columns["state"]
        assert set(state) >= {int(State.READY), int(State.ACTIVE), int(State.FAULT)}
        followed = (state == int(State.ACTIVE)) & (one.columns["motion"] != MotionWord.NONE)
        assert (one.columns["task_ns"][followed] >= 0).mean() > 0.99
        for name in FIELDS:
            assert np.isnan(one.columns[name][~followed]).all(), name
            assert np.isfinite(one.columns[name][followed]).all(), name


def test_a_recording_read_by_a_viewer_has_no_setpoint_in_a_fault(stopped: tuple[hil.Simulation, Path]) -> None:
    from hil.runs.summary import load_run

    data = load_run(stopped[1])  # as the file's Tick messages have it
    fault = data.columns["state"] == int(State.FAULT)
    assert fault.sum() > 100
    assert np.isnan(data.columns["setpoint_position"][fault]).all()


@pytest.mark.parametrize("first", [0, 60, 300])
def test_a_picture_ends_where_the_run_does_and_breaks_where_ticks_are_missing(
    run: hil.Simulation, monkeypatch: pytest.MonkeyPatch, first: int
) -> None:
    drawn: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    monkeypatch.setattr(Axes, "plot", lambda _panel, x, y, **_: drawn.append((np.array(x), np.array(y))))
    missing = slice(first, first + 100)
    columns = {name: np.delete(values, missing, axis=0) for name, values in run.columns.items()}
    gone = hil.Run(run.rig, columns)
    axis_svg(gone.rig, gone, 0)
    begin = run.time[100] if first == 0 else run.time[0]
    for x, _ in drawn:
        assert x[-1] == pytest.approx(gone.time[-1], abs=2e-3)
        assert x[-1] == pytest.approx(run.time[-1] - begin, abs=2e-3)
    force = drawn[2][1]
    if first:  # inside the run: the gap is a gap
        inside = (drawn[2][0] > run.time[first] + 2e-3) & (drawn[2][0] < run.time[first + 99] - 2e-3)
        assert inside.any()
        assert np.isnan(force[inside]).all()


def test_a_picture_takes_a_run_whose_clock_jumps_by_years(run: hil.Simulation) -> None:
    columns = {name: values[:50].copy() for name, values in run.columns.items()}
    columns["scheduled_ns"][25:] += 2**59
    jumped = hil.Run(run.rig, columns)
    assert "<svg" in axis_svg(jumped.rig, jumped, 0)


def test_a_fault_begins_at_any_time(tmp_path: Path) -> None:
    """Before READY nothing was ever followed."""
    (tmp_path / "early.toml").write_text('[[fault]]\nkind = "drive_fault"\nat_tick = 3\n')
    run = hil.simulate("paper", 0.05, scenario=tmp_path / "early.toml")
    assert np.isnan(run.setpoint).all()
    assert np.isnan(run.error).all()
