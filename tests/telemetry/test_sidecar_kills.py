"""The sidecar killed and ended at random moments: every tick is recorded once, none is published as new twice."""

import random
import signal
import threading
import time
from pathlib import Path

import pytest
import zenoh
from zenoh.handlers import RingChannel

from hil.live.ring import RingReader
from hil.telemetry.client import RigClient
from hil.telemetry.session import client_config
from hil.telemetry.tick_schema import TickSchema
from tests.telemetry.test_sidecar import Bench, bench, end, eventually, recorded

__all__ = ["bench"]


class Subscriber(threading.Thread):
    """Stays connected from sidecar to sidecar. sequences: of every tick that came, in the order in which they came."""

    def __init__(self, endpoint: str, rig: dict) -> None:
        super().__init__(daemon=True)
        self.sequences: list[int] = []
        self._message = TickSchema(rig).message
        self._session = zenoh.open(client_config(endpoint))
        self._ticks = self._session.declare_subscriber("hil/microscope-ideal/tick", RingChannel(65536))
        self._ended = threading.Event()

    def run(self) -> None:
        while not self._ended.is_set() or self._take():
            self._take()
            time.sleep(0.02)

    def _take(self) -> bool:
        sample = self._ticks.try_recv()
        found = sample is not None
        while sample is not None:
            self.sequences.append(self._message.FromString(sample.payload.to_bytes()).sequence)
            sample = self._ticks.try_recv()
        return found

    def stop(self) -> None:
        self._ended.set()
        self.join()
        self._session.close()


@pytest.mark.live
@pytest.mark.parametrize(
    "kills",
    [
        pytest.param(3, id="3 kills"),
        pytest.param(100, id="100 kills", marks=pytest.mark.slow),
    ],
)
def test_a_sidecar_killed_at_random_moments_loses_no_tick_and_publishes_none_again(bench: Bench, kills: int) -> None:
    moments = random.Random(25)
    control = bench.control()
    ring = bench.runtime / "microscope-ideal" / "ring"
    with RingReader(ring) as reader:
        rig = reader.metadata["rig"]
    sidecar = bench.sidecar()
    subscriber = Subscriber(bench.endpoint, rig)
    subscriber.start()
    parts = 0
    for kill in range(kills):
        if kill % 2:  # on a busy machine few would live long enough to record anything
            recording_again(bench.out, parts)
        time.sleep(moments.uniform(0.05, 1.5))
        end(sidecar, signal.SIGKILL)
        parts = len(list(bench.out.glob("*.mcap")))
        sidecar = bench.sidecar()
        if kill % 10 == 9:
            whole_until_now(bench.out / "run.mcap")
    with RigClient(bench.endpoint) as client:
        before = eventually(client, lambda status: status.recording and status.produced > 0)
        eventually(client, lambda status: status.sent > before.sent)
        assert end(control) == 0
        last = eventually(
            client, lambda status: status.control_ended and status.produced == status.sent + status.dropped
        )
        assert last.dropped <= 512 * kills  # a batch that was under way is not known to have arrived: counted, once
    assert end(sidecar) == 0
    subscriber.stop()
    with RingReader(ring) as reader:
        produced = reader.written
    ticks, recording = recorded(bench.out / "run.mcap")
    assert [tick.ring for tick in ticks] == list(range(produced))
    assert len(recording.parts) > kills // 2  # those killed before they recorded anything left no part
    assert len(subscriber.sequences) > 0
    assert all(later > earlier for earlier, later in zip(subscriber.sequences, subscriber.sequences[1:], strict=False))


def recording_again(folder: Path, parts: int) -> None:
    """Until the newest sidecar has begun a part beyond those there were."""
    deadline = time.monotonic() + 60.0
    while len(list(folder.glob("*.mcap"))) <= parts:
        assert time.monotonic() < deadline, "no part of its own"
        time.sleep(0.01)


def whole_until_now(path: Path) -> None:
    """No tick is twice in the parts there are, and none is missing between them."""
    ticks, _ = recorded(path)
    assert [tick.ring for tick in ticks] == list(range(len(ticks)))


@pytest.mark.live
@pytest.mark.parametrize("ends", [pytest.param(3, id="3 ends"), pytest.param(20, id="20 ends", marks=pytest.mark.slow)])
def test_a_sidecar_ends_cleanly_at_any_moment_whatever_becomes_of_the_control_process(bench: Bench, ends: int) -> None:
    """Control processes start, end and are killed around it; its own end is status 0, without a word on stderr."""
    moments = random.Random(52)
    control = bench.control()
    for _ in range(ends):
        sidecar = bench.sidecar()
        time.sleep(moments.uniform(0.0, 1.0))
        if moments.random() < 0.6:
            end(control, moments.choice((signal.SIGTERM, signal.SIGKILL)))
            if moments.random() < 0.7:
                control = bench.control()
                time.sleep(moments.uniform(0.0, 0.3))
        assert end(sidecar, moments.choice((signal.SIGTERM, signal.SIGINT, signal.SIGHUP))) == 0
        if control.poll() is not None:
            control = bench.control()
