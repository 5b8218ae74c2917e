"""What is written down of a fault, once: a row. Each file beside this one has the rows of a family.

The table (fault_table.py), the numbers (number.py), the texts of events, docs/faults.md and the fault
campaign are made from the rows. A new fault takes a row with the next number, a detector in
hil/cycle/fault_monitor.py (none where a status bit of a drive is the fault), and `make docs`.
"""

from enum import Enum, IntEnum
from typing import Final, NamedTuple

from drivers.protocols.answer_fields import Field
from hil.cycle.state_machine import TORQUE_STATES, State


class Reaction(IntEnum):
    """In order of severity. WITHDRAW takes the place of STOP where the tip of a motion is inside (withdrawal.py)."""

    COUNT = 0
    BRIDGE = 1
    WITHDRAW = 2
    STOP = 3
    ZERO = 4
    SILENT = 5


class Form(Enum):
    """What evidence of a fault is.

    THRESHOLD: a value beyond a limit. STATE: something is so; `measured` says what, with the word for its value.
    GRANT: a permission, there (1) or not (0), with a word for either; it is told, too, when it comes back.
    """

    THRESHOLD = "threshold"
    STATE = "state"
    GRANT = "grant"


MOVING: Final = TORQUE_STATES
WATCHING: Final = frozenset({State.READY, *MOVING})
RESTING: Final = frozenset({State.CONNECTED, State.READY, State.FAULT, State.ESTOP})
ALWAYS: Final = frozenset(State) - {State.BOOT, State.SHUTDOWN}
STANDING: Final = frozenset({State.READY, State.FAULT, State.ESTOP})
RESET: Final = "then hil command NAME reset"
OF_SENSOR: Final = "of the sensor"  # a unit: the one that [sensors] states


class Trial(NamedTuple):
    """How the fault campaign brings a fault about.

    name: of the trial. step: a step of hil/studies/fault_campaign/from_rows.py, with its argument after a blank; the
    campaign makes the trial from it and the row. Empty: the trial is about more than this fault, and catalogue.py there
    has it. within: ticks from the injection to the fault.
    """

    name: str
    step: str = ""
    within: int = 3


class Row(NamedTuple):
    """One fault.

    number: in records and telemetry, never used again for another. seen_by, after: how the detector finds it, for
    people. states: those in which it counts. drive_latched: the drive holds it, so it does not keep RESET from clearing
    it. told_by_drives: it is seen in what a drive says of itself, as late as the drive says so. of_sensor:
    its evidence names a channel of [sensors] in the place of an axis. form, measured, unit:
    what its evidence is, and `words` what stands for {} in `measured`, by a
    value of 0, 1, ...; "m" and "N" stand for rad and N m where the axis is rotary. status: DriveStatus bits, any of
    which is the fault by itself; 0: none is. cause: what usually brings it about. action: what to do next. guards: the
    fields of an answer whose bound it watches. requirement: the one of docs/safety-case.md that it serves.
    """

    number: int
    name: str
    seen_by: str
    after: str
    reaction: Reaction
    states: frozenset[State]
    measured: str
    cause: str
    action: str
    unit: str = ""
    form: Form = Form.THRESHOLD
    status: int = 0
    drive_latched: bool = False
    told_by_drives: bool = False
    of_sensor: bool = False
    words: tuple[str, ...] = ()
    trials: tuple[Trial, ...] = ()
    guards: tuple[Field, ...] = ()
    requirement: str = ""
