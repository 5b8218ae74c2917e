"""Ticks that came late, or not at all: what is known of an axis then, where its stamps tell when that was."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.identify.estimate import Refused
from hil.identify.frequency_fit import Pass, response_of
from hil.identify.signals import Signals, signals
from hil.runs.api import Run, simulate
from tests.identify import rigs

PERIOD_NS, MASS, SPEED, BASE = 1_000_000, 0.9, 0.02, 200
LINES = range(2, 80, 4)  # 10 to 390 Hz
Array = NDArray[np.float64]


def late_run(late_ns: NDArray[np.int64], sign: int, *, stamped: bool = True, lost: tuple[int, ...] = ()) -> Run:
    """A free mass at 20 mm/s under a multisine; its drive samples, and takes each force, when the late tick's command
    comes. Between two commands the force stays, so that the motion is exact.
    """
    n = len(late_ns)
    phases = np.random.default_rng(3).uniform(0.0, 6.28, len(LINES))
    angle = 2.0 * np.pi * np.outer(np.arange(BASE), LINES) / BASE
    wave = sign * 0.05 * np.cos(angle + phases).sum(axis=1)
    kept = np.setdiff1d(np.arange(n), lost)
    force, comes = wave[kept % BASE], kept * PERIOD_NS + late_ns[kept]
    seconds = np.diff(comes, append=comes[-1] + PERIOD_NS) * 1e-9
    speed = SPEED + np.concatenate([[0.0], np.cumsum(force / MASS * seconds)])[:-1]
    position = np.concatenate([[0.0], np.cumsum(speed * seconds + 0.5 * force / MASS * seconds**2)])[:-1]
    columns = {
        "index": kept, "scheduled_ns": kept * PERIOD_NS, "now_ns": comes - 50_000, "task_ns": kept * PERIOD_NS,
        "force": force[:, None], "age_ticks": np.zeros((len(kept), 1), np.int64),
        "position": np.concatenate([[0.0], position[:-1]])[:, None],
        "stamp_ns": np.concatenate([[0], comes[:-1]])[:, None],
    }  # fmt: skip
    if not stamped:
        columns["now_ns"] = columns["scheduled_ns"]
        del columns["stamp_ns"]
    rig = rigs.one_axis().config
    return cast("Run", SimpleNamespace(axes=["x"], rig=rig, columns=columns))


def response_off(made: list[Signals]) -> Array:
    """By how much the response of such runs, one for each sign, is off that of the mass, dB."""
    ticks = slice(BASE, 5 * BASE)
    passes = [
        Pass(of.step[ticks], of.late[ticks], of.position[ticks], 1, sign, BASE)
        for of, sign in zip(made, (1, -1) * 4, strict=True)
    ]
    measured = response_of(passes, PERIOD_NS * 1e-9, LINES, BASE)
    z = np.exp(2j * np.pi * measured.frequency_hz * PERIOD_NS * 1e-9)
    mass = (PERIOD_NS * 1e-9) ** 2 * (z + 1.0) / (2.0 * MASS * (z - 1.0) ** 2)
    return cast("Array", 20.0 * np.log10(np.abs(measured.response / mass)))


def test_a_response_is_true_though_the_ticks_were_late() -> None:
    random = np.random.default_rng(11)
    late = [random.exponential(60_000.0, 6 * BASE).astype(np.int64) for _ in range(8)]
    runs = [late_run(each, sign) for each, sign in zip(late, (1, -1) * 4, strict=True)]
    assert np.abs(response_off([signals(run, "x") for run in runs])).max() < 0.1
    blind = [late_run(each, sign, stamped=False) for each, sign in zip(late, (1, -1) * 4, strict=True)]
    with pytest.raises(AssertionError):
        assert np.abs(response_off([signals(run, "x") for run in blind])).max() < 1.0


def test_a_force_lasts_while_a_tick_is_late_or_lost() -> None:
    late = np.zeros(6 * BASE, np.int64)
    late[300] = 400_000
    whole, held = signals(late_run(0 * late, 1), "x"), signals(late_run(late, 1, lost=(310,)), "x")
    assert held.force[300] == pytest.approx(0.4 * whole.force[299] + 0.6 * whole.force[300])
    assert held.force[310] == pytest.approx(whole.force[309])
    others = np.setdiff1d(np.arange(len(whole.force)), [300, 310])
    assert np.allclose(held.force[others], whole.force[others])


def test_instants_within_a_gap_of_the_samples_are_told() -> None:
    of = signals(late_run(np.zeros(6 * BASE, np.int64), 1, lost=(300, 600, 601, 602)), "x")
    assert np.flatnonzero(of.stalled).tolist() == [599, 600, 601, 602]


def test_a_few_lost_ticks_are_filled_in_and_many_are_refused() -> None:
    task: dict[str, Any] = {"kind": "point_to_point", "axes": ["x"], "target": [2e-3], "move_s": 0.15, "dwell_s": 0.1}
    run = simulate(rigs.one_axis(task=task, law={"name": "pid"}), 2.0)
    whole = signals(run, "x")
    kept = np.ones(len(run.time), bool)
    kept[[700, 1200, 1201]] = False
    run.columns = {name: column[kept] for name, column in run.columns.items()}
    filled = signals(run, "x")
    assert np.allclose(filled.seconds, whole.seconds, atol=1e-6)
    assert np.abs(filled.position - whole.position).max() < 1e-6
    run.columns = {name: column[::50] for name, column in run.columns.items()}
    with pytest.raises(Refused, match=r"ticks are missing; limit 0\.5 %"):
        signals(run, "x")
