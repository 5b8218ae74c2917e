"""What the phases look at: the force on the cell, where the tip was when it was sampled, and what the camera saw."""

from collections import deque
from collections.abc import Sequence
from math import nan

from hil.control.motion.contract import Observation, Surroundings
from hil.control.motion.injection.settings import Settings

DEAD_SAME: int = 8  # readings of exactly one value
DEAD_SILENT: int = 3  # ticks without a reading
TARE: int = 64  # samples
PLACES: int = 512  # ticks that the tip's way is known of: the age of any frame that counts


class Frames:
    """One channel of the camera. latency_ticks: from exposure to the frame. exposed: tick of the newest frame's;
    age: ticks since.
    """

    def __init__(self, channel: int, latency_ticks: int, most_ticks: int) -> None:
        self._channel, self._latency, self._most = channel, latency_ticks, most_ticks
        self.value, self.exposed, self.age, self.frozen = nan, -1, 0, False

    def take(self, seen: Observation) -> None:
        """This tick's."""
        reading = seen.readings[self._channel]
        old = seen.ages[self._channel] + self._latency
        self.frozen = reading.sequence < 0 or old > self._most
        self.value, self.exposed, self.age = reading.value, seen.tick - old, old


class Senses:
    """force: tared, N, pressing positive; at `place`, m along the axis of injection. fresh: it is of this tick. dead:
    nothing that the sensor says can be believed. shift, tip, bolus, dimple: of the camera; None where there is none.
    """

    def __init__(self, rig: Surroundings, settings: Settings) -> None:
        self._axis = rig.axes.index(settings.along)
        self._channel = rig.sensors.index(settings.force)
        self.noise = rig.noise[self._channel]
        latency = round(settings.camera_latency_s / rig.period)
        most = round(settings.camera_age_s / rig.period)
        found = [
            Frames(rig.sensors.index(name), latency, most) if name else None
            for name in (settings.shift, settings.tip, settings.bolus, settings.dimple)
        ]
        self.shift, self.tip, self.bolus, self.dimple = found
        self.dimple_noise = rig.noise[rig.sensors.index(settings.dimple)] if settings.dimple else 0.0
        self._cameras: Sequence[Frames] = [frames for frames in found if frames is not None]
        self._places: deque[float] = deque(maxlen=PLACES)
        self._tare: list[float] = []
        self._bias = 0.0
        self._sequence, self._raw = -1, nan
        self._same = self._silent = 0
        self.force, self.place = 0.0, nan
        self.fresh = self.dead = False

    def take(self, seen: Observation) -> None:
        """This tick's."""
        reading, age = seen.readings[self._channel], seen.ages[self._channel]
        self.fresh = reading.valid and reading.sequence != self._sequence
        if self.fresh:
            self._same = self._same + 1 if reading.value == self._raw else 1
            self._sequence, self._raw, self._silent = reading.sequence, reading.value, 0
            self.force = reading.value - self._bias
            back = age + 1  # the newest command was an interval before the coming one begins
            self.place = self.place_at(back)
            self._tare.append(reading.value)
        else:
            self._silent += 1
        self.dead = self._silent >= DEAD_SILENT or self._same >= DEAD_SAME
        self._places.append(seen.position[self._axis])
        for frames in self._cameras:
            frames.take(seen)

    def place_at(self, back: int) -> float:
        """Of the tip along the axis of injection, m, so many ticks ago; NaN where that is not known."""
        return self._places[-back] if 0 < back <= len(self._places) else nan

    @property
    def frozen(self) -> bool:
        """A camera that has shown nothing new for too long."""
        return any(frames.frozen for frames in self._cameras)

    def begin_tare(self) -> None:
        """From here on nothing touches the tip."""
        self._tare.clear()

    def tared(self) -> bool:
        """Enough samples have come: their mean is zero from here on."""
        if len(self._tare) < TARE:
            return False
        self._bias = sum(self._tare[-TARE:]) / TARE
        return True
