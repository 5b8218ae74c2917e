"""What became of a cell."""

from dataclasses import dataclass
from enum import IntEnum
from math import nan


class Verdict(IntEnum):
    """NONE: it has not been injected yet. UNKNOWN: the evidence that says so is missing; never counted as OK."""

    NONE = 0
    OK = 1
    NO_CELL = 2
    ROLLED = 3
    NOT_PIERCED = 4
    DOUBLE = 5  # pierced twice: the far side, too
    SENSOR_DEAD = 6
    CAMERA_FROZEN = 7
    CLOGGED = 8
    STUCK = 9  # the cell stays on the pipette
    BROKEN = 10  # the tip is not where it should be: the batch stops
    UNKNOWN = 11
    SKIPPED = 12  # by an operator, before its pulse
    HELD = 13  # the force was held as long as it was to be, and nothing is pierced
    BURST = 14  # pierced while its force was to be held


class Phase(IntEnum):
    """Where in a cell's injection the motion is."""

    NONE = 0
    APPROACH = 1
    TARE = 2
    SEEK = 3
    PRESS = 4
    FREEZE = 5
    ADVANCE = 6
    PULSE = 7
    CONFIRM = 8
    WITHDRAW = 9
    LIFT = 10
    PAUSED = 11  # by an operator, between two cells


TOLD = 100  # a phase of so much and a verdict: the tick in which it is reached


@dataclass
class CellResult:
    """One cell. Positions in m along the axis of injection, forces in N, times in s since the motion began; NaN where
    there is none.
    """

    number: int
    verdict: Verdict = Verdict.NONE
    began_s: float = nan
    ended_s: float = nan
    contact: float = nan  # where the first touch was
    found: float = nan  # where it was known
    found_s: float = nan
    pierced: float = nan  # where the puncture was known
    pierced_s: float = nan
    pierced_force: float = nan  # most before it
    pierced_speed: float = nan
    peak_force: float = 0.0
    rested: float = nan  # where it came to rest behind that
    deposit: float = nan  # depth behind the first touch
    pull: float = 0.0  # most force on the way out
    held_rms: float = nan  # of the reading against the force that was held
    pulse_s: float = nan  # when the pulse began
    bolus: float = nan
    evidence: str = ""  # what decided
    left: bool = False  # at an operator's request, or in a batch that was interrupted
