"""Readings: newest value, age, validity; every fault of a sensor at its exact threshold."""

import math
from pathlib import Path
from random import Random

import pytest

from drivers.frame import FD, Frame, on_segment
from drivers.protocols.base import Reject
from drivers.sensors.config import SensorConfig
from drivers.sensors.readers import sensor_readers
from hil.control.reading import Reading
from hil.cycle.fault_monitor import FaultMonitor
from hil.cycle.fault_table import Fault
from hil.cycle.reading_faults import check_readings
from hil.cycle.readings import Readings
from hil.rig.schema import SafetyConfig

MS = 1_000_000
IDS = (0x300, 0x301)
Flagged = tuple[Fault, int, float, float]  # with channel, value, limit
FORCE = SensorConfig(
    can_id=0x300, unit="N", scale=0.5, noise=50.0, range=[-100.0, 200.0], silent_ticks=3, stuck_ticks=12
)
LIGHT = SensorConfig(can_id=0x301, unit="W", scale=2.0, noise=0.0, range=[0.0, 10.0], silent_ticks=5, stuck_ticks=0)


class Bench:
    """Two sensors and the detectors; `tick` gives the counts and sequence numbers that come of the first.

    offset_ns: of the sensors' clocks, which run fast by `fast`. late_ns: from the command to the samples that now come.
    """

    def __init__(self, offset_ns: int = 0, fast: float = 0.0) -> None:
        self.offset_ns, self.fast, self.late_ns, self.sent_ns = offset_ns, fast, 230_000, 0
        self.readings = Readings([FORCE, LIGHT], sensor_readers({"force": FORCE, "light": LIGHT}, Path()), MS)
        self.monitor = FaultMonitor(SafetyConfig(), [], 1_000_000, [])
        self.sequence = -1
        self.light = -1

    def tick(self, *counts: int, jump: int = 0, status: int = 0, light: int | None = 1) -> list[Flagged]:
        """One tick in which these counts come; what is flagged, with channel, value and limit."""
        readings = self.readings
        self.sent_ns += MS
        readings.begin(self.sent_ns)
        self.monitor.begin()
        for value in counts:
            self.sequence += 1 + jump
            self.take(0, value, self.sequence, status)
        if light is not None:
            self.light += 1
            self.take(1, light, self.light)
        readings.close()
        check_readings(readings, self.monitor)
        return [(Fault(found.fault), found.axis, found.value, found.limit) for found in self.monitor.evidence]

    def take(self, channel: int, counts: int, sequence: int, status: int = 0) -> Reject | None:
        stamp = round((self.sent_ns + self.late_ns) * (1.0 + self.fast) + self.offset_ns) // 1000 % 2**16
        data = counts.to_bytes(4, "little", signed=True) + stamp.to_bytes(2, "little") + bytes((sequence % 256, status))
        return self.readings.take(Frame(IDS[channel], data, 0, self.sent_ns + 700_000))


def test_a_reading_is_the_newest_value_with_its_age_and_its_channel() -> None:
    bench = Bench()
    assert all(math.isnan(value) for value in bench.readings.values)
    assert not any(reading.valid for reading in bench.readings.newest)
    assert bench.tick(7, light=3) == []
    assert bench.readings.newest == [Reading(0, 3.5, 1_230_000, 0, True), Reading(1, 6.0, 1_230_000, 0, True)]
    assert bench.tick(light=None) == []
    assert (bench.readings.values, bench.readings.age) == ([3.5, 6.0], [1, 1])
    assert bench.tick(9, light=None) == []
    assert (bench.readings.values, bench.readings.age) == ([4.5, 6.0], [0, 2])


@pytest.mark.requirement(id="SR-8.1")
def test_a_sensor_is_silent_at_its_own_number_of_ticks_and_its_reading_is_valid_no_more() -> None:
    bench = Bench()
    bench.tick(1)
    assert [bench.tick(), bench.tick()] == [[], []]
    assert bench.readings.newest[0].valid
    assert bench.tick() == [(Fault.SENSOR_SILENT, 0, 3.0, 3.0)]
    assert not bench.readings.newest[0].valid
    assert bench.tick() == [(Fault.SENSOR_SILENT, 0, 4.0, 3.0)]
    assert bench.tick(2) == []
    assert bench.readings.newest[0].valid


def test_a_reading_that_its_sensor_calls_invalid_is_none() -> None:
    bench = Bench()
    bench.tick(1)
    assert [bench.tick(5, status=1), bench.tick(5, status=255)] == [[], []]
    assert bench.readings.values[0] == 0.5
    assert bench.tick(5, status=1) == [(Fault.SENSOR_SILENT, 0, 3.0, 3.0)]


@pytest.mark.requirement(id="SR-8.1")
def test_a_sensor_is_stuck_at_the_last_of_so_many_equal_readings() -> None:
    bench = Bench()
    for _ in range(2):
        assert [bench.tick(4) for _ in range(11)] == [[]] * 11
        assert bench.tick(5) == []
        assert [bench.tick(4) for _ in range(11)] == [[]] * 11
        assert bench.tick(4) == [(Fault.SENSOR_STUCK, 0, 12.0, 12.0)]
        assert bench.tick(5) == []
    for _ in range(50):
        assert bench.tick(*[bench.sequence % 7], light=1) == [], "stuck_ticks = 0: never"


@pytest.mark.parametrize(("counts", "limit"), [(401, 200.0), (-201, -100.0), (2**31 - 1, 200.0), (-(2**31), -100.0)])
def test_a_reading_beyond_its_range_is_a_fault_in_its_tick_alone(counts: int, limit: float) -> None:
    bench = Bench()
    assert bench.tick(400) == bench.tick(-200) == []
    assert bench.tick(counts) == [(Fault.SENSOR_RANGE, 0, counts * 0.5, limit)]
    assert not bench.readings.newest[0].valid
    assert bench.readings.values[0] == counts * 0.5, "people are shown it all the same"
    assert bench.tick() == []
    assert bench.tick(1) == []


def test_a_sequence_number_may_go_on_by_the_ticks_that_passed_and_no_more() -> None:
    bench = Bench()
    bench.tick(1)
    assert bench.tick(2, jump=1) == [(Fault.SENSOR_SEQUENCE, 0, 2.0, 1.0)]
    assert (bench.readings.values[0], bench.readings.age[0]) == (0.5, 1)
    assert bench.tick(3) == [], "those behind it follow again"
    assert bench.readings.values[0] == 1.5
    bench.tick()
    assert bench.tick(4, jump=1) == [], "one was lost"
    assert bench.tick(5, jump=-1) == [(Fault.SENSOR_SEQUENCE, 0, 0.0, 1.0)], "the same again"
    assert bench.tick(6, jump=-2) == [(Fault.SENSOR_SEQUENCE, 0, 255.0, 1.0)], "backwards"
    assert bench.tick(7, jump=-1) == [(Fault.SENSOR_SILENT, 0, 3.0, 3.0), (Fault.SENSOR_SEQUENCE, 0, 0.0, 1.0)]


def test_two_frames_in_one_tick_are_a_late_one_and_its_successor() -> None:
    bench = Bench()
    bench.tick(1)
    bench.tick()
    assert bench.tick(2, 3) == []
    assert bench.readings.values[0] == 1.5


def test_after_a_reset_what_was_heard_before_counts_no_more() -> None:
    bench = Bench()
    for _ in range(11):
        bench.tick(4)
    bench.tick()
    bench.readings.forget()
    assert bench.tick(5, jump=77) == []
    assert (bench.readings.age[0], bench.readings.values[0]) == (0, 2.5)


@pytest.mark.parametrize("offset_ns", [0, 5, -31 * MS, 32 * MS + 700_000, 10**9])
@pytest.mark.parametrize("fast", [0.0, 1e-4, -1e-4])
def test_an_age_counts_from_the_sample_whatever_the_sensors_clock_says(offset_ns: int, fast: float) -> None:
    bench = Bench(offset_ns, fast)
    for late, ticks in ((0, 700), (1, 3), (0, 700), (2, 50), (0, 700)):
        bench.late_ns = 230_000 - late * MS
        for _ in range(ticks):
            assert bench.tick(bench.sequence % 7) == []
            assert bench.readings.age[0] == late


def test_readings_that_come_in_every_tick_and_too_late_are_a_silent_sensor() -> None:
    bench = Bench()
    bench.tick(1)
    bench.late_ns -= 3 * MS
    for counts in (2, 3, 4):
        found = [flag for flag in bench.tick(counts, light=None) if not flag[1]]
        assert found == [(Fault.SENSOR_SILENT, 0, 3.0, 3.0)]
        assert not bench.readings.newest[0].valid


def test_a_sensor_whose_first_readings_were_late_is_in_time_at_the_third_that_is() -> None:
    bench = Bench()
    bench.late_ns -= MS
    bench.tick(1)
    bench.late_ns += MS
    for counts in (2, 3, 4):
        bench.tick(counts)
    bench.late_ns -= MS
    bench.tick(5)
    assert bench.readings.age[0] == 1


def test_one_command_that_was_held_up_makes_no_later_reading_late() -> None:
    bench = Bench()
    bench.tick(1)
    for held_up_ns in (800_000, 0, 0, 0):
        bench.late_ns = 230_000 + held_up_ns
        bench.tick(2)
        assert (bench.readings.age[0], bench.readings.values[0]) == (0, 1.0)


def test_the_clock_of_a_sensor_that_was_restarted_is_learnt_anew() -> None:
    bench = Bench()
    bench.tick(1)
    bench.sequence, bench.offset_ns = 100, -7 * MS
    assert bench.tick(2, light=None) == [(Fault.SENSOR_SEQUENCE, 0, 101.0, 1.0)]
    assert bench.tick(3, light=None) == []
    assert bench.readings.age[0] == 0


def test_a_frame_on_another_segment_is_none_of_a_sensor() -> None:
    readings = Bench().readings
    frame = Frame(IDS[0], bytes(8))
    assert readings.knows(frame)
    assert not readings.knows(on_segment(frame, 1))
    assert not readings.knows(frame._replace(can_id=0x302))


def test_damage_is_told_by_its_reason_and_changes_nothing() -> None:
    bench = Bench()
    bench.tick(1)
    before = list(bench.readings.newest)
    assert bench.readings.take(Frame(0x300, bytes(7))) is Reject.WRONG_LENGTH
    assert bench.readings.take(Frame(0x300, bytes(12), FD)) is Reject.WRONG_FORMAT
    assert bench.readings.newest == before


@pytest.mark.requirement(id="SR-8.1")
def test_no_bytes_raise_and_every_value_is_a_number() -> None:
    bench, rng = Bench(), Random(3)
    flagged: set[int] = set()
    for _ in range(500):
        bench.readings.begin(0)
        bench.monitor.begin()
        for _ in range(rng.randrange(4)):
            bench.readings.take(Frame(rng.choice(IDS), rng.randbytes(rng.choice((0, 8, 8, 8, 12))), rng.choice((0, 4))))
        bench.readings.close()
        check_readings(bench.readings, bench.monitor)
        assert all(age >= 0 for age in bench.readings.age)
        flagged |= {found.fault for found in bench.monitor.evidence}
    assert {Fault.SENSOR_SEQUENCE, Fault.SENSOR_SILENT} <= flagged
