"""A rig to look at: a run in virtual time, told to ring, stop page and sidecar at the pace of the wall clock.

No tick of it depends on how busy this computer is, so a page shows the same on every machine.

python -m tests.support.shown_rig RIG_FILE [--faults SCENARIO] [KEY=VALUE ...]: runs until SIGTERM. Prints "up" when it
writes.
"""

import argparse
import signal
import time
from collections.abc import Sequence
from pathlib import Path

from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.mailbox import Mailbox
from hil.live.ring import RingWriter
from hil.live.runtime_paths import runtime_paths
from hil.live.stop_line import StopLine
from hil.rig.file import load_rig
from hil.rig.provenance import describe_run
from hil.virtual.lockstep import LockstepRun
from sim_plant.scenario.language import load_scenario

SLOTS = 8192
AGAIN = 100  # ticks, after which a rig that is READY is activated


def main(rig_file: str, overrides: Sequence[str], faults: Path | None = None) -> None:
    rig = load_rig(rig_file, overrides)
    paths = runtime_paths(rig.name)
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(1))
    asked: list[CommandKind] = []

    def operator(run: LockstepRun, index: int) -> Sequence[CommandKind]:
        posted = [asked.pop()] if asked else []
        if run.cycle.state is State.READY and index % AGAIN == 0:
            posted.append(CommandKind.ACTIVATE)
        return posted

    scenario = load_scenario(faults) if faults else None
    run = LockstepRun(rig, Path(rig_file).parent, operator=operator, scenario=scenario)
    metadata = describe_run(rig, Path(rig_file).parent, realtime="none: virtual time at the pace of the clock")
    with (
        Mailbox.create(paths.mailbox) as mailbox,
        StopLine(paths.directory) as line,
        RingWriter(paths.ring, SLOTS, period_ns=rig.period_ns, metadata=metadata) as ring,
    ):
        print("up", flush=True)
        began_ns = time.monotonic_ns()
        while not stopped:
            due_ns = began_ns + run.index * rig.period_ns
            if (early_ns := due_ns - time.monotonic_ns()) > 0:
                time.sleep(early_ns * 1e-9)
            taken = mailbox.poll()
            asked.extend(CommandKind(command.kind) for command in taken)
            run.estop = line.pressed()
            pressed, index = run.estop, run.index
            record = run.tick().record
            record["scheduled_ns"], record["now_ns"] = due_ns, max(time.monotonic_ns(), due_ns)
            for place, command in enumerate(taken[: int(record["n_commands"])]):  # as the gateway numbered them
                record["commands"][place]["sequence"] = command.sequence
            ring.append(record)
            if pressed:
                line.latched(run.cycle.state.name, index)
            line.tell(run.cycle.state.name, index)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("rig_file")
    parser.add_argument("--faults", type=Path)
    parser.add_argument("overrides", nargs="*")
    given = parser.parse_args()
    main(given.rig_file, given.overrides, given.faults)
