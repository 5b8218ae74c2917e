"""Random loops: the stability check's verdict against ticks that are simulated one by one for ten minutes.

The ticks come from equations that are written here: plant with a held force, the rig's filter, PD or PID, the force
one period late. The rule is the check's own: a pulse may neither grow nor circle, a kicked axis is back after OFFSET_S,
and no pole is beyond SETTLED. Laws without such equations are ticked by their own code.
"""

import random
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.analysis.pulse_loop import DECAYED, GROWN, pulse_and_kick
from hil.analysis.stability import OFFSET_LEFT, OFFSET_S, check_stability
from hil.control.estimator import filterpy_design
from hil.control.estimator.gains import design_gains
from hil.control.laws.base import Array
from hil.rig.file import build_rig
from hil.rig.schema import RigConfig

RATES_HZ = (100.0, 250.0, 500.0, 1000.0)
assert filterpy_design, "designs are made in this process, not in one child each"
OWN_CODE = ("disturbance-observer", "computed-torque", "structured-kalman")
SETTLED = 1.0 - 1e-12  # what grows more slowly than ten minutes show has a pole beyond it
WRONG_SIGN = "./wrong_sign.py:WrongSign"
HERE = Path(__file__).parent
_STATES = 8  # error, rate; the filter's position, velocity, disturbance; force, the one before; integral


class Loop(NamedTuple):
    """One axis under one law. kp, kd, ki: N/m, N s/m, N/(m s)."""

    law: str
    rate_hz: float
    mass: float
    kp: float
    kd: float
    ki: float

    @property
    def rig(self) -> RigConfig:
        """The loop as a rig."""
        limits = {"position": [-0.3, 0.3], "speed": 1.0, "force": 1e3, "force_rate": 1e7, "following_error": 0.01}
        axis = {"encoder_resolution": 1e-7, "rated_force": 1e3, "limits": limits, "model": {"mass": self.mass}}
        gains = {"kp": self.kp, "kd": self.kd} | ({"ki": abs(self.ki)} if self.law == "pid" else {})
        law = {"name": WRONG_SIGN if self.ki < 0.0 else self.law, "gains": gains}
        drives = {"watchdog_s": 3.0 / self.rate_hz}
        return build_rig(
            {"name": "drawn", "rate_hz": self.rate_hz, "axes": {"x": axis}, "law": law, "drives": drives}, folder=HERE
        )


class Verdict(NamedTuple):
    """Of the check, and of the ticks."""

    loop: Loop
    said: bool
    true: bool


def drawn(draw: random.Random, laws: tuple[str, ...] = ("pd-feedforward", "pid"), most_hz: float = 1000.0) -> Loop:
    """Stiffness none, next to none or real; bandwidths up to where the delay decides; integrators of either sign."""
    rate = draw.choice([rate for rate in RATES_HZ if rate <= most_hz])
    mass, bandwidth = 10.0 ** draw.uniform(-2.0, 1.3), rate / 10.0 ** draw.uniform(0.3, 2.3)
    kind = draw.random()
    kp = 0.0 if kind < 0.15 else 10.0 ** draw.uniform(-9.0, 0.0) if kind < 0.4 else mass * bandwidth**2
    kd = 2.0 * draw.uniform(0.05, 2.0) * mass * bandwidth
    kind = draw.random()
    wrong, slow = -(10.0 ** draw.uniform(-6.0, 1.0)), kp * bandwidth * 10.0 ** draw.uniform(-4.0, 0.3)
    ki = 0.0 if kind < 0.15 else wrong if kind < 0.45 else slow
    law = draw.choice(laws)
    return Loop(law, rate, mass, kp, kd, ki if law == "pid" else 0.0)


def verdicts(loops: list[Loop]) -> Iterator[Verdict]:
    """Of each loop, in the order of their rates."""
    for rate in sorted({loop.rate_hz for loop in loops}):
        those = [loop for loop in loops if loop.rate_hz == rate]
        with_equations = [loop for loop in those if loop.law not in OWN_CODE]
        if with_equations:
            for loop, true in zip(with_equations, ticked(with_equations), strict=True):
                yield Verdict(loop, said(loop), true)
        for loop in those:
            if loop.law in OWN_CODE:
                _, motion, kicked = pulse_and_kick(loop.rig, round(OFFSET_S * rate))
                yield Verdict(loop, said(loop), bool(holds(np.abs(motion), np.abs(kicked))[0]))


def said(loop: Loop) -> bool:
    """The check's verdict."""
    return check_stability(loop.rig).axes["x"].stable


def ticked(loops: list[Loop]) -> list[bool]:
    """Whether each loop holds, by OFFSET_S of ticks; all have one rate."""
    period, ticks = 1.0 / loops[0].rate_hz, round(OFFSET_S * loops[0].rate_hz)
    matrices = np.stack([tick_of(loop) for loop in loops])
    pulse = np.zeros((len(loops), _STATES, 2))
    for number, loop in enumerate(loops):
        pulse[number, :, 0] = _step(loop, np.zeros(_STATES), 1.0)
    pulse[:, 1, 1] = 1.0 / period  # kicked
    pulse[:, :, 1:] = matrices @ pulse[:, :, 1:]
    seen = np.zeros((ticks, len(loops), 2))
    with np.errstate(all="ignore"):
        for k in range(ticks):
            seen[k] = np.abs(pulse[:, 0] + period * pulse[:, 1])
            pulse = matrices @ pulse
    held = holds(seen[:, :, 0], seen[:, :, 1])
    return [bool(each) and radius_of(loop) < SETTLED for each, loop in zip(held, loops, strict=True)]


def radius_of(loop: Loop) -> float:
    """Of the slowest pole; an integral without a gain is no part of the loop."""
    states = _STATES if loop.ki else _STATES - 1
    return float(np.abs(np.linalg.eigvals(tick_of(loop)[:states, :states])).max())


def holds(motion: Array, kicked: Array) -> Array:
    """By the check's rule, of sizes (ticks, loops): after a pulse, and after a kick."""
    quarter, last = len(motion) // 4, max(1, len(kicked) // 100)
    with np.errstate(all="ignore"):
        small = np.all(motion < GROWN, axis=0)
        decays = motion[-quarter:].max(axis=0) <= DECAYED * motion.max(axis=0)
        back = kicked[-last:].max(axis=0) <= OFFSET_LEFT * kicked.max(axis=0)
    found: Array = small & decays & back
    return found


def tick_of(loop: Loop) -> Array:
    """The matrix of one tick, (states, states)."""
    return np.array([_step(loop, unit, 0.0) for unit in np.eye(_STATES)]).T


def _step(loop: Loop, state: Array, pulse: float) -> Array:
    """One tick with a pulse on the measured error."""
    e, r, p, v, d, last, before, integral = state
    period, mass = 1.0 / loop.rate_hz, loop.mass
    k1, k2, k3 = _filter_of(loop)
    change = (before - d) / mass * period
    predicted = p + (0.5 * change + v) * period
    innovation = e + pulse - predicted
    p, v, d = predicted + k1 * innovation, v + change + k2 * innovation, d + k3 * innovation
    ahead = (last - d) / mass * period
    position, velocity = p + (0.5 * ahead + v) * period, v + ahead
    integral -= loop.ki * position * period
    force = integral - loop.kp * position - loop.kd * velocity
    speed = last / mass * period
    return np.array([e + (r + 0.5 * speed) * period, r + speed, p, v, d, force, last, integral])


_filters: dict[tuple[float, float], tuple[float, float, float]] = {}


def _filter_of(loop: Loop) -> tuple[float, float, float]:
    at = (loop.mass, loop.rate_hz)
    if at not in _filters:
        k1, k2, k3 = (float(gain[0]) for gain in design_gains(loop.rig)[0])
        _filters[at] = k1, k2, k3
    return _filters[at]


def told(number: int, own_code: int, seed: int) -> bool:
    """Print every loop whose verdict is wrong, and the counts; whether at least 99 % are right and none of those that
    do not hold was called stable.
    """
    draw = random.Random(seed)
    loops = [drawn(draw) for _ in range(number)] + [drawn(draw, OWN_CODE, 100.0) for _ in range(own_code)]
    right = held = wrongly_stable = 0
    for verdict in verdicts(loops):
        right += verdict.said == verdict.true
        held += verdict.true
        if verdict.said != verdict.true:
            wrongly_stable += verdict.said
            words = ("stable", "does not hold") if verdict.said else ("not stable", "holds")
            print(f"the check says {words[0]}, by ticks it {words[1]}: {verdict.loop}", flush=True)
    print(f"loops, seed {seed}: {right} of {len(loops)} verdicts right; {held} hold; {wrongly_stable} wrongly stable")
    return right >= 0.99 * len(loops) and not wrongly_stable
