"""Every kind of event in words: how grave it is, what was measured, what causes it, what to do next.

Journal, `hil events`, summaries, pictures, monitor, telemetry and docs/faults.md take them from here, and those of each
fault from its row (hil/cycle/faults/).
"""

from enum import IntEnum
from typing import Final, NamedTuple

from hil.cycle.fault_table import ROWS, Fault, Reaction


class Severity(IntEnum):
    """Levels of syslog(3), which the journal takes as they are."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class Kind(IntEnum):
    """Number of a kind of event in telemetry and recordings (events.proto has the same). Those up to RIG_FILE and
    ACCURACY_LOST follow from the ticks' records alone, DRIVE, LAW and TIP from what the cycle says in words; the others
    are the sidecar's.
    """

    STATE = 1
    FAULT_SEEN = 2
    FAULT_LATCHED = 3
    FAULT_CLEARED = 4
    COMMAND = 5
    TICKS_LOST = 6
    TICK_LATE = 7
    BUS = 8
    RIG_FILE = 9
    REQUEST = 10
    RECORDER = 11
    SIDECAR = 12
    RECORDS_LOST = 13
    DRIVE = 14
    LAW = 15
    ACCURACY_LOST = 16
    TIP = 17


class KindText(NamedTuple):
    """text: what an event of this kind says has happened. measured, unit: what its value and limit are. action: what to
    do next. severity: of most events of the kind; of faults it follows from the reaction.
    """

    text: str
    severity: Severity
    measured: str = ""
    unit: str = ""
    cause: str = ""
    action: str = ""


KINDS: Final[dict[Kind, KindText]] = {
    Kind.STATE: KindText("state", Severity.NOTICE, action="none"),
    Kind.FAULT_SEEN: KindText("fault seen", Severity.WARNING),
    Kind.FAULT_LATCHED: KindText("fault latched", Severity.ERROR),
    Kind.FAULT_CLEARED: KindText("fault cleared", Severity.NOTICE, action="none: the rig may be activated again"),
    Kind.COMMAND: KindText("command", Severity.INFO, action="none"),
    Kind.TICKS_LOST: KindText(
        "ticks lost",
        Severity.WARNING,
        "slots skipped",
        "ticks",
        "the machine or the control process was held up",
        "hil doctor; the counters missed_own and missed_host say who held it up",
    ),
    Kind.TICK_LATE: KindText(
        "tick late",
        Severity.INFO,
        "start after the deadline",
        "s",
        "the machine woke the control process late",
        "hil doctor, if it happens often",
    ),
    Kind.BUS: KindText("bus", Severity.WARNING, cause="error frames", action="hil bus; check the cable"),
    Kind.RIG_FILE: KindText(
        "rig file",
        Severity.WARNING,
        cause="somebody wrote the rig file, or a file it names",
        action="restart the control process to take the new file, or put the old one back",
    ),
    Kind.REQUEST: KindText("request", Severity.INFO, action="none"),
    Kind.RECORDER: KindText(
        "recorder",
        Severity.WARNING,
        "write errors",
        "",
        "the disk is full or broken, or the directory is not writable",
        "make room or mend the disk: recording goes on by itself",
    ),
    Kind.SIDECAR: KindText("sidecar", Severity.NOTICE, action="none"),
    Kind.RECORDS_LOST: KindText(
        "records lost",
        Severity.WARNING,
        "ticks overwritten in the ring",
        "ticks",
        "the sidecar was held up longer than the ring lasts",
        "give the sidecar time or a longer telemetry.blackbox_s; what these ticks held is lost to the recording",
    ),
    Kind.DRIVE: KindText(
        "drive",
        Severity.WARNING,
        action="mend what the cause names, in the drive or in the rig file; switch the drive off and on, and reset",
    ),
    Kind.LAW: KindText(
        "law",
        Severity.ERROR,
        action="mend the law or the estimator where the cause says; hil check RIG --law or --estimator FILE tries it",
    ),
    Kind.TIP: KindText(
        "tip",
        Severity.ERROR,
        action="hil command NAME reset, then hil command NAME activate-hold, then hil move NAME AXIS=HEIGHT",
    ),
    Kind.ACCURACY_LOST: KindText(
        "accuracy lost",
        Severity.WARNING,
        cause="the axis is not as it was: its name says what it looks like",
        action="as the event says; the stage goes on",
    ),
}

REFUSED_ACTION: Final = "see the cause; docs/states.md says which state takes which command"


def severity_of(fault: Fault, *, latched: bool) -> Severity:
    """From the fault's reaction."""
    reaction = ROWS[fault].reaction
    if latched:
        return Severity.CRITICAL if reaction is Reaction.SILENT else Severity.ERROR
    return Severity.NOTICE if reaction is Reaction.COUNT else Severity.WARNING
