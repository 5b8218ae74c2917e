"""The command gateway: from a request to the mailbox, and the control process' verdict back.

Rules:
- A request needs an authorised peer, a known kind, a sequence number above the connection's last, and an expiry on the
  rig's clock that is neither past nor further off than safety.command_expiry_s. Nothing is adjusted.
- ESTOP needs the authorised peer alone: it presses the stop page (hil/live/stop_page.py), whatever the clock says.
- The reply waits for the tick that judged the command, and names it, so that a client can read it itself.
- Every request is recorded, and every press of stop: who, what, when, verdict, why.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.base.toml_file import short
from hil.analysis.feasibility import violations
from hil.cycle.axis_homing import HOMING_REQUIRED
from hil.cycle.command_desk import LOADS
from hil.cycle.goal import MotionWord
from hil.cycle.limits import axis_limits, motion_limits
from hil.cycle.rest_watch import SETTLED_S
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live import stop_page
from hil.live.mailbox import Mailbox, MailboxError
from hil.rig.provenance import rig_of_run
from hil.rig.schema import RigConfig, RigError
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.codec import ESTOP, REALTIME_OK, RECORDER_OK, RIG_OK
from hil.telemetry.command_server import Asked
from hil.telemetry.goal_gateway import GoalGateway
from hil.telemetry.task_loader import MOST_BYTES, Prepared, TaskLoader
from hil.telemetry.window import silent_axes

VERDICT_TIMEOUT_NS = 500_000_000
_NOBODY = "no control process is running this rig"
_MOST_PROBLEMS, _LONGEST_PROBLEM = 3, 160  # in a reply: it has to fit a message (command_wire.LIMIT)


class _Pending(NamedTuple):
    asked: Asked
    until_ns: int
    loaded: Prepared = Prepared("")  # of a LOAD_TASK or SET_LAW


class Gateway:
    """Judges requests and keeps those whose verdict is still to come.

    rig: longest life of a command, and why its task cannot begin somewhere; of a run, `follow` tells the one that
    counts. stop: the rig's stop page. record: takes every entry. problems: what stands against the drives now, in
    words (hil/events/notes.py). task: where the file of another task or law goes. goals: of clients elsewhere.
    """

    def __init__(
        self,
        rig: RigConfig,
        stop: Path,
        record: Callable[[pb.CommandEntry], None],
        problems: Callable[[], Sequence[str]] = tuple,
        task: Path = Path("task"),
        goals: GoalGateway | None = None,
    ) -> None:
        self.goals = goals or GoalGateway(Path("goals"))
        self._rig = rig
        self._doubt = ""  # about reasons told from `rig`
        self._problems = problems
        self._stop = stop
        self._record = record
        self._pending: dict[int, _Pending] = {}  # by mailbox sequence
        self._stops: list[_Pending] = []  # presses of the stop page
        self._loader = TaskLoader(task)
        self.refused = 0

    def follow(self, metadata: dict[str, Any]) -> None:
        """From now on that of the control process whose ring has this metadata, whatever the sidecar's file says."""
        self.goals.follow(dict(metadata.get("rig", {})))
        try:
            with rig_of_run(metadata) as (rig, _):
                self._rig, self._doubt = rig, ""
        except RigError:  # it is of another version of hil
            self._doubt = "; by the sidecar's own rig file: what the control process runs cannot be read"

    def judge(self, asked: Asked, now_ns: int) -> str:
        """Why the request is refused; empty when it is not. Notes the sequence number."""
        request, last = asked.request, asked.connection.last_sequence
        if asked.refusal:
            return asked.refusal
        if request.kind not in set(CommandKind) and not request.HasField("goal"):
            return f"unknown command {request.kind}: known are 1 to {max(CommandKind)}"
        if request.kind == CommandKind.ESTOP:
            return ""
        if request.sequence <= last:
            return f"replayed: sequence {request.sequence} is not above {last}"
        if request.expires_ns <= now_ns:
            return f"stale: expired {(now_ns - request.expires_ns) * 1e-6:.1f} ms ago"
        if request.expires_ns > now_ns + round(self._rig.safety.command_expiry_s * 1e9):
            longest = self._rig.safety.command_expiry_s
            return f"expires too late: at most {longest:g} s ahead (safety.command_expiry_s)"
        asked.connection.last_sequence = request.sequence
        return ""

    def take(self, asked: Asked, mailbox: Mailbox | None, now_ns: int, state: str, last: np.void | None = None) -> None:
        """Judge one request; hand it on, or answer it at once. last: the newest tick, where it is the present."""
        reason = self.judge(asked, now_ns)
        if not reason and asked.request.HasField("goal"):
            self.goals.take(asked, now_ns)
            return
        if not reason and asked.request.kind in LOADS:
            reason = self._collect(asked)
            if not reason and asked.request.more:
                asked.connection.answer(pb.CommandReply(accepted=True, now_ns=now_ns, sequence=asked.request.sequence))
                return
            reason = reason or self._loader.take(asked, self._rig, mailbox, last, now_ns)
        elif not reason:
            pending = _Pending(asked, now_ns + VERDICT_TIMEOUT_NS)
            press = asked.request.kind == CommandKind.ESTOP
            reason = self._press(pending) if press else self._post(pending, mailbox)
        if reason:
            self._answer(asked, pb.CommandReply(reason=reason, now_ns=now_ns, state=state))

    @staticmethod
    def _collect(asked: Asked) -> str:
        """Put a part of a task or law behind the others."""
        connection = asked.connection
        connection.upload += asked.request.task
        if len(connection.upload) <= MOST_BYTES:
            return ""
        connection.upload = b""
        return f"what is sent is longer than {MOST_BYTES} bytes, compressed"

    def advance(self, mailbox: Mailbox | None, now_ns: int, state: str) -> None:
        """Go on with goals, and with a task or law that is being loaded."""
        self.goals.advance(now_ns)
        ended = self._loader.advance(mailbox, now_ns)
        if ended is None:
            return
        asked, prepared = ended
        reason = prepared.reason
        if not reason:
            expires_ns = now_ns + round(self._rig.safety.command_expiry_s * 1e9)
            reason = self._post(_Pending(asked, now_ns + VERDICT_TIMEOUT_NS, prepared), mailbox, expires_ns)
        if reason:
            self._answer(asked, pb.CommandReply(reason=reason, now_ns=now_ns, state=state))

    def _press(self, pending: _Pending) -> str:
        page = stop_page.open_page(str(self._stop))
        if page is None:
            return _NOBODY
        page.press()
        page.close()
        self._stops.append(pending)
        return ""

    def _post(self, pending: _Pending, mailbox: Mailbox | None, expires_ns: int | None = None) -> str:
        if mailbox is None:
            return _NOBODY
        request = pending.asked.request
        try:
            sequence = mailbox.post(CommandKind(request.kind), expires_ns or request.expires_ns)
        except MailboxError as error:
            return str(error)
        self._pending[sequence] = pending
        return ""

    def verdicts(self, records: np.ndarray, first: int, now_ns: int) -> None:
        """Answer the requests that these ticks judged. first: ring index of the first."""
        for place in np.flatnonzero(records["flags"] & ESTOP):
            self._stopped(records[place], first + int(place), now_ns)
        if not self._pending:
            return
        for place in np.flatnonzero(records["n_commands"]):
            record = records[place]
            for command in record["commands"][: record["n_commands"]]:
                pending = self._pending.pop(int(command["sequence"]), None)
                if pending:
                    kind, expires_ns = CommandKind(pending.asked.request.kind), int(command["expires_ns"])
                    accepted = bool(command["accepted"])
                    reason = "" if accepted else self._explain(kind, expires_ns, record)
                    reply = _reply(record, first + int(place), now_ns, reason)
                    reply.posted = int(command["sequence"])
                    if accepted and pending.loaded.rig is not None:
                        self._rig = pending.loaded.rig
                    self._answer(pending.asked, reply, pending.loaded.document)

    def _explain(self, kind: CommandKind, expires_ns: int, record: np.void) -> str:
        """Why it was refused, and what stands against the drives, which is most often why."""
        reason = explain(kind, expires_ns, record, self._rig) + self._doubt
        problems = [short(problem, _LONGEST_PROBLEM) for problem in self._problems()[:_MOST_PROBLEMS]]
        return "; ".join([reason, *problems])

    def _stopped(self, record: np.void, index: int, now_ns: int) -> None:
        """A tick in which stop was pressed: by whom the page says, or by those who asked here."""
        for pending in self._stops:
            self._answer(pending.asked, _reply(record, index, now_ns, ""))
        if not self._stops:
            page = stop_page.open_page(str(self._stop))
            status = page.status() if page else None
            if page:
                page.close()
            who = f"uid {status.presser_uid} (pid {status.presser_pid}) says the stop page" if status else "unknown"
            self._note(who, CommandKind.ESTOP, _reply(record, index, int(record["now_ns"]), ""))
        self._stops = []

    def give_up(self, now_ns: int, state: str, *, everything: bool = False) -> None:
        """Answer requests nobody judged in time."""
        overdue = [sequence for sequence, pending in self._pending.items() if everything or now_ns > pending.until_ns]
        late = [self._pending.pop(sequence) for sequence in overdue]
        late += [pending for pending in self._stops if everything or now_ns > pending.until_ns]
        self._stops = [pending for pending in self._stops if pending not in late]
        for pending in late:
            reason = "the control process did not take it"
            if pending.asked.request.kind == CommandKind.ESTOP:
                reason += " yet: stop stays pressed"
            self._answer(pending.asked, pb.CommandReply(reason=reason, now_ns=now_ns, state=state))

    def _answer(self, asked: Asked, reply: pb.CommandReply, task: str = "") -> None:
        reply.sequence = asked.request.sequence
        self._note(asked.who, asked.request.kind, reply, task)
        asked.connection.answer(reply)

    def _note(self, who: str, kind: int, reply: pb.CommandReply, task: str = "") -> None:
        self.refused += not reply.accepted
        entry = pb.CommandEntry(who=who, kind=kind, when_ns=reply.now_ns, accepted=reply.accepted)
        if task:  # what replay needs of it
            entry.posted, entry.task = reply.posted, task.encode()
        entry.reason, entry.state = reply.reason, reply.state
        self._record(entry)

    def note_rejected(self, who: str, reason: str, now_ns: int) -> None:
        """Somebody who did not get as far as to ask."""
        self._note(who, 0, pb.CommandReply(reason=reason, now_ns=now_ns))


def _reply(record: np.void, index: int, now_ns: int, reason: str) -> pb.CommandReply:
    state = State(int(record["state"])).name
    return pb.CommandReply(accepted=not reason, reason=reason, now_ns=now_ns, state=state, tick=index + 1)


def explain(kind: CommandKind, expires_ns: int, record: np.void, rig: RigConfig) -> str:
    """Why the control process refused a command, from the tick that did. rig: which it runs."""
    state, late_ns = State(int(record["state"])), int(record["now_ns"]) - expires_ns
    ages_s = record["age_ticks"][: len(rig.axes)] * (rig.period_ns * 1e-9)
    silent = silent_axes(rig.axes, ages_s.tolist())
    also = f"; {silent}" if silent else ""
    if late_ns > 0 and kind is not CommandKind.ESTOP:
        return f"stale: expired {late_ns * 1e-6:.1f} ms before the tick that took it"
    if kind in (CommandKind.ACTIVATE, CommandKind.ACTIVATE_HOLD, CommandKind.HOME) and state is State.READY:
        flags = int(record["flags"])
        missing = {
            RECORDER_OK: "no recorder is alive",
            REALTIME_OK: "the kernel did not grant real time (timing.allow_degraded)",
            RIG_OK: "the rig file has changed since the start",
        }
        reasons = [text for bit, text in missing.items() if not flags & bit] + _moving(rig, record)
        if kind is not CommandKind.HOME:
            reasons += homing_required(rig, record)
        if not reasons and kind is CommandKind.ACTIVATE:
            reasons = _infeasible(rig, record)
        missing_heartbeat = "no operator heartbeat" if rig.safety.heartbeat_s else "the task cannot begin here"
        return "refused: " + (" and ".join(reasons) or missing_heartbeat)
    if kind is CommandKind.LOAD_TASK and state is State.READY and (reasons := homing_required(rig, record)):
        return f"refused: {reasons[0]}"
    if kind is CommandKind.LOAD_TASK and (state is State.READY or record["motion"] == MotionWord.HOLD):
        return "refused: the task cannot begin where the axes stand"
    if kind is CommandKind.SET_LAW and (state is State.READY or record["motion"] == MotionWord.HOLD):
        return "refused: it came without a law"
    if kind is CommandKind.RESET and state in (State.FAULT, State.ESTOP):
        moving = " and ".join(_moving(rig, record))
        cause = f"the cause of the fault is still there, or an axis moved in the last {SETTLED_S:g} s"
        return f"refused in {state.name}: {moving or cause}{also}"
    return f"{kind.name} is not possible in state {state.name}{also}"


def homing_required(rig: RigConfig, record: np.void) -> list[str]:
    """The axes that are yet to be homed, and the command that does it; empty where none is."""
    yet = int(record["homing"]) >> 4
    names = [name for axis, name in enumerate(rig.axes) if yet >> axis & 1]
    first = f"not homed since power-up; first: hil home {rig.name}"
    return [f"{HOMING_REQUIRED}: {', '.join(names)} {first}"] if names else []


def _moving(rig: RigConfig, record: np.void) -> list[str]:
    """The axes that move although they have no torque."""
    rest = [limits.rest_window / SETTLED_S for limits in axis_limits(rig)]
    speeds = record["velocity_estimate"].tolist()
    return [
        f"{name} moves at {abs(speed):.3g} {'rad/s' if axis.kind == 'rotary' else 'm/s'}: it has to rest first"
        for (name, axis), speed, least in zip(rig.axes.items(), speeds, rest, strict=False)
        if abs(speed) > least
    ]


def _infeasible(rig: RigConfig, record: np.void) -> list[str]:
    """The first limit that the task would break from where the axes stood."""
    start = record["position"][: len(rig.axes)].tolist()
    found = violations(rig, start)
    return [f"the task cannot begin here: {found[0].text()}{_way_back(rig, start)}"] if found else []


def _way_back(rig: RigConfig, start: list[float]) -> str:
    """What brings axes back inside that rest beyond their travel; empty where none does."""
    places = []
    for (name, axis), fence, at in zip(rig.axes.items(), motion_limits(rig), start, strict=True):
        low, high = axis.limits.position
        if not low <= at <= high:
            inside = 0.01 * (fence.high - fence.low)
            places.append(f"{name}={fence.low + inside if at < low else fence.high - inside:.4g}")
    move = f"hil command {rig.name} activate-hold && hil move {rig.name} {' '.join(places)}"
    return f"; to bring it back: {move}" if places else ""
