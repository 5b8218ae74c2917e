"""[outputs.NAME]: what the host can switch, and for how long at most."""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field, model_validator

from drivers.base.keys import REQUIRED, Table, key

MAX_OUTPUTS: Final = 8
CANOPEN: Final = ("cia401", "cia404")

Identifier = Annotated[int, Field(ge=1, le=0x7FF)]


def _is_empty(value: Any) -> bool:
    return not value


class OutputConfig(Table):
    """[outputs.NAME]: a valve, a light or a pulse that a node switches, on the first segment of the bus.

    It is 0 outside ACTIVE, in a tick with a fault, and after `longest_s`, until it has not been asked for.
    """

    kind: Literal["hil", "dbc", "cia401", "cia404"] = key(
        "hil",
        "how the node is told. hil: a bit of the frame of docs/outputs.md; dbc: a signal of a DBC file; cia401, "
        "cia404: a digital output of such a CANopen device, beside CiA 402 drives",
        exclude_if=lambda kind: kind == "hil",
    )
    can_id: Identifier = key(REQUIRED, "identifier of the frame; outputs of one node share it", "1")
    bit: int = key(
        REQUIRED, "its number in motions and records; kind = hil: its bit in the frame, too", "1",
        ge=0, le=MAX_OUTPUTS - 1,
    )  # fmt: skip
    longest_s: float = key(REQUIRED, "longest that it stays set", "s", gt=0, le=3600)
    fd: bool = key(False, "kind = dbc: the message is a CAN FD frame", exclude_if=_is_empty)
    file: str = key(
        "", "kind = dbc: DBC file beside the rig file; cia401, cia404: the device's EDS or DCF", exclude_if=_is_empty
    )
    signal: str = key("", "kind = dbc: the signal that is 1 while the output is set", exclude_if=_is_empty)
    counter: str = key("", "kind = dbc: signal that counts the frames; without it none does", exclude_if=_is_empty)
    node: int = key(0, "kind = cia401, cia404: CANopen node of the device", "1", exclude_if=_is_empty, ge=0, le=126)
    channel: int = key(
        0, "kind = cia401, cia404: which output of the device; 1 is bit 0 of 6200h:01", "1", exclude_if=_is_empty,
        ge=0, le=64,
    )  # fmt: skip

    @model_validator(mode="after")
    def _every_key_acts(self) -> "OutputConfig":
        """Raise ValueError for a key of another kind, or one that this kind lacks."""
        for name, kinds, needed in _OF_KINDS:
            given = bool(getattr(self, name))
            if given and self.kind not in kinds:
                raise ValueError(f"{name}: a key of kind = {' or '.join(map(repr, kinds))}, not of {self.kind!r}")
            if needed and not given and self.kind in kinds:
                raise ValueError(f"{name}: kind = {self.kind!r} needs it")
        return self


_OF_KINDS: Final = (  # key, kinds that have it, whether they need it
    ("fd", ("dbc",), False),
    ("file", ("dbc", *CANOPEN), True),
    ("signal", ("dbc",), True),
    ("counter", ("dbc",), False),
    ("node", CANOPEN, True),
    ("channel", CANOPEN, True),
)
_ALIKE: Final = ("kind", "file", "node", "fd", "counter")  # of the outputs of one frame


def by_frame(outputs: Mapping[str, OutputConfig]) -> list[dict[str, OutputConfig]]:
    """The outputs of each frame, in the order of the first of each."""
    found: dict[int, dict[str, OutputConfig]] = {}
    for name, output in outputs.items():
        found.setdefault(output.can_id, {})[name] = output
    return list(found.values())


def clashes(outputs: Mapping[str, OutputConfig]) -> list[str]:
    """What is wrong with them among themselves: own frames of two identifiers, two outputs of one place, one frame of
    two nodes.
    """
    problems = []
    own = {name: output.can_id for name, output in outputs.items() if output.kind == "hil"}
    if len(set(own.values())) > 1:
        names = ", ".join(f"{name}: {can_id:#x}" for name, can_id in own.items())
        problems.append(f"outputs: all are in one frame with kind = 'hil'; can_id is now {names}")
    bits: dict[int, str] = {}
    for name, output in outputs.items():
        other = bits.setdefault(output.bit, name)
        if other != name:
            problems.append(f"outputs.{name}.bit = {output.bit}: it is the bit of outputs.{other}, too")
    for group in by_frame(outputs):
        first, found = next(iter(group.items()))
        places: dict[tuple[str, int], str] = {}
        for name, output in group.items():
            for shared in _ALIKE:
                value, expected = getattr(output, shared), getattr(found, shared)
                if value != expected:
                    problems.append(
                        f"outputs.{name}.{shared} = {value!r}: outputs.{first}, in the same frame, has {expected!r}"
                    )
            taken = places.setdefault((output.signal, output.channel), name)
            if taken != name and output.kind != "hil":
                place = "signal" if output.signal else "channel"
                problems.append(f"outputs.{name}.{place}: outputs.{taken} has it, too")
    return problems
