"""Goals from elsewhere: from an authorised connection to the goal page, and the tick's verdict back.

Rules:
- Who may command may move, and nobody else: the command server and the gateway have judged a request before it comes
  here.
- One connection holds the lease. Like every other holder of it, it loses it LEASE_NS after its last word.
- Knots of a stream go through the jitter buffer. One that is too late or out of order is dropped and counted.
"""

import json
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from hil.cycle.goal import GoalKind, Refusal
from hil.live.goal_page import GoalPage, GoalPageError
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.command_server import Asked, Connection
from hil.telemetry.command_wire import LIMIT
from hil.telemetry.goal_wire import Act, unpacked
from hil.telemetry.jitter_buffer import JitterBuffer

VERDICT_NS = 500_000_000
FAR_NS = 1 << 62  # as good as never: the cycle refuses it
SOON_S = 1e-3  # between two looks for a verdict
NOBODY = "no control process is running this rig"


class _Pending(NamedTuple):
    asked: Asked
    number: int
    until_ns: int


class GoalGateway:
    """path: of the goal page. note: who took the lease, in words. tell: what the axes do, once a run is followed."""

    def __init__(self, path: Path, note: Callable[[str, str], None] = lambda who, what: None) -> None:
        self._path, self._note = path, note
        self._page: GoalPage | None = None
        self._holder: Connection | None = None
        self._lease = 0
        self._pending: list[_Pending] = []
        self._buffer = JitterBuffer()
        self._rig: dict[str, Any] = {}
        self.tell: Callable[[int], pb.Motion] = lambda now_ns: pb.Motion()

    def follow(self, rig: dict[str, Any]) -> None:
        """From now on it is a rig's run, as JSON has the rig."""
        self._rig = rig
        self._leave()

    def take(self, asked: Asked, now_ns: int) -> None:
        """Answer a request that was judged, or keep it until the tick that takes its goal."""
        request = asked.request.goal
        try:
            reply = self._act(asked, request, now_ns)
        except GoalPageError as error:
            self._answer(asked, now_ns, pb.GoalReply(), str(error))
        else:
            if reply is not None:
                self._answer(asked, now_ns, reply)

    def _act(self, asked: Asked, request: pb.GoalRequest, now_ns: int) -> pb.GoalReply | None:
        """None: the verdict is still to come. Raises GoalPageError with why it is refused."""
        if request.act == Act.DESCRIBE:
            return pb.GoalReply(rig=self._described())
        if request.act in (Act.TAKE, Act.TAKE_OVER):
            self._take_lease(asked, by_force=request.act == Act.TAKE_OVER)
        elif request.act != Act.LOOK:
            return self._held(asked, request, now_ns)
        return pb.GoalReply()

    def _described(self) -> bytes:
        data = zlib.compress(json.dumps(self._rig).encode())
        if not self._rig or len(data) > LIMIT // 2:
            raise GoalPageError(NOBODY if not self._rig else "the rig's description is too long for a message")
        return data

    def _take_lease(self, asked: Asked, *, by_force: bool) -> None:
        page = self._attached()
        if not by_force and self.holds(page) and self._holder is not asked.connection:
            assert self._holder is not None
            raise GoalPageError(f"{self._holder.who} moves this rig already")
        self._lease = page.take_lease(by_force=by_force or self.holds(page)).number
        self._holder = asked.connection
        self._buffer.forget()
        self._note(asked.who, f"takes the lease, number {self._lease}")

    def _held(self, asked: Asked, request: pb.GoalRequest, now_ns: int) -> pb.GoalReply | None:
        """What only the holder may ask for."""
        page = self._attached()
        if asked.connection is not self._holder or not self.holds(page):
            raise GoalPageError("the lease has ended: take it again")
        if request.act == Act.SEND:
            return self._send(page, asked, request, now_ns)
        if request.act == Act.GIVE_BACK:
            page.give_back()
            self._holder = None
        elif request.act == Act.BEAT:
            page.beat()
        else:
            raise GoalPageError(f"unknown act {request.act}: known are 1 to {max(Act)}")
        return pb.GoalReply()

    def _send(self, page: GoalPage, asked: Asked, request: pb.GoalRequest, now_ns: int) -> pb.GoalReply | None:
        goal = unpacked(request)
        if goal is None:
            return pb.GoalReply(refusal=Refusal.UNKNOWN)
        if goal.kind == GoalKind.KNOT:
            due_ns = self._buffer.due(request.sent_ns, goal.due_ns, now_ns)
            if due_ns is None:
                page.beat()
                return pb.GoalReply()
            goal = goal._replace(due_ns=min(due_ns, FAR_NS))
        self._pending.append(_Pending(asked, page.post(goal), now_ns + VERDICT_NS))
        return None

    def advance(self, now_ns: int) -> None:
        """Answer those whose goals were taken."""
        waiting, self._pending = self._pending, []
        for pending in waiting:
            refusal = self._page.verdict(pending.number) if self._page else Refusal.FOREIGN
            if refusal is not None:
                self._answer(pending.asked, now_ns, pb.GoalReply(number=pending.number, refusal=refusal))
            elif now_ns > pending.until_ns:
                self._answer(pending.asked, now_ns, pb.GoalReply(), "the control process did not take it")
            else:
                self._pending.append(pending)

    def _answer(self, asked: Asked, now_ns: int, reply: pb.GoalReply, reason: str = "") -> None:
        reply.motion.CopyFrom(self.tell(now_ns))
        asked.connection.answer(
            pb.CommandReply(
                accepted=not reason, reason=reason, now_ns=now_ns, sequence=asked.request.sequence, goal=reply
            )
        )

    def holds(self, page: GoalPage) -> bool:
        """The lease on the page is one that was taken here."""
        found = page.holder()
        return self._holder is not None and found is not None and found.number == self._lease

    def fill(self, motion: pb.Motion) -> None:
        """Who of elsewhere moves the rig, and what became of a stream."""
        if self._page is not None and self.holds(self._page) and self._holder is not None:
            motion.lease = self._holder.who
            motion.stream_delay = self._buffer.delay_ns * 1e-9
        motion.stream_late, motion.stream_disordered = self._buffer.late, self._buffer.disordered

    def patience(self, period_s: float) -> float:
        """How long the sidecar may rest now, s; at most its period."""
        return SOON_S if self._pending else period_s

    @property
    def awaited(self) -> Connection | None:
        """Whose next word should not wait for the sidecar's period."""
        return self._holder if self._holder is not None and self._holder.open else None

    def _attached(self) -> GoalPage:
        if self._page is None or self._page.replaced:
            self._leave()
            try:
                self._page = GoalPage(self._path)
            except GoalPageError:
                raise GoalPageError(NOBODY) from None
        return self._page

    def _leave(self) -> None:
        self._holder = None
        if self._page is not None:
            self._page.close()
            self._page = None
