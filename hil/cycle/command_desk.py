"""Operator commands: refused with the reason when stale, replayed or illegal; never adjusted silently."""

from collections.abc import Callable, Sequence

from hil.cycle.state_machine import Event
from hil.cycle.tick import CommandKind, OperatorCommand

EVENTS: dict[int, Event] = {
    CommandKind.ACTIVATE: Event.ACTIVATE,
    CommandKind.ACTIVATE_HOLD: Event.ACTIVATE,
    CommandKind.STOP: Event.STOP,
    CommandKind.RESET: Event.RESET,
    CommandKind.ESTOP: Event.ESTOP,
    CommandKind.HOME: Event.HOME,
    CommandKind.SHUTDOWN: Event.EXIT,
}


LOADS: frozenset[int] = frozenset({CommandKind.LOAD_TASK, CommandKind.SET_LAW})  # what comes with a document


class CommandDesk:
    """Checks sequence and expiry, remembers the heartbeat, hands events to the state machine."""

    def __init__(self) -> None:
        self.refused = 0
        self.hold_asked = False  # by the newest ACTIVATE: to hold, not to begin the task
        self.heartbeat_ns: int | None = None
        self.handled: list[tuple[OperatorCommand, bool]] = []
        self._last_sequence = -1

    def handle(
        self,
        commands: Sequence[OperatorCommand],
        now_ns: int,
        act: Callable[[Event], bool],
        load: Callable[[int], bool],
    ) -> None:
        """Give each acceptable command's event to `act`, the kind of one that loads to `load`, which say whether it was
        taken.
        """
        self.handled = []
        for command in commands:
            accepted = self._accept(command, now_ns, act, load)
            self.refused += not accepted
            self.handled.append((command, accepted))

    def _accept(
        self, command: OperatorCommand, now_ns: int, act: Callable[[Event], bool], load: Callable[[int], bool]
    ) -> bool:
        if command.kind == CommandKind.ESTOP:
            return act(Event.ESTOP)  # stale or replayed, an emergency stop is obeyed
        if command.sequence <= self._last_sequence or now_ns > command.expires_ns:
            return False
        self._last_sequence = command.sequence
        if command.kind == CommandKind.HEARTBEAT:
            self.heartbeat_ns = now_ns
            return True
        if command.kind in LOADS:
            return load(command.kind)
        event = EVENTS.get(command.kind)
        if event is Event.ACTIVATE:
            self.hold_asked = command.kind == CommandKind.ACTIVATE_HOLD
        return event is not None and act(event)
