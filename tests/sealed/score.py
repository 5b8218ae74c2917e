"""Holds an answer against the truth: is the cause the right one, is the axis, and how late was it?"""

import math
import re
from typing import Final, NamedTuple

from tests.sealed.draw import Case
from tests.sealed.reader import Answer

QUIET_S: Final = 0.5
# What an answer must say, in the words of the events. Where two causes look alike, an answer that names both is right.
RIGHT: Final = {
    "encoder_silent": r"this axis does not answer",
    "encoder_stuck": r"encoder stuck",
    "encoder_jump": r"encoder[ _]jump",
    "encoder_noise": r"accuracy lost: noise|noise at the encoder",
    "encoder_fault": r"cannot read its encoder",
    "drive_fault": r"the drive found a fault",
    "drive_watchdog": r"heard no command",
    "stale_feedback": r"old sequence number",
    "duplicate_feedback": r"answers came twice",
    "wrong_sequence": r"old sequence number",
    "bad_checksum": r"wrong checksum",
    "garbage": r"wrong checksum",
    "clock_jump": r"clock jumped",
    "torque_constant": r"drive gives less force",
    "axis_jam": r"friction up|blocked",
    "push": r"pushed or pulled|pushes or pulls|pulls on it",
    "plant_encoder_noise": r"accuracy lost: noise|noise at the encoder",
    "plant_encoder_periodic_error": r"periodic error|with a period of \S+ of travel",
    "plant_vibration": r"accuracy lost: oscillation|shakes the stage",
    "wire_no_ack": r"this axis does not answer",
}
QUIET: Final = frozenset({
    "encoder_stuck", "encoder_noise", "plant_encoder_noise", "axis_jam", "plant_encoder_periodic_error",
    "plant_vibration",
})  # fmt: skip


class Score(NamedTuple):
    """Of one case. late_s: from when it showed until it was told; NaN where it is no quiet fault, or was not told."""

    cause: bool
    axis: bool
    late_s: float

    @property
    def in_time(self) -> bool:
        """Whether a quiet fault was told soon enough; others count as told in time."""
        return not self.late_s > QUIET_S


def score(case: Case, said: Answer) -> Score:
    """An answer that says nothing is wrong in all."""
    if not said.line:
        return Score(cause=False, axis=False, late_s=math.inf if case.kind in QUIET else math.nan)
    late_s = said.at_s - case.shows_s if case.kind in QUIET else math.nan
    early = said.at_s < case.at_s  # a false alarm is no answer
    return Score(re.search(RIGHT[case.kind], said.line) is not None and not early, said.axis == case.axis, late_s)
