"""Scripted faults of the simulated segment: of single frames, and of whole nodes."""

import pytest

from drivers.bus.counters import BusState
from drivers.frame import BRS, FD, Frame
from drivers.frame_length import INTERMISSION, frame_bits
from drivers.wire.faults import FOREVER_NS, FaultKind, Random, WireFault
from drivers.wire.wire import Wire
from tests.support.wire_rig import BIT, COMMAND, FEEDBACK, MS, Rig, bits, pair

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


def test_a_frame_without_payload_has_no_bit_to_be_altered() -> None:
    wire, sender, heard, _ = pair(WireFault(FaultKind.ALTER, bit=3))
    sender.send(Frame(0x123, b""), 0)
    wire.advance(MS)
    assert [frame._replace(timestamp_ns=0) for frame in heard] == [Frame(0x123, b"")]


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


@pytest.mark.parametrize("kind", [FaultKind.NO_ACK, FaultKind.DOWN, FaultKind.BUS_OFF])
def test_a_node_that_is_off_the_bus_hears_nothing_though_it_has_heard_before(kind: FaultKind) -> None:
    rig = Rig(WireFault(kind, node="drive1", from_ns=2 * MS - 1, until_ns=5 * MS - 1))
    rig.ticks(8)
    back = 0 if kind is FaultKind.BUS_OFF else 3
    assert [len(heard) for heard in rig.at_drive.values()] == [8, 2 + back, 8, 8]
    assert sum(frame.can_id == FEEDBACK[1].can_id for frame in rig.at_host) == 2 + back


@pytest.mark.parametrize("kind", [FaultKind.NO_ACK, FaultKind.DOWN, FaultKind.BUS_OFF])
@pytest.mark.parametrize(("gone_ns", "heard"), [(300_000, 0), (900_000, 1)])
def test_what_comes_late_is_not_taken_by_a_node_that_has_gone(kind: FaultKind, gone_ns: int, heard: int) -> None:
    rig = Rig(
        WireFault(FaultKind.DELAY, receiver="drive1", can_id=COMMAND.can_id, delay_ns=500_000),
        WireFault(kind, node="drive1", from_ns=gone_ns),
    )
    rig.ticks(1)
    assert len(rig.at_drive["drive1"]) == rig.drives[1].received == heard


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


@pytest.mark.parametrize(
    ("key", "low", "high"),
    [
        ("from_ns", 0, FOREVER_NS - 1),
        ("until_ns", 8, FOREVER_NS),  # from_ns is 7
        ("count", 0, 2**31),
        ("delay_ns", 0, FOREVER_NS),
        ("bit", -1, 1000),
        ("period_ns", 0, FOREVER_NS),
        ("length", 0, 8),
    ],
)
def test_every_number_of_a_fault_has_a_range_whose_ends_belong_to_it(key: str, low: int, high: int) -> None:
    given = {"from_ns": 7} if key == "until_ns" else {}
    for value in (low, high):
        assert getattr(WireFault(FaultKind.DROP, **given, **{key: value}), key) == value  # type: ignore[arg-type]
    most = FOREVER_NS if key == "from_ns" else high
    for value in (low - 1, most + 1):
        with pytest.raises(ValueError, match=f"wire fault drop: {key} = {value}, allowed {low} to {most}"):
            WireFault(FaultKind.DROP, **given, **{key: value})  # type: ignore[arg-type]


def test_the_defaults_are_a_fault_that_lasts_of_every_frame() -> None:
    fault = WireFault(FaultKind.DROP)
    assert (fault.from_ns, fault.until_ns, fault.can_id, fault.node, fault.receiver) == (
        0,
        FOREVER_NS,
        None,
        None,
        None,
    )
    assert (fault.count, fault.probability, fault.delay_ns, fault.bit) == (0, 1.0, MS, -1)
    assert (fault.period_ns, fault.length) == (0, 8)


def test_a_fault_of_an_unknown_node_names_those_there_are() -> None:
    rig = Rig(WireFault(FaultKind.DOWN, node="drive9"))
    with pytest.raises(ValueError, match="no node 'drive9'; there are host, drive0"):
        rig.ticks(1)


def test_a_bit_that_is_not_named_is_drawn_anywhere_in_the_frame() -> None:
    ends = set()
    for seed in range(40):
        rig = Rig(WireFault(FaultKind.CORRUPT, can_id=COMMAND.can_id, count=1), drives=1, seed=seed)
        rig.ticks(1)
        (heard,) = rig.at_drive["drive0"]  # the repetition, behind the error frame
        ends.add(heard.timestamp_ns // BIT)
    assert len(ends) > 20
    assert max(ends) - min(ends) > bits(COMMAND) // 2
