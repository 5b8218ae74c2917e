"""Reaction and states of every fault, written down a second time: a row changed by mistake turns a test red."""

from drivers.protocols.base import DriveStatus
from hil.cycle.fault_table import ROWS, Fault, Reaction
from hil.cycle.state_machine import State

MOVING = {State.HOMING, State.ACTIVE, State.STOPPING}
WATCHING = MOVING | {State.READY}
RESTING = {State.CONNECTED, State.READY, State.FAULT, State.ESTOP}
ALWAYS = set(State) - {State.BOOT, State.SHUTDOWN}

# The table's other two columns, once more.
EXPECTED: dict[Fault, tuple[Reaction, set[State]]] = {
    Fault.ENCODER_GAP: (Reaction.BRIDGE, MOVING),
    Fault.ENCODER_LOST: (Reaction.STOP, MOVING),
    Fault.ENCODER_DEAD: (Reaction.ZERO, WATCHING),
    Fault.BAD_FRAMES: (Reaction.ZERO, WATCHING),
    Fault.ENCODER_GLITCH: (Reaction.BRIDGE, MOVING),
    Fault.ENCODER_JUMP: (Reaction.ZERO, WATCHING),
    Fault.ENCODER_STUCK: (Reaction.ZERO, MOVING),
    Fault.FOLLOWING_ERROR: (Reaction.STOP, MOVING),
    Fault.TRAVEL_PLANNED: (Reaction.STOP, MOVING),
    Fault.TRAVEL: (Reaction.ZERO, MOVING),
    Fault.SPEED_PLANNED: (Reaction.STOP, MOVING),
    Fault.SPEED: (Reaction.ZERO, MOVING),
    Fault.NOT_FINITE: (Reaction.ZERO, MOVING),
    Fault.FILTER_DIVERGED: (Reaction.ZERO, MOVING),
    Fault.DRIVE_FAULT: (Reaction.ZERO, WATCHING),
    Fault.DRIVE_WATCHDOG: (Reaction.ZERO, WATCHING),
    Fault.DRIVE_DISABLED: (Reaction.ZERO, MOVING),
    Fault.ENABLE_TIMEOUT: (Reaction.ZERO, MOVING),
    Fault.ENCODER_FAULT: (Reaction.ZERO, WATCHING),
    Fault.BUS_PASSIVE: (Reaction.COUNT, ALWAYS),
    Fault.BUS_OFF: (Reaction.SILENT, ALWAYS),
    Fault.NO_ACK: (Reaction.SILENT, ALWAYS),
    Fault.TRANSMIT_REFUSED: (Reaction.COUNT, ALWAYS),
    Fault.TRANSMIT_BLOCKED: (Reaction.ZERO, ALWAYS),
    Fault.INTERFACE_DOWN: (Reaction.SILENT, ALWAYS),
    Fault.RECEIVE_FLOOD: (Reaction.STOP, ALWAYS),
    Fault.OVERRUN: (Reaction.COUNT, ALWAYS),
    Fault.OVERRUN_BURST: (Reaction.STOP, MOVING),
    Fault.OVERRUN_LONG: (Reaction.ZERO, MOVING),
    Fault.HEARTBEAT_LOST: (Reaction.STOP, MOVING),
    Fault.REALTIME_DENIED: (Reaction.COUNT, ALWAYS),
    Fault.RECORDER_LOST: (Reaction.COUNT, ALWAYS),
    Fault.RIG_CHANGED: (Reaction.COUNT, ALWAYS),
    Fault.DRIVE_STAYS_ENABLED: (Reaction.SILENT, RESTING),
    Fault.AXIS_NOT_AS_STATED: (Reaction.ZERO, MOVING),
    Fault.OSCILLATION: (Reaction.STOP, MOVING),
    Fault.LIMIT_SWITCH: (Reaction.STOP, WATCHING),
    Fault.FOREIGN_COMMAND: (Reaction.ZERO, ALWAYS),
    Fault.ANSWERS_DIFFER: (Reaction.ZERO, WATCHING),
    Fault.STAMP: (Reaction.ZERO, WATCHING),
    Fault.STAMP_GLITCH: (Reaction.BRIDGE, MOVING),
    Fault.STANDSTILL: (Reaction.ZERO, {State.READY, State.FAULT, State.ESTOP}),
    Fault.AXIS_MOVED: (Reaction.COUNT, {State.CONNECTED}),
    Fault.SENSOR_SILENT: (Reaction.STOP, MOVING),
    Fault.SENSOR_STUCK: (Reaction.STOP, MOVING),
    Fault.SENSOR_RANGE: (Reaction.STOP, MOVING),
    Fault.SENSOR_SEQUENCE: (Reaction.COUNT, MOVING),
    Fault.HOMING_FAILED: (Reaction.STOP, {State.HOMING}),
}
BITS = {  # a drive's status that is a fault by itself
    Fault.DRIVE_FAULT: DriveStatus.FAULT,
    Fault.DRIVE_WATCHDOG: DriveStatus.WATCHDOG,
    Fault.ENCODER_FAULT: DriveStatus.ENCODER_FAULT,
}
# A drive holds these, so they do not keep RESET from clearing them.
DRIVES_OWN = {fault for fault in ROWS if fault.name.startswith("DRIVE_")} | {
    *BITS,
    Fault.ENABLE_TIMEOUT,
    Fault.LIMIT_SWITCH,
}
