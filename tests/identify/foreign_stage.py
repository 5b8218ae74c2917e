"""The experiments on a stage that no code of hil moves: the tests' integrator, with the experiments' law around it."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from hil.control.laws.base import Model
from hil.identify.excitation import Excitation
from hil.identify.experiments import ROW_S
from hil.identify.lockstep import APPROACH_S, Trial
from hil.rig.schema import RigConfig
from hil.runs.api import Run
from hil.runs.rigs import Rig
from tests.identify.stages import PERIOD, Array, Bristle, Hung, MaxwellSlip, record

PERIOD_NS = round(PERIOD * 1e9)


class ForeignStage:
    """A Runner (hil/identify/lockstep.py) of one axis; its encoder, drive and clock are ideal. following: by
    experiment, the greatest following error over its limit.
    """

    def __init__(
        self,
        friction: Bristle | MaxwellSlip,
        mass: float,
        viscous: float,
        weight: float = 0.0,
        hung: Sequence[Hung] = (),
    ) -> None:
        self._hung = hung
        self._friction, self._mass, self._viscous, self._weight = friction, mass, viscous, weight
        self.following: dict[str, float] = {}

    def __call__(self, trial: Trial) -> tuple[Run, str]:
        rig = Rig.build(trial.document, trial.folder).config
        law, way = _law(rig, trial), _reference(trial)
        asked, n = _asked(law, way), round(trial.seconds / PERIOD)
        count = rig.axes[trial.axis].encoder_resolution
        own = self._mass, self._viscous, self._weight, count
        force, position = record(self._friction, asked, n * PERIOD, *own, hung=self._hung)
        error = position - way(np.arange(n) * PERIOD)[0]
        self.following[trial.experiment] = float(np.abs(error).max() / rig.axes[trial.axis].limits.following_error)
        return _as_run(rig, trial.axis, force, position, error), "foreign"


def _law(rig: RigConfig, trial: Trial) -> Excitation:
    model = rig.axes[trial.axis].model
    known = Model(mass=model.mass, coulomb=0.0, viscous=0.0, quadratic=0.0, gravity=-model.gravity)
    gains = {key: values[0] if isinstance(values, list) else values for key, values in rig.law.gains.items()}
    return Excitation(known, PERIOD, rig.axes[trial.axis].limits.force, **gains)


def _reference(trial: Trial) -> Any:
    """Position (m), velocity and acceleration of the plan at times (s)."""
    rows = trial.plan.positions
    fine = np.interp(np.arange(round(len(rows) * ROW_S / PERIOD)) * PERIOD, np.arange(len(rows)) * ROW_S, rows)
    smooth = np.convolve(np.pad(fine, 10, mode="edge"), np.ones(21) / 21, mode="valid")  # rows are 10 ms apart
    speed = np.gradient(smooth, PERIOD)
    curves = smooth, speed, np.gradient(speed, PERIOD)

    def at(seconds: Any) -> Any:
        k = np.clip(np.rint((np.asarray(seconds) - APPROACH_S) / PERIOD).astype(int), 0, len(smooth) - 1)
        return tuple(curve[k] for curve in curves)

    return at


def _asked(law: Excitation, way: Any) -> Any:
    def asked(seconds: float, position: float, speed: float) -> float:
        wanted, rate, acceleration = (float(value) for value in way(seconds))
        inputs: Any = SimpleNamespace(
            start=SimpleNamespace(position=wanted, velocity=rate), position=position, position_estimate=position,
            velocity_estimate=speed, mean_velocity=rate, mean_acceleration=acceleration, mean_sign=float(np.sign(rate)),
            task_ns=round(seconds * 1e9),
        )  # fmt: skip
        return float(law.force(inputs))

    return asked


def _as_run(rig: RigConfig, axis: str, force: Array, position: Array, error: Array) -> Run:
    """As a recording has it: the sample of a tick's command comes with the next tick."""
    ticks = np.arange(len(force) + 1)
    columns = {
        "index": ticks, "scheduled_ns": ticks * PERIOD_NS, "now_ns": ticks * PERIOD_NS, "task_ns": ticks * PERIOD_NS,
        "age_ticks": np.zeros((len(ticks), 1), np.int64), "force": np.append(force, force[-1])[:, None],
        "position": np.concatenate([position[:1], position])[:, None],
        "following_error": np.concatenate([error[:1], error])[:, None],
        "stamp_ns": np.concatenate([[-PERIOD_NS], ticks[:-1] * PERIOD_NS])[:, None],
    }  # fmt: skip
    return cast("Run", SimpleNamespace(axes=[axis], rig=rig, columns=columns, summary=lambda: {"faults": []}))
