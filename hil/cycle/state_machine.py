"""The states of the control process as one table.

Rules: every (state, event) pair that is not in TABLE is illegal: refused, counted, and without effect. FAULT and ESTOP
are left by RESET alone, and lead to CONNECTED, never to ACTIVE. SHUTDOWN is the end. Torque is permitted in
TORQUE_STATES only; in BOOT and SHUTDOWN nothing is sent at all.
"""

from enum import IntEnum
from typing import Final

from mypy_extensions import mypyc_attr


class State(IntEnum):
    """Where the control process is."""

    BOOT = 0  # nothing sent
    CONNECTED = 1  # zero torque and SYNC are sent; waiting for every axis to answer, healthy
    READY = 2  # every axis answers; zero torque, drives disabled
    HOMING = 3  # moving to the home position
    ACTIVE = 4  # following the task
    STOPPING = 5  # damped stop, then zero
    FAULT = 6  # latched; zero torque, drives disabled
    ESTOP = 7  # operator's emergency stop, latched; zero torque, drives disabled
    SHUTDOWN = 8  # nothing sent


class Event(IntEnum):
    """What can happen."""

    BUS_UP = 0  # the shell has a bus
    AXES_READY = 1  # all axes fresh and healthy long enough
    ACTIVATE = 2  # operator
    HOME = 3  # operator
    HOMED = 4  # home position reached
    STOP = 5  # operator
    STOPPED = 6  # the damped stop is over
    STOPPED_IN_FAULT = 7  # the same, with a fault latched
    STOPPED_FOR_EXIT = 8  # the same, with SIGTERM pending
    FAULT_STOP = 9  # a fault whose reaction is a damped stop (R2)
    FAULT_ZERO = 10  # a fault whose reaction is zero torque now (R3, R4)
    ESTOP = 11  # operator
    RESET = 12  # operator; only when the cause is gone
    EXIT = 13  # SIGTERM, SIGINT


TORQUE_STATES: Final = frozenset({State.HOMING, State.ACTIVE, State.STOPPING})
SILENT_STATES: Final = frozenset({State.BOOT, State.SHUTDOWN})

_S, _E = State, Event
TABLE: dict[tuple[State, Event], State] = {
    (_S.BOOT, _E.BUS_UP): _S.CONNECTED,
    (_S.BOOT, _E.EXIT): _S.SHUTDOWN,
    (_S.BOOT, _E.FAULT_STOP): _S.FAULT,
    (_S.BOOT, _E.FAULT_ZERO): _S.FAULT,
    (_S.BOOT, _E.ESTOP): _S.ESTOP,
    (_S.CONNECTED, _E.AXES_READY): _S.READY,
    (_S.CONNECTED, _E.RESET): _S.CONNECTED,  # clears what the drives have latched
    (_S.CONNECTED, _E.EXIT): _S.SHUTDOWN,
    (_S.CONNECTED, _E.FAULT_STOP): _S.FAULT,
    (_S.CONNECTED, _E.FAULT_ZERO): _S.FAULT,
    (_S.CONNECTED, _E.ESTOP): _S.ESTOP,
    (_S.READY, _E.ACTIVATE): _S.ACTIVE,
    (_S.READY, _E.HOME): _S.HOMING,
    (_S.READY, _E.EXIT): _S.SHUTDOWN,
    (_S.READY, _E.FAULT_STOP): _S.FAULT,
    (_S.READY, _E.FAULT_ZERO): _S.FAULT,
    (_S.READY, _E.ESTOP): _S.ESTOP,
    (_S.HOMING, _E.HOMED): _S.STOPPING,
    (_S.HOMING, _E.STOP): _S.STOPPING,
    (_S.HOMING, _E.EXIT): _S.STOPPING,
    (_S.HOMING, _E.FAULT_STOP): _S.STOPPING,
    (_S.HOMING, _E.FAULT_ZERO): _S.FAULT,
    (_S.HOMING, _E.ESTOP): _S.ESTOP,
    (_S.ACTIVE, _E.STOP): _S.STOPPING,
    (_S.ACTIVE, _E.EXIT): _S.STOPPING,
    (_S.ACTIVE, _E.FAULT_STOP): _S.STOPPING,
    (_S.ACTIVE, _E.FAULT_ZERO): _S.FAULT,
    (_S.ACTIVE, _E.ESTOP): _S.ESTOP,
    (_S.STOPPING, _E.STOPPED): _S.READY,
    (_S.STOPPING, _E.STOPPED_IN_FAULT): _S.FAULT,
    (_S.STOPPING, _E.STOPPED_FOR_EXIT): _S.SHUTDOWN,
    (_S.STOPPING, _E.EXIT): _S.STOPPING,
    (_S.STOPPING, _E.FAULT_STOP): _S.STOPPING,  # already stopping; the fault latches all the same
    (_S.STOPPING, _E.FAULT_ZERO): _S.FAULT,
    (_S.STOPPING, _E.ESTOP): _S.ESTOP,
    (_S.FAULT, _E.RESET): _S.CONNECTED,
    (_S.FAULT, _E.EXIT): _S.SHUTDOWN,
    (_S.FAULT, _E.FAULT_STOP): _S.FAULT,
    (_S.FAULT, _E.FAULT_ZERO): _S.FAULT,
    (_S.FAULT, _E.ESTOP): _S.ESTOP,
    (_S.ESTOP, _E.RESET): _S.CONNECTED,
    (_S.ESTOP, _E.EXIT): _S.SHUTDOWN,
    (_S.ESTOP, _E.FAULT_STOP): _S.ESTOP,
    (_S.ESTOP, _E.FAULT_ZERO): _S.ESTOP,
    (_S.ESTOP, _E.ESTOP): _S.ESTOP,
}


@mypyc_attr(allow_interpreted_subclasses=True)
class StateMachine:
    """The current state and how many illegal events it has refused."""

    def __init__(self) -> None:
        self.state = State.BOOT
        self.refused = 0

    def handle(self, event: Event) -> bool:
        """Take the transition TABLE names; False (and counted) where the event is illegal in this state."""
        target = TABLE.get((self.state, event))
        if target is None:
            self.refused += 1
            return False
        self.state = target
        return True
