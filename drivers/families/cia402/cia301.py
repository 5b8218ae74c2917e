"""Numbers and small formulas of CiA 301 (communication) and CiA 402 (drives) that master and drive share."""

from enum import Enum, IntEnum
from pathlib import Path
from struct import Struct

EDS = Path(__file__).with_name("cia402.eds")

# Function codes of the predefined connection set (CiA 301, 7.3.5): identifier = code + node.
NMT_ID = 0x000
SYNC_ID = 0x080
EMCY_ID = 0x080
TPDO1_ID = 0x180
RPDO1_ID = 0x200
RPDO2_ID = 0x300
RPDO3_ID = 0x400
SDO_RESPONSE_ID = 0x580
SDO_REQUEST_ID = 0x600
HEARTBEAT_ID = 0x700

STANDARD_IDS = 0x7FF  # bits of a COB-ID that hold an identifier of 11 bits
PDO_INVALID = 1 << 31  # in a PDO's COB-ID: not in use
SYNC_COUNTER_MAX = 240  # 1019h
TORQUE_MODE = 10  # 6060h: cyclic synchronous torque
TORQUE_MODE_BIT = 1 << 9  # 6502h
HOMING_MODE, HOMING_MODE_BIT = 6, 1 << 5  # of the same
DEVICE_PROFILE = 402  # low word of 1000h

CONTROLWORD, STATUSWORD, MODE, MODE_DISPLAY = 0x6040, 0x6041, 0x6060, 0x6061
POSITION, TORQUE, TORQUE_ACTUAL, TORQUE_MAX, TORQUE_RATED = 0x6064, 0x6071, 0x6077, 0x6072, 0x6076


class NmtCommand(IntEnum):
    """First byte of an NMT frame."""

    START = 0x01
    STOP = 0x02
    PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(IntEnum):
    """The byte of a heartbeat."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class Abort(IntEnum):
    """SDO abort codes (CiA 301, table 22)."""

    TOGGLE = 0x05030000
    TIMEOUT = 0x05040000
    COMMAND = 0x05040001
    BLOCK_SIZE = 0x05040002
    SEQUENCE = 0x05040003
    CRC = 0x05040004
    OUT_OF_MEMORY = 0x05040005
    UNSUPPORTED = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_LENGTH = 0x06040042
    LENGTH = 0x06070010
    TOO_LONG = 0x06070012
    TOO_SHORT = 0x06070013
    NO_SUBINDEX = 0x06090011
    VALUE_RANGE = 0x06090030
    VALUE_HIGH = 0x06090031
    VALUE_LOW = 0x06090032
    DEVICE_STATE = 0x08000022


class Emergency(IntEnum):
    """Emergency error codes this project sends or understands (CiA 301, table 26; CiA 402-2)."""

    NONE = 0x0000
    INTERNAL = 0x6100
    SENSOR = 0x7300
    HEARTBEAT = 0x8130
    PDO_TOO_SHORT = 0x8210
    SYNC_LENGTH = 0x8240
    RPDO_TIMEOUT = 0x8250
    FOLLOWING = 0x8611


class DriveState(Enum):
    """State of the CiA 402 power state machine: (mask, value) of the statusword."""

    NOT_READY = (0x4F, 0x00)
    SWITCH_ON_DISABLED = (0x4F, 0x40)
    READY_TO_SWITCH_ON = (0x6F, 0x21)
    SWITCHED_ON = (0x6F, 0x23)
    OPERATION_ENABLED = (0x6F, 0x27)
    QUICK_STOP = (0x6F, 0x07)
    FAULT_REACTION = (0x4F, 0x0F)
    FAULT = (0x4F, 0x08)


def drive_state(statusword: int) -> DriveState | None:
    """State that a statusword tells; None where its bits make none."""
    for state in DriveState:
        mask, value = state.value
        if statusword & mask == value:
            return state
    return None


# Controlwords of the commands in CiA 402-2, table 27.
DISABLE_VOLTAGE = 0x0000
QUICK_STOP = 0x0002
SHUTDOWN = 0x0006
SWITCH_ON = 0x0007
ENABLE_OPERATION = 0x000F
FAULT_RESET = 0x0080
HALT = 0x0100
START_HOMING = 0x0010  # in homing mode

VOLTAGE_ENABLED = 1 << 4  # statusword bits besides the state
REMOTE = 1 << 9
LIMIT_ACTIVE = 1 << 11
FOLLOWS_COMMAND = 1 << 12
HOMED = 1 << 14  # manufacturer's
BRAKE = 1 << 15  # manufacturer's

SDO = Struct("<BHB4s")  # command, index, sub-index, data
EMCY = Struct("<HB5s")  # error code, error register, manufacturer's

# Identifiers that no PDO, SYNC or emergency may have (CiA 301, 7.3.5): NMT, reserved, SDO, heartbeats.
_RESTRICTED = ((0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF))


def is_restricted(can_id: int) -> bool:
    """Whether CiA 301 keeps an identifier of 11 bits for something else."""
    return any(low <= can_id <= high for low, high in _RESTRICTED)


def mapping_entry(index: int, subindex: int, bits: int) -> int:
    """Value of a mapping parameter: index, sub-index and length of the mapped object."""
    return index << 16 | subindex << 8 | bits
