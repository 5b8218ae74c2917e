"""Slots that were lost: counted in the records and in the timing file, as many as the ticks' numbers lack."""

import time

import numpy as np

from hil.live.ring import RingReader
from hil.live.runtime_paths import runtime_paths
from hil.live.timing_record import read_timing
from tests.live.test_loop import NO_ACK, UnpoweredDrives, loop_beside


def test_lost_slots_are_in_the_next_record_and_in_the_timing_file(tmp_path, monkeypatch):
    with loop_beside(UnpoweredDrives(NO_ACK, []), tmp_path, monkeypatch) as loop:
        loop.pacer.start()
        for number in range(8):
            if number in (3, 5):
                time.sleep(0.004)
            loop._tick()
            loop.ticks += 1
        counters = read_timing(runtime_paths("paper").timing).counters
        with RingReader(runtime_paths("paper").ring) as reader:
            records = reader.read().records
        loop.parts.ring.close()
    lost = np.diff(records["index"], prepend=-1) - 1  # before the first tick, too
    assert lost.max() >= 3
    own, host = records["missed_own"], records["missed_host"]
    assert (own + host).tolist() == np.cumsum(lost).tolist()
    assert records["longest_streak"].tolist() == np.maximum.accumulate(lost).tolist()
    told = [counters[name] for name in ("missed_own", "missed_host", "longest_streak")]
    assert told == [own[-1], host[-1], records["longest_streak"][-1]]
