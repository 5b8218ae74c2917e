"""Every fault: its row by its number. The rows are declared by family in hil/cycle/faults/."""

from typing import Final

from hil.cycle.faults.families import in_order
from hil.cycle.faults.number import Fault
from hil.cycle.faults.row import ALWAYS, MOVING, RESTING, WATCHING, Form, Reaction, Row

__all__ = ["ALWAYS", "GRANTS", "MOVING", "RESTING", "ROWS", "WATCHING", "Fault", "Form", "Reaction", "Row"]

ROWS: Final[dict[Fault, Row]] = {Fault(row.number): row for row in in_order()}
GRANTS: Final = frozenset(fault for fault, row in ROWS.items() if row.form is Form.GRANT)
