"""What a DBC file says besides where values are, held against the binding: units, and whose each message is.

A unit that is none of those below, or none at all, says nothing. Nor does a node that sends the messages of all axes.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from drivers.families.dbc.config import SignalBinding
from drivers.families.dbc.page import Bound
from drivers.protocols.base import LayoutError
from drivers.protocols.count_size import CountSize

_LENGTHS: Final = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9}
_ANGLES: Final = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "°": math.pi / 180} | dict.fromkeys(
    ("rev", "revs", "turn", "turns"), 2 * math.pi
)
_NEWTON: Final = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "Nm": 1.0, "mNm": 1e-3, "cNm": 1e-2, "Ncm": 1e-2, "kNm": 1e3}
_ALLOWED: Final = 0.01  # of a scale, by which a rounded one may differ


def count_size(bound: Bound, item: SignalBinding) -> CountSize | None:
    """How far a count of a bound position is, by the unit of its signal."""
    unit = bound.message.unit(item.signal).strip()
    unit_size = _LENGTHS.get(unit) or _ANGLES.get(unit)
    if unit_size is None:
        return None
    source = f"{item.message}.{item.signal} is in {unit}, bus.dbc.position has scale = {item.scale:g}"
    return CountSize(unit_size / item.scale, unit in _ANGLES, False, source)


def check_torques(torques: Sequence[Bound], items: Sequence[SignalBinding]) -> None:
    """Raise LayoutError where a signal states N or N m and the binding scales it otherwise."""
    for axis, (bound, item) in enumerate(zip(torques, items, strict=True)):
        unit = bound.message.unit(item.signal)
        newton = _NEWTON.get("".join(unit.split()).replace("*", "").replace("·", ""))
        if newton is not None and abs(item.scale / newton - 1.0) > _ALLOWED:
            raise LayoutError(
                f"bus.dbc.torque[{axis}]: {item.message}.{item.signal} is in {unit}, so its scale is {newton:g}, not "
                f"{item.scale:g}. A gear is axes.NAME.gear; if the file's unit is wrong, change it there"
            )


class Owned(NamedTuple):
    """A bound value of one axis. key: where it is bound."""

    key: str
    axis: int
    bound: Bound


def per_axis(key: str, bounds: Sequence[Bound], n_axes: int) -> list[Owned]:
    """Those of a list with one entry an axis; of a list with one for all none is anybody's."""
    return [Owned(f"{key}[{at}]", at, bound) for at, bound in enumerate(bounds) if len(bounds) == n_axes]


def check_owners(owned: Iterable[Owned], of: Sequence[Bound], what: str) -> None:
    """Raise LayoutError where a value of one axis is bound in a message of another one's drive.

    of: positions (torques) by axis, which say whose a message is: by itself, and by the node that sends it. what: their
    name.
    """
    for key, axis, bound in owned:
        if bound.message is of[axis].message:
            continue
        for other, theirs in enumerate(of):
            theirs_alone = theirs.message.owners - of[axis].message.owners
            if other != axis and (bound.message is theirs.message or bound.message.owners & theirs_alone):
                raise LayoutError(
                    f"bus.dbc.{key}: {bound.message.name} belongs to the drive of {what}[{other}] in "
                    f"{theirs.message.name}, not to that of {what}[{axis}] in {of[axis].message.name}"
                )
