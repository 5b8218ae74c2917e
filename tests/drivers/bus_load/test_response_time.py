"""The bounds by themselves: what has none stays without, and none of random traffic changes unnoticed."""

import hashlib
import random

from drivers.bus_load.response_time import UNBOUNDED, Bus, ErrorModel, Item, priority_queue_bound
from drivers.bus_load.schedulability import analyse
from tests.support.traffic import random_messages


def test_what_waits_for_a_frame_without_bound_has_none_however_seldom_that_frame_comes() -> None:
    seldom = 2**40
    urgent, mate, last = (Item(priority, 1, seldom, 0, sender) for priority, sender in ((1, "a"), (5, "a"), (9, "b")))
    bus = Bus([urgent, mate, last], 1, ErrorModel(), fifo=("a",))
    for item in bus.items:
        item.response = item.cost
    assert priority_queue_bound(bus, last) < seldom
    urgent.response = UNBOUNDED
    assert priority_queue_bound(bus, last) == UNBOUNDED


def test_no_bound_of_300_random_sets_has_changed() -> None:
    """Integers alone, the same on every machine. Are other bounds meant, the wire has to agree first
    (test_schedulability.py); the digest is then what the failure shows.
    """
    draw, digest = random.Random(29), hashlib.sha256()
    for _ in range(300):
        bitrate = draw.choice((1_000_000, 500_000, 125_000))
        messages = random_messages(draw, bitrate)
        fifo = draw.choice((("host",), ("host", "shared"), ("host", "shared", "drive0")))
        errors = ErrorModel(burst=draw.choice((0, 0, 1, 2)), interval_ns=draw.choice((0, 0, 0, 100_000_000)))
        analysis = analyse(messages, bitrate, 4 * bitrate, errors, fifo)
        bounds = [(response.worst_ns, response.at_least_ns) for response in analysis.responses]
        digest.update(repr((bounds, analysis.tick_ns, analysis.tightest.frame)).encode())
    assert digest.hexdigest() == "4e459b1083a28234855710bc9eb826787642789667582486619a7f6451a1317f"
