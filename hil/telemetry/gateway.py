"""The command gateway: from a Zenoh query to the mailbox, and the control process's verdict back.

A request must carry the token (a file only the rig's owner can read), a known kind, a sequence number above the
client's last, and an expiry on the rig's own clock that is neither past nor further off than safety.command_expiry_s.
Whatever is wrong is refused with the reason; nothing is adjusted. The answer waits for the tick that judged it.
"""

import hmac
from typing import NamedTuple

import numpy as np
import zenoh
from google.protobuf.message import DecodeError

from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.mailbox import Mailbox, MailboxError
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.codec import REALTIME_OK, RECORDER_OK, RIG_OK

ASK_TIME = 0  # kind of a request that wants to know the rig's clock only
VERDICT_TIMEOUT_NS = 500_000_000
_CLIENTS = 256  # remembered; older ones would have to guess an unexpired time to be replayed


class _Pending(NamedTuple):
    query: zenoh.Query
    kind: CommandKind
    until_ns: int


class Gateway:
    """Judges requests and keeps those whose verdict is still to come. expiry_s: longest life of a command."""

    def __init__(self, key: str, token: str, expiry_s: float) -> None:
        self._key = f"{key}/command"
        self._token = token.encode()
        self._expiry_ns = round(expiry_s * 1e9)
        self._last_sequence: dict[int, int] = {}
        self._pending: dict[int, _Pending] = {}  # by mailbox sequence
        self.refused = 0

    def judge(self, request: pb.CommandRequest, now_ns: int) -> str:
        """Why the request is refused; empty when it is not. Notes the sequence number of an authorised client."""
        if not hmac.compare_digest(request.token.encode(), self._token):
            return "not authorised: the token is not the one in the rig's runtime directory"
        if request.kind == ASK_TIME:
            return ""
        last = self._last_sequence.get(request.client, 0)
        if request.kind not in set(CommandKind):
            return f"unknown command {request.kind}: known are 1 to {max(CommandKind)}"
        if request.sequence <= last:
            return f"replayed: sequence {request.sequence} is not above {last}"
        if request.expires_ns <= now_ns:
            return f"stale: expired {(now_ns - request.expires_ns) * 1e-6:.1f} ms ago"
        if request.expires_ns > now_ns + self._expiry_ns:
            return f"expires too late: at most {self._expiry_ns * 1e-9:g} s ahead (safety.command_expiry_s)"
        self._remember(request)
        return ""

    def _remember(self, request: pb.CommandRequest) -> None:
        self._last_sequence.pop(request.client, None)
        self._last_sequence[request.client] = request.sequence
        if len(self._last_sequence) > _CLIENTS:
            del self._last_sequence[next(iter(self._last_sequence))]

    def take(self, query: zenoh.Query, mailbox: Mailbox | None, now_ns: int, state: str) -> None:
        """Judge one query; hand it on, or answer it at once."""
        payload = query.payload
        try:
            request = pb.CommandRequest.FromString(payload.to_bytes() if payload else b"")
        except DecodeError:
            self._answer(query, now_ns, state, "not a CommandRequest")
            return
        reason = self.judge(request, now_ns)
        if not reason and request.kind != ASK_TIME:
            reason = self._post(query, request, mailbox, now_ns)
            if not reason:
                return
        self._answer(query, now_ns, state, reason)

    def _post(self, query: zenoh.Query, request: pb.CommandRequest, mailbox: Mailbox | None, now_ns: int) -> str:
        if mailbox is None:
            return "no control process is running this rig"
        kind = CommandKind(request.kind)
        try:
            sequence = mailbox.post(kind, request.expires_ns)
        except MailboxError as error:
            return str(error)
        self._pending[sequence] = _Pending(query, kind, now_ns + VERDICT_TIMEOUT_NS)
        return ""

    def verdicts(self, records: np.ndarray, now_ns: int) -> None:
        """Answer the requests that these ticks judged."""
        if not self._pending:
            return
        for place in np.flatnonzero(records["n_commands"]):
            record = records[place]
            for command in record["commands"][: record["n_commands"]]:
                pending = self._pending.pop(int(command["sequence"]), None)
                if pending:
                    reason = "" if command["accepted"] else explain(pending.kind, int(command["expires_ns"]), record)
                    self._answer(pending.query, now_ns, State(int(record["state"])).name, reason)

    def give_up(self, now_ns: int, state: str, *, everything: bool = False) -> None:
        """Answer requests nobody judged in time."""
        overdue = [sequence for sequence, pending in self._pending.items() if everything or now_ns > pending.until_ns]
        for sequence in overdue:
            self._answer(self._pending.pop(sequence).query, now_ns, state, "the control process did not take it")

    def _answer(self, query: zenoh.Query, now_ns: int, state: str, reason: str) -> None:
        self.refused += bool(reason)
        reply = pb.CommandReply(accepted=not reason, reason=reason, now_ns=now_ns, state=state)
        with query:
            query.reply(self._key, reply.SerializeToString())


def explain(kind: CommandKind, expires_ns: int, record: np.void) -> str:
    """Why the control process refused a command, from the tick that did."""
    state, late_ns = State(int(record["state"])), int(record["now_ns"]) - expires_ns
    if late_ns > 0 and kind is not CommandKind.ESTOP:
        return f"stale: expired {late_ns * 1e-6:.1f} ms before the tick that took it"
    if kind in (CommandKind.ACTIVATE, CommandKind.HOME) and state is State.READY:
        flags = int(record["flags"])
        missing = {
            RECORDER_OK: "no recorder is alive",
            REALTIME_OK: "the kernel did not grant real time (timing.allow_degraded)",
            RIG_OK: "the rig file has changed since the start",
        }
        reasons = [text for bit, text in missing.items() if not flags & bit]
        return "refused: " + (" and ".join(reasons) or "no operator heartbeat")
    if kind is CommandKind.RESET and state in (State.FAULT, State.ESTOP):
        return f"refused in {state.name}: the cause of the fault is still there"
    return f"{kind.name} is not possible in state {state.name}"
