"""Numbers of CiA 301 and 402: host and emulated drive share them, so that a wrong one would be wrong on both sides."""

from enum import IntEnum

import pytest

from drivers.families.cia402.cia301 import Abort, DriveState, NmtCommand, NmtState, drive_state

ABORTS = {  # table 22
    "TOGGLE": 0x05030000,
    "TIMEOUT": 0x05040000,
    "COMMAND": 0x05040001,
    "BLOCK_SIZE": 0x05040002,
    "SEQUENCE": 0x05040003,
    "CRC": 0x05040004,
    "OUT_OF_MEMORY": 0x05040005,
    "WRITE_ONLY": 0x06010001,
    "READ_ONLY": 0x06010002,
    "NO_OBJECT": 0x06020000,
    "NOT_MAPPABLE": 0x06040041,
    "PDO_LENGTH": 0x06040042,
    "LENGTH": 0x06070010,
    "TOO_LONG": 0x06070012,
    "TOO_SHORT": 0x06070013,
    "NO_SUBINDEX": 0x06090011,
    "VALUE_RANGE": 0x06090030,
    "VALUE_HIGH": 0x06090031,
    "VALUE_LOW": 0x06090032,
    "DEVICE_STATE": 0x08000022,
}
COMMANDS = {"START": 1, "STOP": 2, "PRE_OPERATIONAL": 128, "RESET_NODE": 129, "RESET_COMMUNICATION": 130}
STATES = {"BOOT_UP": 0, "STOPPED": 4, "OPERATIONAL": 5, "PRE_OPERATIONAL": 127}


@pytest.mark.parametrize(("kind", "numbers"), [(Abort, ABORTS), (NmtCommand, COMMANDS), (NmtState, STATES)])
def test_the_numbers_are_those_of_the_standard(kind: type[IntEnum], numbers: dict[str, int]) -> None:
    assert {name: int(kind[name]) for name in numbers} == numbers


@pytest.mark.parametrize(
    ("low_byte", "state"),  # CiA 402-2, table 30: xxxx xxxx x1xx 0000 and so on
    [
        (0b0000_0000, DriveState.NOT_READY),
        (0b0100_0000, DriveState.SWITCH_ON_DISABLED),
        (0b0010_0001, DriveState.READY_TO_SWITCH_ON),
        (0b0010_0011, DriveState.SWITCHED_ON),
        (0b0010_0111, DriveState.OPERATION_ENABLED),
        (0b0000_0111, DriveState.QUICK_STOP),
        (0b0000_1111, DriveState.FAULT_REACTION),
        (0b0000_1000, DriveState.FAULT),
        (0b0110_0001, None),
        (0b0100_1000, None),
    ],
)
def test_a_statusword_tells_its_state_whatever_its_other_bits(low_byte: int, state: DriveState | None) -> None:
    for other in (0x0000, 0x0010, 0x0080, 0xFF90):
        assert drive_state(low_byte | other) is state
