"""How the tip goes into a cell, and by what a touch and a puncture are seen: `z_law` of [motion.parameters].

| z_law | on its way | touch and puncture |
|---|---|---|
| press | at `press_speed` from the touch on; stops at the puncture | force |
| ramp | as press, its speed trimmed by how far the force is from a ramp of `force_rate`: an admittance | force |
| impedance | to the planned depth, giving way to the force as a mass on a spring and a damper would | force |
| visual | as press | dimple of the cell, as the camera sees it |
| position | to the planned depth | force, which stops nothing |
| hold | until the force is `hold_force`, which it holds for `hold_s`; pierces nothing | force |

Impedance (Hogan, J. Dyn. Syst. Meas. Control 107, 1985; position-based) and position are what the tip is compared with.
Under each of them the force limit holds.
"""

from collections import deque
from math import pi, sqrt
from typing import Any

from hil.control.motion.contract import Observation
from hil.control.motion.glide import Glide
from hil.control.motion.injection.detectors import Contact, Puncture
from hil.control.motion.injection.senses import Senses
from hil.control.motion.injection.settings import Settings

CONTACT_DRIFT = 0.75  # of the noise
CONTACT_SUM = 9.0  # exceeded by noise alone once in about e^(2 * 0.75 * 9) samples: one approach in some thousands
DROP_TICKS = 10  # in which the force falls
DROP_FRAMES = 3  # in which the dimple does
DROP_SHARE = 0.3
DROP_NOISE = 7.0
SEEN_NOISE = 5.0  # of the dimple: a touch
RAMP_SHARE = 0.5  # of press_speed, where the force is on its ramp
GIVES_WAY_HZ = 20.0  # of the mass on its spring, critically damped
_OMEGA = 2.0 * pi * GIVES_WAY_HZ
PULLS_BACK = 50.0  # 1/s: of the way that limits have kept the tip from going
FELT = 4  # samples that the held force is the mean of
NEARLY = 0.98  # of the held force: it is reached
SETTLES_S = 0.15  # from there, until what is held counts
SETTLED = 1e-5  # m/s: it gives way no more
RENEWED_S = 0.02  # a speed that nobody renews ends in rest


class Press:
    """stops: at a puncture. dives: at press_speed until then, so that the force limit has to look ahead. held: what was
    to be held has been. Along the axis of injection; `direction` is that of the settings.
    """

    stops = True
    dives = True
    held = False

    def __init__(self, settings: Settings, senses: Senses, glide: Glide, axis: int, period: float) -> None:
        self._s, self._senses, self._z, self._axis, self._period = settings, senses, glide, axis, period
        self._contact = Contact(CONTACT_DRIFT, CONTACT_SUM)
        self._puncture = Puncture(DROP_TICKS, DROP_SHARE, DROP_NOISE * senses.noise)

    def search(self, seen: Observation, top: float) -> None:
        """From above the cell, whose top is expected there, m, until something is touched."""
        self._contact.restart()
        self._to(seen, top + self._s.direction * self._s.deepest, self._s.seek_speed)

    def press(self, seen: Observation, contact: float) -> None:
        """From the touch on, which was at `contact`, m."""
        self.forget()
        self._to(seen, contact + self._s.direction * self._s.deepest, self._s.press_speed)

    def step(self, seen: Observation) -> None:
        """Once a tick, on its way."""

    def rests(self, seen: Observation) -> bool:
        """It has come to its end."""
        return self._z.rests(seen.ends_ns[self._axis])

    def touch(self) -> float | None:
        """Where the tip has touched, m, as soon as it is certain."""
        senses = self._senses
        if not (senses.fresh and self._contact.take(senses.force / senses.noise)):
            return None
        return senses.place - self._s.direction * (self._contact.onset * self._speed * self._period)

    def pierces(self) -> bool:
        """Whether a membrane gives way."""
        return self._senses.fresh and self._puncture.take(self._senses.force)

    def forget(self) -> None:
        """What is seen from here on is another membrane."""
        self._puncture.restart()

    @property
    def force(self) -> float:
        """Before the membrane gave way, N."""
        return self._puncture.peak

    @property
    def _speed(self) -> float:
        return self._s.seek_speed

    def _to(self, seen: Observation, place: float, speed: float) -> None:
        self._z.to(seen.ends_ns[self._axis], seen.reference[self._axis], place, speed)

    def _at(self, seen: Observation, speed: float) -> None:
        """Go on inwards at that speed, m/s."""
        self._z.jog(seen.ends_ns[self._axis], seen.reference[self._axis], self._s.direction * speed, RENEWED_S)


class Ramp(Press):
    """Speed = a share of press_speed + (force of the ramp - force) / admittance, never outwards."""

    _began: int | None = None  # tick of the touch

    def press(self, seen: Observation, contact: float) -> None:
        """See Press."""
        self.forget()
        self._began = seen.tick
        self._end = contact + self._s.direction * self._s.deepest

    def step(self, seen: Observation) -> None:
        """See Press."""
        if self._began is None or self._over(seen):
            return
        wanted = self._s.force_rate * (seen.tick - self._began) * self._period
        speed = RAMP_SHARE * self._s.press_speed + (wanted - self._senses.force) / self._s.admittance
        self._at(seen, max(0.0, min(speed, self._s.press_speed)))

    def rests(self, seen: Observation) -> bool:
        """See Press."""
        return (self._began is None or self._over(seen)) and super().rests(seen)

    def _over(self, seen: Observation) -> bool:
        return (seen.reference[self._axis][0] - self._end) * self._s.direction >= 0.0


class Position(Press):
    """Down to the planned depth, whatever is felt."""

    stops = False

    def search(self, seen: Observation, top: float) -> None:
        """See Press."""
        self._contact.restart()
        self._to(seen, top + self._s.direction * self._s.deposit, self._s.press_speed)

    def press(self, seen: Observation, contact: float) -> None:
        """See Press."""
        self.forget()

    @property
    def _speed(self) -> float:
        return self._s.press_speed


class Impedance(Position):
    """Way given = what the force does to a mass on a spring of `stiffness` (N/m), critically damped."""

    def search(self, seen: Observation, top: float) -> None:
        """See Press."""
        self._contact.restart()
        self._from = seen.reference[self._axis][0]
        self._length = (top - self._from) * self._s.direction + self._s.deposit
        self._began = seen.tick
        self._given = self._speed_given = 0.0

    def step(self, seen: Observation) -> None:
        """See Press."""
        pushed = self._senses.force / self._s.stiffness - self._given
        self._speed_given += _OMEGA * (_OMEGA * pushed - 2.0 * self._speed_given) * self._period
        self._given += self._speed_given * self._period
        planned = min(self._planned(seen), self._length)
        speed = self._s.press_speed if planned < self._length else 0.0
        here = (seen.reference[self._axis][0] - self._from) * self._s.direction
        self._at(seen, speed - self._speed_given + PULLS_BACK * (planned - self._given - here))

    def rests(self, seen: Observation) -> bool:
        """See Press."""
        ended = self._planned(seen) - self._length > self._s.press_speed * 2.0 / GIVES_WAY_HZ
        return ended and abs(seen.reference[self._axis][1]) < SETTLED

    def _planned(self, seen: Observation) -> float:
        return self._s.press_speed * (seen.tick - self._began) * self._period


class Visual(Press):
    """A force sensor holds the limit alone; what the camera has not shown has not happened."""

    def __init__(self, settings: Settings, senses: Senses, glide: Glide, axis: int, period: float) -> None:
        super().__init__(settings, senses, glide, axis, period)
        assert senses.dimple is not None  # `settings` has looked
        self._frames = senses.dimple
        self._noise = senses.dimple_noise
        self._puncture = Puncture(DROP_FRAMES, DROP_SHARE, DROP_NOISE * self._noise)
        self._looked, self._arrived = -1, -1
        self._peak = 0.0

    def press(self, seen: Observation, contact: float) -> None:
        """See Press. What the camera has shown of the touch is the beginning."""
        super().press(seen, contact)
        self._puncture.take(self._frames.value)

    def rests(self, seen: Observation) -> bool:
        """See Press; and the camera has shown it."""
        if not super().rests(seen):
            self._arrived = seen.tick
            return False
        return self._frames.exposed > self._arrived

    def touch(self) -> float | None:
        """See Press."""
        if not self._new() or self._frames.value <= SEEN_NOISE * self._noise:
            return None
        return self._senses.place_at(self._frames.age) - self._s.direction * self._frames.value

    def pierces(self) -> bool:
        """See Press."""
        self._peak = max(self._peak, self._senses.force)
        return self._new() and self._puncture.take(self._frames.value)

    def forget(self) -> None:
        """See Press."""
        super().forget()
        self._peak = 0.0

    @property
    def force(self) -> float:
        """See Press: the greatest since the touch."""
        return self._peak

    def _new(self) -> bool:
        looked, self._looked = self._looked, self._frames.exposed
        return self._looked != looked


class Hold(Press):
    """Speed = (hold_force - force) / admittance, at most press_speed: an integrator, which follows a cell that yields.

    rms: of the reading against hold_force, N, over `hold_s`.
    """

    dives = False

    def press(self, seen: Observation, contact: float) -> None:
        """See Press."""
        self.forget()
        self._end = contact + self._s.direction * self._s.deepest
        self._felt: deque[float] = deque(maxlen=FELT)
        self._since: int | None = None
        self._squares, self._samples = 0.0, 0

    def step(self, seen: Observation) -> None:
        """See Press."""
        if not hasattr(self, "_felt"):
            return
        if self._senses.fresh:
            self._take(self._senses.force, seen.tick)
        force = sum(self._felt) / len(self._felt) if self._felt else 0.0
        speed = (self._s.hold_force - force) / self._s.admittance
        most = self._s.press_speed
        deep = (seen.reference[self._axis][0] - self._end) * self._s.direction >= 0.0
        self._at(seen, max(-most, min(speed, 0.0 if deep else most)))

    def _take(self, force: float, tick: int) -> None:
        self._felt.append(force)
        if self._since is None and sum(self._felt) >= NEARLY * self._s.hold_force * FELT:
            self._since = tick
        if self._since is not None and (tick - self._since) * self._period >= SETTLES_S and not self.held:
            self._squares += (force - self._s.hold_force) ** 2
            self._samples += 1
            self.held = self._samples * self._period >= self._s.hold_s

    @property
    def rms(self) -> float:
        """See Hold; 0.0 before there is one."""
        return sqrt(self._squares / self._samples) if self._samples else 0.0

    def rests(self, seen: Observation) -> bool:
        """See Press: it never does, but at the deepest place."""
        if not hasattr(self, "_felt"):
            return super().rests(seen)
        deep = (seen.reference[self._axis][0] - self._end) * self._s.direction >= 0.0
        return deep and self._since is None and abs(seen.reference[self._axis][1]) < SETTLED


Z_LAWS: dict[str, type[Press]] = {
    "press": Press, "ramp": Ramp, "impedance": Impedance, "visual": Visual, "position": Position,
    "hold": Hold,
}  # fmt: skip


def z_law(settings: Settings, *around: Any) -> Press:
    """That of the settings. around: senses, glide, axis and period."""
    return Z_LAWS[settings.z_law](settings, *around)
