"""stage_fd.dbc is the contract of the layout; the structs of stage_fd.py are what the code goes by: the same thing."""

import re
from struct import Struct

import pytest

from drivers.families.stage.stage_fd import COMMAND, DBC, FEEDBACK
from drivers.protocols.base import EVERY_STATUS, DriveStatus
from drivers.protocols.dbc_codec import compile_codec, load_dbc

COMMAND_SIGNALS = ("force_0", "force_1", "force_2", "force_3", "sequence", "flags", "checksum")
FEEDBACK_SIGNALS = ("position", "sample_time", "status", "sequence", "checksum")
MESSAGES = [("Command", COMMAND, COMMAND_SIGNALS)] + [
    (f"Feedback{axis}", FEEDBACK, FEEDBACK_SIGNALS) for axis in range(4)
]


@pytest.mark.parametrize(("name", "layout", "signals"), MESSAGES)
def test_a_message_has_the_bytes_that_the_contract_says(name: str, layout: Struct, signals: tuple[str, ...]) -> None:
    codec = compile_codec(load_dbc(DBC).get_message_by_name(name), signals)
    assert codec.length == layout.size
    for place in range(len(signals)):
        values = [0] * len(signals)
        values[place] = 1
        data = codec.pack(*values)
        assert data == layout.pack(*values)
        assert layout.unpack(b"\xa5" * layout.size) == codec.unpack(b"\xa5" * layout.size)


def test_the_contract_has_room_for_every_status_bit_and_says_what_each_is() -> None:
    status = [load_dbc(DBC).get_message_by_name(f"Feedback{axis}").get_signal_by_name("status") for axis in range(4)]
    assert {signal.maximum for signal in status} == {EVERY_STATUS}
    numbers = [int(number) for number in re.findall(r"\d+(?= [a-z])", str(status[0].comment))]
    assert [1 << number for number in numbers] == [int(bit) for bit in DriveStatus]
