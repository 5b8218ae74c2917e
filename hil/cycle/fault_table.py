"""Every fault: how it is detected, after how many ticks, in which states it is armed, and the reaction to it."""

from enum import IntEnum
from typing import NamedTuple

from hil.cycle.state_machine import TORQUE_STATES, State


class Reaction(IntEnum):
    """In order of severity."""

    COUNT = 0
    BRIDGE = 1
    STOP = 2
    ZERO = 3
    SILENT = 4


class Fault(IntEnum):
    """Number of a fault in records and telemetry; 0 is none."""

    NONE = 0
    ENCODER_GAP = 1
    ENCODER_LOST = 2
    ENCODER_DEAD = 3
    BAD_FRAMES = 4
    ENCODER_GLITCH = 5
    ENCODER_JUMP = 6
    ENCODER_STUCK = 7
    FOLLOWING_ERROR = 8
    TRAVEL_PLANNED = 9
    TRAVEL = 10
    SPEED_PLANNED = 11
    SPEED = 12
    NOT_FINITE = 13
    FILTER_DIVERGED = 14
    DRIVE_FAULT = 15
    DRIVE_WATCHDOG = 16
    DRIVE_DISABLED = 17
    ENABLE_TIMEOUT = 18
    ENCODER_FAULT = 19
    BUS_PASSIVE = 20
    BUS_OFF = 21
    NO_ACK = 22
    TRANSMIT_REFUSED = 23
    TRANSMIT_BLOCKED = 24
    INTERFACE_DOWN = 25
    RECEIVE_FLOOD = 26
    OVERRUN = 27
    OVERRUN_BURST = 28
    OVERRUN_LONG = 29
    HEARTBEAT_LOST = 30
    REALTIME_DENIED = 31
    RECORDER_LOST = 32
    RIG_CHANGED = 33
    DRIVE_STAYS_ENABLED = 34
    AXIS_NOT_AS_STATED = 35
    OSCILLATION = 36


MOVING = TORQUE_STATES


WATCHING = frozenset({State.READY, *MOVING})


RESTING = frozenset({State.CONNECTED, State.READY, State.FAULT, State.ESTOP})


ALWAYS = frozenset(State) - {State.BOOT, State.SHUTDOWN}


class Rule(NamedTuple):
    """seen_by, after: for people. states: where the detector is armed. drive_latched: the drive holds it, so it does
    not keep RESET from clearing it.
    """

    seen_by: str
    after: str
    reaction: Reaction
    states: frozenset[State]
    drive_latched: bool = False


RULES: dict[Fault, Rule] = {
    Fault.ENCODER_GAP: Rule("no answer to the latest command", "1 tick", Reaction.BRIDGE, MOVING),
    Fault.ENCODER_LOST: Rule("the same", "safety.silent_stop_ticks (3)", Reaction.STOP, MOVING),
    Fault.ENCODER_DEAD: Rule("the same", "safety.silent_zero_ticks (10)", Reaction.ZERO, WATCHING),
    Fault.BAD_FRAMES: Rule(
        "sequence, checksum, length; leaky bucket", "safety.bad_frame_limit (5)", Reaction.ZERO, WATCHING
    ),
    Fault.ENCODER_GLITCH: Rule(
        "step beyond the speed bound; the sample is discarded", "1 sample", Reaction.BRIDGE, MOVING
    ),
    Fault.ENCODER_JUMP: Rule("the same", "2 samples in a row", Reaction.ZERO, WATCHING),
    Fault.ENCODER_STUCK: Rule("high force, not one count of motion", "safety.stuck_ticks (50)", Reaction.ZERO, MOVING),
    Fault.FOLLOWING_ERROR: Rule(
        "|position - setpoint| beyond a limit that grows with speed", "1 tick", Reaction.STOP, MOVING
    ),
    Fault.TRAVEL_PLANNED: Rule(
        "setpoint, or position plus stopping distance, outside the travel", "1 tick", Reaction.STOP, MOVING
    ),
    Fault.TRAVEL: Rule("measured position outside the travel", "1 tick", Reaction.ZERO, MOVING),
    Fault.SPEED_PLANNED: Rule("setpoint speed above the limit", "1 tick", Reaction.STOP, MOVING),
    Fault.SPEED: Rule("estimated speed above the limit", "1 tick", Reaction.ZERO, MOVING),
    Fault.NOT_FINITE: Rule("NaN or infinity in the law's request or the filter", "1 tick", Reaction.ZERO, MOVING),
    Fault.FILTER_DIVERGED: Rule(
        "normalised innovation squared", "safety.nis_ticks (20) in a row", Reaction.ZERO, MOVING
    ),
    Fault.DRIVE_FAULT: Rule("status bit", "1 tick", Reaction.ZERO, WATCHING, True),
    Fault.DRIVE_WATCHDOG: Rule("status bit", "1 tick", Reaction.ZERO, WATCHING, True),
    Fault.DRIVE_DISABLED: Rule("status bit gone after it was set", "1 tick", Reaction.ZERO, MOVING, True),
    Fault.ENABLE_TIMEOUT: Rule(
        "status bit not set after activation", "safety.enable_timeout_ticks (500)", Reaction.ZERO, MOVING, True
    ),
    Fault.ENCODER_FAULT: Rule("status bit", "1 tick", Reaction.ZERO, WATCHING, True),
    Fault.BUS_PASSIVE: Rule("error frames", "1 tick", Reaction.COUNT, ALWAYS),
    Fault.BUS_OFF: Rule("error frames", "1 tick", Reaction.SILENT, ALWAYS),
    Fault.NO_ACK: Rule("error frames", "2 ticks in a row", Reaction.SILENT, ALWAYS),
    Fault.TRANSMIT_REFUSED: Rule("ENOBUFS, EAGAIN; newest wins, nothing is retried", "1 frame", Reaction.COUNT, ALWAYS),
    Fault.TRANSMIT_BLOCKED: Rule("the same", "safety.transmit_refused_limit (3) ticks in a row", Reaction.ZERO, ALWAYS),
    Fault.INTERFACE_DOWN: Rule("ENETDOWN, ENODEV", "1 tick", Reaction.SILENT, ALWAYS),
    Fault.RECEIVE_FLOOD: Rule(
        "frames of no use per tick, overflow counter", "safety.flood_frames (12)", Reaction.STOP, ALWAYS
    ),
    Fault.OVERRUN: Rule("a slot was skipped", "1 slot", Reaction.COUNT, ALWAYS),
    Fault.OVERRUN_BURST: Rule("the same", "safety.overrun_streak (5) ticks in a row", Reaction.STOP, MOVING),
    Fault.OVERRUN_LONG: Rule("time between two ticks", "safety.overrun_zero_s (20 ms)", Reaction.ZERO, MOVING),
    Fault.HEARTBEAT_LOST: Rule(
        "age of the operator's heartbeat", "safety.heartbeat_s, when not 0", Reaction.STOP, MOVING
    ),
    Fault.REALTIME_DENIED: Rule(
        "what the kernel granted", "at start; ACTIVATE is refused unless timing.allow_degraded", Reaction.COUNT, ALWAYS
    ),
    Fault.RECORDER_LOST: Rule(
        "the sidecar's heartbeat", "ACTIVATE is refused if telemetry.recording_required", Reaction.COUNT, ALWAYS
    ),
    Fault.RIG_CHANGED: Rule("hash of the rig file", "ACTIVATE is refused", Reaction.COUNT, ALWAYS),
    Fault.DRIVE_STAYS_ENABLED: Rule(
        "status bit set although no torque is permitted: its brake is open; only its watchdog is left",
        "safety.disable_timeout_ticks (50) in a row",
        Reaction.SILENT,
        RESTING,
        True,
    ),
    Fault.AXIS_NOT_AS_STATED: Rule(
        "the commissioning push moved the axis the wrong way, too far or too little ([axes.NAME.push])",
        "a push",
        Reaction.ZERO,
        MOVING,
    ),
    Fault.OSCILLATION: Rule(
        "the following error swings to and fro without fading, 5 Hz to half the rate, by limits.oscillation",
        "3 swings",
        Reaction.STOP,
        MOVING,
    ),
}
