"""[bus.cia402]: what a rig says of its CiA 402 drives."""

from typing import Annotated, Any, Literal

from pydantic import Field

from drivers.base.keys import REQUIRED, Table, key


class ObjectValue(Table):
    """A value to write into a drive's object dictionary; its size is what the drive's EDS says."""

    object: Annotated[str, Field(pattern=r"^[0-9A-Fa-f]{4}h?(:[0-9A-Fa-f]{1,2})?$")] = key(
        REQUIRED, 'index and sub-index, hexadecimal: "6007h", "1029h:01"'
    )
    value: int = key(REQUIRED, "value to write", "1", ge=-(2**31), lt=2**32)

    @property
    def place(self) -> tuple[int, int]:
        """Index and sub-index."""
        index, _, subindex = self.object.partition(":")
        return int(index.rstrip("h"), 16), int(subindex or "0", 16)


NodeNumber = Annotated[int, Field(ge=1, le=126)]
RatedTorque = Annotated[float, Field(gt=0, lt=1e6)]


class Cia402Config(Table):
    """[bus.cia402]: CiA 402 drives as their makers describe them. Lists are in the order of [axes], one entry per axis.

    Without this table the drives are the project's own (drivers/families/cia402/cia402.eds).
    """

    eds: list[str] = key(REQUIRED, "EDS or DCF files, beside the rig file: one per axis, or one for all", min_length=1)
    nodes: list[NodeNumber] = key([], "CANopen node of each axis", "1", derived="bus.node_id and the numbers after it")
    rpdo: Literal["auto", "shared", "own"] = key(
        "auto", "shared: one RPDO with the torques of all drives; own: one per drive; auto: shared where all drives can"
    )
    sync_counter: Literal["auto", "on", "off"] = key("auto", "counter in SYNC (1019h); auto: where all drives have it")
    rated_torque: list[RatedTorque] = key(
        [],
        "torque (force) that 6076h stands for; compared with the drive's",
        "N or N m",
        derived="read from each drive",
    )
    write_rated_torque: bool = key(False, "write 6076h, which on many drives is a property of the motor")
    start: Literal["nmt", "autostart"] = key("nmt", "autostart: the drives go to operational by themselves")
    stop_options: Literal["release", "keep"] = key(
        "release",
        "release: disabled, in fault, or without its host a drive lets go at once (1029h, 6007h, 605Bh, 605Ch, 605Eh "
        "are written where they exist and `write` states none); keep: as the drive has them",
    )
    watch_mode: bool = key(
        False,
        "map 6061h into every answer, behind position and statusword: a drive that leaves CST counts as in fault",
        exclude_if=lambda watched: not watched,
    )
    inputs: bool = key(
        False,
        "map 60FDh into TPDO 2, sent at every SYNC: limit switches and home switch; without it for 5 ticks a drive "
        "counts as in fault",
        exclude_if=lambda told: not told,
    )
    touch_probe: bool = key(
        False,
        "map 60B9h and 60BAh into TPDO 3 of every drive that has them, sent at every tenth SYNC: an axis that homes on "
        "its encoder's index stops there. Without it, it goes all of home.farthest, and its drive is asked then",
        exclude_if=lambda told: not told,
    )
    write: list[ObjectValue] = key([], "further objects, written in this order before the drive is started")


class Cia402Keys(Table):
    """What this family adds to [bus]."""

    node_id: int = key(1, "cia402: CANopen node of the first axis; the others follow", "1", ge=1, le=120)
    cia402: Cia402Config | None = key(None, "the drives' own EDS files; cia402 without it: the project's own drive")


def cia402_keys(bus: Any) -> Cia402Keys:
    """The keys of this family in [bus]."""
    keys: Cia402Keys = bus
    return keys
