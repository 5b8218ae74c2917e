"""A stand-in for the control process: writes records into a ring at 1 kHz and judges commands, nothing else.

python -m tests.support.fake_control RIG_FILE [TICKS]: runs until SIGTERM, or for so many ticks. Prints "up" when it
writes.
"""

import math
import signal
import sys
from pathlib import Path

from drivers.frame import Frame
from hil.cycle.command_desk import CommandDesk
from hil.cycle.record import REJECT_REASONS
from hil.cycle.record_builder import RecordBuilder
from hil.cycle.state_machine import Event, State
from hil.cycle.tick import PortCounters
from hil.live.mailbox import Mailbox
from hil.live.pacing import Pacer
from hil.live.ring import RingWriter
from hil.live.runtime_paths import runtime_paths
from hil.rig.file import load_rig
from hil.rig.provenance import describe_run
from tests.support.records import bare_tick, put_axis, put_tick

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
            desk.handle(mailbox.poll(), pacer.now_ns, act, lambda: False)
            flags = mailbox.recorder_ok(pacer.now_ns) << 1
            put_tick(builder, bare_tick(pacer.index, pacer.now_ns, scheduled_ns=pacer.scheduled_ns, flags=flags), state)
            for axis in range(n):
                put_axis(builder, axis, [math.sin(pacer.index * 1e-3)] * 9)
            builder.drives([0] * n, [1] * n)
            builder.counters(PortCounters(), [0] * REJECT_REASONS, 0, 0, 0)
            sent, received = [Frame(0x80, bytes(24), 5)], [Frame(0x100, bytes(16), 5, pacer.now_ns)] * 4
            ring.append(builder.traffic(desk.handled, sent, received))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 2**62)
