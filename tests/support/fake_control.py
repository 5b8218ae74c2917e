"""A stand-in for the control process: writes records into a ring at 1 kHz and decides on commands, nothing else.

python -m tests.support.fake_control RIG_FILE [TICKS]: runs until SIGTERM, or for so many ticks. Prints "up" when it
writes.
"""

import math
import signal
import sys
from pathlib import Path

from drivers.frame import Frame
from hil.control.estimator.motion_filter import MotionFilter
from hil.control.laws.base import axis_inputs
from hil.cycle.command_desk import CommandDesk
from hil.cycle.record import REJECT_REASONS
from hil.cycle.record_builder import RecordBuilder
from hil.cycle.state_machine import Event, State
from hil.cycle.tick import PortCounters, Tick
from hil.live.mailbox import Mailbox
from hil.live.pacing import Pacer
from hil.live.ring import RingWriter
from hil.live.runtime_paths import runtime_paths
from hil.rig.file import load_rig
from hil.rig.provenance import describe_run

SLOTS = 65536  # a minute: no reader is held up for longer than that, whatever else the machine does


def main(rig_file: str, ticks: int) -> None:
    rig = load_rig(rig_file)
    paths = runtime_paths(rig.name)
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(1))
    state = State.READY

    def act(event: Event) -> bool:
        nonlocal state
        if event is Event.ACTIVATE and state is State.READY:
            state = State.ACTIVE
            return True
        return False

    n = len(rig.axes)
    desk, builder, pacer = CommandDesk(), RecordBuilder(n), Pacer(rig.period_ns)
    inputs, motion = axis_inputs(), MotionFilter([0.0, 0.0, 0.0], 1.0)
    with (
        Mailbox.create(paths.mailbox) as mailbox,
        RingWriter(
            paths.ring,
            SLOTS,
            period_ns=rig.period_ns,
            metadata=describe_run(rig, Path(rig_file).parent, realtime="none: a test"),
        ) as ring,
    ):
        print("up", flush=True)
        pacer.start()
        while not stopped and ring.written < ticks:
            pacer.wait()
            desk.handle(mailbox.poll(), pacer.now_ns, act)
            recorder_ok = mailbox.recorder_ok(pacer.now_ns)
            tick = Tick(pacer.index, pacer.scheduled_ns, pacer.now_ns, PortCounters(), recorder_ok=recorder_ok)
            builder.tick(tick, state, 0, 0, sending=True)
            builder.progress(pacer.index, -1)
            inputs.position = motion.position = motion.velocity = math.sin(pacer.index * 1e-3)
            for axis in range(n):
                builder.axis(axis, inputs, motion)
                builder.force(axis, inputs.position, inputs.position, 0)
            builder.drives([0] * n, [1] * n)
            builder.counters(PortCounters(), [0] * REJECT_REASONS, 0, 0, 0)
            sent, received = [Frame(0x80, bytes(24), 5)], [Frame(0x100, bytes(16), 5, pacer.now_ns)] * 4
            ring.append(builder.traffic(desk.handled, sent, received))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 2**62)
