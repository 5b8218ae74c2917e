"""hil/cycle/faults/number.py from the rows beside it: `python -m docs.make_fault_numbers`, first of `make docs`.

Type checkers and the compiled build want the members of an enumeration in a source. A person writes the row alone.
"""

from pathlib import Path

from hil.cycle.faults.families import in_order

FILE = Path(__file__).parent.parent / "hil" / "cycle" / "faults" / "number.py"
HEAD = '''"""Numbers of the faults. Made by `make docs` from the rows beside this file."""

from enum import IntEnum


class Fault(IntEnum):
    """Number of a fault in records and telemetry; 0 is none."""

    NONE = 0
'''


def numbers() -> str:
    """The source."""
    return HEAD + "".join(f"    {row.name} = {row.number}\n" for row in in_order())


if __name__ == "__main__":
    FILE.write_text(numbers(), encoding="utf-8")
