"""[bus.mit]: what a rig says of its drives of the MIT kind."""

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from drivers.base.keys import Table, key

MotorNumber = Annotated[int, Field(ge=1, le=127)]
AnswerId = Annotated[int, Field(ge=0, le=0x7FF)]
Range = Annotated[float, Field(gt=0, le=1e3)]


class MitConfig(Table):
    """[bus.mit]: drives of the MIT kind. Lists are in the order of [axes].

    A count is 1/65535 of the whole range of positions, 2 position / 65535 rad of the output shaft, and torque is N m
    there: axes.NAME.encoder_resolution and gear follow. The ranges scale every value on the bus: as the drive itself is
    set, not as its name promises. The defaults are a DM-J4310's as it is delivered.
    """

    kind: Literal["damiao", "cubemars", "robstride"] = key(
        "damiao", "how they pack their values: damiao; cubemars: T-Motor AK, too; robstride: values in the identifier"
    )
    position: list[Range] = key([12.5], "greatest position that a drive tells (P_MAX); one value for all", "rad")
    torque: list[Range] = key([10.0], "greatest torque that a drive takes (T_MAX); one value for all", "N m")
    nodes: list[MotorNumber] = key([], "number of each axis' drive (CAN_ID)", "1", derived="1, 2, ...")
    answers: list[AnswerId] = key(
        [],
        "damiao, cubemars: identifier in which each drive answers (MST_ID)",
        "1",
        derived="damiao: its number + 0x10; cubemars: its number",
    )
    host: int = key(0xFD, "robstride: number of this host", "1", ge=0, le=255)

    @field_validator("position", "torque", mode="before")
    @classmethod
    def _one_for_all(cls, value: Any) -> Any:
        return value if isinstance(value, list) else [value]


class MitKeys(Table):
    """What this family adds to [bus]."""

    mit: MitConfig | None = key(None, "mit: the drives, where they are not as the defaults say")


def mit_keys(bus: Any) -> MitKeys:
    """The keys of this family in [bus]."""
    keys: MitKeys = bus
    return keys
