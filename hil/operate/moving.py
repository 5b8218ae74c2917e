"""`hil.motion`: who may move a rig, and from which state on."""

import contextlib
import time

from hil.cycle.goal import MotionError, MotionWord
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.goal_link import PageLink
from hil.live.runtime_paths import nearest
from hil.live.task_loading import task_document
from hil.operate.command import at_hand
from hil.rig.schema import TaskConfig
from hil.runs.mover import Mover
from hil.runs.rigs import Rig
from hil.runs.virtual_mover import VirtualMover
from hil.telemetry.command_client import NoGatewayError

HOLD_S = 30.0  # in which an activated rig must hold: its drives' answer, and a commissioning push
_POLL_S = 0.01


def motion(rig: str | Rig, *, take: bool = False, activate: bool = True) -> Mover:
    """Move a rig: one that runs on this machine, by its name, or a loaded one in virtual time (a VirtualMover).

    A running rig that is READY is activated to hold where it stands, with its drives under torque. One that is ACTIVE
    goes on with its task until the first goal. take: also where another client moves it. activate=False: a rig that is
    READY is refused. Raises MotionError where it does not run, is in another state or is moved by somebody else,
    NoGatewayError where it must be activated and nobody takes commands, RigError for one that cannot be simulated.
    """
    if isinstance(rig, Rig):
        return VirtualMover(rig)
    with contextlib.ExitStack() as undo:
        link = undo.enter_context(open_link(rig))
        holder = link.holder()
        if holder and not take:
            raise MotionError(f"{rig}: {holder} moves this rig already; take=True takes over")
        _await_hold(link, rig, activate=activate)
        mover = Mover(link, take=take)
        undo.pop_all()
    return mover


class RunningRig(PageLink):
    """A running rig, with a sidecar for what takes a computer longer than a tick. Raises as PageLink."""

    def load_task(self, task: TaskConfig) -> None:
        """Raises MotionError where the sidecar or the control process refuses it, or nobody takes commands."""
        try:
            with at_hand(self.rig.name) as client:
                verdict = client.load_task(task_document(task))
        except NoGatewayError as error:
            raise MotionError(f"{self.rig.name}: a path goes by the sidecar: {error}") from None
        if not verdict.accepted:
            raise MotionError(f"{self.rig.name}: {verdict.reason}")


def open_link(name: str) -> RunningRig:
    """To the running rig of that name, a demo's first. Raises MotionError."""
    return nearest(name, RunningRig, MotionError)


def _await_hold(link: RunningRig, name: str, *, activate: bool) -> None:
    """Until the rig's axes are held, or do a task."""
    if link.look().state is State.READY:
        if not activate:
            raise MotionError(
                f"{name} is READY, without torque: `hil command {name} activate-hold` lets its drives hold the stage"
            )
        with at_hand(name) as client:
            verdict = client.command(CommandKind.ACTIVATE_HOLD)
        if not verdict.accepted:
            raise MotionError(f"{name} was not activated: {verdict.reason}")
    until = time.monotonic() + HOLD_S
    while (look := link.look()).motion is MotionWord.NONE:
        if look.state is not State.ACTIVE or time.monotonic() > until:
            raise MotionError(f"{name} does not hold: it is {look.state.name}, fault {look.fault.name}")
        time.sleep(_POLL_S)
