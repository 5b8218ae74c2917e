"""A sidecar that is behind its ring: it tells no old state as the present one."""

import socket
import time
from typing import Any

import pytest

from hil.cycle.record_builder import RecordBuilder
from hil.cycle.state_machine import State
from hil.live.ring import RingReader, RingWriter
from hil.live.runtime_paths import runtime_paths
from hil.rig.file import load_rig
from hil.rig.provenance import describe_run
from hil.telemetry.command_server import CommandServer
from hil.telemetry.publisher import Publisher
from hil.telemetry.sidecar import Sidecar
from tests.support.paths import ROOT
from tests.support.records import bare_tick, put_tick

RIG = ROOT / "deploy" / "rigs" / "microscope-ideal.toml"


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.mark.replaces_methods
def test_of_a_full_ring_whose_writer_overtakes_the_reader_a_sidecar_tells_no_old_state(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And no more of one that it was too slow for: it says nothing until it has read the newest tick again."""
    rig = load_rig(RIG)
    paths = runtime_paths(rig.name)
    builder = RecordBuilder(len(rig.axes))

    def tick(state: State) -> None:
        put_tick(builder, bare_tick(ring.written, time.monotonic_ns()), state)
        ring.append(builder.traffic([], [], []))

    copied = RingReader._copy

    def copy_beside_a_writer(*arguments: Any) -> Any:
        tick(State.ESTOP)
        return copied(*arguments)

    monkeypatch.setattr(RingReader, "_copy", copy_beside_a_writer)
    metadata = describe_run(rig, RIG.parent, realtime="none: a test")
    with (
        RingWriter(paths.ring, 1024, period_ns=rig.period_ns, metadata=metadata) as ring,
        Publisher("hil", rig.name, [free_endpoint()]) as publisher,
        CommandServer(paths.commands) as commands,
    ):
        for _ in range(2000):
            tick(State.READY)
        sidecar = Sidecar(rig, paths, publisher, commands, None)
        for _ in range(2):  # to the newest tick; then again after it was held up
            told: list[str] = []
            while len(told) < 5 and (not told or told[-1] == ""):
                sidecar.step(time.monotonic_ns())
                sidecar.publish_status(time.monotonic_ns())
                told.append(sidecar.status.state)
            assert set(told) == {"", "ESTOP"}, told
            for _ in range(600):
                tick(State.ESTOP)
        sidecar.close()  # though a tick more is there whenever it looks
