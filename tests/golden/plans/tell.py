"""Plans of CiA 402 drives, step by step.

Each drive is planned with settings that differ in one thing, or lacks one thing: what a line of profile.py decides is
in the text of some plan.
"""

import difflib
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

from drivers.eds.reader import Eds
from drivers.families.cia402.config import Cia402Config, ObjectValue
from drivers.families.cia402.drive_plan import Axis, DrivePlan
from drivers.families.cia402.profile import plan_drives
from tests.support.foreign_drive import CST_DRIVE, FULL_DRIVE, I16, U8, U16, U32, Fact, eds_text
from tests.support.real_drives import REAL_DRIVES, Facts

MS = 1_000_000
ALL_DUMMIES = (3, 6)
WHOLE = "full, one"


class Asked(NamedTuple):
    """Drives of one bus to be planned. axes: so many alike. settings: of [bus.cia402]."""

    facts: Facts
    axes: int = 1
    dummies: Sequence[int] = ()
    settings: Mapping[str, Any] = {}
    rated_force: float | None = 0.5
    period_ns: int = MS
    master_ms: int = 100
    eds: str = ""  # more of the file


def _with(**facts: Fact) -> Facts:
    """FULL_DRIVE with others: x6071, or x60C2_1 for a sub-index."""
    places = {name[1:].partition("_"): fact for name, fact in facts.items()}
    return FULL_DRIVE | {(int(index, 16), int(sub or "0", 16)): fact for (index, _, sub), fact in places.items()}


def _without(*indices: int) -> Facts:
    return {key: fact for key, fact in FULL_DRIVE.items() if key[0] not in indices}


@cache
def asked() -> dict[str, Asked]:
    """Every case, by name."""
    period = [ObjectValue(object="60C2h:01", value=3), ObjectValue(object="1029h:01", value=2)]
    fixed = {"x1A00_0": Fact(U8, "const", "2"), "x1A00_1": Fact(U32, "const", "0x60640020")}
    cases = {
        "full, one": Asked(FULL_DRIVE),
        "full, three that share": Asked(FULL_DRIVE, 3, ALL_DUMMIES),
        "full, three, no dummy of 16 bits with a sign": Asked(FULL_DRIVE, 3, (6,), {"rpdo": "shared"}),
        "full, three, own": Asked(FULL_DRIVE, 3, ALL_DUMMIES, {"rpdo": "own"}),
        "bare, two": Asked(CST_DRIVE, 2),
        "no counter asked for": Asked(FULL_DRIVE, settings={"sync_counter": "off"}),
        "a counter that is on": Asked(_with(x1019=Fact(U8, "rw", "240")), settings={"sync_counter": "off"}),
        "a counter that it cannot have": Asked(CST_DRIVE, settings={"sync_counter": "on"}),
        "stated torque": Asked(FULL_DRIVE, 2, settings={"rated_torque": [0.5, 0.25], "write_rated_torque": True}),
        "stated torque, compared": Asked(FULL_DRIVE, settings={"rated_torque": [0.1]}),
        "stated torque that 6076h cannot say": Asked(FULL_DRIVE, settings={"rated_torque": [0.0004]}),
        "torque written from the force": Asked(FULL_DRIVE, settings={"write_rated_torque": True}),
        "torque written, force unknown": Asked(FULL_DRIVE, settings={"write_rated_torque": True}, rated_force=None),
        "no 6076h, stated": Asked(_without(0x6076), settings={"rated_torque": [0.5]}),
        "no 6076h": Asked(_without(0x6076)),
        "just as much as 6071h can say": Asked(FULL_DRIVE, settings={"rated_torque": [1.0]}, rated_force=32.767),
        "more than 6071h can say": Asked(FULL_DRIVE, settings={"rated_torque": [1.0]}, rated_force=32.7681),
        "options kept": Asked(FULL_DRIVE, settings={"stop_options": "keep"}),
        "objects stated": Asked(FULL_DRIVE, settings={"write": period}),
        "a sign stated": Asked(FULL_DRIVE, settings={"write": [ObjectValue(object="607Eh", value=0x80)]}),
        "an object stated that is not there": Asked(
            CST_DRIVE, settings={"write": [ObjectValue(object="1029h:01", value=1)]}
        ),
        "silence that 1016h cannot say": Asked(FULL_DRIVE, master_ms=70_000),
        "a TPDO mapping that is fixed and right": Asked(_with(**fixed, x1A00_2=Fact(U32, "const", "0x60410010"))),
        "a TPDO mapping that is fixed and wrong": Asked(_with(**fixed, x1A00_2=Fact(U32, "const", "0x60400010"))),
        "a mapping that is not there": Asked(_without(0x1A00)),
        "RPDOs that are not there": Asked(_without(0x1400, 0x1401)),
        "SYNC produced by the drive": Asked(_with(x1005=Fact(U32, "rw", "0x40000080"))),
        "SYNC elsewhere, read-only": Asked(_with(x1005=Fact(U32, "ro", "0x81"))),
        "no SYNC object": Asked(_without(0x1005)),
        "emergencies that are off and fixed": Asked(_with(x1014=Fact(U32, "ro", "0x80000081"))),
        "emergencies elsewhere, fixed": Asked(_with(x1014=Fact(U32, "const", "0x000000A5"))),
        "no heartbeat to watch": Asked(_without(0x1016)),
        "no heartbeat of its own": Asked(_with(x1017=Fact(U16, "ro", "100"))),
        "more TPDOs, some on": Asked(
            _with(x1802_1=Fact(U32, "rw", "0x281"), x1807_1=Fact(U32, "rw", "0x80000481"), x1808_1=Fact(U32, "rw", "1"))
        ),
        "a TPDO for remote frames too": Asked(_with(x1800_1=Fact(U32, "rw", "$NODEID+0x180"))),
        "a profile of another kind": Asked(_with(x1000=Fact(U32, "ro", "0x00020191"))),
        "no drive at all": Asked({(0x1000, 0): Fact(U32, "ro", "0x00020191"), (0x1001, 0): Fact(U8, "ro")}),
        "no drive, but with a controlword": Asked(
            {(0x1000, 0): Fact(U32, "ro", "0x00020191"), (0x6040, 0): Fact(U16, "rw", "0", True)}
        ),
        "no profile said": Asked(_with(x1000=Fact(U32, "ro", ""))),
        "modes of every kind but CST": Asked(_with(x6502=Fact(U32, "ro", "0x5FF"))),
        "no modes said": Asked(_with(x6502=Fact(U32, "ro", ""))),
        "no mode at all": Asked(_with(x6502=Fact(U32, "ro", "0"))),
        "words that do not fit": Asked(_with(x6071=Fact(U8, "rw", "0", True), x6041=Fact(U16, "ro", "0", False))),
        "numbers out of range": Asked(FULL_DRIVE, eds="[605C]\nParameterName=p\nObjectType=0x7\nDataType=0x0003\n"
                                      "AccessType=rw\nLowLimit=1\nHighLimit=3\n"),
        "a mode that is too wide": Asked(_with(x6060=Fact(0x2, "rw", "1"), x1019=Fact(0x9, "rw", ""))),
        "a limit of one byte": Asked(_with(x6072=Fact(U8, "rw", "0"), x1006=Fact(I16, "rw", "0"))),
        "a broken entry": Asked(_without(0x6071), eds="[6071]\nObjectType=0x7\nDataType=torque\nAccessType=rw\n"),
    }  # fmt: skip
    for period_ns in (0, 125_000, 250_000, 255_000, 256_000, 1_000, 2_000_000, 20_000_000, 333_333, 1_000_000_000):
        cases[f"a period of {period_ns} ns"] = Asked(FULL_DRIVE, period_ns=period_ns)
    cases["a period of 333333 ns, bare"] = Asked(CST_DRIVE, period_ns=333_333)
    for real in REAL_DRIVES:
        cases[real.name] = Asked(real.facts, 2, real.dummies, dict(real.states))
    return cases


def plans(case: Asked) -> list[DrivePlan]:
    """As the host makes them: nodes 5, 6, ... of a bus whose first is 5."""
    axes = [
        Axis(number, case.axes, 5 + number, 5, case.rated_force, case.period_ns, case.master_ms)
        for number in range(case.axes)
    ]
    drives = [Eds(eds_text(case.facts, case.dummies) + case.eds, axis.node_id) for axis in axes]
    return plan_drives(drives, axes, Cia402Config.model_validate({"eds": ["made.eds"], **case.settings}))


def text_of(plan: DrivePlan) -> list[str]:
    """All that a plan says."""
    shown = f"{plan.name}: mode {plan.mode or '-'}, shared {plan.shared}, counter {plan.counter}"
    lines = [f"{shown}, unit {plan.unit}, limit {plan.limit}, emergencies at {plan.emcy_id:#x}"]
    lines.append(f"offers {' '.join(plan.offers)}")
    for step, need, why, skipped in plan.planned:
        place = f"{step.object_index:04X}:{step.subindex:02X}"
        deed = f"write {step.value:#x} in {step.size}" if step.size else f"read {step.value:#x} of {step.mask:#x}"
        lines.append(f"{place} {deed}, {step.width} bytes, {need}: {why}{f' | {skipped}' if skipped else ''}")
        assert step.required is (need != "optional")
    lines += [f"refused: {reason.object} {reason.text} | {reason.remedy}" for reason in plan.reasons]
    return lines + [f"warning: {warning}" for warning in plan.warnings]


def stories() -> list[str]:
    """Their names."""
    return list(asked())


def tell(story: str) -> list[str]:
    """The plan of every axis: WHOLE as it is, of the others the lines that stand in place of which of its own."""
    return [
        f"axis {at}: {line}"
        for at, plan in enumerate(plans(asked()[story]))
        for line in (text_of(plan) if story == WHOLE else _instead(_whole(), text_of(plan)))
    ]


@cache
def _whole() -> list[str]:
    return text_of(plans(asked()[WHOLE])[0])


def _instead(whole: list[str], lines: list[str]) -> list[str]:
    changed = list(difflib.unified_diff(whole, lines, n=0, lineterm=""))[2:]
    return [line for line in changed if not line.startswith("-")]
