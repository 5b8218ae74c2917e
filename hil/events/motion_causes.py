"""Why an axis left its set-point, by the ticks before: it rings, its encoder stepped or stands still, it was pushed."""

from typing import Final, NamedTuple

import numpy as np

from hil.cycle.faults.row import RESET
from hil.events.axis_model import AxisModel, Floats, steps
from hil.events.ringing import ringing_hz

RINGS: Final = "rings at"  # what a cause of that begins with
FROZEN: Final = 20  # ticks of one and the same count, while the setpoint moves
_HALTED: Final = 4  # ticks of one count after one that moved by _FAST counts: no axis stops within a tick
_FAST: Final = 20.0
_LEAST: Final = 5  # ticks that a push is judged by
_SINGLE: Final = 4  # steps of a jump
_BEGUN: Final = 0.05  # of the error at the end, where the deviation began
_OUTSIDE: Final = 1.5  # times the dry friction, that no model is off by
_UNKNOWN: Final = 0.1  # of the model's gravity
_OFF: Final = 0.25  # of the force applied, that mass and force constant may be off by
_DELAYED: Final = 2.0  # times too much or too little, that a growing force seems to do, as it comes ticks later
_WEAK: Final = 1.1  # times gravity, at most what a weak drive lets go


class Cause(NamedTuple):
    """Why, and what to do. axis: 0-based, whose it is; -1: not known, or of all."""

    text: str
    action: str
    axis: int = -1


class Motion(NamedTuple):
    """One axis in the ticks up to now, (n,), m, m/s and N (rad, rad/s, N m). error: position less set-point."""

    position: Floats
    setpoint: Floats
    velocity: Floats  # of the set-point
    error: Floats
    force: Floats


def why_it_left(motion: Motion, model: AxisModel | None, period_s: float, axis: int) -> Cause | None:
    """None where nothing more is known than the fault itself. model: None where the axis is not known."""
    known = model if len(motion.position) > _LEAST else None
    if (cause := _frozen(motion, model, axis)) is not None:  # first, as an axis that seems to halt has stepped, too
        return cause
    if known is not None and (cause := _jumped(motion, known, period_s, axis)) is not None:
        return cause
    return _pushed(motion, known, period_s, axis) if known is not None else None


def ringing(motion: Motion, model: AxisModel | None, period_s: float, axis: int) -> Cause | None:
    """None where the axis does not swing to and fro."""
    resolution = model.resolution if model else 0.0
    frequency = ringing_hz(motion.error, motion.force, motion.setpoint, resolution, period_s)
    if frequency is None:
        return None
    why = "a resonance that the model does not have, gains too high, or something shakes the stage"
    return Cause(f"{RINGS} {frequency:.0f} Hz: {why}", f"hil check, lower the gains, {RESET}", axis)


def _jumped(motion: Motion, model: AxisModel, period_s: float, axis: int) -> Cause | None:
    found = steps(model, period_s, motion.position, motion.force, motion.velocity)
    if not found.beyond:
        return None
    action = f"check the encoder's cable and head; home the axis, {RESET}"
    if found.beyond > _SINGLE:
        return Cause(f"noise at the encoder or its cable: {found.beyond} steps that no force explains", action, axis)
    counts = round(found.worst[0] / model.resolution)
    text = f"encoder jump: a step of {counts} counts in one tick, which no force explains"
    return Cause(f"{text}: the encoder lost or won counts, or noise at its cable", action, axis)


def _frozen(motion: Motion, model: AxisModel | None, axis: int) -> Cause | None:
    """Whether the axis shows one and the same count while its setpoint moves on."""
    position, setpoint = motion.position, motion.setpoint
    changes = np.flatnonzero(position != position[-1])
    first = int(changes[-1]) + 1 if len(changes) else 0
    ticks = len(position) - first
    halted = ticks >= _HALTED and first > 1 and model is not None
    halted = halted and abs(position[first - 1] - position[first - 2]) > _FAST * (model.resolution if model else 0.0)
    if (not halted and ticks < FROZEN) or np.ptp(setpoint[first:]) <= 0.05 * abs(float(motion.error[-1])):
        return None
    action = f"check the encoder's head and cable; move the axis by hand, {RESET}"
    if halted:
        text = f"encoder stuck: not one new count for {ticks} ticks, from one tick to the next at full speed"
    else:
        text = f"encoder stuck, or the axis blocked: not one new count for {ticks} ticks while the setpoint moved"
    return Cause(text, action, axis)


def _against(motion: Motion, model: AxisModel, first: int, period_s: float, axis: int) -> Cause | None:
    """Whether the way since tick `first` is that of the force asked for, turned round, and not that of a steady push
    with that force against it.
    """
    acting = np.concatenate((motion.force[first : first + 1], motion.force[first:-1]))  # of the tick before
    dry = model.dry * np.sign(motion.error[-1] - motion.error[first])
    ticks = np.arange(len(acting))
    line = np.stack((np.ones(len(ticks)), ticks))
    own = np.cumsum(np.cumsum(acting)) * period_s**2 / model.mass
    fallen = 0.5 * (model.gravity - dry) / model.mass * (ticks * period_s) ** 2
    position = motion.position[first:]
    turned, misses = _fit(np.vstack((line, fallen - own)), position)
    _, of_push = _fit(np.vstack((line, ticks**2)), position - own)
    if not 1.0 / _DELAYED <= turned <= _DELAYED or misses > 0.5 * of_push or misses > _BEGUN * float(np.ptp(position)):
        return None
    text = "the axis goes against the force asked for: wrong direction of axis or drive"
    return Cause(text, f"check axes.AXIS.direction and the drive's own sense, {RESET}", axis)


def _fit(rows: Floats, values: Floats) -> tuple[float, float]:
    """(factor of the last of `rows`, RMS of what is left) by least squares; rows: (k, n), values: (n,)."""
    found, *_ = np.linalg.lstsq(rows.T, values, rcond=None)
    return float(found[-1]), float(np.sqrt(np.mean((values - found @ rows) ** 2)))


def _pushed(motion: Motion, model: AxisModel, period_s: float, axis: int) -> Cause | None:
    """Whether the axis went where nothing but an outside force takes it: it gains speed that way, against friction."""
    error = motion.error
    quiet = np.flatnonzero(np.abs(error) <= _BEGUN * abs(float(error[-1])))
    first = int(quiet[-1]) if len(quiet) else 0
    if len(error) - first < _LEAST:
        return None
    if (cause := _against(motion, model, first, period_s, axis)) is not None:
        return cause
    seconds = np.arange(len(error) - first) * period_s
    deviation = motion.position[first:]
    curve, slope, _ = np.polyfit(seconds, deviation, 2)
    acting = float(np.mean(motion.force[first:])) + model.gravity
    speed = slope + curve * seconds[-1]  # in the middle of the ticks
    outside = model.mass * 2.0 * curve + model.wet * speed - acting
    moved = float(error[-1] - error[first])
    if (
        abs(outside) <= _OUTSIDE * model.dry + _UNKNOWN * abs(model.gravity) + _OFF * abs(acting)
        or outside * moved <= 0.0
        or outside * speed <= 0.0
    ):
        return None
    sense = "upwards" if outside > 0.0 else "downwards"
    action = f"look for what touches the axis, and at its drive, {RESET}"
    if outside * model.gravity > 0.0 and abs(outside) <= _WEAK * abs(model.gravity) + model.dry:
        text = "the drive gives less force than asked for and the axis sinks, or something pulls on it"
    else:
        text = "the axis was pushed or pulled"
    return Cause(f"{text}: about {abs(outside):.2g} N (N m) {sense} that nobody asked for", action, axis)
