"""The simulated CAN segment: what a bus does when all is well, and when it is not."""

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.frame import BRS, EXTENDED, FD, REMOTE, Frame
from drivers.frame_length import INTERMISSION, frame_bits
from drivers.wire.faults import FaultKind, WireFault
from drivers.wire.node import arbitration_key
from drivers.wire.wire import Wire
from tests.support.wire_rig import BIT, COMMAND, FEEDBACK, MS, Rig, bits, pair

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
