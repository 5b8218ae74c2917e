"""60B8h to 60BAh: the touch probe of a drive on its encoder's zero pulse. The drive latches its position by itself, so
that the index is known to the count however far an axis goes between two samples.

By CiA 402-2. 60B8h: bit 0 on, bit 1 clear (first event alone), bits 2 and 3 = 01 (zero pulse), bit 4 positive edge.
60B9h: bit 0 it is on, bit 1 a position is latched; off clears both. 60BAh: that position, in the units of 6064h.

Where the rig asks for it the drive tells 60B9h and 60BAh in its TPDO 3; else, and where none came, it is asked by SDO
once the axis rests.
"""

from struct import Struct
from typing import Final

from drivers.families.cia402.drive_plan import DrivePlan
from drivers.families.cia402.errand import Asked, Errand, written
from drivers.families.cia402.node import RUNNING, NodeMaster
from drivers.families.cia402.sdo import Step
from drivers.protocols.finding import Search

FUNCTION, STATUS, PLACE = 0x60B8, 0x60B9, 0x60BA
TPDO3_ID: Final = 0x380
LENGTH: Final = 6  # bytes of TPDO 3
SYNCS: Final = 10  # it comes at every so many: what it tells is latched, so that it may come late
_OFF, _FIRST_ZERO_PULSE = 0, 1 << 0 | 1 << 2 | 1 << 4
_ON, _LATCHED = 1 << 0, 1 << 1
_TPDO: Final = Struct("<Hi")


class TouchProbe(Asked):
    """Finder of one drive's index."""

    def __init__(self, node: NodeMaster) -> None:
        super().__init__(node)
        self.count = 0
        self._node = node

    def begin(self) -> None:
        """See Finder: off, which forgets what is latched, then on."""
        self.problem = ""
        self._ask(
            [
                *written(FUNCTION, 0, _OFF, 2),
                Step(STATUS, 0, 0, mask=_ON | _LATCHED, width=2),
                *written(FUNCTION, 0, _FIRST_ZERO_PULSE, 2),
                Step(STATUS, 0, _ON, mask=_ON, width=2),
            ]
        )

    def settle(self) -> None:
        """See Finder."""
        self._ask([Step(STATUS, 0, 0, width=2), Step(PLACE, 0, 0)])

    def end(self) -> None:
        """See Finder."""
        if self._search is not Search.NONE and self._node.phase is RUNNING:
            self._node.errand = Errand([Step(FUNCTION, 0, _OFF, 2, width=2)])
        self._forget()

    def hear(self, data: bytes) -> None:
        """A TPDO 3 of LENGTH bytes."""
        if self._search is Search.RUNNING:
            self._take(*_TPDO.unpack(data))

    def _take(self, status: int, place: int) -> None:
        if status & _ON and status & _LATCHED:
            self.count, self._search = place, Search.FOUND

    def _conclude(self, errand: Errand) -> None:
        if PLACE not in errand.values:
            self._search = Search.RUNNING
        else:
            self._search = Search.MISSED
            place = errand.values[PLACE]
            self._take(errand.values[STATUS], place - (1 << 32) if place >> 31 else place)


def touch_probe(node: NodeMaster, plan: DrivePlan) -> TouchProbe | str:
    """Of a drive; or why it has none."""
    return plan.no_probe or TouchProbe(node)
