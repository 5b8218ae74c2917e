"""[bus.moteus]: what a rig says of its moteus controllers."""

from typing import Annotated, Any, Literal

from pydantic import Field

from drivers.base.keys import REQUIRED, Table, key
from drivers.protocols.base import InputName

MoteusNumber = Annotated[int, Field(ge=1, le=127)]


class MoteusInput(Table):
    """A switch at a pin of a controller, which `auxN.pins` of the controller calls a digital input."""

    axis: int = key(REQUIRED, "whose switch, from 0, in the order of [axes]", "1", ge=0, le=63)
    input: InputName = key(REQUIRED, "limit switch at the least or greatest position of the drive, or the home switch")
    aux: Literal[1, 2] = key(1, "connector that it is wired to", "1")
    pin: int = key(REQUIRED, "pin of that connector, from 1", "1", ge=1, le=5)
    closed: Literal[0, 1] = key(1, "level with which the switch is closed", "1")


class MoteusConfig(Table):
    """[bus.moteus]: moteus controllers. Lists are in the order of [axes].

    A count is 1/100 000 of a turn of the output shaft, a torque is N m there: axes.NAME.gear and encoder_resolution
    follow from the travel of a turn.
    """

    nodes: list[MoteusNumber] = key([], "number (id.id) of each axis' controller", "1", derived="1, 2, ...")
    position: Literal["int16", "int32", "float"] = key(
        "int32", "type in which positions are asked for: int16 tells 3.2 turns in steps of 1/10 000 turn"
    )
    torque: Literal["int16", "int32", "float"] = key(
        "float", "type in which torques are sent: int16 in steps of 0.01 N m, int32 of 0.001 N m"
    )
    watchdog_s: float = key(
        0.01,
        "watchdog timeout in every command, after which a drive goes to servo.timeout_mode; as drives.watchdog_s",
        "s",
        gt=0,
        le=1,
    )
    inputs: list[MoteusInput] = key(
        [], "limit switches and home switches at the controllers' pins", exclude_if=lambda entries: not entries
    )


class MoteusKeys(Table):
    """What this family adds to [bus]."""

    moteus: MoteusConfig | None = key(None, "moteus: the controllers, where they are not as the defaults say")


def moteus_keys(bus: Any) -> MoteusKeys:
    """The keys of this family in [bus]."""
    keys: MoteusKeys = bus
    return keys
