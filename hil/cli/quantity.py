"""Lengths, angles and speeds as people write them on a command line: 1mm, -20um, 0.5deg, 2mm/s."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Final

_UNITS: Final = {
    "linear": {"": 1.0, "m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "nm": 1e-9},
    "rotary": {"": 1.0, "rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "µrad": 1e-6, "deg": math.pi / 180.0},
}
_QUANTITY: Final = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zA-Zµ]*)(/s)?")


def quantity(name: str, text: str, kind: str, *, speed: bool = False) -> float:
    """A text in m or rad, with `speed` in m/s or rad/s; a bare number is in these. kind: of the axis, linear or rotary.

    Raises ValueError naming the axis, the text and what it may be.
    """
    units = _UNITS[kind]
    found = _QUANTITY.fullmatch(text.strip())
    if found is None or found[2] not in units or (found[3] and not speed) or (speed and found[2] and not found[3]):
        per = "/s" if speed else ""
        known = ", ".join(f"{unit}{per}" for unit in units if unit and unit.isascii())
        raise ValueError(f"{name}={text}: expected a number with one of {known}")
    return float(found[1]) * units[found[2]]


def positions(kinds: Mapping[str, str], values: Sequence[float], sign: str = "") -> list[str]:
    """Where axes are, one text each. kinds: as for quantities. values: m (rad) by axis. sign: + shows it always."""
    return [
        f"{name} {value * 1e3:{sign}.4f} {'mm' if kind == 'linear' else 'mrad'}"
        for (name, kind), value in zip(kinds.items(), values, strict=True)
    ]


def quantities(words: Sequence[str], kinds: Mapping[str, str], *, speed: bool = False) -> dict[str, float]:
    """AXIS=VALUE words by axis. kinds: of the rig's axes. Raises ValueError."""
    values: dict[str, float] = {}
    for word in words:
        name, is_there, text = word.partition("=")
        if not is_there or name not in kinds:
            raise ValueError(f"{word}: expected AXIS=VALUE, of the axes {', '.join(kinds)}")
        if name in values:
            raise ValueError(f"{word}: {name} is named twice")
        values[name] = quantity(name, text, kinds[name], speed=speed)
    return values
