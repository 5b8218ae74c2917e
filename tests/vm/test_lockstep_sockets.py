"""Lockstep with the real socket layer in the middle: every frame goes through the kernel, nothing may change for it."""

from collections.abc import Callable, Sequence

import pytest

from drivers.bus.port import open_port
from drivers.frame import Frame
from hil.cycle.state_machine import State
from hil.cycle.step import ControlCycle
from hil.cycle.tick import CommandKind, OperatorCommand, PortCounters, Tick
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from sim_plant.emulator import EmulatedStage
from tests.vm.live import LAYOUTS, RIGS
from tests.vm.ports import receive

pytestmark = pytest.mark.vcan

TICKS = 400
WIRE_NS = 100_000  # one way, on the virtual clock

Carry = Callable[[Sequence[Frame]], list[Frame]]


def run(rig: RigConfig, to_stage: Carry, to_host: Carry) -> list[tuple[int, State, list[Frame]]]:
    """Sequence of (tick, state, frames sent) of a run in virtual time; the two functions carry frames across."""
    cycle = ControlCycle(rig, RIGS)
    rated = [axis.rated_force for axis in rig.axes.values()]
    stage = EmulatedStage(rig.plant, rig.bus, rig.axis_names, rated, RIGS, drives=rig.drives)
    waiting: list[Frame] = []
    trace = []
    activated = 0
    for index in range(TICKS):
        now_ns = index * rig.period_ns
        commands: tuple[OperatorCommand, ...] = ()
        if not activated and cycle.state is State.READY:
            activated = index
            commands = (OperatorCommand(CommandKind.ACTIVATE, 1, now_ns + rig.period_ns),)
        result = cycle.step(Tick(index, now_ns, now_ns, PortCounters(), commands), waiting)
        trace.append((index, cycle.state, list(result.frames)))
        waiting = []
        for frame in to_stage(result.frames):
            answers = stage.on_frame(frame._replace(timestamp_ns=now_ns + WIRE_NS))
            waiting += [frame._replace(timestamp_ns=now_ns + 2 * WIRE_NS) for frame in to_host(answers)]
        stage.advance(now_ns + 2 * WIRE_NS)
    assert activated, f"never READY: {trace[-1]}"
    return trace


@pytest.mark.parametrize("layout", LAYOUTS)
def test_torque_frames_are_the_same_to_the_byte_with_and_without_the_kernel_between(vcan: str, layout: str) -> None:
    file, protocol = LAYOUTS[layout]
    rig = load_rig(RIGS / file, [f"bus.protocol={protocol}", f"bus.channel={vcan}", "bus.interface=socketcan"])
    fd = ControlCycle(rig, RIGS).protocol.fd
    host, device = (open_port(rig.bus, role=role, fd=fd) for role in ("host", "device"))

    def to_stage(frames: Sequence[Frame]) -> list[Frame]:
        assert all(host.send(frame) for frame in frames)
        return receive(device, len(frames))

    def to_host(frames: Sequence[Frame]) -> list[Frame]:
        assert all(device.send(frame) for frame in frames)
        return receive(host, len(frames))

    through_kernel = run(rig, to_stage, to_host)
    assert through_kernel == run(rig, list, list)
    assert through_kernel[-1][1] is State.ACTIVE
    counters = host.counters()
    assert (counters.errors, counters.refused, counters.echo, counters.overflow) == (0, 0, 0, 0)
    host.close()
    device.close()
