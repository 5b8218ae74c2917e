"""Values of a DCF that contain the node it was written for, as they are for another node."""

from drivers.eds.data_types import integer
from drivers.eds.sections import Sections

_FUNCTION, _NODE, _STANDARD = 0x780, 0x7F, 0x7FF  # bits of an identifier of the predefined connection set
_EXTENDED = 1 << 29
# Objects that hold such identifiers: emergencies, SDO channels, PDOs (CiA 301, 7.5).
_EMERGENCY = 0x1014
_RECORDS = ((0x1200, 0x12FF, (1, 2)), (0x1400, 0x15FF, (1,)), (0x1800, 0x19FF, (1,)))


def moved_values(sections: Sections, own: int, node: int) -> dict[tuple[int, int], int]:
    """Values by index and sub-index, with `node` in place of `own`."""
    moved = {}
    for name, keys in sections.items():
        index, _, sub = name.partition("sub")
        try:
            place = int(index, 16), int(sub or "0", 16)
            stated = integer(keys["parametervalue"], node) if keys.get("parametervalue") else None
        except ValueError:
            continue
        if stated is None or len(index) != 4 or "$NODEID" in keys["parametervalue"].upper():
            continue
        value = _derived(keys.get("defaultvalue", ""), stated, own, node)
        if value is None and _holds_identifier(*place):
            value = _identifier(stated, own, node)
        if value is not None:
            moved[place] = value
    return moved


def _derived(default: str, stated: int, own: int, node: int) -> int | None:
    """What the default's formula gives for the node, where the DCF states what it gives for its own."""
    if "$NODEID" not in default.upper():
        return None
    try:
        return integer(default, node) if integer(default, own) == stated else None
    except ValueError:
        return None


def _holds_identifier(index: int, subindex: int) -> bool:
    in_records = any(first <= index <= last and subindex in subs for first, last, subs in _RECORDS)
    return in_records or (index == _EMERGENCY and subindex == 0)


def _identifier(stated: int, own: int, node: int) -> int | None:
    if stated & _EXTENDED or not stated & _FUNCTION or stated & _NODE != own:
        return None
    return stated & ~_NODE | node
