"""The CANopen master of a rig: at most one service frame in two ticks brings the drives to operation and back.

Rules. Order of precedence: reset of communication at the start, controlwords that change, the master's heartbeat,
then the nodes in turn. One frame carries the controlwords of all drives: they are enabled and disabled together.
Where it takes the enable bit of a drive that is enabled, it waits for no turn: the host may send nothing after it.
Where each drive has an RPDO of its own, its controlword travels there, in every tick (`words`), and the service frames
are the rest of the list.
"""

from collections.abc import Sequence
from typing import Final

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import DriveState, NmtCommand, NmtState
from drivers.families.cia402.node import RUNNING, NodeMaster
from drivers.families.cia402.profile import MASTER_ID
from drivers.frame import Frame

SERVICE_TICKS = 2  # at least, between service frames but an urgent one, which has no answer: schedulability's figure
HEARTBEAT_TICKS = 20
RESEND_TICKS = 20  # a controlword whose effect is not seen after so long was lost
REPEAT_TICKS = 2 * SERVICE_TICKS  # as is one that disables, sooner: what it took back may still wait there for SYNC
RESET_TICKS = 100  # a reset that does not help in this time is over
BOOT_TICKS = 10  # patience after the reset of communication, before the first SDO

_SWITCHED_ON: Final = DriveState.SWITCHED_ON
_ENABLED: Final = DriveState.OPERATION_ENABLED
_FAULT: Final = DriveState.FAULT
_CLIMB = {
    DriveState.SWITCH_ON_DISABLED: cia301.SHUTDOWN,
    DriveState.READY_TO_SWITCH_ON: cia301.SWITCH_ON,
    _SWITCHED_ON: cia301.SWITCH_ON,
    _ENABLED: cia301.SWITCH_ON,
}
"""Controlword that leads from a state towards SWITCHED ON, where a drive waits for its enable bit."""

_GOALS = (_SWITCHED_ON, _ENABLED)


class Master:
    """All nodes of a rig, in axis order. heartbeat_tick: when its own heartbeat is due."""

    def __init__(self, nodes: Sequence[NodeMaster], word_ids: tuple[int, int] | None, *, reset: bool = True) -> None:
        """word_ids: of the controlword frames that act at once and at SYNC; None: `words` are sent otherwise.

        reset: begin by resetting communication on the whole bus.
        """
        self.nodes = list(nodes)
        self._word_ids = word_ids
        self._reset_bus = reset
        n = len(self.nodes)
        self._words = [-1] * n
        self._armed = [False] * n
        self._words_tick = 0
        self._reset_before = False
        self._reset_tick = -RESET_TICKS - 1
        self._enable_before = 0
        self._quiet = False
        self._turn = 0
        self._started_tick = -1
        self._sent_tick = -1
        self.heartbeat_tick = 0
        self._heartbeat = Frame(cia301.HEARTBEAT_ID + MASTER_ID, bytes((NmtState.OPERATIONAL,)))

    def service(self, tick: int, enable: int, reset: bool) -> Frame | None:
        """The service frame of this tick, or None. enable, reset: as in `Command`."""
        if self._started_tick < 0:
            self._started_tick = self._sent_tick = tick
            if not self._reset_bus:
                return None
            return Frame(cia301.NMT_ID, bytes((NmtCommand.RESET_COMMUNICATION, 0)))
        heartbeat_due = tick >= self.heartbeat_tick
        if self._quiet and enable == self._enable_before and reset == self._reset_before and not heartbeat_due:
            return None
        if reset and not self._reset_before:
            self._reset_tick = tick
        in_turn = tick - self._sent_tick >= SERVICE_TICKS
        urgent = self._enable_before & ~enable and any(n.state is _ENABLED for n in self.nodes)
        self._reset_before, self._enable_before = reset, enable
        if not in_turn and not urgent:
            return None
        frame = self._controlwords(tick, enable)
        if frame is None and in_turn:
            frame = self._in_turn(tick, heartbeat_due)
        if frame is not None:
            self._sent_tick = tick
            self._quiet = False
        return frame

    def _in_turn(self, tick: int, heartbeat_due: bool) -> Frame | None:
        """What can wait."""
        if heartbeat_due:
            self.heartbeat_tick = tick + HEARTBEAT_TICKS
            return self._heartbeat
        return self._serve_nodes(tick) if tick - self._started_tick >= BOOT_TICKS else None

    def stir(self) -> None:
        """Something was received that may call for an answer."""
        self._quiet = False

    def _resetting(self, tick: int) -> bool:
        """Whether the reset bit is to be set: from one tick after the operator's edge, so that it has an edge too."""
        return 0 < tick - self._reset_tick <= RESET_TICKS

    def _serve_nodes(self, tick: int) -> Frame | None:
        for _ in self.nodes:
            self._turn = (self._turn + 1) % len(self.nodes)
            frame = self.nodes[self._turn].service(tick)
            if frame is not None:
                return frame
        return None

    def words(self, tick: int, enable: int) -> list[int]:
        """The controlword of each drive in this tick; after `service`."""
        return [self._controlword(tick, axis, node, bool(enable >> axis & 1)) for axis, node in enumerate(self.nodes)]

    def _controlwords(self, tick: int, enable: int) -> Frame | None:
        """The controlwords of all drives, where one has to change or had no effect."""
        words, waiting, running, busy = [], tick - self._reset_tick <= RESET_TICKS, 0, False
        for axis, node in enumerate(self.nodes):
            wanted = bool(enable >> axis & 1)
            words.append(self._controlword(tick, axis, node, wanted))
            if node.phase is RUNNING:
                running += 1
                busy = busy or node.errand is not None
                goal = _GOALS[wanted and self._armed[axis]]
                waiting = waiting or node.state not in (goal, _FAULT)
        self._quiet = words == self._words and not waiting and not busy and running == len(self.nodes)
        if not running or self._word_ids is None:
            self._words = words
            return None
        disables = self._disables(words)
        patience = REPEAT_TICKS if disables else RESEND_TICKS
        if words == self._words and not (waiting and tick - self._words_tick >= patience):
            return None
        can_id = self._word_ids[0 if disables else 1]
        self._words, self._words_tick = words, tick
        return Frame(can_id, b"".join(word.to_bytes(2, "little") for word in words))

    def _disables(self, words: Sequence[int]) -> bool:
        """Whether any drive that is enabled, or was told to be, is so no longer."""
        return any(
            not _enables(word) and (_enables(before) or node.state is _ENABLED)
            for word, before, node in zip(words, self._words, self.nodes, strict=True)
        )

    def _controlword(self, tick: int, axis: int, node: NodeMaster, wanted: bool) -> int:
        state = node.state
        if node.phase is not RUNNING or state is None:
            self._armed[axis] = False
            return cia301.DISABLE_VOLTAGE
        if state is _FAULT:
            # An enable bit that outlives a fault enables nothing: it has to be seen clear first.
            self._armed[axis] = False
            return cia301.FAULT_RESET if self._resetting(tick) else cia301.DISABLE_VOLTAGE
        if not wanted:
            self._armed[axis] = True
        elif self._armed[axis] and state is _ENABLED:
            return cia301.ENABLE_OPERATION | (cia301.START_HOMING if node.homes else 0)
        elif self._armed[axis] and state is _SWITCHED_ON and not node.away:
            return cia301.ENABLE_OPERATION
        return _CLIMB.get(state, cia301.DISABLE_VOLTAGE)


def _enables(word: int) -> bool:
    """Of a controlword: the drive is to be enabled, whatever else it is to do."""
    return word >= 0 and word & cia301.ENABLE_OPERATION == cia301.ENABLE_OPERATION
