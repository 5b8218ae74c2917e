"""Processes killed, stopped and continued in every state, a few moments each: what the rest makes of it.

Whatever happens to the control process, the drives are at zero within their watchdog. Whatever happens to the others,
the control process goes on, or explains itself. What was recorded stays readable.
"""

import contextlib
import itertools
import json
import random
import resource
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hil.cycle.fault_table import WATCHING, Fault
from hil.cycle.state_machine import TORQUE_STATES, State
from hil.cycle.tick import CommandKind
from hil.live.ring import RingReader
from hil.live.runtime_paths import runtime_paths_in
from hil.telemetry import cycle_codec
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.client import NoSidecarError, RigClient
from hil.telemetry.command_client import NoGatewayError
from hil.telemetry.credentials import Credentials
from hil.telemetry.recording import Recording
from hil.telemetry.window import silent_axes
from tests.attacks.registry import attack
from tests.attacks.target import NAME, PATIENCE_S, Target

MOMENTS = 2
SETTLED_TICKS = 25
CONNECT_S = 0.3  # for a monitor that connects only then
LATEST_S = 0.03  # after the state was asked for
WATCHDOG_NS = 500_000_000  # drives.watchdog_s of tests/support/live_rig.py
_random = random.Random(24)


def _ask(target: Target, *kinds: CommandKind) -> None:
    for kind in kinds:
        target.command(kind)


def _faulty(target: Target) -> None:
    """As a drive reports that its watchdog expired."""
    target.active()
    target.signal("run", signal.SIGSTOP)
    time.sleep(1.2 * WATCHDOG_NS * 1e-9)
    target.signal("run", signal.SIGCONT)
    target.until(lambda: target.newest() is State.FAULT, "FAULT")


def _pressed(target: Target) -> None:
    target.active()
    target.press()


def _connecting(target: Target) -> None:
    _pressed(target)
    _ask(target, CommandKind.RESET)


def _stopping(target: Target) -> None:
    target.active()
    _ask(target, CommandKind.STOP)


SITUATIONS: dict[str, Callable[[Target], None]] = {
    "CONNECTED": _connecting,
    "READY": lambda target: target.ready(),
    "HOMING": lambda target: _ask(target, CommandKind.HOME),
    "ACTIVE": lambda target: target.active(),
    "STOPPING": _stopping,
    "ESTOP": _pressed,
    "FAULT": _faulty,
}


def moments(target: Target, situation: str, how_often: int = MOMENTS) -> Iterator[State]:
    """Bring the rig there, and wait a moment; the state in which it then is."""
    for _ in range(how_often):
        target.ready()
        SITUATIONS[situation](target)
        time.sleep(_random.uniform(0.0, LATEST_S))
        yield target.newest()


def drives(target: Target) -> dict[str, Any]:
    """What the emulated drives say of themselves (sim_plant/process.py)."""
    path = runtime_paths_in(target.runtime, NAME).emulator
    said: dict[str, Any] = json.loads(path.read_text())
    return said


def at_zero(target: Target, since_ns: int) -> str:
    """The drives, which heard nothing from `since_ns` on, have gone to zero when their watchdogs had to."""
    after = since_ns + WATCHDOG_NS
    target.until(lambda: drives(target)["now_ns"] > after and not _applied(target), "zero torque")
    trips = [trip for axis in drives(target)["axes"].values() for trip in axis["trips"]]
    late = [trip for trip in trips if trip["zero_ns"] - trip["last_command_ns"] != WATCHDOG_NS]
    assert not late, late
    return "drives at zero"


def _applied(target: Target) -> bool:
    return any(axis["applied_force"] for axis in drives(target)["axes"].values())


def newest_recording(target: Target) -> Path:
    return max((target.base / "out").glob("run*.mcap"), key=lambda path: path.stat().st_mtime_ns)


def ticks_of(recording: Recording) -> list[int]:
    """Ring indices of the ticks in a recording."""
    cycles = (pb.Cycle.FromString(item.data) for item in recording if item.topic == "cycle")
    return [tick.ring for message in cycles for tick in cycle_codec.recorded_ticks(message)]


def whole(target: Target) -> str:
    """The recording of a run that ended holds every tick of it from the first recorded to the last in the ring."""
    with RingReader(target.directory / "ring") as reader:
        written = reader.written
        target.until(lambda: reader.saved or reader.ended, "the recording is finished")
    recording = Recording(newest_recording(target))
    ticks = ticks_of(recording)
    assert ticks == list(range(ticks[0], written)), (ticks[0], ticks[-1], len(ticks), written)
    assert not recording.truncated
    return f"{len(ticks)} ticks recorded to the last"


def goes_on(target: Target) -> str:
    """The control process ticks, without a fault."""
    with RingReader(target.directory / "ring") as reader:
        before = reader.written
        target.until(lambda: reader.written > before + SETTLED_TICKS, "it ticks on")
        reader.next = reader.written - 1
        last = reader.read(1).records[-1]
    return State(int(last["state"])).name


def explained(target: Target) -> str:
    """The control process asks for no torque, and names why; not before it has seen what there is to see."""
    with RingReader(target.directory / "ring") as reader:
        before = reader.written
        target.until(lambda: reader.written > before + SETTLED_TICKS, "it ticks on")

        def fault() -> Fault:
            reader.next = reader.written - 1
            last = reader.read(1).records[-1]
            quiet = State(int(last["state"])) not in TORQUE_STATES and not last["force"].any()
            return Fault(int(last["fault"])) if quiet else Fault.NONE

        target.until(lambda: fault() is not Fault.NONE or target.newest() not in WATCHING, "it stops")
        return f"{target.newest().name}, {fault().name}"


def killed_control(target: Target, situation: str) -> Iterator[str]:
    said = []
    for state in moments(target, situation):
        with RigClient(target.endpoint, rig=NAME) as client:
            client.wait_status(PATIENCE_S)
            target.signal("run", signal.SIGKILL)
            since_ns = time.monotonic_ns()
            target.processes["run"].wait()
            while (status := client.wait_status(PATIENCE_S)).control_alive:
                pass
        assert not status.control_ended
        assert status.state == target.newest().name
        said.append(f"in {state.name}: {at_zero(target, since_ns)}; {whole(target)}; told as killed in {status.state}")
        target.start("run")
        target.until(lambda: target.newest() is not State.BOOT and _commands(target), "it runs again")
    yield "; ".join(said)


def stopped_control(target: Target, situation: str) -> Iterator[str]:
    said = []
    for state in moments(target, situation):
        target.signal("run", signal.SIGSTOP)
        try:
            zero = at_zero(target, time.monotonic_ns())
            assert "ago, nothing since" in target.command(CommandKind.STOP).state
        finally:
            target.signal("run", signal.SIGCONT)
        said.append(f"in {state.name}: {zero}; continued: {explained(target)}")
    yield "; ".join(said)


def _commands(target: Target) -> bool:
    try:
        return target.command(CommandKind.HEARTBEAT).accepted
    except NoGatewayError:
        return False


def killed_sidecar(target: Target, situation: str) -> Iterator[str]:
    """Its successor begins with what the ring still holds, so that what was not yet on disk is not lost either."""
    said = []
    for state in moments(target, situation):
        target.signal("sidecar", signal.SIGKILL)
        target.processes["sidecar"].wait()
        goes = goes_on(target)
        left = newest_recording(target)
        target.start("sidecar")
        target.until(lambda: _commands(target), "a new sidecar")
        ticks = ticks_of(Recording(left))
        assert ticks == list(range(ticks[0], ticks[0] + len(ticks))) if ticks else True
        with RigClient(target.endpoint, rig=NAME) as client:
            while not (status := client.wait_status(PATIENCE_S)).recording:
                pass
        on_disk = ticks[-1] + 1 if ticks else 0
        assert status.dropped <= on_disk, (status.dropped, on_disk)  # overwritten in the ring, but not unrecorded
        said.append(f"in {state.name}: the rig goes on in {goes}; {len(ticks)} ticks left readable, the next has all")
    yield "; ".join(said)


def stopped_sidecar(target: Target, situation: str) -> Iterator[str]:
    said = []
    for state in moments(target, situation):
        target.signal("sidecar", signal.SIGSTOP)
        try:
            goes = goes_on(target)
        finally:
            target.signal("sidecar", signal.SIGCONT)
        said.append(f"in {state.name}: the rig goes on in {goes}; continued: {target.obeyed()}")
    yield "; ".join(said)


def killed_emulator(target: Target, situation: str) -> Iterator[str]:
    said = []
    for state in moments(target, situation, 1):
        target.signal("emulate", signal.SIGKILL)
        struck_s = time.monotonic()
        target.processes["emulate"].wait()
        said.append(f"in {state.name}: {told_silent(target, struck_s)}")
        target.start("emulate")
    yield "; ".join(said)


def stopped_emulator(target: Target, situation: str) -> Iterator[str]:
    said = []
    for state in moments(target, situation, 1):
        target.signal("emulate", signal.SIGSTOP)
        try:
            said.append(f"in {state.name}: {told_silent(target, time.monotonic())}")
        finally:
            target.signal("emulate", signal.SIGCONT)
    yield "; ".join(said)


def told_silent(target: Target, since_s: float) -> str:
    """Monitors hear within a second which axes fell silent, and an operator why nothing is possible."""
    with RigClient(target.endpoint, rig=NAME) as client:
        while not (silent := silent_axes((status := client.wait_status(PATIENCE_S)).axes, status.answer_age)):
            assert time.monotonic() - since_s < PATIENCE_S, "nobody says that the drives are silent"
        took = time.monotonic() - since_s
    assert took < 1.0 + CONNECT_S, f"{took:.1f} s"
    assert all(name in silent for name in status.axes), silent
    seen = explained(target)
    verdict = target.command(CommandKind.ACTIVATE)
    assert "no answer from" in verdict.reason, verdict
    return f"told after {took:.1f} s: {silent}; {seen}"


def routed(target: Target) -> str:
    """A monitor behind the router hears the rig."""
    with RigClient(target.routed, rig=NAME, credentials=Credentials(target.made / "monitor")) as client:
        return client.wait_status(PATIENCE_S).state


def struck_router(target: Target, situation: str, number: signal.Signals) -> Iterator[str]:
    said = []
    target.start("router")
    try:
        routed(target)
        for state in moments(target, situation, 1):
            target.signal("router", number)
            said.append(f"in {state.name}: the rig goes on in {goes_on(target)}; {target.obeyed()}")
            if number is signal.SIGSTOP:
                target.signal("router", signal.SIGCONT)
                said.append(f"continued, a monitor behind it hears {routed(target)}")
    finally:
        target.processes["router"].kill()
        target.processes["router"].wait()
    yield "; ".join(said)


def limit_memory(target: Target, kind: str) -> None:
    """It gets no more memory than it has."""
    pid = target.processes[kind].pid
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[0])
    resource.prlimit(pid, resource.RLIMIT_AS, (pages * resource.getpagesize(), resource.RLIM_INFINITY))


@attack("control process at its memory limit", "it goes on, and stops when it is told to", moving=True)
def starved_control(target: Target) -> Iterator[str]:
    limit_memory(target, "run")
    time.sleep(1.0)
    yield f"the rig goes on in {goes_on(target)}"
    resource.prlimit(target.processes["run"].pid, resource.RLIMIT_AS, (resource.RLIM_INFINITY,) * 2)


@attack("sidecar at its memory limit", "the rig goes on, and stops when it is told to", moving=True)
def starved_sidecar(target: Target) -> Iterator[str]:
    limit_memory(target, "sidecar")
    with contextlib.suppress(NoSidecarError), RigClient(target.endpoint, rig=NAME) as client:
        client.wait_status(1.0)  # one more client wants buffers of its own
    alive = target.processes["sidecar"].poll() is None
    yield f"the rig goes on in {goes_on(target)}; the sidecar {'lives' if alive else 'ended'}"
    target.processes["sidecar"].kill()
    target.processes["sidecar"].wait()
    target.start("sidecar")
    target.until(lambda: _commands(target), "a new sidecar")


Struck = Callable[[Target, str], Iterator[str]]
RIG_GOES_ON = "the rig goes on; what was recorded is readable; commands are obeyed again"
SILENT = "within a second it is told which axes are silent; a state that needs them is left, with the fault named"
STRIKES: dict[tuple[str, str], tuple[Struck, str]] = {
    ("control", "killed"): (killed_control, "zero torque within the watchdog; told as killed; every tick recorded"),
    ("control", "stopped and continued"): (stopped_control, "zero torque within the watchdog; then it says why"),
    ("sidecar", "killed"): (killed_sidecar, RIG_GOES_ON),
    ("sidecar", "stopped and continued"): (stopped_sidecar, RIG_GOES_ON),
    ("emulator", "killed"): (
        killed_emulator,
        SILENT,
    ),
    ("emulator", "stopped and continued"): (
        stopped_emulator,
        SILENT,
    ),
    ("router", "killed"): (lambda target, at: struck_router(target, at, signal.SIGKILL), RIG_GOES_ON),
    ("router", "stopped and continued"): (lambda target, at: struck_router(target, at, signal.SIGSTOP), RIG_GOES_ON),
}

for (process, how), situation in itertools.product(STRIKES, SITUATIONS):
    struck, expected = STRIKES[process, how]

    @attack(f"{process} {how} in {situation}", expected)
    def strike(target: Target, struck: Struck = struck, situation: str = situation) -> Iterator[str]:
        return struck(target, situation)
