"""Every kind of event and every fault in words: how grave it is, what was measured, what causes it, what to do next.

The one place for these texts: journal, `hil events`, summaries, pictures, monitor, telemetry and docs/faults.md take
them from here. How a fault is detected and what the cycle does about it: fault_table.py.
"""

from enum import IntEnum
from typing import Final, NamedTuple

from hil.cycle.fault_table import RULES, Fault, Reaction


class Severity(IntEnum):
    """Levels of syslog(3), which the journal takes as they are."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class Kind(IntEnum):
    """Number of a kind of event in telemetry and recordings (events.proto has the same). Those up to RIG_FILE follow
    from the ticks' records alone, DRIVE and LAW from what the cycle says in words; the others are the sidecar's.
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
    Kind.BUS: KindText("bus", Severity.WARNING, "controller state", "", "error frames", "hil bus; check the cable"),
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
}

REFUSED_ACTION: Final = "see the cause; docs/states.md says which state takes which command"


class FaultText(NamedTuple):
    """measured, unit: what an event's value and limit are. cause: what usually brings the fault about. action: what to
    do next. "m" and "N" stand for rad and N m where the axis is rotary.
    """

    measured: str
    unit: str
    cause: str
    action: str


_RESET = "then hil command NAME reset"
_SILENT = "no answer came: the drive is off, its cable is loose, or the bus is overloaded"
_CABLE = "check the drive's supply and its cable"
_BUS = "bus states: 0 active, 1 passive, 2 off, 3 down"
_LOAD = "another process or the hypervisor held the control process up"

FAULT_TEXTS: Final[dict[Fault, FaultText]] = {
    Fault.ENCODER_GAP: FaultText("age of the axis' sample", "ticks", _SILENT, "none, if it is rare; else check cables"),
    Fault.ENCODER_LOST: FaultText("age of the axis' sample", "ticks", _SILENT, f"{_CABLE}, {_RESET}"),
    Fault.ENCODER_DEAD: FaultText("age of the axis' sample", "ticks", _SILENT, f"{_CABLE}, {_RESET}"),
    Fault.BAD_FRAMES: FaultText(
        "damaged or unexpected frames in the leaky bucket",
        "frames",
        "a drive of another layout, two nodes of one identifier, or damage in a gateway",
        f"hil bus shows the frames; check bus.protocol and identifiers, {_RESET}",
    ),
    Fault.ENCODER_GLITCH: FaultText(
        "step from the last trusted sample", "m", "electrical noise at the encoder", "none, if it is rare"
    ),
    Fault.ENCODER_JUMP: FaultText(
        "step from the last trusted sample",
        "m",
        "the encoder lost counts, its head is loose, or the drive was restarted",
        f"check the encoder's cable and head, home the axis, {_RESET}",
    ),
    Fault.ENCODER_STUCK: FaultText(
        "ticks of high force without one count of motion",
        "ticks",
        "the axis is blocked, or the encoder shows an old value",
        f"move the axis by hand and watch its position in hil monitor, {_RESET}",
    ),
    Fault.FOLLOWING_ERROR: FaultText(
        "|position - setpoint|",
        "m",
        "the axis is blocked or overloaded, or the law is not tuned for it",
        f"free the axis; hil check and hil tune for the law, {_RESET}",
    ),
    Fault.TRAVEL_PLANNED: FaultText(
        "setpoint, or where the axis would come to rest",
        "m",
        "the task leaves the travel, or the axis is too fast near its end",
        f"change the task or axes.AXIS.limits.position, {_RESET}",
    ),
    Fault.TRAVEL: FaultText(
        "measured position",
        "m",
        "the axis was pushed, or overshot the end of its travel",
        f"move the axis back inside by hand, {_RESET}",
    ),
    Fault.SPEED_PLANNED: FaultText(
        "setpoint speed", "m/s", "the task is too fast", f"slow the task or raise axes.AXIS.limits.speed, {_RESET}"
    ),
    Fault.SPEED: FaultText(
        "estimated speed", "m/s", "the axis runs away: wrong direction, wrong force constant", f"hil check, {_RESET}"
    ),
    Fault.NOT_FINITE: FaultText(
        "what was no finite number: the law's request, or the filter's innovation",
        "",
        "the law divides by zero or overflows, or it failed, or an estimator of users did",
        f"the journal has the failure; mend the law, its gains or the estimator, {_RESET}",
    ),
    Fault.FILTER_DIVERGED: FaultText(
        "|innovation|",
        "m",
        "the nominal model is far from the axis: mass, friction or force constant",
        f"compare [axes.AXIS.model] with the stage, {_RESET}",
    ),
    Fault.DRIVE_FAULT: FaultText("fault bit", "", "the drive found a fault", f"read the drive's own log, {_RESET}"),
    Fault.DRIVE_WATCHDOG: FaultText(
        "watchdog bit", "", "the drive heard no command for drives.watchdog_s", f"see the events before it, {_RESET}"
    ),
    Fault.DRIVE_DISABLED: FaultText(
        "enabled bit", "", "the drive switched itself off: its own limit, its stop input", f"{_CABLE}, {_RESET}"
    ),
    Fault.ENABLE_TIMEOUT: FaultText(
        "wait for the enabled bit",
        "ticks",
        "the drive refuses to be enabled: supply, stop input, a fault of its own",
        f"hil monitor shows the drive's state; hil drives its demands, {_RESET}",
    ),
    Fault.ENCODER_FAULT: FaultText(
        "encoder fault bit", "", "the drive cannot read its encoder", f"check the encoder's cable, {_RESET}"
    ),
    Fault.BUS_PASSIVE: FaultText(
        f"controller state ({_BUS})", "", "many errors on the bus: termination, bit rate, a bad cable", "check the bus"
    ),
    Fault.BUS_OFF: FaultText(
        f"controller state ({_BUS})",
        "",
        "too many of our frames failed: a short circuit, or another bit rate",
        f"check cable and bit rate, {_RESET}",
    ),
    Fault.NO_ACK: FaultText(
        "ticks in which nobody acknowledged",
        "ticks",
        "no other node is on the bus: drives without power, cable unplugged",
        f"{_CABLE}, {_RESET}",
    ),
    Fault.TRANSMIT_REFUSED: FaultText(
        "frames refused", "frames", "the transmit queue is full: the bus is busy or stuck", "hil bus, if it goes on"
    ),
    Fault.TRANSMIT_BLOCKED: FaultText(
        "ticks in which frames were refused",
        "ticks",
        "the transmit queue stays full: the bus is busy or stuck",
        f"hil bus shows who talks, {_RESET}",
    ),
    Fault.INTERFACE_DOWN: FaultText(
        f"controller state ({_BUS})",
        "",
        "the CAN interface was set down or unplugged",
        f"plug it in or set it up (ip link), {_RESET}",
    ),
    Fault.RECEIVE_FLOOD: FaultText(
        "frames of no use, or lost to an overflow",
        "frames",
        "another node sends far more than it should",
        f"hil bus shows who talks; take it off the bus, {_RESET}",
    ),
    Fault.OVERRUN: FaultText("slots skipped", "ticks", _LOAD, "none, if it is rare; else hil doctor"),
    Fault.OVERRUN_BURST: FaultText("ticks in a row that skipped slots", "ticks", _LOAD, f"hil doctor, {_RESET}"),
    Fault.OVERRUN_LONG: FaultText("time between two ticks", "s", _LOAD, f"hil doctor, {_RESET}"),
    Fault.HEARTBEAT_LOST: FaultText(
        "age of the operator's heartbeat",
        "s",
        "the operator's program ended or lost its connection",
        f"start it again, {_RESET}",
    ),
    Fault.REALTIME_DENIED: FaultText(
        "real time granted", "", "the kernel refused what [timing] asks for", "hil doctor says what to grant"
    ),
    Fault.RECORDER_LOST: FaultText(
        "recorder alive", "", "the sidecar is not running, or cannot write", "start hil sidecar; look at its disk"
    ),
    Fault.RIG_CHANGED: FaultText(
        "rig file as it was read",
        "",
        "somebody wrote the rig file, or a file it names",
        "restart the control process to take the new file, or put the old one back",
    ),
    Fault.DRIVE_STAYS_ENABLED: FaultText(
        "ticks a drive said it is enabled although told otherwise",
        "ticks",
        "the drive does not obey: its brake is open",
        f"cut the drive's power, {_RESET}",
    ),
    Fault.OSCILLATION: FaultText(
        "amplitude of the following error's swing",
        "m",
        "the loop is at the edge of stability: gains too high, or a mode nobody modelled",
        f"hil check, lower the gains, {_RESET}",
    ),
    Fault.AXIS_NOT_AS_STATED: FaultText(
        "motion in the commissioning push",
        "m",
        "the axis is mounted the other way round, blocked, or not as heavy as stated",
        f"check axes.AXIS.direction, rated_force and model, {_RESET}",
    ),
}
GRANTS: Final = frozenset({Fault.REALTIME_DENIED, Fault.RECORDER_LOST, Fault.RIG_CHANGED})  # there (1) or not (0)


def severity_of(fault: Fault, *, latched: bool) -> Severity:
    """From the fault's reaction."""
    reaction = RULES[fault].reaction
    if latched:
        return Severity.CRITICAL if reaction is Reaction.SILENT else Severity.ERROR
    return Severity.NOTICE if reaction is Reaction.COUNT else Severity.WARNING
