"""Cells over Zenoh: a client that joins late has the newest word on each, and then what comes."""

import time
from collections.abc import Callable

import zenoh

from hil.control.motion.injection.verdict import TOLD, CellResult, Phase, Verdict
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.cell_feed import CellFeed
from hil.telemetry.cell_watch import CellWatch, Told
from hil.telemetry.publisher import Publisher
from tests.support.cells import equipped


def over(watch: CellWatch, number: int, verdict: Verdict, tick: int) -> pb.Cell:
    """The word on a cell that has its verdict. number: from 0 on."""
    return watch.tell(Told(tick, tick, TOLD + verdict, CellResult(number, verdict)))


def gathered(feed: CellFeed, publisher: Publisher, answer: Callable[[], bytes], enough: int) -> list[tuple[int, str]]:
    found: list[tuple[int, str]] = []
    until = time.monotonic() + 20.0
    while len(found) < enough:
        assert time.monotonic() < until, found
        publisher.answer_queries({"cells": answer})
        found += [(cell.number, cell.verdict or cell.phase) for cell in feed.take()]
        time.sleep(0.01)
    return found


def test_who_joins_late_has_the_newest_word_on_each_cell_and_what_comes(
    publisher: Publisher, session: zenoh.Session
) -> None:
    watch = CellWatch(equipped(3), run=7)
    watch.tell(Told(1, 1, Phase.SEEK, CellResult(0)))
    over(watch, 0, Verdict.OK, 2)
    over(watch, 1, Verdict.NO_CELL, 3)
    feed = CellFeed(session, "hil/rig/cells")
    assert gathered(feed, publisher, watch.told, 2) == [(1, "ok"), (2, "no_cell")]
    publisher.put("cells", watch.tell(Told(4, 4, Phase.PRESS, CellResult(2))).SerializeToString())
    assert gathered(feed, publisher, watch.told, 1) == [(3, "press")]


def test_what_is_no_cell_is_passed_over(publisher: Publisher, session: zenoh.Session) -> None:
    watch = CellWatch(equipped(3))
    feed = CellFeed(session, "hil/rig/cells")
    until = time.monotonic() + 20.0
    while not publisher.wanted("cells"):
        assert time.monotonic() < until
        time.sleep(0.01)
    publisher.put("cells", b"\xff\xff\xff")
    publisher.put("cells", over(watch, 2, Verdict.STUCK, 9).SerializeToString())
    assert gathered(feed, publisher, bytes, 1) == [(3, "stuck")]
