"""What the trial of a user's layout says to both sides, taken down by a layout that carries everything as it is."""

from pathlib import Path
from typing import Any

import pytest

from drivers.config import BusConfig, Wiring
from drivers.frame import EXTENDED, FD, FD_LENGTHS
from drivers.protocols.base import DriveStatus, LayoutError
from drivers.protocols.layout_trial import NOISE, ROUNDS, try_sides
from drivers.protocols.user_sides import Maker

RATED, PERIOD_NS, LAG = [4.0, 2.0, 0.5], 2_000_000, 2
TAKES_DOWN = """
from hil import Command, DriveSide, Frame, FrameLayout, HostSide, Message, Reject, Sample

class TakesDown(FrameLayout):
    def __init__(self, wiring, late=0):
        super().__init__(wiring)
        self.late = late
        self.commands, self.samples, self.to_host, self.to_drives = [], [], [], []
    def host(self):
        return Host(self)
    def drives(self):
        return Drives(self)

class Host(HostSide):
    sequence_modulus, states, causes = 2**62, True, True
    def __init__(self, layout):
        self.layout = layout
    def encode(self, command):
        self.layout.commands.append(command)
        return [Frame(0x10, b"")]
    def decode(self, frame):
        self.layout.to_host.append(frame)
        if frame.can_id != 0x20 or frame.data:
            return Reject.UNKNOWN_ID
        sample = self.layout.samples[-1]
        older = Sample(sample.axis, sample.position + 1, sample.status, sample.sequence, -1)
        return older, sample  # of several the last counts
    def messages(self, period_ns):
        senders = ("host", 0x10), ("axis 0", 0x20), ("axis 1", 0x20), ("axis 2", 0x20)
        return [Message(sender, at, 0, False, period_ns, period_ns, 0, sender) for sender, at in senders]

class Drives(DriveSide):
    sequence_modulus, enable_lag = 2**62, 2
    def __init__(self, layout):
        self.layout = layout
    def decode_command(self, frame):
        self.layout.to_drives.append(frame)
        if frame.can_id != 0x10 or frame.data:
            return Reject.UNKNOWN_ID
        said = self.layout.commands
        sequence, force, _, reset = said[-1]
        return Command(sequence, force, said[max(0, len(said) - 1 - self.layout.late)].enable, reset)
    def encode_feedback(self, sample):
        self.layout.samples.append(sample)
        return Frame(0x20, b"")
"""


def tried(late: int = 0) -> Any:
    """The layout after its trial. late: ticks by which its drives hear of an enable."""
    bus = BusConfig(protocol="./down.py:TakesDown", source=TAKES_DOWN, parameters={"late": late})
    maker = Maker(Wiring(bus, 3, RATED, PERIOD_NS, Path()))
    host, drives = maker.sides()
    try_sides(host, drives, maker)
    return host._side.layout


@pytest.fixture(scope="module")
def taken() -> Any:
    return tried()


def test_axes_are_enabled_not_at_all_all_and_each_alone_for_as_long_as_it_may_take(taken: Any) -> None:
    assert [command.sequence for command in taken.commands] == list(range(ROUNDS * (LAG + 1)))
    said = [(tuple(command.force), command.enable, command.reset) for command in taken.commands]
    runs = said[:: LAG + 1]
    assert said == [each for each in runs for _ in range(LAG + 1)]
    enables = [enable for _, enable, _ in runs]
    assert enables[0] == 0
    assert set(enables) == {0, 0b001, 0b010, 0b100, 0b111}
    assert sum(reset for *_, reset in runs) == 1


def test_every_axis_is_told_all_torques_of_both_signs_while_it_is_enabled_and_none_else(taken: Any) -> None:
    for axis, rated in enumerate(RATED):
        told = [(command.force[axis], command.enable >> axis & 1) for command in taken.commands]
        assert all(force == 0.0 for force, enabled in told if not enabled)
        shares = {force / rated * (-1) ** axis for force, enabled in told if enabled}
        assert shares == {0.0, 0.5, 1.0, -1.0, -0.013}


def test_every_axis_answers_with_every_state_and_position_and_no_two_alike_in_a_tick(taken: Any) -> None:
    ticks = [taken.samples[at : at + 3] for at in range(0, len(taken.samples), 3)]
    homed = DriveStatus.HOMED
    states = {homed, homed | DriveStatus.ENABLED, homed | DriveStatus.FAULT, homed | DriveStatus.WATCHDOG}
    for axis in range(3):
        assert {samples[axis].axis for samples in ticks} == {axis}
        assert {samples[axis].position for samples in ticks} == {0, 3, 700, -5, -300}
        assert {samples[axis].status for samples in ticks} == states | {DriveStatus.ENCODER_FAULT}
    assert all(len({sample.position for sample in samples}) == 3 for samples in ticks)
    assert [samples[0].sequence for samples in ticks] == [command.sequence for command in taken.commands]


def test_frames_are_heard_one_period_after_the_other_and_answers_within_it(taken: Any) -> None:
    starts = [PERIOD_NS * (tick + 1) for tick in range(len(taken.commands))]
    assert [frame.timestamp_ns for frame in taken.to_drives[: len(starts)]] == starts
    assert [sample.stamp_ns for sample in taken.samples[::3]] == starts
    answered = [frame.timestamp_ns for frame in taken.to_host[: 3 * len(starts) : 3]]
    assert all(0 < after - before < PERIOD_NS for before, after in zip(starts, answered, strict=True))


def test_in_the_end_both_sides_hear_noise_of_every_kind(taken: Any) -> None:
    noise = taken.to_host[-NOISE:]
    assert noise == taken.to_drives[-NOISE:] == tried().to_host[-NOISE:]
    assert [len(taken.to_host), len(taken.to_drives)] == [ROUNDS * 9 + NOISE, ROUNDS * 3 + NOISE]
    for flags, lengths in ((0, set(range(9))), (FD, set(FD_LENGTHS))):
        assert {len(frame.data) for frame in noise if frame.flags == flags} == lengths
    assert {frame.flags for frame in noise} == {0, FD}
    assert {0x10, 0x20} < {frame.can_id for frame in noise}
    others = [frame.can_id for frame in noise if frame.can_id not in (0x10, 0x20)]
    assert max(others) > EXTENDED + (1 << 28)
    assert max(can_id for can_id in others if can_id < EXTENDED) > 0x400
    times = [frame.timestamp_ns for frame in noise]
    assert times == sorted(set(times))


def test_an_enable_may_be_as_late_as_the_drives_say_and_no_later() -> None:
    assert tried(late=LAG).commands
    with pytest.raises(LayoutError, match=r"host\(\) enables axes 0b1, and 0b0 is read"):
        tried(late=LAG + 1)
