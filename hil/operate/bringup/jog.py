"""Jogging one axis: a capped force while a key is held, and zero force within a period of its time-out.

Rules. One drive is enabled, the one of the axis, and only while a key is held (a terminal repeats it). The force is at
most `force` beyond what holds the axis against gravity by its nominal model, and goes through the torque gate
(hil/cycle/gate.py). It rises slowly, from half the nominal friction, until the axis moves
at `speed`, falls ten times as fast beyond it, and damps the motion by the nominal mass. The jog ends, with zero force
in the same tick, at any other key, at a fault of the drive, where its position stays away, beyond `distance` from the
start, and beyond twice `speed`.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

from drivers.frame import Frame
from drivers.protocols.base import UNHEALTHY, DriveStatus
from hil.cycle.supervisor import RESET_TICKS
from hil.operate.bringup.drive_host import DriveHost
from hil.rig.schema import RigConfig

POSITIVE, NEGATIVE = "p", "n"
KEY_TIMEOUT_S = 0.3
SPEED = 0.05  # of limits.speed, where no speed is asked for
DISTANCE = 0.05  # of the travel, where no distance is asked for
UNLATCH_S = 2.0  # at most; and at least so many ticks, in which answers to the reset come:
_UNLATCH_LEAST_TICKS = 10 * RESET_TICKS
_LOST_S = 0.05  # without a position; and never less than so many periods of it:
_LOST_PERIODS = 4
_WINDOW = 4  # ticks over which speed is taken
_DAMPING_TICKS = 10  # time constant of the damping: well beyond the delay of what is measured
_RISE_S = 2.0  # of the force, from nothing to its cap
_FALL = 10.0  # times as fast


class JogSettings(NamedTuple):
    """axis: its place among [axes]. force: N (N m); speed: m/s (rad/s); distance: m (rad); key_timeout_s: s."""

    axis: int
    force: float
    speed: float
    distance: float
    key_timeout_s: float = KEY_TIMEOUT_S


def jog_settings(
    rig: RigConfig, name: str, force: float | None, speed: float | None, distance: float | None
) -> JogSettings:
    """From the rig file, where the operator leaves something open. Raises ValueError naming what is out of range."""
    if name not in rig.axes:
        raise ValueError(f"axis {name!r}: the rig has {', '.join(rig.axes)}")
    axis = rig.axes[name]
    most = axis.limits.force - abs(axis.model.gravity)
    if force is None:
        if axis.push is None:
            raise ValueError(
                f"--force: state the greatest force, above 0 and at most {most:g}; the rig has no axes.{name}.push "
                f"to take it from. A first try: {min(most, 3.0 * axis.model.coulomb) or most:.2g}"
            )
        force = axis.push.force
    if not 0.0 < force <= most:
        raise ValueError(f"force {force:g}: above 0, and with gravity at most axes.{name}.limits.force: {most:g}")
    low, high = axis.limits.position
    speed = SPEED * axis.limits.speed if speed is None else speed
    distance = DISTANCE * (high - low) if distance is None else distance
    if not 0.0 < speed <= axis.limits.speed / 2:
        raise ValueError(f"speed {speed:g}: above 0, at most half of axes.{name}.limits.speed = {axis.limits.speed:g}")
    if not 0.0 < distance <= high - low:
        raise ValueError(f"distance {distance:g}: above 0, at most the travel {high - low:g}")
    return JogSettings(list(rig.axes).index(name), force, speed, distance)


class Unlatch:
    """Reset the drives at zero force until the one of the axis is well, for UNLATCH_S at most; `step` until `done`.

    A drive whose host fell silent may have latched its watchdog: after another session, and while a report is shown.
    """

    def __init__(self, host: DriveHost, axis: int) -> None:
        self.host, self._axis = host, axis
        self._tick = 0
        self._most_ticks = round(UNLATCH_S * 1e9 / host.rig.period_ns)
        self.done = False

    def step(self, now_ns: int, frames: Sequence[Frame]) -> list[Frame]:
        """One tick: the frames received since the last one, and those to send now."""
        self.host.take(frames, now_ns)
        self._tick += 1
        well = not self.host.status(self._axis) & UNHEALTHY and not self.host.problem(self._axis)
        self.done = self._tick > self._most_ticks or (well and self._tick > _UNLATCH_LEAST_TICKS)
        return self.host.zero(reset=RESET_TICKS < self._tick <= 2 * RESET_TICKS)


class Jog:
    """The procedure; `step` once a tick until `done`, then `host.zero` for a while.

    keys: what was pressed since the last call, oldest first. ended: why it is over, in words. moved: since the start,
    m (rad). farthest: the greatest of it either way. was_enabled: the drive said once that it applies torque.
    """

    def __init__(self, host: DriveHost, settings: JogSettings, keys: Callable[[], str]) -> None:
        self.host, self.settings = host, settings
        rig = host.rig
        axis = list(rig.axes.values())[settings.axis]
        self._keys = keys
        self._model = axis.model
        host.allow(settings.axis, settings.force + abs(axis.model.gravity))
        self._key_timeout_ns = round(settings.key_timeout_s * 1e9)
        feedback_ns = min((m.period_ns for m in host.protocol.messages(rig.period_ns) if m.sender != "host"), default=0)
        self._lost_ns = max(round(_LOST_S * 1e9), _LOST_PERIODS * feedback_ns)
        self._period_s = rig.period_ns * 1e-9
        self._path: deque[float] = deque(maxlen=_WINDOW + 1)
        self._start: float | None = None
        self._direction = 0
        self._pressed_ns = self._begun_ns = 0
        self._push = 0.0
        self.moved = 0.0
        self.farthest = 0.0
        self.was_enabled = False
        self.ended = ""

    @property
    def done(self) -> bool:
        """It is over."""
        return bool(self.ended)

    @property
    def force(self) -> float:
        """Told to the drive in the latest tick, N (N m)."""
        return self.host.force(self.settings.axis)

    @property
    def held(self) -> bool:
        """A key is held, and the drive told to apply torque."""
        return self._direction != 0

    def step(self, now_ns: int, frames: Sequence[Frame]) -> list[Frame]:
        """One tick: the frames received since the last one, and those to send now."""
        self.host.take(frames, now_ns)
        self._read_keys(now_ns)
        position = self.host.position(self.settings.axis)
        self._watch(now_ns, position)
        if self.ended or not self._direction or position is None:
            self._push = 0.0
            return self.host.zero()
        return self.host.push(self.settings.axis, self._model.gravity + self._direction * self._pushed())

    def _read_keys(self, now_ns: int) -> None:
        for key in self._keys():
            if key in (POSITIVE, NEGATIVE):
                self._direction = 1 if key == POSITIVE else -1
                self._pressed_ns = now_ns
            else:
                self.ended = "another key"
        if now_ns - self._pressed_ns >= self._key_timeout_ns:
            self._direction = 0

    def _watch(self, now_ns: int, position: float | None) -> None:
        """End where it must not go on."""
        axis = self.settings.axis
        self._begun_ns = self._begun_ns or now_ns
        if now_ns - max(self._begun_ns, self.host.heard_ns[axis]) > self._lost_ns:
            self.ended = self.ended or f"no position from the drive for {self._lost_ns / 1e6:.0f} ms"
        if position is None:
            return
        bad = self.host.status(axis) & UNHEALTHY
        if bad:
            self.ended = self.ended or f"the drive says {' '.join(f.name.lower() for f in bad if f.name)}"
        if problem := self.host.problem(axis):
            self.ended = self.ended or problem
        self.was_enabled = self.was_enabled or DriveStatus.ENABLED in self.host.status(axis)
        if self._start is None:
            self._start = position
        self._path.append(position)
        self.moved = position - self._start
        self.farthest = max(self.farthest, self.moved, -self.moved)
        if abs(self.moved) > self.settings.distance:
            self.ended = self.ended or f"it has moved {self.moved:+.4g}, beyond {self.settings.distance:g}"
        if abs(self.speed) > 2.0 * self.settings.speed:
            self.ended = self.ended or f"it moves at {self.speed:+.4g}, beyond twice {self.settings.speed:g}"

    @property
    def speed(self) -> float:
        """Over the last ticks, m/s (rad/s)."""
        path = self._path
        return (path[-1] - path[0]) / ((len(path) - 1) * self._period_s) if len(path) > 1 else 0.0

    def _pushed(self) -> float:
        """Force in the direction of the key, without what holds the axis."""
        cap, ahead = self.settings.force, self.speed * self._direction
        step = cap * self._period_s / _RISE_S
        rising = ahead < self.settings.speed
        self._push = max(self._push + step, 0.5 * self._model.coulomb) if rising else self._push - _FALL * step
        self._push = max(0.0, min(cap, self._push))
        return max(0.0, min(cap, self._push - self._model.mass / (_DAMPING_TICKS * self._period_s) * ahead))
