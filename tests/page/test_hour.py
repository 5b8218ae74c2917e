"""Ten minutes of a page in lockstep, one turn after the other, and what they leave in memory."""

import gc
import sys
from collections.abc import Callable

import pytest

from hil.page.hub import TURN_S, WAITING, Hub, Viewer
from hil.page.sidecar_feed import KEPT
from hil.page.words import status_words
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb
from tests.page.conftest import Told

TURNS = round(600 / TURN_S)
STATUS, EVENT = 3, 250  # turns from one to the next
MOST_BLOCKS = 300  # of memory that may stay; a page that kept one a turn would keep 15 000


def turned(hub: Hub, told: Told, viewers: list[Viewer]) -> Callable[[int], None]:
    """Plays that many turns, with all that comes meanwhile; the last viewer takes nothing."""
    at = 0

    def play(count: int) -> None:
        nonlocal at
        for turn in range(at, at + count):
            told.tick(turn)
            if turn % STATUS == 0:
                message = pb.Status(rig="paper", index=turn)
                hub.sidecar._status, hub.sidecar._message = status_words(message), message
            if turn % EVENT == 0:
                hub.sidecar._events.add([pb_events.Event(sequence=turn, name=f"event {turn}")])
            hub.turn()
            for viewer in viewers[:-1]:
                while not viewer._waiting.empty():
                    viewer._waiting.get_nowait()
        at += count

    return play


@pytest.mark.long
def test_ten_minutes_of_turns_leave_nothing_in_memory(told: Told) -> None:
    hub = Hub("paper")
    hub.sidecar.close()
    viewers = [Viewer(f"viewer {number}") for number in range(5)]
    hub.viewers.update(viewers)
    viewers[1].chosen = viewers[2].chosen = (0, 1)  # two have a scope
    play = turned(hub, told, viewers)
    hub.sidecar._events.add(pb_events.Event(sequence=n, name=f"event {n}") for n in range(KEPT))
    play(2 * EVENT)
    gc.collect()
    before = sys.getallocatedblocks()
    play(TURNS)
    gc.collect()
    more = sys.getallocatedblocks() - before
    hub.ring.close()
    print(f"{more} blocks more of {before} after {TURNS} turns")
    assert viewers[-1].dropped > TURNS - WAITING  # who takes nothing costs nothing
    assert more < MOST_BLOCKS
