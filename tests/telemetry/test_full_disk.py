"""A disk that fills under the sidecar, and is freed: recording stops, says so, and goes on without a gap."""

import contextlib
import resource
from collections.abc import Iterator

import pytest

from hil.cycle.tick import CommandKind
from hil.live.ring import RingReader
from hil.telemetry.client import RigClient
from hil.telemetry.recording import Recording
from tests.telemetry.test_sidecar import Bench, bench, end, eventually, obeyed, recorded

__all__ = ["bench"]


@contextlib.contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """Processes started within can write no file beyond this until the limit is raised: a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.requirement(id="SR-7.2")
@pytest.mark.live
def test_a_full_disk_stops_the_recorders_sign_of_life_and_nothing_else(bench: Bench) -> None:
    with file_size_limit(4096):  # less than a recording begins with
        sidecar = bench.sidecar()
    control = bench.control()
    with RigClient(bench.endpoint) as client:
        status = eventually(client, lambda status: status.recorder_errors > 0)
        assert not status.recording
        later = eventually(client, lambda now: now.sent > status.sent + 100)
        assert later.control_alive
        obeyed(bench, CommandKind.ACTIVATE)
        assert list(bench.out.iterdir()) == []  # no file that holds nothing
        resource.prlimit(sidecar.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        status = eventually(client, lambda status: status.recording)
    assert (end(control), end(sidecar)) == (0, 0)
    ticks, recording = recorded(bench.out / "run.mcap")
    assert not recording.truncated
    assert [tick.ring for tick in ticks] == list(range(len(ticks)))  # the ring still held what the disk had not
    assert len(ticks) > later.produced


@pytest.mark.live
def test_a_disk_that_fills_and_is_freed_again_and_again_loses_no_tick(bench: Bench) -> None:
    sidecar = bench.sidecar()
    control = bench.control()
    path = bench.out / "run.mcap"
    infinity = resource.RLIM_INFINITY
    with RigClient(bench.endpoint) as client:
        for size in (60_000, 90_000, 20_000):  # of any file: a disk that has room for a little more, or for nothing
            before = eventually(client, lambda status: status.recording).recorder_errors
            resource.prlimit(sidecar.pid, resource.RLIMIT_FSIZE, (size, infinity))
            eventually(client, lambda status, before=before: status.recorder_errors > before)  # type: ignore[misc]
            resource.prlimit(sidecar.pid, resource.RLIMIT_FSIZE, (infinity, infinity))
        eventually(client, lambda status: status.recording)
    assert (end(control), end(sidecar)) == (0, 0)
    ticks, recording = recorded(path)
    assert len(recording.parts) >= 2
    assert [tick.ring for tick in ticks] == list(range(len(ticks)))
    with RingReader(bench.runtime / "microscope-ideal" / "ring") as reader:
        assert len(ticks) == reader.written
    messages = [item for item in Recording(path) if item.topic == "tick"]
    assert len(messages) == len(ticks)
