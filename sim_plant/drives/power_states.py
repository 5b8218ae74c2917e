"""The power state machine of CiA 402-2, figure 8, as a table."""

from enum import Enum, auto

from drivers.families.cia402.cia301 import DriveState


class PowerCommand(Enum):
    """What a controlword asks for."""

    SHUTDOWN = auto()
    SWITCH_ON = auto()
    ENABLE = auto()
    DISABLE_VOLTAGE = auto()
    QUICK_STOP = auto()


_S, _C = DriveState, PowerCommand

TRANSITIONS: dict[tuple[DriveState, PowerCommand], DriveState] = {
    (_S.SWITCH_ON_DISABLED, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 2
    (_S.READY_TO_SWITCH_ON, _C.SWITCH_ON): _S.SWITCHED_ON,  # 3
    (_S.READY_TO_SWITCH_ON, _C.ENABLE): _S.OPERATION_ENABLED,  # 3 and 4
    (_S.SWITCHED_ON, _C.ENABLE): _S.OPERATION_ENABLED,  # 4
    (_S.OPERATION_ENABLED, _C.SWITCH_ON): _S.SWITCHED_ON,  # 5
    (_S.SWITCHED_ON, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 6
    (_S.READY_TO_SWITCH_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 7
    (_S.READY_TO_SWITCH_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 7
    (_S.OPERATION_ENABLED, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 8
    (_S.OPERATION_ENABLED, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 9
    (_S.SWITCHED_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 10
    (_S.SWITCHED_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 10
    (_S.OPERATION_ENABLED, _C.QUICK_STOP): _S.QUICK_STOP,  # 11
    (_S.QUICK_STOP, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 12
    (_S.QUICK_STOP, _C.ENABLE): _S.OPERATION_ENABLED,  # 16
}


def power_command(controlword: int) -> PowerCommand:
    """The command in bits 0 to 3 of a controlword (CiA 402-2, table 27)."""
    if not controlword & 0x02:
        return PowerCommand.DISABLE_VOLTAGE
    if not controlword & 0x04:
        return PowerCommand.QUICK_STOP
    if not controlword & 0x01:
        return PowerCommand.SHUTDOWN
    return PowerCommand.ENABLE if controlword & 0x08 else PowerCommand.SWITCH_ON
