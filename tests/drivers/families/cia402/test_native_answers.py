"""cia402's frames in C against Python: the same samples, states of drives and commands, whatever comes."""

from itertools import zip_longest
from types import ModuleType
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusConfig, Wiring
from drivers.families.cia402 import cia301, host
from drivers.families.cia402.config import Cia402Config
from drivers.families.cia402.host import Cia402Host
from drivers.families.cia402.node import Phase
from drivers.frame import ECHO, EXTENDED, FD, Frame
from drivers.protocols.base import Command
from hil.cycle.inbox import Inbox

pytestmark = pytest.mark.long

MS = 1_000_000
RATED = (5.3, 20.0, 0.04)
TOLD = (
    "samples", "fresh", "received_ns", "age", "heard", "rejects", "bad_frames", "suspect_axis", "late", "lost",
    "foreign_id", "differ_axis", "useless_now",
)  # fmt: skip
OF_NODE = ("phase", "state", "alarms", "emergency", "problem", "_heard_tick", "_tick")
ENABLED, SWITCHED_ON, FAULT = 0x0637, 0x0633, 0x0638


def wiring(*, watched: bool = False) -> Wiring:
    """Three of the project's drives. watched: with the mode in every answer, by a table of their own."""
    eds = [str(cia301.EDS)]
    table = Cia402Config(eds=eds, write_rated_torque=True, watch_mode=True) if watched else None
    return Wiring(BusConfig(protocol="cia402", **({"cia402": table} if table else {})), len(RATED), RATED)


def about_to_run(*, watched: bool) -> Cia402Host:
    """A host whose drives are configured; the next answer of each says that it runs."""
    made = Cia402Host(wiring(watched=watched))
    for node in made.nodes:
        node._enter(Phase.START)
    return made


def answer(axis: int, position: int, word: int, mode: int, damage: int) -> Frame:
    """An axis' answer, of 7 bytes with its mode; damage: 1 to 3, in one of its parts."""
    data = position.to_bytes(4, "little", signed=True) + word.to_bytes(2, "little") + mode.to_bytes(1, "little")
    flags = (0, FD, ECHO, 0)[damage]
    return Frame(cia301.TPDO1_ID + 1 + axis, data[: 5 if damage == 3 else 7], flags)


WORDS = st.sampled_from([ENABLED] * 6 + [SWITCHED_ON, FAULT, 0x0E37, 0x4637, 0x0000]) | st.integers(0, 0xFFFF)
POSITIONS, DAMAGE = st.integers(-(2**31), 2**31 - 1), st.sampled_from([0] * 9 + [1, 2, 3])
USUAL = st.builds(answer, st.integers(0, 2), POSITIONS, st.just(ENABLED), st.just(10), DAMAGE)
ANSWERS = st.builds(answer, st.integers(0, 3), POSITIONS, WORDS, st.sampled_from([10] * 9 + [1, 255]), DAMAGE)
SYNC_ECHO = Frame(cia301.SYNC_ID, b"\x01", ECHO)
SERVICES = st.sampled_from(
    [
        Frame(cia301.HEARTBEAT_ID + 1, b"\x05"),
        Frame(cia301.HEARTBEAT_ID + 2, b"\x7f"),
        Frame(cia301.HEARTBEAT_ID + 3, b"\x00"),
        Frame(cia301.EMCY_ID + 1, bytes.fromhex("3081010000000000")),
        Frame(cia301.EMCY_ID + 1, bytes(8)),
        Frame(cia301.SDO_RESPONSE_ID + 2, bytes.fromhex("6040600000000000")),
        SYNC_ECHO._replace(flags=0),
        Frame(cia301.RPDO1_ID + 1, bytes(6), ECHO),
        Frame(EXTENDED | cia301.TPDO1_ID + 1, bytes(6)),
        Frame(0x7FF, b""),
    ]
)
HEARD = st.one_of(*[USUAL] * 3, ANSWERS, SERVICES, st.just(SYNC_ECHO))
TICKS = st.tuples(st.booleans(), st.lists(HEARD, max_size=6), st.sampled_from([0, 5, 7, 7]), st.booleans())


@given(watched=st.booleans(), ticks=st.lists(TICKS, max_size=8), late=st.lists(st.integers(-4 * MS, MS), max_size=6))
def test_a_host_and_its_inbox_are_the_same_whoever_reads(
    c: ModuleType, watched: bool, ticks: list[tuple[bool, list[Frame], int, bool]], late: list[int]
) -> None:
    plain, fast = (about_to_run(watched=watched) for _ in range(2))
    inbox, other = Inbox(plain, 20), Inbox(fast, 20)
    inbox._answers = None
    first = [answer(axis, 0, ENABLED, 10, 0) for axis in range(3)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(host, "_tpdos", c.tpdos)
        for number, (echoed, heard, enable, reset) in enumerate([(True, first, 7, False), *ticks], 1):
            frames = [
                frame._replace(data=frame.data[:6] if is_short(frame, watched) else frame.data, timestamp_ns=stamp)
                for frame, stamp in zip(
                    [SYNC_ECHO] * echoed + heard, stamps(number, late, echoed + len(heard)), strict=True
                )
            ]
            for node in (*plain.nodes, *fast.nodes):
                node._tick = number  # as `service` does now and then
            inbox.collect(frames, number)
            other.collect(frames, number)
            assert [getattr(other, name) for name in TOLD] == [getattr(inbox, name) for name in TOLD]
            command = Command(number, [0.1 * number % 0.03] * 3, enable, reset)
            assert fast.encode(command) == plain.encode(command)
            assert state_of(fast) == state_of(plain)


def is_short(frame: Frame, watched: bool) -> bool:
    """Whether an answer of 7 bytes has no mode there."""
    return not watched and len(frame.data) == 7


def stamps(number: int, late: list[int], count: int) -> list[int]:
    """When frames of a tick came; out of order, or unknown, where that is drawn."""
    return [max(-1, number * MS + (delay or 0)) for delay, _ in zip_longest(late[:count], range(count))]


def state_of(made: Cia402Host) -> list[Any]:
    """All that answers change in a host."""
    clock = made._clock
    known = [clock._current_ns, clock._last_ns, clock._first_axis, clock._usual_ns, bytes(made._usual), made.problems]
    return [known, *([getattr(node, name) for name in OF_NODE] for node in made.nodes)]


def test_all_of_an_ordinary_tick_is_read_in_c(c: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host, "_tpdos", c.tpdos)
    made = about_to_run(watched=False)
    tick = [SYNC_ECHO, *(answer(axis, 0, ENABLED, 10, 0) for axis in range(3))]
    tick = [frame._replace(data=frame.data[:6], timestamp_ns=MS) for frame in tick]
    assert made.answers(tick) == b""  # no drive is known to run
    made.encode(Command(0, [0.0] * 3, 0, False))
    for frame in tick:
        made.decode(frame)
    assert len(made.answers(tick)) == 4 * 48
    last = tick[3]
    for other in (
        last._replace(data=bytes(4) + FAULT.to_bytes(2, "little")), last._replace(flags=FD),
        last._replace(data=last.data[:5]), last._replace(can_id=0x7FF), SYNC_ECHO._replace(flags=0),
    ):  # fmt: skip
        assert len(made.answers([*tick[:3], other, tick[1]])) == 3 * 48
    unknown = SYNC_ECHO._replace(timestamp_ns=-1)
    assert made.answers([unknown, *tick[1:]]) == made.answers(tick[1:]) == b""  # SYNC's instant is to be estimated


FORCES = st.sampled_from([0.0, -0.0, 0.5, 1.5, -2.5, 5.3, 1e5, float("nan"), float("inf")]) | st.floats(-6.0, 6.0)
AXES = st.tuples(
    FORCES, st.sampled_from([5.3, 1e5]), st.sampled_from([0.0, 1.0, 1e6]) | st.floats(0, 1e6), st.integers(0, 32767)
)


@given(axes=st.lists(AXES, max_size=4), enable=st.integers(0, 15), short=st.sampled_from([False] * 5 + [True]))
def test_torques_are_written_or_refused_alike(
    c: ModuleType, axes: list[tuple[float, float, float, int]], enable: int, short: bool
) -> None:
    forces, rated, gains, limits = ([of[part] for of in axes] for part in range(4))
    arguments = (forces[: -1 if short else None], rated, gains, limits, enable)
    assert c.torques(*arguments) == host._plain_torques(*arguments)
