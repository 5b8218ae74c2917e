"""[outputs.NAME]: what the host can switch, and for how long at most."""

from typing import Annotated, Final

from pydantic import Field

from drivers.base.keys import REQUIRED, Table, key

MAX_OUTPUTS: Final = 8

Identifier = Annotated[int, Field(ge=1, le=0x7FF)]


class OutputConfig(Table):
    """[outputs.NAME]: a bit of the output node's frame (drivers/outputs/hil_frame.py), on the first segment of the bus.

    It is 0 outside ACTIVE, in a tick with a fault, and after `longest_s`, until it has not been asked for.
    """

    can_id: Identifier = key(REQUIRED, "identifier of the frame; all outputs of a rig are in one", "1")
    bit: int = key(REQUIRED, "its bit in that frame", "1", ge=0, le=MAX_OUTPUTS - 1)
    longest_s: float = key(REQUIRED, "longest that it stays set", "s", gt=0, le=3600)
