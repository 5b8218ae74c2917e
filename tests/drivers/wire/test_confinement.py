"""Error counters, bus-off and recovery on the simulated segment."""

from itertools import pairwise

import pytest

from drivers.bus.counters import BusState
from drivers.frame import Frame
from drivers.frame_length import INTERMISSION
from drivers.wire.faults import FaultKind, WireFault
from drivers.wire.wire import Wire
from tests.support.wire_rig import BIT, COMMAND, FEEDBACK, MS, Rig, bits, pair


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


@pytest.mark.parametrize("queued_behind", [False, True], ids=["nothing else to send", "a frame for later"])
def test_an_error_passive_sender_lets_others_go_first(queued_behind: bool) -> None:
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
    if queued_behind:
        sender.send(Frame(0x002, b""), 7 * MS)
    wire.advance(6 * MS)
    assert [frame.can_id for frame in heard] == [0x001, 0x700, 0x001, 0x700]  # by priority the 0x700s come last


def test_a_passive_node_recovers_by_sending_well() -> None:
    wire, sender, _, listener = pair(WireFault(FaultKind.CORRUPT, node="sender", bit=15, count=16))
    sender.send(COMMAND, 0)
    wire.advance(5 * MS)
    assert (sender.tec, sender.state) == (127, BusState.ERROR_ACTIVE)
    for left in range(126, -1, -1):
        sender.send(COMMAND, wire.now_ns)
        wire.advance(wire.now_ns + MS)
        assert sender.tec == left
        assert wire.confinement.healthy is (left == 0 and not listener.rec)
    assert listener.rec == 0


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
    assert node.counters().errors == node.counters().no_ack
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


def test_two_nodes_that_send_the_very_same_bits_disturb_nobody() -> None:
    wire = Wire(1_000_000)
    heard: list[Frame] = []
    twins = [wire.attach(name, None) for name in ("a", "b")]
    wire.attach("listener", heard.append)
    for twin in twins:
        twin.send(Frame(0x123, b"\x01"), 0)
    wire.advance(MS)
    assert [frame.data for frame in heard] == [b"\x01"] * 2
    assert [(twin.counters().errors, twin.counters().sent) for twin in twins] == [(0, 1)] * 2


def test_an_error_passive_sender_lets_others_go_before_it_tries_again() -> None:
    for tec, order in ((0, [0x001, 0x700]), (200, [0x700, 0x001])):
        wire, sender, heard, _ = pair(WireFault(FaultKind.CORRUPT, node="sender", bit=15, count=1))
        sender.tec = tec
        sender.send(Frame(0x001, b""), 0)
        wire.attach("other", None).send(Frame(0x700, b""), 1)
        wire.advance(MS)
        assert [frame.can_id for frame in heard] == order


@pytest.mark.parametrize(("tec", "order"), [(128, [1, 2, 0x700]), (129, [1, 0x700, 2])])
def test_a_sender_that_is_active_again_waits_for_nobody(tec: int, order: list[int]) -> None:
    wire, sender, heard, _ = pair()
    wire.confinement.healthy, sender.tec = False, tec
    for can_id in (1, 2):
        sender.send(Frame(can_id, b""), 0)
    wire.attach("other", None).send(Frame(0x700, b""), 1)
    wire.advance(MS)
    assert [frame.can_id for frame in heard] == order


def test_a_node_that_nobody_hears_tries_again_after_its_error_frame_and_later_when_it_is_passive() -> None:
    attempts: list[tuple[int, int]] = []
    wire = Wire(
        1_000_000,
        faults=[WireFault(FaultKind.NO_ACK, node="alone")],
        observer=lambda start, end, _sender, _frame, _sent: attempts.append((start, end)),
    )
    wire.attach("alone", None).send(COMMAND, 0)
    wire.attach("other", None)
    wire.advance(5 * MS)
    assert {end - start for start, end in attempts} == {bits(COMMAND) * BIT}
    gaps = [after - end for (_, end), (after, _) in pairwise(attempts)]
    # The error flag of 6 bits and its delimiter of 8 are in place of 8 bits of the frame; 3 of intermission follow.
    assert gaps[:15] == [9 * BIT] * 15
    assert set(gaps[15:]) == {17 * BIT}


def test_a_node_that_was_alone_counts_down_once_it_is_heard() -> None:
    wire = Wire(1_000_000)
    sender = wire.attach("sender", None)
    sender.send(COMMAND, 0)
    wire.advance(MS // 4)
    wire.attach("listener", None)
    wire.advance(MS)
    tec = sender.tec
    assert (sender.sent, tec, tec % 8) == (1, tec, 7)
    sender.send(COMMAND, MS)
    wire.advance(2 * MS)
    assert sender.tec == tec - 1


def test_a_collision_is_over_when_one_of_both_gives_up() -> None:
    wire, sender, heard, _ = pair()
    other = wire.attach("other", None)
    sender.send(Frame(1, b"a"), 0)
    other.send(Frame(1, b"b"), 0)
    wire.advance(43 * BIT)  # 21 bits, the error frame of 20, and two of three bits of intermission
    assert (sender.tec, other.tec, other.purge()) == (8, 8, 1)
    wire.advance(MS)
    assert ([frame.data for frame in heard], sender.tec, other.tec) == ([b"a"], 7, 8)


def test_a_frame_cut_short_is_an_error_of_those_who_hear_it_until_they_hear_a_good_one() -> None:
    wire, sender, heard, listener = pair(WireFault(FaultKind.DOWN, node="sender", from_ns=20 * BIT))
    sender.send(COMMAND, 0)
    other = wire.attach("other", None)
    wire.advance(MS)
    assert (len(heard), listener.rec, other.rec, listener.errors) == (0, 1, 1, 1)
    assert not wire.confinement.healthy
    other.send(COMMAND, MS)
    wire.advance(2 * MS)
    assert (len(heard), listener.rec, other.tec) == (1, 0, 0)


def test_what_a_node_repeats_is_forgotten_when_it_goes() -> None:
    wire, sender, heard, _ = pair(
        WireFault(FaultKind.DUPLICATE, count=1),
        WireFault(FaultKind.DOWN, node="sender", from_ns=(bits(COMMAND) + 5) * BIT, until_ns=MS),
        WireFault(FaultKind.DROP, from_ns=MS),
    )
    sender.send(COMMAND, 0)
    wire.advance(MS)
    assert len(heard) == 1
    sender.send(COMMAND, MS)
    wire.advance(2 * MS)
    assert (len(heard), sender.sent, wire.dropped) == (1, 1, 1)


@pytest.mark.parametrize(
    ("tec", "rec", "state"),
    [
        (0, 0, BusState.ERROR_ACTIVE),
        (127, 127, BusState.ERROR_ACTIVE),
        (128, 0, BusState.ERROR_PASSIVE),
        (0, 128, BusState.ERROR_PASSIVE),
        (255, 0, BusState.ERROR_PASSIVE),
    ],
)
def test_a_node_is_passive_above_127_of_either_counter(tec: int, rec: int, state: BusState) -> None:
    _, sender, _, _ = pair()
    sender.tec, sender.rec = tec, rec
    assert sender.state is state


def test_a_listener_of_broken_frames_becomes_passive_and_one_good_one_makes_it_active_again() -> None:
    wire, sender, heard, listener = pair(WireFault(FaultKind.CORRUPT, node="sender", bit=15, count=200))
    seen = []
    while not heard:
        sender.tec = 0  # else it would be off the bus before
        sender.send(COMMAND, wire.now_ns)
        wire.advance(wire.now_ns + MS // 10)
        seen.append((listener.rec, listener.state))
    assert max(seen) == (128, BusState.ERROR_PASSIVE)
    assert seen[-1] == (127, BusState.ERROR_ACTIVE)


def test_a_frame_that_its_sender_repeats_comes_again_behind_an_error_frame_of_20_bits() -> None:
    wire, sender, heard, _ = pair(WireFault(FaultKind.DUPLICATE, count=1))
    sender.send(COMMAND, 0)
    wire.advance(MS)
    whole = bits(COMMAND) + INTERMISSION
    assert [frame.timestamp_ns for frame in heard] == [bits(COMMAND) * BIT, (20 + whole + bits(COMMAND)) * BIT]
    assert wire.busy_ns == (2 * whole + 20) * BIT
    assert sender.counters().errors == 1


def test_a_frame_that_was_to_be_repeated_and_is_purged_leaves_nothing_behind() -> None:
    """What comes next may be overtaken, and is struck by the script like any other frame."""
    wire = Wire(1_000_000, faults=[WireFault(FaultKind.DUPLICATE, count=2)])
    heard: list[int] = []
    sender = wire.attach("sender", None, fifo=False)
    wire.attach("listener", lambda frame: heard.append(frame.can_id))
    sender.send(Frame(0x200, b""), 0)
    wire.advance((bits(Frame(0x200, b"")) + 5) * BIT)
    assert (heard, sender.purge()) == ([0x200], 1)
    for can_id in (0x300, 0x100):
        sender.send(Frame(can_id, b""), wire.now_ns)
    wire.advance(2 * MS)
    assert heard == [0x200, 0x100, 0x100, 0x300]


@pytest.mark.parametrize(("before", "is_off"), [(247, False), (248, True)])
def test_a_node_is_off_the_bus_above_255(before: int, is_off: bool) -> None:
    wire, sender, heard, _ = pair(WireFault(FaultKind.CORRUPT, count=1, bit=3))
    sender.tec = before
    sender.send(COMMAND, 0)
    wire.advance(MS)
    assert (sender.is_bus_off, sender.state is BusState.BUS_OFF, len(heard)) == (is_off, is_off, not is_off)
    assert sender.tec == (256 if is_off else 254)  # less one for what went through in the end
