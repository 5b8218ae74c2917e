"""Homing by the drive itself: mode 6 of CiA 402-2, from cyclic synchronous torque and back to it.

Rules. The drive is told method (6098h), speeds (6099h), acceleration (609Ah) and its greatest torque (6072h) while the
axis rests under the host's torque; each is read back. Then 6060h = 6, and once 6061h says so, bit 4 of the controlword.
It has homed where bits 12 and 10 of the statusword are set; bit 13 is its error. Bits that a drive shows before it
begins are those of an earlier homing: they count once they have been clear. Back: 6060h = 10, 6061h, then 6072h as it
was, read back as well.

However it ends, the drive is not enabled before it is back; one that does not come back is refused.
"""

import math
from collections.abc import Callable
from typing import Final

from drivers.families.cia402 import cia301
from drivers.families.cia402.drive_plan import DrivePlan
from drivers.families.cia402.errand import Asked, Errand, written
from drivers.families.cia402.node import RUNNING, NodeMaster
from drivers.families.cia402.sdo import Step
from drivers.protocols.finding import HomingTerms, Search

METHOD, SPEEDS, ACCELERATION = 0x6098, 0x6099, 0x609A
_REACHED, _ATTAINED, _ERROR = 1 << 10, 1 << 12, 1 << 13  # of the statusword in this mode
PATIENT_WORDS: Final = 10  # that still show an earlier homing, before it is begun all the same
_MOST: Final = 0xFFFFFFFF


class HomingMode(Asked):
    """Homer of one drive."""

    methods = range(-128, 128)
    lets_go = False

    def __init__(self, node: NodeMaster, plan: DrivePlan, gain: Callable[[], float]) -> None:
        """gain: thousandths of 6076h in an N (N m)."""
        super().__init__(node)
        self._node, self._plan, self._gain = node, plan, gain
        self._terms: HomingTerms | None = None  # that the drive is yet to be told
        self._limit = 0  # 6072h as it was
        self._heard = 0  # statuswords in that mode, before it was told to begin
        self._shown = 0  # bits of an earlier homing that it shows still

    def begin(self, terms: HomingTerms) -> None:
        """See Homer."""
        self.problem, self._terms = "", terms
        self._ask([Step(cia301.TORQUE_MAX, 0, 0, width=2)])

    def end(self) -> None:
        """See Homer."""
        if self._node.away and self._node.phase is RUNNING:
            self._come_back()
        self._forget()

    def hear(self, word: int) -> None:
        """A statusword."""
        if self._search is not Search.RUNNING:
            return
        if not self._node.homes:
            self._heard += 1
            self._shown = word & (_ATTAINED | _ERROR)
            self._node.homes = not self._shown or self._heard == PATIENT_WORDS
            return
        self._shown &= word
        if word & ~self._shown & _ERROR:
            self.problem = f"node {self._node.node_id}: homing error, bit 13 of the statusword"
            self._search = Search.ERROR
        elif word & ~self._shown & _ATTAINED and word & _REACHED:
            self._come_back()

    def _conclude(self, errand: Errand) -> None:
        if self._terms is not None:
            self._limit = errand.values[cia301.TORQUE_MAX]
            self._prepare(self._terms)
        elif errand.required:
            self._search = Search.FOUND
        else:
            self._search, self._heard = Search.RUNNING, 0

    def _prepare(self, terms: HomingTerms) -> None:
        self._terms = None
        limit = min(self._plan.limit, math.floor(terms.force * self._gain()))
        self._ask(
            [
                *written(METHOD, 0, terms.method, 1),
                *written(SPEEDS, 1, _whole(terms.speed), 4),
                *written(SPEEDS, 2, _whole(terms.latch_speed), 4),
                *written(ACCELERATION, 0, _whole(terms.acceleration), 4),
                *written(cia301.TORQUE_MAX, 0, limit, 2),
                *_mode(cia301.HOMING_MODE),
            ]
        )
        self._node.away = self._errand is not None and not self._errand.over

    def _come_back(self) -> None:
        self._node.homes = False
        self._ask([*_mode(cia301.TORQUE_MODE), *written(cia301.TORQUE_MAX, 0, self._limit, 2)], required=True)


def _mode(mode: int) -> list[Step]:
    return [
        Step(cia301.MODE, 0, mode, 1, width=1),
        Step(cia301.MODE_DISPLAY, 0, mode, mask=0xFF, width=1),
    ]


def _whole(value: float) -> int:
    return max(1, min(_MOST, round(value)))


def homing_mode(node: NodeMaster, plan: DrivePlan, gain: Callable[[], float]) -> HomingMode | str:
    """Of a drive; or why it has none."""
    return plan.no_homing or HomingMode(node, plan, gain)
