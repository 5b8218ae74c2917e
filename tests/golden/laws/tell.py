"""What every law asks for over one script, on a stiff model and on one with lag and a spring.

The script has what wears on a law: moves and rests of two axes of unlike lengths, reversals, noise, samples that are
missing, slots that were skipped, forces that were cut. Its numbers come from additions and multiplications alone, so
that they are the same bits everywhere.
"""

import dataclasses
import random
import struct
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np

from hil.control.laws import make_axis_laws, make_law
from hil.control.laws.base import Array, LawInputs, Model, Reference
from hil.control.nominal_model import blank_inputs
from hil.rig.file import load_rig
from hil.rig.law_names import LAWS
from hil.rig.schema import LawConfig
from tests.golden.golden import sha256
from tests.support.paths import RIGS

PERIOD = 1e-3
TICKS = 260
LIMIT = np.array([5.0, 3.0])
TRAVEL = np.array([0.02, -0.003])  # m, of a move
MOVE, REST = 60, 25  # ticks
REPEAT_NS = 2 * (MOVE + REST) * 1_000_000


def models() -> dict[str, Model]:
    """A stiff, quick drive, and one that lags and carries its tool on a spring."""
    stiff = Model(
        mass=np.array([0.022, 0.35]), coulomb=np.array([1.146, 0.172]), viscous=np.array([-0.047, 2.0]),
        quadratic=np.array([0.0026, -0.0015]), gravity=np.array([0.0, 0.7]),
    )  # fmt: skip
    soft = dataclasses.replace(
        stiff, torque_lag=np.array([3e-4, 2e-4]), mode_frequency=np.array([90.0, 60.0]),
        mode_damping=np.array([0.02, 0.05]), mode_load=np.array([0.3, 0.2]),
    )  # fmt: skip
    return {"stiff": stiff, "soft": soft}


@cache
def laws() -> dict[str, LawConfig]:
    """Every law with its own gains and with those of both rigs, and one inside iterative learning."""
    configured = {name: LawConfig(name=name) for name in LAWS} | {"learning": LawConfig(iterative_learning=True)}
    for rig in ("paper", "microscope-ideal"):
        for name, gains in load_rig(RIGS / f"{rig}.toml").law.tuned.items():
            two = {key: value[:2] if isinstance(value, list) else value for key, value in gains.items()}
            configured[f"{name}, gains of {rig}.toml"] = LawConfig(name=name, gains=two)
    return configured


def _setpoint(k: int, offset: float) -> Reference:
    """Minimum-jerk moves to and fro with rests between, `offset` ticks after tick k."""
    t = max(k + offset, 0.0)
    whole = int(t // (MOVE + REST))
    u, back = min((t - whole * (MOVE + REST)) / MOVE, 1.0), whole % 2
    s, span = u * u * u * (10.0 + u * (6.0 * u - 15.0)), MOVE * PERIOD
    v = 30.0 * u * u * (u * (u - 2.0) + 1.0) / span
    a = 60.0 * u * (1.0 + u * (2.0 * u - 3.0)) / (span * span)
    place, sign = (1.0 - s, -1.0) if back else (s, 1.0)
    return Reference(TRAVEL * place, TRAVEL * (sign * v), TRAVEL * (sign * a))


def script() -> Iterator[LawInputs]:
    """A tick's inputs, but for the forces that were applied."""
    noise = random.Random(29)
    for k in range(TICKS):
        inputs = blank_inputs((2,))
        inputs.sample, inputs.start, inputs.end = _setpoint(k, -1.0), _setpoint(k, 0.0), _setpoint(k, 1.0)
        error = np.array([(noise.random() - 0.5) * 4e-5, (noise.random() - 0.4) * 1e-4])
        inputs.position = inputs.sample.position + error
        inputs.fresh = np.array([float(k % 17 != 3), float(k % 23 != 5)])
        inputs.answered = np.maximum(inputs.fresh[0], inputs.fresh[1])
        late = 2.0 if k % 37 == 11 else 1.0
        inputs.sample_interval = np.array([late * PERIOD, PERIOD])
        inputs.ahead = np.array([PERIOD, 1.05 * PERIOD])
        inputs.position_estimate = inputs.start.position + 0.9 * error
        inputs.velocity_estimate = inputs.start.velocity + 20.0 * error
        inputs.disturbance_estimate = 1e3 * error
        inputs.mean_velocity = (inputs.end.position - inputs.start.position) / PERIOD
        inputs.mean_acceleration = (inputs.end.velocity - inputs.start.velocity) / PERIOD
        total = np.abs(inputs.start.velocity) + np.abs(inputs.end.velocity)
        signed = inputs.start.velocity + inputs.end.velocity
        inputs.mean_sign = np.divide(signed, total, out=np.zeros(2), where=total > 0.0)
        inputs.task_ns = k * 1_000_000
        yield inputs


def _one_axis(inputs: LawInputs, axis: int) -> LawInputs:
    def pick(value: Any) -> Any:
        if isinstance(value, Reference):
            return Reference(*(float(getattr(value, field.name)[axis]) for field in dataclasses.fields(Reference)))
        return float(value[axis]) if isinstance(value, np.ndarray) and value.ndim else value

    return LawInputs(**{field.name: pick(getattr(inputs, field.name)) for field in dataclasses.fields(LawInputs)})


def play(config: LawConfig, model: Model) -> tuple[list[list[float]], list[list[float]]]:
    """Forces asked for, N, tick by tick: of the law on arrays, and of one law of floats an axis."""
    repeat = (REPEAT_NS, 0)
    arrays, floats = (
        make_law(config, model, PERIOD, LIMIT, repeat),
        make_axis_laws(config, model, PERIOD, LIMIT, repeat),
    )
    first = _setpoint(0, 0.0).position
    arrays.reset(first, np.asarray(model.gravity) + 0.1)
    floats.reset(first.tolist(), (np.asarray(model.gravity) + 0.1).tolist())
    last: Array = np.zeros(2)
    before: Array = np.zeros(2)
    asked: tuple[list[list[float]], list[list[float]]] = ([], [])
    for inputs in script():
        inputs.force_last, inputs.force_before = last, before
        together = np.array(arrays.force(inputs))
        asked[0].append(together.tolist())
        asked[1].append(floats.force([_one_axis(inputs, axis) for axis in range(2)]))
        last, before = np.clip(together, -LIMIT, LIMIT), last
    return asked


def stories() -> list[str]:
    """Their names."""
    return list(laws())


def tell(story: str) -> list[str]:
    """Of a law, on each model."""
    return [line for kind, model in models().items() for line in lines(kind, play(laws()[story], model)[0])]


def lines(kind: str, asked: Sequence[Sequence[float]]) -> list[str]:
    """Some of the forces that were asked for, and the hash of all of them."""
    forces = np.array(asked)
    most = ", ".join(f"{force:.6g}" for force in np.abs(forces).max(axis=0))
    shown = [f"{kind}, tick {k}: {', '.join(f'{force:.6g} N' for force in asked[k])}" for k in range(0, TICKS, 20)]
    told = sha256(*(struct.pack("<2d", *force) for force in asked), digits=64)
    return [*shown, f"{kind}, most: {most} N", f"{kind}, sha256 of all forces: {told}"]
