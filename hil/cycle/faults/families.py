"""All rows, by number."""

from typing import Final

from hil.cycle.faults import bus, drive, law, motion, operator, samples, sensor, timing
from hil.cycle.faults.row import Row

FAMILIES: Final = (samples, motion, law, drive, bus, timing, operator, sensor)


def in_order() -> list[Row]:
    """Raises ValueError where a number or a name is given twice, or a number left out."""
    rows = sorted((row for family in FAMILIES for row in family.ROWS), key=lambda row: row.number)
    if [row.number for row in rows] != list(range(1, len(rows) + 1)) or len({row.name for row in rows}) < len(rows):
        raise ValueError(f"faults: numbers from 1 on, each name once: {[(row.number, row.name) for row in rows]}")
    return rows
