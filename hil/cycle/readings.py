"""The newest reading of every sensor, with its age, and counters for every frame that was not one.

An age counts from the sample, not from the frame's arrival. The frame carries the sample's instant on the sensor's own
clock; how far that clock is from the host's, the readings that come in time tell. A delay that every reading has from
the first one on looks like an offset between the clocks, and is not seen.
"""

import math
from collections.abc import Sequence
from typing import Final

from drivers.frame import Frame, segment_of
from drivers.protocols.base import Reject
from drivers.sensors.base import Measured, SensorReader
from drivers.sensors.config import SensorConfig
from drivers.sensors.hil_frame import WRAP_NS
from hil.control.reading import Reading

_SEQUENCES: Final = 256
_UNKNOWN: Final = math.nan
_EARLY: Final = 2  # readings in a row that came earlier than the clocks allow: then the offset was too large
_FOLLOW: Final = 64  # readings that the offset is averaged over, so that it follows clocks that drift


class SensorClock:
    """How many periods a sensor's readings are late, by its stamps. known: the offset between the clocks is."""

    __slots__ = ("_early", "_offset_ns", "_period_ns", "known")

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._offset_ns = self._early = 0
        self.known = False

    def late(self, stamp_ns: int, sent_ns: int) -> int:
        """Periods from the host's command that made the sensor sample to the newest one. sent_ns: of the newest."""
        passed_ns = sent_ns - stamp_ns
        if not self.known:
            self.known, self._offset_ns, self._early = True, passed_ns, 0
            return 0
        excess_ns = (passed_ns - self._offset_ns + WRAP_NS // 2) % WRAP_NS - WRAP_NS // 2
        late = (excess_ns + self._period_ns // 2) // self._period_ns
        if late == 0:
            self._offset_ns += excess_ns // _FOLLOW
            self._early = 0
        elif late < 0:  # the first ones were late, or this once the command was
            self._early += 1
            self.known = self._early < _EARLY
            late = 0
        return late


class Readings:
    """The sensors of a rig, in the order of its file. readers: of their frames. period_ns: of the control loop.

    newest: their readings. values: the same, numbers alone. age: ticks since the newest value was sampled; 0: at the
    latest command. repeats: frames in a row with exactly the newest value. strayed: step of a sequence number that was
    wrong in this tick; -1: none was. outside: this tick's value is beyond the range. alarm: any of these is worth a
    look in this tick.
    """

    def __init__(self, sensors: Sequence[SensorConfig], readers: Sequence[SensorReader], period_ns: int) -> None:
        n = len(sensors)
        self.silent_ticks = [sensor.silent_ticks for sensor in sensors]
        self.stuck_ticks = [sensor.stuck_ticks for sensor in sensors]
        self.low = [sensor.range[0] for sensor in sensors]
        self.high = [sensor.range[1] for sensor in sensors]
        self.channels = {can_id: channel for channel, reader in enumerate(readers) for can_id in reader.can_ids}
        self._readers = list(readers)
        self._served = [reader for sensor, reader in zip(sensors, readers, strict=True) if sensor.kind == "cia404"]
        self._turn = 0
        self._clocks = [SensorClock(period_ns) for _ in sensors]
        self.newest = [Reading(channel, _UNKNOWN, 0, -1, False) for channel in range(n)]
        self.values = [_UNKNOWN] * n
        self.age = [0] * n
        self.repeats = [0] * n
        self.strayed = [-1] * n
        self.outside = [False] * n
        self.alarm = False
        self._late = [-1] * n  # of this tick's reading, periods; -1: none came
        self._waited = [0] * n  # ticks since the last reading came
        self._last_sequence = [-1] * n
        self._sent_ns = 0

    def forget(self) -> None:
        """After a reset: sequence, repeats, clocks and ages begin anew."""
        n = len(self.age)
        self._last_sequence = [-1] * n
        self.repeats = [0] * n
        self.age[:] = self._waited[:] = [0] * n  # motions look at the same lists all the time
        for clock in self._clocks:
            clock.known = False

    def knows(self, frame: Frame) -> bool:
        """Whether it is the frame of a sensor; these are on the first segment."""
        return frame.can_id in self.channels and not segment_of(frame)

    def take(self, frame: Frame) -> Reject | None:
        """A frame that it `knows`; why it carries nothing, None where it was understood."""
        channel = self.channels[frame.can_id]
        measured = self._readers[channel].decode(frame)
        if not isinstance(measured, Measured):
            return measured
        last = self._last_sequence[channel]
        stamp_ns = frame.timestamp_ns if measured.stamp_ns is None else measured.stamp_ns
        sequence = measured.sequence if measured.sequence >= 0 else (last + 1) % _SEQUENCES
        self._last_sequence[channel] = sequence
        if last >= 0:
            step = (sequence - last) % _SEQUENCES
            if not 0 < step <= self._waited[channel] + 1:  # at most one sample a tick
                self.strayed[channel] = step
                self._clocks[channel].known = False  # restarted, its clock begins anew
                return None
        if measured.valid:
            self._accept(channel, measured.value, sequence, stamp_ns)
        return None

    def _accept(self, channel: int, value: float, sequence: int, stamp_ns: int) -> None:
        self.repeats[channel] = self.repeats[channel] + 1 if value == self.values[channel] else 1
        self.values[channel] = value
        self.outside[channel] = not self.low[channel] <= value <= self.high[channel]
        self._late[channel] = self._clocks[channel].late(stamp_ns, self._sent_ns)
        valid = not self.outside[channel]
        self.newest[channel] = Reading(channel, value, stamp_ns, sequence, valid)

    def close(self) -> None:
        """All frames of the tick are taken: ages, and whether anything is wrong."""
        alarm = False
        for channel, late in enumerate(self._late):
            if late >= 0:
                self.age[channel] = late
                self._waited[channel] = 0
                self._late[channel] = -1
            else:
                self.age[channel] += 1
                self._waited[channel] += 1
            silent = self.age[channel] >= self.silent_ticks[channel]
            if silent and self.newest[channel].valid:
                self.newest[channel] = self.newest[channel]._replace(valid=False)
            stuck = self.stuck_ticks[channel]
            alarm = alarm or silent or self.outside[channel] or self.strayed[channel] >= 0
            alarm = alarm or 0 < stuck <= self.repeats[channel]
        self.alarm = alarm

    def service(self) -> list[Frame]:
        """The frame that one of the sensors is due, if any: at most one a tick, in turn."""
        for _ in self._served:
            self._turn = (self._turn + 1) % len(self._served)
            frame = self._served[self._turn].service()
            if frame is not None:
                return [frame]
        return []

    @property
    def problems(self) -> list[str]:
        """Why sensors are no good, for people."""
        return [reader.problem for reader in self._readers if reader.problem]

    def begin(self, sent_ns: int) -> None:
        """A new tick: nothing has strayed yet, and no value is new. sent_ns: when the newest command was sent."""
        self._sent_ns = sent_ns
        if self.alarm:
            for channel in range(len(self.age)):
                self.strayed[channel] = -1
                self.outside[channel] = False
