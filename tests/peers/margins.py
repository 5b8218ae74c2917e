"""python-control's margins of loops that are written as equations here, and ours, found by pulses into our code."""

import math
import random
from collections.abc import Iterator
from typing import Any

import numpy as np

from hil.analysis.pulse_loop import pulse_response
from hil.analysis.stability import ANSWER, LoopMargins, margins
from hil.control.estimator.gains import design_gains
from hil.control.nominal_model import rig_model
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from tests.peers.sources import UnavailableError, tool
from tests.peers.table import DIFFERS, NOT_RUN, PASSED, Row
from tests.support.paths import RIGS

GAIN_DB, PHASE_DEG = 0.1, 0.5  # that the two may differ by
PEER = "python-control"


def rows(number: int) -> Iterator[Row]:
    """A row a drawn rig and one of its axes."""
    try:
        control = tool("control")
    except UnavailableError as error:
        yield Row(PEER, "margins", NOT_RUN, str(error))
        return

    draw = random.Random(44)
    for count in range(number):
        rig = drawn(draw)
        axis = count % len(rig.axes)
        loop = loop_of(control, rig, axis)
        if not _stable(loop):  # a loop has margins only where it is stable
            continue
        ours, theirs = margins(pulse_response(rig, ANSWER)[0][:, axis]), margins_by(control, loop)
        pairs = (
            (ours.gain_db, theirs.gain_db, GAIN_DB, "dB"),
            (ours.phase_margin, theirs.phase_margin, PHASE_DEG, "deg"),
        )
        equal = all(a == b or abs(a - b) <= bound for a, b, bound, _ in pairs)
        told = ", ".join(f"{a:.3f} and {b:.3f} {unit}" for a, b, _, unit in pairs)
        yield Row(PEER, f"rig {count}", PASSED if equal else DIFFERS, f"ours and theirs: {told}")


def drawn(draw: random.Random) -> RigConfig:
    """The paper's rig with a PD law, its rate, masses and gains drawn."""
    facts = load_rig(RIGS / "paper.toml").model_dump(exclude_unset=True)
    facts["rate_hz"] = draw.choice((200.0, 500.0, 1000.0, 2000.0))
    kp, kd = [], []
    for axis in facts["axes"].values():
        axis["model"]["mass"] *= 2.0 ** draw.uniform(-1.0, 1.0)
        damping, bandwidth = draw.uniform(0.4, 1.5), facts["rate_hz"] / draw.uniform(15.0, 60.0)
        kp.append(axis["model"]["mass"] * bandwidth**2)
        kd.append(2.0 * damping * axis["model"]["mass"] * bandwidth)
    facts["law"] = {"name": "pd-feedforward", "gains": {"kp": kp, "kd": kd}}
    return RigConfig.model_validate(facts)


def loop_of(control: Any, rig: RigConfig, axis: int) -> Any:
    """The loop gain as a state space, from the sample to the position, negated.

    States: position, velocity; the filter's position, velocity and disturbance; the force of the interval that begins
    with the sample, and that of the one before. The force answering a sample acts one period later.
    """
    period, mass = rig.period_ns * 1e-9, float(rig_model(rig).mass[axis])
    filter_gains = [float(gain[axis]) for gain in design_gains(rig)[0]]
    gains = rig.law.effective_gains()
    kp, kd = float(gains["kp"][axis]), float(gains["kd"][axis])

    def step(x: Any, sample: float) -> list[float]:
        e, r, p, v, d, force, before = x
        change = (before - d) / mass * period
        predicted = p + (0.5 * change + v) * period
        innovation = sample - predicted
        p = predicted + filter_gains[0] * innovation
        v = v + change + filter_gains[1] * innovation
        d = d + filter_gains[2] * innovation
        change = (force - d) / mass * period
        answer = -kp * (p + (0.5 * change + v) * period) - kd * (v + change)
        speed = force / mass * period
        return [e + (r + 0.5 * speed) * period, r + speed, p, v, d, answer, force]

    a = np.array([step(unit, 0.0) for unit in np.eye(7)]).T
    b = np.array(step(np.zeros(7), 1.0))[:, None]
    c = np.array([[-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    return control.ss(a, b, c, 0.0, period)


def _stable(loop: Any) -> bool:
    return bool(np.all(np.abs(np.linalg.eigvals(loop.A - loop.B @ loop.C)) < 1.0))


def margins_by(control: Any, loop: Any) -> LoopMargins:
    """By the peer, of the frequency response at 1000 frequencies."""
    omega = np.geomspace(1e-3, 1.0, 1001)[:-1] * math.pi / loop.dt
    response = loop(np.exp(1j * omega * loop.dt))
    data = (np.abs(response), np.degrees(np.unwrap(np.angle(response))), omega)
    gain, phase, *_ = control.stability_margins(data, returnall=True)
    up, down = gain[gain > 1.0], gain[gain < 1.0]
    return LoopMargins(
        float(up.min()) if up.size else None,
        float(down.max()) if down.size else None,
        float(np.abs(phase).min()) if phase.size else None,
    )
