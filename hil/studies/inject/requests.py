"""Requests to a batch that are declared beforehand: `skip@3`, `pause@2:press`, `abort@5:confirm`."""

from collections.abc import Sequence
from typing import Final, NamedTuple

from hil.control.motion.contract import Request
from hil.control.motion.injection.verdict import TOLD, Phase
from hil.rig.schema import RigError

PAUSE_S: Final = 1.0  # that a declared pause lasts
WORDS: Final = tuple(word.name.lower() for word in Request if word)
_PHASES: Final = tuple(phase.name.lower() for phase in Phase if phase and phase is not Phase.PAUSED)


class Declared(NamedTuple):
    """request: to be made once cell `number`, from 1 on, is in `phase`; NONE: as soon as it is that cell's turn."""

    request: Request
    number: int
    phase: Phase


def declared(text: str) -> Declared:
    """Of WORD@CELL or WORD@CELL:PHASE. Raises RigError."""
    word, _, place = text.partition("@")
    number, colon, phase = place.partition(":")
    known = [name for name in WORDS if name != "resume"]
    counts = number.isdecimal() and len(number) <= 4 and int(number) >= 1
    if word not in known or not counts or (colon and phase not in _PHASES):
        raise RigError(
            [
                f"--ask {text[:40]!r}: expected WORD@CELL or WORD@CELL:PHASE, as skip@3 or pause@2:press; WORD is one "
                f"of {', '.join(known)}, PHASE one of {', '.join(_PHASES)}"
            ]
        )
    return Declared(Request[word.upper()], int(number), Phase[phase.upper()] if phase else Phase.NONE)


class Script:
    """Makes declared requests in their order as the batch comes to them. A pause ends by itself."""

    def __init__(self, wanted: Sequence[Declared]) -> None:
        self._waiting = sorted(wanted, key=lambda one: (one.number, one.phase))
        self._resume_s = -1.0

    def due(self, number: int, phase: int, now_s: float) -> Request:
        """What is to be asked now, with the batch at `phase` of cell `number`; NONE: nothing."""
        if 0.0 <= self._resume_s <= now_s:
            self._resume_s = -1.0
            return Request.RESUME
        if not self._waiting or phase >= TOLD or phase == Phase.PAUSED:
            return Request.NONE
        first = self._waiting[0]
        if (number, phase) < (first.number, first.phase):
            return Request.NONE
        self._waiting.pop(0)
        if first.number != number:  # it was over before it could be asked
            return Request.NONE
        if first.request is Request.PAUSE:
            self._resume_s = now_s + PAUSE_S
        return first.request
