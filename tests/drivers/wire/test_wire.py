"""The simulated CAN segment: what a bus does when all is well, and when it is not."""

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.bus.counters import BusState
from drivers.frame import BRS, EXTENDED, FD, REMOTE, Frame
from drivers.frame_length import INTERMISSION, frame_bits
from drivers.wire.faults import FaultKind, Random, WireFault
from drivers.wire.node import WireNode, arbitration_key
from drivers.wire.wire import Wire

BIT = 1000  # ns at 1 Mbit/s
MS = 1_000_000
COMMAND = Frame(0x080, bytes(range(8)))
FEEDBACK = [Frame(0x100 + axis, bytes([axis, 255, axis, 0, 7, 7, 7, 7])) for axis in range(4)]


class Rig:
    """A host and four drives that answer a command at its reception, on a 1 Mbit/s segment."""

    def __init__(self, *faults: WireFault, drives: int = 4, **options: object) -> None:
        self.wire = Wire(1_000_000, 5_000_000, faults=faults, **options)  # type: ignore[arg-type]
        self.at_host: list[Frame] = []
        self.at_drive: dict[str, list[Frame]] = {}
        self.host = self.wire.attach("host", self.at_host.append)
        self.drives = [self._drive(f"drive{axis}", FEEDBACK[axis]) for axis in range(drives)]

    def _drive(self, name: str, answer: Frame) -> WireNode:
        heard = self.at_drive[name] = []

        def receive(frame: Frame) -> None:
            heard.append(frame)
            node.send(answer, frame.timestamp_ns)

        node = self.wire.attach(name, receive, accept={COMMAND.can_id})
        return node

    def ticks(self, count: int, start: int = 0) -> None:
        for tick in range(start, start + count):
            self.host.send(COMMAND, tick * MS)
            self.wire.advance((tick + 1) * MS)


def bits(frame: Frame) -> int:
    return sum(frame_bits(frame))


def pair(*faults: WireFault, queue_length: int = 16) -> tuple[Wire, WireNode, list[Frame], WireNode]:
    """A sender and a listener."""
    wire = Wire(1_000_000, faults=faults)
    heard: list[Frame] = []
    sender = wire.attach("sender", None, queue_length)
    listener = wire.attach("listener", heard.append)
    return wire, sender, heard, listener


# -- a healthy bus -----------------------------------------------------------------------------------------------------


def test_a_frame_arrives_with_its_last_bit_and_not_before() -> None:
    wire, sender, heard, _ = pair()
    sender.send(COMMAND, 500)
    end = 500 + bits(COMMAND) * BIT
    wire.advance(end - 1)
    assert heard == []
    wire.advance(end)
    assert heard == [COMMAND._replace(timestamp_ns=end)]
    assert sender.counters().sent == 1


def test_drives_answer_a_command_in_the_order_of_their_identifiers_back_to_back() -> None:
    rig = Rig()
    rig.ticks(1)
    expected_ns = bits(COMMAND) * BIT
    for frame, answer in zip(rig.at_host, FEEDBACK, strict=True):
        expected_ns += (INTERMISSION + bits(answer)) * BIT
        assert frame == answer._replace(timestamp_ns=expected_ns)


def test_the_data_phase_of_an_fd_frame_runs_at_the_data_bit_rate() -> None:
    wire = Wire(1_000_000, 5_000_000)
    heard: list[Frame] = []
    sender = wire.attach("sender", None)
    wire.attach("listener", heard.append)
    frame = Frame(0x080, bytes(range(24)), FD | BRS)
    nominal, fast = frame_bits(frame)
    sender.send(frame, 0)
    wire.advance(MS)
    assert heard[0].timestamp_ns == nominal * 1000 + fast * 200


def test_a_frame_on_the_wire_is_not_interrupted_by_a_more_urgent_one() -> None:
    wire = Wire(1_000_000)
    order: list[int] = []
    slow, urgent = wire.attach("slow", None), wire.attach("urgent", None)
    wire.attach("listener", lambda frame: order.append(frame.can_id))
    slow.send(Frame(0x700, bytes(8)), 0)
    urgent.send(Frame(0x001, b""), 1)
    wire.advance(MS)
    assert order == [0x700, 0x001]


def test_a_short_advance_in_the_middle_of_a_frame_changes_nothing() -> None:
    whole, pieces = Rig(), Rig()
    whole.ticks(3)
    for tick in range(3):
        pieces.host.send(COMMAND, tick * MS)
        for part in range(1, 1001):
            pieces.wire.advance(tick * MS + part * 1000)
    assert pieces.at_host == whole.at_host
    assert len(whole.at_host) == 12


@given(st.integers(0, 0x1FFFFFFF), st.integers(0, 0x1FFFFFFF), st.booleans(), st.booleans(), st.booleans())
def test_arbitration_compares_the_bits_that_are_on_the_wire(
    first: int, second: int, first_extended: bool, second_extended: bool, remote: bool
) -> None:
    def identifier(number: int, extended: bool) -> int:
        return (number | EXTENDED if extended else number & 0x7FF) | (REMOTE if remote else 0)

    def written_out(can_id: int) -> list[int]:
        asks = int(bool(can_id & REMOTE))
        if can_id & EXTENDED:
            digits = f"{can_id & 0x1FFFFFFF:029b}"
            return [int(d) for d in digits[:11]] + [1, 1] + [int(d) for d in digits[11:]] + [asks]
        return [int(d) for d in f"{can_id & 0x7FF:011b}"] + [asks, 0]  # then r0 and so on: never compared further

    a, b = identifier(first, first_extended), identifier(second, second_extended)
    if a == b:
        assert arbitration_key(a) == arbitration_key(b)
    else:
        assert (arbitration_key(a) < arbitration_key(b)) == (written_out(a) < written_out(b))


def test_a_base_frame_beats_an_extended_one_with_the_same_first_bits() -> None:
    wire = Wire(1_000_000)
    order: list[int] = []
    extended, base = wire.attach("a", None), wire.attach("b", None)
    wire.attach("listener", lambda frame: order.append(frame.can_id))
    extended.send(Frame(EXTENDED | 0x100 << 18, b""), 0)
    base.send(Frame(0x100, b""), 0)
    wire.advance(MS)
    assert order == [0x100, EXTENDED | 0x100 << 18]


def test_the_queue_of_a_node_is_a_fifo_so_an_urgent_frame_waits_behind_a_lazy_one() -> None:
    wire = Wire(1_000_000)
    order: list[int] = []
    inverted, other = wire.attach("inverted", None), wire.attach("other", None)
    wire.attach("listener", lambda frame: order.append(frame.can_id))
    inverted.send(Frame(0x700, b""), 0)
    inverted.send(Frame(0x001, b""), 0)
    for _ in range(2):
        other.send(Frame(0x300, b""), 0)
    wire.advance(MS)
    assert order == [0x300, 0x300, 0x700, 0x001]


def test_a_node_with_a_buffer_for_each_message_sends_its_most_urgent_one_first() -> None:
    wire = Wire(1_000_000)
    order: list[int] = []
    buffered, other = wire.attach("buffered", None, fifo=False), wire.attach("other", None)
    wire.attach("listener", lambda frame: order.append(frame.can_id))
    other.send(Frame(0x300, b""), 0)
    wire.advance(BIT)
    for can_id, at_ns in ((0x700, BIT), (0x200, 2 * BIT), (0x001, MS)):
        buffered.send(Frame(can_id, b""), at_ns)
    wire.advance(80 * BIT)  # 0x200 is on the wire
    buffered.send(Frame(0x100, b""), 80 * BIT)
    wire.advance(2 * MS)
    assert order == [0x300, 0x200, 0x100, 0x700, 0x001]


def test_a_full_queue_refuses_and_counts_and_the_refused_frame_is_never_sent() -> None:
    wire, sender, heard, _ = pair(queue_length=2)
    frames = [Frame(0x100 + i, b"") for i in range(3)]
    assert [sender.send(frame, 0) for frame in frames] == [True, True, False]
    wire.advance(MS)
    assert [frame.can_id for frame in heard] == [0x100, 0x101]
    assert sender.counters().refused == 1
    assert sender.send(frames[2], MS)  # there is room again


def test_purging_drops_what_waits_but_not_what_is_on_the_wire() -> None:
    wire, sender, heard, _ = pair()
    for i in range(4):
        sender.send(Frame(0x100 + i, b""), 0)
    wire.advance(10 * BIT)
    assert sender.purge() == 3
    wire.advance(MS)
    assert [frame.can_id for frame in heard] == [0x100]


def test_the_past_and_impossible_settings_are_refused_by_name() -> None:
    wire, sender, _, _ = pair()
    wire.advance(MS)
    with pytest.raises(ValueError, match="send at 0 ns, but the wire is at 1000000 ns"):
        sender.send(COMMAND, 0)
    with pytest.raises(ValueError, match="advance to 0 ns"):
        wire.advance(0)
    with pytest.raises(ValueError, match="'sender' is attached already"):
        wire.attach("sender", None)
    with pytest.raises(ValueError, match="queue_length = 0"):
        wire.attach("other", None, 0)
    with pytest.raises(ValueError, match="bitrate = 0"):
        Wire(0)
    with pytest.raises(ValueError, match="drop_probability = 1"):
        Wire(1_000_000, drop_probability=1.0)


def test_bus_time_adds_up() -> None:
    rig = Rig()
    rig.ticks(10)
    per_tick = (bits(COMMAND) + sum(bits(answer) for answer in FEEDBACK) + 5 * INTERMISSION) * BIT
    assert rig.wire.busy_ns == 10 * per_tick


# -- faults of single frames -------------------------------------------------------------------------------------------


def test_a_dropped_frame_is_acknowledged_and_lost_in_silence() -> None:
    rig = Rig(WireFault(FaultKind.DROP, can_id=0x101, count=1))
    rig.ticks(2)
    assert [frame.can_id for frame in rig.at_host] == [0x100, 0x102, 0x103, 0x100, 0x101, 0x102, 0x103]
    assert rig.drives[1].counters().sent == 2
    assert rig.wire.dropped == 1
    assert rig.host.counters().errors == 0


def test_a_drop_can_be_confined_to_one_receiver() -> None:
    rig = Rig(WireFault(FaultKind.DROP, can_id=COMMAND.can_id, receiver="drive2", until_ns=MS))
    rig.ticks(2)
    assert [len(heard) for heard in rig.at_drive.values()] == [2, 2, 1, 2]


def test_random_drops_come_from_the_seed_at_about_their_probability() -> None:
    def losses(seed: int) -> list[int]:
        rig = Rig(drop_probability=0.1, seed=seed)
        rig.ticks(400)
        return [frame.timestamp_ns for frame in rig.at_host]

    assert losses(1) == losses(1)
    assert losses(1) != losses(2)
    assert 0.76 < len(losses(3)) / 1600 < 0.86  # both the command and the answer have to arrive: 0.81


def test_the_random_stream_is_the_published_one() -> None:
    stream = Random(1234567)  # the reference values of SplitMix64 for this seed
    assert [stream.bits() for _ in range(3)] == [6457827717110365317, 3203168211198807973, 9817491932198370423]


def test_a_duplicate_is_taken_twice_because_its_sender_saw_the_last_bit_spoiled() -> None:
    rig = Rig(WireFault(FaultKind.DUPLICATE, can_id=0x102, count=1))
    rig.ticks(1)
    assert [frame.can_id for frame in rig.at_host] == [0x100, 0x101, 0x102, 0x102, 0x103]
    assert rig.at_host[2].data == rig.at_host[3].data
    assert (rig.drives[2].tec, rig.drives[2].sent, rig.drives[2].errors) == (7, 1, 1)


def test_a_permanent_duplication_still_lets_the_bus_move_on() -> None:
    rig = Rig(WireFault(FaultKind.DUPLICATE, can_id=0x102))
    rig.ticks(3)
    assert [frame.can_id for frame in rig.at_host] == [0x100, 0x101, 0x102, 0x102, 0x103] * 3


def test_a_reordered_frame_arrives_behind_its_successor() -> None:
    rig = Rig(WireFault(FaultKind.REORDER, can_id=0x101, count=1))
    rig.ticks(1)
    assert [frame.can_id for frame in rig.at_host] == [0x100, 0x102, 0x101, 0x103]
    stamps = [frame.timestamp_ns for frame in rig.at_host]
    assert stamps == sorted(stamps)


def test_a_reordered_frame_with_no_successor_arrives_after_its_delay() -> None:
    rig = Rig(WireFault(FaultKind.REORDER, can_id=0x103, count=1, delay_ns=300_000))
    rig.ticks(1)
    undisturbed = Rig()
    undisturbed.ticks(1)
    assert rig.at_host[-1].timestamp_ns == undisturbed.at_host[-1].timestamp_ns + 300_000


def test_a_delayed_frame_arrives_late_and_may_answer_late() -> None:
    rig = Rig(WireFault(FaultKind.DELAY, can_id=COMMAND.can_id, receiver="drive0", delay_ns=2 * MS, until_ns=1))
    rig.ticks(4)
    arrivals = [frame.timestamp_ns for frame in rig.at_drive["drive0"]]
    first = bits(COMMAND) * BIT
    assert arrivals == [first + MS, first + 2 * MS, first + 2 * MS, first + 3 * MS]
    assert sum(frame.can_id == 0x100 for frame in rig.at_host) == 4


def test_an_altered_frame_passes_the_controllers_with_one_bit_changed() -> None:
    rig = Rig(WireFault(FaultKind.ALTER, can_id=0x100, bit=9, count=1))
    rig.ticks(1)
    assert rig.at_host[0].data == bytes([0, 255 ^ 2, 0, 0, 7, 7, 7, 7])
    assert rig.host.counters().errors == 0
    assert FEEDBACK[0].data[1] == 255  # what was sent is untouched


def test_a_corrupted_frame_is_repeated_and_only_time_is_lost() -> None:
    rig = Rig(WireFault(FaultKind.CORRUPT, can_id=0x100, bit=30, count=1))
    undisturbed = Rig()
    rig.ticks(1)
    undisturbed.ticks(1)
    lost = (31 + 12 + 8 + INTERMISSION) * BIT  # up to the error, flags, delimiter, intermission
    assert [f.timestamp_ns - lost for f in rig.at_host] == [f.timestamp_ns for f in undisturbed.at_host]
    assert rig.drives[0].tec == 8 - 1  # the failure, then the success
    assert rig.host.counters().errors == 1
    assert rig.host.rec == 0  # one error, then a frame taken well


def test_where_an_fd_frame_is_hit_decides_how_long_the_attempt_lasted() -> None:
    frame = Frame(0x100, bytes(range(16)), FD | BRS)
    nominal, _ = frame_bits(frame)
    head = nominal - 9

    def end_of_attempt(bit: int) -> int:
        ends: list[int] = []
        wire = Wire(
            1_000_000,
            5_000_000,
            faults=[WireFault(FaultKind.CORRUPT, bit=bit, count=1)],
            observer=lambda _start, end, _sender, _frame, _ok: ends.append(end),
        )
        wire.attach("listener", None)
        wire.attach("sender", None).send(frame, 0)
        wire.advance(MS)
        return ends[0] - 20 * BIT  # without the error frame

    assert end_of_attempt(0) == 1 * BIT
    assert end_of_attempt(head - 1) == head * BIT
    assert end_of_attempt(head + 49) == head * BIT + 50 * 200
    assert end_of_attempt(10_00) == nominal * BIT + frame_bits(frame)[1] * 200


# -- fault confinement -------------------------------------------------------------------------------------------------


def test_a_node_whose_frames_always_fail_becomes_passive_after_16_and_bus_off_after_32() -> None:
    rig = Rig(WireFault(FaultKind.CORRUPT, node="drive0", bit=15))
    states: list[BusState] = []
    rig.host.send(COMMAND, 0)
    while rig.wire.now_ns < 10 * MS:
        rig.wire.advance(rig.wire.now_ns + 10 * BIT)
        if not states or states[-1] != rig.drives[0].state:
            states.append(rig.drives[0].state)
    assert states == [BusState.ERROR_ACTIVE, BusState.ERROR_PASSIVE, BusState.BUS_OFF]
    assert rig.drives[0].counters().errors == 32
    assert rig.drives[0].counters().bus_off == 1
    assert not rig.drives[0].send(FEEDBACK[0], rig.wire.now_ns)
    assert [frame.can_id for frame in rig.at_host] == [0x101, 0x102, 0x103]  # the others go on


def test_an_error_passive_sender_lets_others_go_first() -> None:
    wire, sender, heard, listener = pair(WireFault(FaultKind.CORRUPT, node="sender", bit=15, count=20))
    sender.send(Frame(0x001, b""), 0)
    wire.advance(5 * MS)
    assert (sender.tec, sender.state) == (20 * 8 - 1, BusState.ERROR_PASSIVE)
    assert (listener.rec, listener.state) == (20 - 1, BusState.ERROR_ACTIVE)
    heard.clear()
    other = wire.attach("other", None)
    for _ in range(2):
        sender.send(Frame(0x001, b""), wire.now_ns)
        other.send(Frame(0x700, b""), wire.now_ns + 1)
    wire.advance(6 * MS)
    assert [frame.can_id for frame in heard] == [0x001, 0x700, 0x001, 0x700]  # by priority the 0x700s come last


def test_a_passive_node_recovers_by_sending_well() -> None:
    wire, sender, _, _ = pair(WireFault(FaultKind.CORRUPT, node="sender", bit=15, count=16))
    sender.send(COMMAND, 0)
    wire.advance(5 * MS)
    assert (sender.tec, sender.state) == (127, BusState.ERROR_ACTIVE)
    for _ in range(127):
        sender.send(COMMAND, wire.now_ns)
        wire.advance(wire.now_ns + MS)
    assert sender.tec == 0


def test_bus_off_lasts_until_it_is_restarted_and_128_times_11_idle_bits_have_passed() -> None:
    rig = Rig(WireFault(FaultKind.BUS_OFF, node="host", from_ns=MS))
    rig.ticks(1)
    rig.wire.advance(500 * MS)
    assert rig.host.state == BusState.BUS_OFF
    assert not rig.host.send(COMMAND, rig.wire.now_ns)
    rig.host.restart(rig.wire.now_ns)
    rig.wire.advance(500 * MS + 1408 * BIT - 1)
    assert rig.host.state == BusState.BUS_OFF
    rig.wire.advance(500 * MS + 1408 * BIT)
    assert rig.host.state == BusState.ERROR_ACTIVE
    assert (rig.host.tec, rig.host.rec, rig.host.counters().restarted) == (0, 0, 1)
    rig.ticks(1, start=502)
    assert len(rig.at_host) == 8


def test_recovery_takes_longer_on_a_busy_bus() -> None:
    rig = Rig(WireFault(FaultKind.BUS_OFF, node="drive3"))
    rig.ticks(1)
    rig.drives[3].restart(MS)
    rig.ticks(2, start=1)
    assert rig.drives[3].state == BusState.BUS_OFF  # 2 ms would be enough on an idle bus
    rig.ticks(2, start=3)
    assert rig.drives[3].state == BusState.ERROR_ACTIVE


def test_what_a_node_had_queued_is_gone_after_bus_off() -> None:
    wire, sender, heard, _ = pair(WireFault(FaultKind.BUS_OFF, node="sender", from_ns=20 * BIT))
    sender.send(COMMAND, 0)
    sender.send(COMMAND, 0)
    wire.advance(MS)
    sender.restart(wire.now_ns)
    wire.advance(10 * MS)
    assert heard == []
    assert not sender.queue


def test_without_acknowledgement_the_counter_stops_at_128_and_the_old_setpoint_replays() -> None:
    rig = Rig(WireFault(FaultKind.NO_ACK, node="host", from_ns=5 * MS, until_ns=50 * MS))
    for tick in range(40):
        rig.host.send(Frame(COMMAND.can_id, bytes([tick] * 8)), tick * MS)
        rig.wire.advance((tick + 1) * MS)
    assert rig.host.tec == 128
    assert rig.host.state == BusState.ERROR_PASSIVE
    assert rig.host.counters().bus_off == 0
    assert rig.host.counters().no_ack > 100
    assert rig.host.counters().refused == 40 - 5 - 16  # the queue holds 16
    assert len(rig.at_drive["drive0"]) == 5
    rig.wire.advance(60 * MS)
    assert [frame.data[0] for frame in rig.at_drive["drive0"]] == list(range(21))  # 5 to 20: too old by then


def test_purging_in_time_keeps_old_setpoints_from_replaying() -> None:
    rig = Rig(WireFault(FaultKind.NO_ACK, node="host", until_ns=10 * MS))
    rig.ticks(10)
    assert rig.host.purge() == 10
    rig.wire.advance(20 * MS)
    assert rig.at_drive["drive0"] == []
    rig.ticks(1, start=20)
    assert len(rig.at_drive["drive0"]) == 1


def test_a_node_alone_on_the_bus_is_not_acknowledged() -> None:
    wire = Wire(1_000_000)
    node = wire.attach("alone", None)
    node.send(COMMAND, 0)
    wire.advance(100 * MS)
    assert node.tec == 128
    assert node.counters().sent == 0
    attempt = bits(COMMAND) + 6 + INTERMISSION
    passive = attempt + 8
    assert node.counters().no_ack == 16 + (100_000 - 15 * attempt - passive - bits(COMMAND)) // passive + 1


def test_two_nodes_with_one_identifier_drive_each_other_off_the_bus() -> None:
    wire = Wire(1_000_000)
    heard: list[Frame] = []
    first, second = wire.attach("a", None), wire.attach("b", None)
    wire.attach("listener", heard.append)
    first.send(Frame(0x100, b"\x00"), 0)
    second.send(Frame(0x100, b"\xff"), 0)
    wire.advance(20 * MS)
    assert first.state == second.state == BusState.BUS_OFF
    assert heard == []


# -- faults of nodes ---------------------------------------------------------------------------------------------------


def test_an_interface_that_goes_down_refuses_then_comes_back_empty() -> None:
    rig = Rig(WireFault(FaultKind.DOWN, node="host", from_ns=2 * MS, until_ns=4 * MS))
    rig.ticks(6)
    counters = rig.host.counters()
    assert (counters.down, counters.sent, counters.refused) == (2, 4, 0)
    assert rig.host.state == BusState.ERROR_ACTIVE
    rig.wire.advance(10 * MS)
    assert len(rig.at_host) == 16


def test_overlapping_windows_end_with_the_last_of_them() -> None:
    rig = Rig(
        WireFault(FaultKind.NO_ACK, node="drive0", until_ns=2 * MS),
        WireFault(FaultKind.NO_ACK, node="drive0", from_ns=MS, until_ns=4 * MS),
        WireFault(FaultKind.DOWN, node="drive1", until_ns=2 * MS),
        WireFault(FaultKind.DOWN, node="drive1", from_ns=MS, until_ns=4 * MS),
    )
    rig.ticks(6)
    assert [len(heard) for heard in rig.at_drive.values()] == [2, 2, 6, 6]


def test_a_drive_that_is_down_is_missed_by_nobody_but_the_host() -> None:
    rig = Rig(WireFault(FaultKind.DOWN, node="drive1"))
    rig.ticks(2)
    assert [frame.can_id for frame in rig.at_host] == [0x100, 0x102, 0x103] * 2
    assert rig.drives[1].state == BusState.DOWN


def test_a_babbling_node_starves_everybody_else_until_it_stops() -> None:
    rig = Rig(WireFault(FaultKind.BABBLE, can_id=0x000, from_ns=2 * MS, until_ns=5 * MS))
    rig.ticks(8)
    commands = [frame.timestamp_ns for frame in rig.at_drive["drive0"]]
    assert not [stamp for stamp in commands if 2 * MS < stamp < 5 * MS]
    assert len(commands) == 8  # what was queued meanwhile comes afterwards, late
    babble = [frame for frame in rig.at_host if frame.can_id == 0x000]
    assert len(babble) > 20


def test_a_periodic_babbler_of_low_urgency_costs_only_its_own_time() -> None:
    rig = Rig(WireFault(FaultKind.BABBLE, can_id=0x7FF, period_ns=200_000, until_ns=2 * MS))
    rig.ticks(4)
    babbler = rig.wire.nodes["babbler"]
    assert sum(frame.can_id == 0x7FF for frame in rig.at_host) == babbler.sent >= 4
    assert babbler.sent + babbler.refused == 10  # it waits its turn, with room for one frame
    assert sum(frame.can_id == 0x100 for frame in rig.at_host) == 4


def test_faults_can_be_injected_while_the_bus_runs() -> None:
    rig = Rig()
    rig.ticks(2)
    rig.wire.inject(WireFault(FaultKind.DOWN, node="drive0"))
    rig.wire.inject(WireFault(FaultKind.DROP, can_id=0x101, from_ns=3 * MS))
    rig.ticks(2, start=2)
    assert [frame.can_id for frame in rig.at_host[8:]] == [0x101, 0x102, 0x103, 0x102, 0x103]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kind": "melt"}, "melt"),
        ({"kind": "drop", "until_ns": 0}, "until_ns = 0, allowed 1 to"),
        ({"kind": "drop", "probability": 0.0}, "probability = 0.0, allowed 0 < p <= 1"),
        ({"kind": "babble", "length": 9}, "length = 9, allowed 0 to 8"),
        ({"kind": "bus_off"}, "node = None"),
    ],
)
def test_an_impossible_fault_is_refused_by_name(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        WireFault(**options)  # type: ignore[arg-type]


def test_a_fault_of_an_unknown_node_names_those_there_are() -> None:
    rig = Rig(WireFault(FaultKind.DOWN, node="drive9"))
    with pytest.raises(ValueError, match="no node 'drive9'; there are host, drive0"):
        rig.ticks(1)


# -- whatever happens --------------------------------------------------------------------------------------------------

frame_faults = st.builds(
    WireFault,
    kind=st.sampled_from(["drop", "duplicate", "reorder", "delay", "corrupt", "alter"]),
    from_ns=st.integers(0, 5 * MS),
    can_id=st.sampled_from([None, 0x080, 0x100, 0x102]),
    count=st.integers(0, 40),
    probability=st.sampled_from([1.0, 0.5, 0.01]),
    delay_ns=st.integers(0, 3 * MS),
)
node_faults = st.builds(
    lambda kind, node, start, length, restart: (WireFault(kind, start, start + length, node=node), restart),
    st.sampled_from(["no_ack", "bus_off", "down", "babble"]),
    st.sampled_from(["host", "drive0", "drive3"]),
    st.integers(0, 5 * MS),
    st.integers(1, 3 * MS),
    st.booleans(),
)


def _history(frame_script: list[WireFault], node_script: list[tuple[WireFault, bool]], seed: int) -> list[object]:
    """Runs a rig under a script; returns all that happened."""
    events: list[object] = []
    script = frame_script + [
        # a babbler has a name of its own
        WireFault(f.kind, f.from_ns, f.until_ns, node="babbler") if f.kind is FaultKind.BABBLE else f
        for f, _ in node_script
    ]
    rig = Rig(*script, seed=seed, observer=lambda *attempt: events.append(attempt))
    for tick in range(12):
        if tick == 8 and any(restart for _, restart in node_script):
            for node in rig.wire.nodes.values():
                node.restart(rig.wire.now_ns)
        rig.host.send(COMMAND, tick * MS)
        rig.wire.advance((tick + 1) * MS)
        events += [
            (node.name, node.counters(), node.tec, node.rec, len(node.queue)) for node in rig.wire.nodes.values()
        ]
    return [*events, *rig.at_host]


@settings(max_examples=150, deadline=None)
@given(st.lists(frame_faults, max_size=3), st.lists(node_faults, max_size=2), st.integers(0, 2**32 - 1))
def test_any_script_ends_reruns_exactly_and_never_has_two_frames_on_the_wire(
    frame_script: list[WireFault], node_script: list[tuple[WireFault, bool]], seed: int
) -> None:
    history = _history(frame_script, node_script, seed)
    assert history == _history(frame_script, node_script, seed)
    isolated = any(fault.kind is FaultKind.NO_ACK for fault, _ in node_script)
    attempts = [
        event for event in history if isinstance(event, tuple) and len(event) == 5 and isinstance(event[0], int)
    ]
    if not isolated:  # a node that is cut off sends on a piece of cable of its own
        for before, after in pairwise(attempts):
            assert after[0] >= before[1] + INTERMISSION * BIT


def test_receivers_get_time_in_order_even_with_late_deliveries() -> None:
    stamps: list[int] = []
    wire = Wire(1_000_000, faults=[WireFault("delay", probability=0.3, delay_ns=700_000)])  # type: ignore[arg-type]
    sender = wire.attach("sender", None)
    wire.attach("listener", lambda frame: stamps.append(frame.timestamp_ns))
    for tick in range(200):
        sender.send(COMMAND, tick * MS // 2)
        wire.advance((tick + 1) * MS // 2)
    wire.advance(200 * MS)
    assert len(stamps) == 200
    assert stamps == sorted(stamps)
