"""How a client on another machine moves a running rig: goals over the TLS of commands, through the rig's sidecar.

What the axes do comes with every reply. The lease is kept by a thread of its own, as on the rig's machine, and ends
with the connection.
"""

import contextlib
import json
import threading
import time
import zlib
from typing import Final

from hil.cycle.fault_table import Fault
from hil.cycle.goal import Goal, MotionError, MotionWord, Refusal
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.goal_link import Look
from hil.live.goal_page import LEASE_NS
from hil.live.mapped_file import Closing
from hil.live.task_loading import task_document
from hil.rig.file import build_rig
from hil.rig.schema import RigConfig, TaskConfig
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.command_client import NoGatewayError, remote_client
from hil.telemetry.credentials import Credentials
from hil.telemetry.goal_wire import Act, packed

HOLD_S: Final = 30.0  # in which an activated rig must hold
_POLL_S: Final = 0.02


class RemoteLink(Closing):
    """A rig elsewhere. where: "host:port" of its sidecar's --commands-from. credentials: an operator's.

    Raises NoGatewayError, CredentialsError, MotionError where no control process runs, RigError for a rig of another
    version of hil.
    """

    def __init__(self, where: str, credentials: Credentials) -> None:
        self._where, self._credentials = where, credentials
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._beats: threading.Thread | None = None
        self._client = remote_client(where, credentials)
        try:
            self.rig: RigConfig = build_rig(json.loads(zlib.decompress(self._ask(Act.DESCRIBE).rig)), carried=True)
        except BaseException:
            self._client.close()
            raise

    def _ask(self, act: Act) -> pb.GoalReply:
        return self._sent(pb.GoalRequest(act=act))

    def _sent(self, request: pb.GoalRequest) -> pb.GoalReply:
        """Raises MotionError where it is refused or nobody answers."""
        try:
            with self._lock:
                reply = self._client.goal(request)
        except NoGatewayError as error:
            raise MotionError(f"{self._where}: {error}") from None
        if not reply.accepted:
            raise MotionError(f"{self._where}: {reply.reason}")
        return reply.goal

    def take(self, *, by_force: bool = False) -> None:
        """Raises MotionError where somebody else moves the rig."""
        self._ask(Act.TAKE_OVER if by_force else Act.TAKE)
        self._beats = threading.Thread(target=self._keep, name="goal lease", daemon=True)
        self._beats.start()

    def _keep(self) -> None:
        while not self._ended.wait(LEASE_NS * 0.25e-9):
            try:
                self._ask(Act.BEAT)
            except MotionError:
                return

    def send(self, goal: Goal) -> tuple[int, Refusal]:
        """Raises MotionError where the lease has ended, or no tick takes the goal. A stream's goal that comes too late
        is dropped by the sidecar and counted (`stream_late` of hil.telemetry.Motion): its number is 0.
        """
        reply = self._sent(packed(goal, time.monotonic_ns()))
        return reply.number, Refusal(reply.refusal)

    def load_task(self, task: TaskConfig) -> None:
        """Raises MotionError with why it is refused."""
        try:
            with remote_client(self._where, self._credentials) as client:  # one of its own: planning takes a while
                verdict = client.load_task(task_document(task))
        except NoGatewayError as error:
            raise MotionError(f"{self._where}: {error}") from None
        if not verdict.accepted:
            raise MotionError(f"{self._where}: {verdict.reason}")

    def look(self) -> Look:
        """The newest tick that the sidecar knows."""
        told = self._ask(Act.LOOK).motion
        if not told.state:
            raise MotionError(f"{self._where}: the control process has run no tick that the sidecar knows")
        return Look(
            State[told.state], Fault[told.fault], MotionWord[told.motion], told.goal, list(told.setpoint),
            list(told.setpoint_velocity), list(told.position), told.in_position,
        )  # fmt: skip

    def now_ns(self) -> int:
        """This machine's monotonic clock."""
        return time.monotonic_ns()

    def wait(self, seconds: float) -> None:
        """Raises MotionError where the lease has ended."""
        time.sleep(max(seconds, self.rig.period_ns * 1e-9))
        if self._beats is not None and not self._beats.is_alive():
            self._ask(Act.BEAT)  # says why

    def hold(self) -> None:
        """Activate a rig that is READY to hold where it stands; until it does. Raises MotionError."""
        if self.look().state is State.READY:
            try:
                with self._lock:
                    verdict = self._client.command(CommandKind.ACTIVATE_HOLD)
            except NoGatewayError as error:
                raise MotionError(f"{self._where}: {error}") from None
            if not verdict.accepted:
                raise MotionError(f"{self.rig.name} was not activated: {verdict.reason}")
        until = time.monotonic() + HOLD_S
        while (look := self.look()).motion is MotionWord.NONE:
            if look.state not in (State.READY, State.ACTIVE) or time.monotonic() > until:
                raise MotionError(f"{self.rig.name} does not hold: it is {look.state.name}, fault {look.fault.name}")
            time.sleep(_POLL_S)

    def leave(self) -> None:
        """Give the lease back; the plan in hand goes on to its rest."""
        self._ended.set()
        if self._beats is not None:
            self._beats.join()
            self._beats = None
            with contextlib.suppress(MotionError):  # it has ended already
                self._ask(Act.GIVE_BACK)

    def close(self) -> None:
        """Leave, and close the connection."""
        self.leave()
        self._client.close()
