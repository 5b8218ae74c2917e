"""Bring-up procedures on a bus, in real time.

Rules. A session holds the lock of the rig's control process, so that it never runs beside `hil run`, nor twice. Every
way out of it sends zero force with all drives disabled until they say so: the end of a procedure, `hil estop`, any
signal that would end or stop the process (SIGTSTP too), an exception. What cannot be caught (SIGKILL) is left to the
drives' own watchdogs, as in `hil run`.
"""

import contextlib
import signal
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

from drivers.base.runtime import stop_signals
from drivers.bus.port import open_port, resolve_interface
from drivers.config import KERNEL_INTERFACES, BusConfig
from drivers.frame import Frame
from hil.live.pacing import Pacer
from hil.live.runtime_paths import runtime_paths
from hil.live.stop_line import StopLine
from hil.operate.bringup.drive_host import DriveHost
from hil.rig.schema import RigConfig

RELEASE_S = 0.5  # of zero torque at the end, at most; at least:
_LEAST_RELEASE_TICKS = 10
_ALIVE_S = 0.1
_STATE = "BRINGUP"


class Procedure(Protocol):
    """What a session can run."""

    @property
    def done(self) -> bool:
        """It is over."""

    def step(self, now_ns: int, frames: Sequence[Frame]) -> list[Frame]:
        """One tick."""


class Bus(Protocol):
    """What a session needs of a port."""

    def drain(self, now_ns: int) -> list[Frame]:
        """What has arrived."""

    def send(self, frame: Frame) -> bool:
        """Send one frame."""

    def close(self) -> None:
        """Leave the bus."""


class Session:
    """A bus, the rig's drives on it, and the rig's lock. stopped: why no procedure goes on, or empty."""

    def __init__(self, host: DriveHost, bus: Bus, stop_line: StopLine, pacer: Pacer | None = None) -> None:
        self.host = host
        self.stopped = ""
        self._bus = bus
        self._stop_line = stop_line
        self._pacer = pacer or Pacer(host.rig.period_ns)
        self._alive_ticks = max(1, round(_ALIVE_S * 1e9 / host.rig.period_ns))

    def run(self, procedure: Procedure) -> None:
        """Until it is done, or the session is stopped."""
        self._pacer.start()
        while not procedure.done:
            now_ns = self._wait()
            if self.stopped:
                return
            self._send(procedure.step(now_ns, self._bus.drain(now_ns)))

    def _wait(self) -> int:
        """The next tick's time, ns."""
        pacer = self._pacer
        pacer.wait()
        if self._stop_line.pressed():
            self.stopped = "hil estop"
            self._send(self.host.zero())
            self._stop_line.latched("ESTOP", pacer.index)
        elif pacer.index % self._alive_ticks == 0:
            self._stop_line.tell(_STATE, pacer.index)
        return pacer.now_ns

    def release(self) -> None:
        """Zero torque and disable, until every drive says that it is."""
        self._pacer.start()
        for tick in range(max(_LEAST_RELEASE_TICKS, round(RELEASE_S * 1e9 / self.host.rig.period_ns))):
            self._send(self.host.zero())
            self._pacer.wait()
            now_ns = self._pacer.now_ns
            self.host.take(self._bus.drain(now_ns), now_ns)
            if tick >= _LEAST_RELEASE_TICKS and not self.host.any_enabled:
                return

    def _send(self, frames: Sequence[Frame]) -> None:
        for frame in frames:
            self._bus.send(frame)


def open_rig_port(config: BusConfig, host: DriveHost) -> Bus:
    """The rig's own bus, through python-can where it is none of the kernel's. Raises PortError."""
    if resolve_interface(config) not in KERNEL_INTERFACES:
        from drivers.bus.any_bus import AnyPort, open_bus

        return AnyPort(open_bus(config, fd=host.protocol.fd))
    return open_port(config, role="host", fd=host.protocol.fd, echo_id=host.protocol.echo_id)


@contextlib.contextmanager
def open_session(
    rig: RigConfig, base_dir: Path, open_bus: Callable[[BusConfig, DriveHost], Bus] = open_rig_port
) -> Iterator[Session]:
    """A session, ended with zero torque whatever happens in it.

    Raises ValueError (the layout cannot carry the rig), RigInUseError (the rig is being run), PortError; before
    anything is sent.
    """
    host = DriveHost(rig, base_dir)
    with contextlib.ExitStack() as stack:
        stop_line = stack.enter_context(StopLine(runtime_paths(rig.name).directory))
        bus = open_bus(rig.bus, host)
        stack.callback(bus.close)
        session = Session(host, bus, stop_line)
        stack.enter_context(_signals(session))
        try:
            yield session
        finally:
            if host.started:
                session.release()


@contextlib.contextmanager
def _signals(session: Session) -> Iterator[None]:
    """While open, signals that would end or stop this process stop the session."""

    def ask(number: int, _frame: object) -> None:
        session.stopped = session.stopped or signal.Signals(number).name

    numbers = (*stop_signals(), signal.SIGTSTP, signal.SIGQUIT)
    before = [(number, signal.signal(number, ask)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)
