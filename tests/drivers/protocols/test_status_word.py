"""The status word: what rig files call its bits, and which of them a layout without words of its own carries."""

from typing import get_args

from drivers.protocols.base import INPUTS, OF_DRIVES, DriveStatus, InputName


def names(bits: DriveStatus) -> list[str]:
    return [(bit.name or "").lower() for bit in bits]


def test_a_rig_file_has_a_name_for_every_input() -> None:
    assert list(get_args(InputName)) == names(INPUTS)


def test_a_later_bit_is_carried_by_no_layout_that_does_not_name_it() -> None:
    told = "enabled", "fault", "watchdog", "torque_limited", "homed", "brake", "encoder_fault"
    assert names(DriveStatus(OF_DRIVES)) == list(told)
    assert not OF_DRIVES & INPUTS
