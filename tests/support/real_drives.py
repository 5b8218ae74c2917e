"""Six CiA 402 drives one can buy, as far as a master looks at them: facts stated by their makers' public EDS and DCF
files, read in November 2026. What a file leaves without a value, the drive has (`values`).
"""

from collections.abc import Mapping
from typing import NamedTuple

from tests.support.foreign_drive import CST_DRIVE, I8, I16, U8, U16, U32, Fact

Facts = dict[tuple[int, int], Fact]


class RealDrive(NamedTuple):
    """One drive. dummies: objects it lets an RPDO map as dummies. values: of objects whose file states none. states:
    what a rig has to state of it. refused_by: the objects that decide that it cannot be used; none for one that can.
    """

    name: str
    facts: Facts
    dummies: tuple[int, ...] = ()
    values: Mapping[int, int] = {}
    states: Mapping[str, object] = {}
    refused_by: tuple[str, ...] = ()


def _but(*missing: int, **more: Fact) -> Facts:
    """CST_DRIVE without some objects, with others: x6071, or x60C2_1 for a sub-index."""
    places = {name[1:].partition("_"): fact for name, fact in more.items()}
    changed = {(int(index, 16), int(sub or "0", 16)): fact for (index, _, sub), fact in places.items()}
    return {key: fact for key, fact in CST_DRIVE.items() if key[0] not in missing} | changed


def _options(shutdown: str, disable: str, fault: str) -> dict[str, Fact]:
    return {"x605B": Fact(I16, "rw", shutdown), "x605C": Fact(I16, "rw", disable), "x605E": Fact(I16, "rw", fault)}


_ALL_DUMMIES = (2, 3, 4, 5, 6, 7)
_CYCLE = {"x60C2_0": Fact(U8, "const", "2"), "x60C2_1": Fact(U8, "rw", "8"), "x60C2_2": Fact(I8, "rw", "-3")}

EPOS4 = RealDrive(
    "maxon EPOS4",
    _but(
        x1000=Fact(U32, "ro", ""),
        x1005=Fact(U32, "const", "0x80"),
        x1029_0=Fact(U8, "ro", "1"),
        x1029_1=Fact(U8, "rw", "0"),
        x6007=Fact(I16, "rw", "3"),
        x605A=Fact(I16, "rw", "6"),
        **_options("0", "1", "2"),
        x6040=Fact(U16, "rww", "0", True),
        x6060=Fact(I8, "rww", "1", True),
        x6071=Fact(I16, "rww", "0", True),
        x60C2_0=Fact(U8, "const", "2"),
        x60C2_1=Fact(U8, "rww", "0", True),
        x60C2_2=Fact(I8, "rww", "-3", True),
        x6502=Fact(U32, "ro", "", True),
    ),
    values={0x1000: 0x20192, 0x6502: 0x385},
)
EUSERVO = RealDrive(
    "Yiyou EuServo",
    _but(
        0x6076,
        x1006=Fact(U32),
        x1014=Fact(U32, "rw", "$NODEID+0x80"),
        x1015=Fact(U16),
        x1019=Fact(U8),
        x605A=Fact(I16, "rw", "1", True),
        **_options("1", "1", "0"),
        x6072=Fact(I16, "rw", "1000", True),
        x60C2_0=Fact(U8, "ro", "2"),
        x60C2_1=Fact(U8, "rw", "1"),
        x60C2_2=Fact(I8, "ro", "-3"),
        x6502=Fact(U32, "ro", "0x3CD"),
    ),
    _ALL_DUMMIES,
    states={"rated_torque": [0.5, 0.5]},
)
IPOS = RealDrive(
    "Technosoft iPOS",
    _but(
        0x1016,
        0x6076,
        x1000=Fact(U32, "ro", "0x00060192"),
        x1006=Fact(U32),
        x1014=Fact(U32, "rw", "$NODEID+0x80"),
        x6007=Fact(I16, "rww", "0"),
        **_options("0", "1", "2"),
        x607E=Fact(U8, "rww", "0", True),
        x6502=Fact(U32, "ro", "0x1F0065", True),
    ),
    refused_by=("6502h:00", "6076h:00"),
)
ISD860 = RealDrive(
    "Technosoft ISD860",
    {
        key: fact
        for key, fact in _but(
            0x1016, 0x6071, 0x6076, x1006=Fact(U32), x6060=Fact(I8, "wo", "", True), x6502=Fact(U32, "ro", "0x65", True)
        ).items()
        if not (key[0] in (0x1600, 0x1A00) and key[1] > 1)
    },
    refused_by=("6502h:00", "6071h:00", "1600h:02", "1A00h:02", "6076h:00"),
)
PRL120 = RealDrive(
    "Schunk PRL120",
    _but(0x6071, 0x6076, x1014=Fact(U32, "rw", "$NODEID+0x80"), **_CYCLE, x6502=Fact(U32, "ro", "0x60")),
    _ALL_DUMMIES,
    refused_by=("6502h:00", "6071h:00", "6076h:00"),
)
PRBT = RealDrive(
    "Pilz PRBT joint",
    _but(
        0x6071,
        0x6076,
        x1000=Fact(U32, "ro", ""),
        x1014=Fact(U32, "rw", "$NODEID+0x80"),
        **_CYCLE,
        x6060=Fact(I8, "rw", "7", True),
        x6502=Fact(U32, "ro", "0x43"),
    ),
    _ALL_DUMMIES,
    refused_by=("6502h:00", "6071h:00", "6076h:00"),
)
REAL_DRIVES = (EPOS4, EUSERVO, IPOS, ISD860, PRL120, PRBT)
