"""Frames of sensors and output nodes in the inbox: handed to whom they are for, and what says nothing is counted."""

from pathlib import Path

import pytest

from drivers.config import BusConfig
from drivers.frame import Frame
from drivers.protocols import host_protocol
from drivers.protocols.base import Reject
from drivers.sensors.base import Measured
from drivers.sensors.config import SensorConfig
from hil.cycle.inbox import Inbox
from hil.cycle.output_gate import OutputGate
from hil.cycle.readings import Readings

READS, SETS = 0x300, 0x301
FORCE = SensorConfig(can_id=READS, unit="N", scale=1.0, noise=0.0, range=[-9.0, 9.0], stuck_ticks=0)


class Node:
    """A sensor and an output node in one. A byte is a value with its number; two bytes are the Reject of the first."""

    bits, ready, problem = 0, True, ""

    def __init__(self, can_id: int) -> None:
        self.can_ids = (can_id,)

    def decode(self, frame: Frame) -> Measured | Reject:
        number = frame.data[0]
        return Measured(float(number), number) if len(frame.data) == 1 else list(Reject)[number]

    def hear(self, frame: Frame) -> Reject:
        return list(Reject)[frame.data[0]]

    def frame(self, bits: int, sequence: int) -> Frame:
        return Frame(self.can_ids[0], bytes((bits, sequence)))

    def service(self) -> Frame | None:
        return None


def make_inbox() -> tuple[Inbox, Readings]:
    readings = Readings([FORCE], [Node(READS)], 1_000_000)
    outputs = OutputGate([], [Node(SETS)], 1_000_000)
    return Inbox(host_protocol(BusConfig(), 1, [5.0], Path()), 100, readings, outputs), readings


def saying(can_id: int, reason: Reject) -> Frame:
    return Frame(can_id, bytes((list(Reject).index(reason), 0)))


def test_a_reading_is_taken_and_no_useless_frame() -> None:
    inbox, readings = make_inbox()
    inbox.collect([Frame(READS, b"\x03")], 0)
    assert readings.values == [3.0]
    assert (sum(inbox.rejects), inbox.useless_now) == (0, 0)


@pytest.mark.parametrize("can_id", [READS, SETS])
@pytest.mark.parametrize("reason", [Reject.WRONG_LENGTH, Reject.SERVICE])
def test_what_a_node_says_beside_its_values_is_counted_and_its_first_service_is_no_flood(
    can_id: int, reason: Reject
) -> None:
    inbox, _ = make_inbox()
    inbox.collect([saying(can_id, reason)] * 2, 0)
    assert inbox.rejects[reason] == sum(inbox.rejects) == 2
    assert inbox.useless_now == (1 if reason is Reject.SERVICE else 2)
    assert inbox.bad_frames == (0 if reason is Reject.SERVICE else 2)


def test_behind_a_reset_a_sensor_counts_from_where_it_likes() -> None:
    inbox, readings = make_inbox()
    inbox.collect([Frame(READS, b"\x03")], 0)
    inbox.forget()
    inbox.collect([Frame(READS, b"\x07")], 1)
    assert (readings.values, readings.strayed) == ([7.0], [-1])
