"""The fixed-size record of one tick: what the control process leaves in the ring, and all that replay needs.

Little-endian, SI units, RECORD_SIZE bytes. Per-axis arrays have MAX_AXES places; those beyond the rig's axes are zero.
"""

from typing import Final

import numpy as np

from drivers.protocols.base import MOST_SENT
from drivers.sensors.config import MAX_SENSORS
from hil.cycle.goal import MOST_GOALS
from hil.rig.schema import MAX_AXES

MAX_RECEIVED: Final = 32
MAX_SENT: Final = MOST_SENT
MAX_COMMANDS: Final = 4
MAX_EVIDENCE: Final = 8
MAX_READINGS: Final = MAX_SENSORS
NO_AXIS: Final = -1  # of evidence that belongs to no axis
EVERY_AXIS: Final = 0xFFFF  # the same as a record has it
REJECT_REASONS = 10  # drivers.protocols.base.Reject

_AXES = (MAX_AXES,)

FRAME = np.dtype(
    [
        ("timestamp_ns", "<i8"),
        ("can_id", "<u4"),
        ("length", "u1"),
        ("flags", "u1"),
        ("reserved", "<u2"),
        ("data", "u1", 64),
    ]
)  # 80 bytes
GOAL = np.dtype(
    [
        ("number", "<u4"),
        ("kind", "u1"),  # hil.cycle.goal.GoalKind
        ("mask", "u1"),
        ("flags", "<u2"),
        ("due_ns", "<i8"),
        ("valid_ns", "<i8"),
        ("position", "<f8", (4,)),
        ("velocity", "<f8", (4,)),
        ("speed", "<f8"),
        ("lease", "<u4"),
        ("refusal", "<u4"),  # hil.cycle.goal.Refusal
        ("reserved", "<u8"),
    ]
)  # 112 bytes
COMMAND = np.dtype([("kind", "<u4"), ("accepted", "<u4"), ("sequence", "<u8"), ("expires_ns", "<i8")])

_FIELDS = [
    # the tick
    ("index", "<i8"),
    ("scheduled_ns", "<i8"),
    ("now_ns", "<i8"),
    ("state", "<u4"),  # hil.cycle.state_machine.State
    ("fault", "<u4"),  # hil.cycle.fault_monitor.Fault that latched, 0: none
    ("faults_active", "<u8"),  # bit f set: detector f fires in this tick
    ("flags", "<u4"),  # bit 0 stop, 1 recorder_ok, 2 realtime_ok, 3 rig_ok, 4 sending, 5 estop
    ("sequence", "<u4"),
    ("task_ns", "<i8"),  # time on the task's clock; -1: no task runs
    # per axis
    ("position", "<f8", _AXES),  # measured, m
    ("position_estimate", "<f8", _AXES),
    ("velocity_estimate", "<f8", _AXES),
    ("disturbance_estimate", "<f8", _AXES),
    ("innovation", "<f8", _AXES),
    ("setpoint_position", "<f8", _AXES),  # at the sample's time stamp
    ("setpoint_velocity", "<f8", _AXES),
    ("following_error", "<f8", _AXES),  # position - setpoint_position, both at the sample's time stamp
    ("force_requested", "<f8", _AXES),  # by the law
    ("force", "<f8", _AXES),  # applied, as the gate let it pass
    ("stamp_ns", "<i8", _AXES),
    ("age_ticks", "<u4", _AXES),  # since the last accepted sample
    ("drive_status", "<u4", _AXES),
    # counters, cumulative
    ("port", "<u8", (12,)),  # hil.cycle.tick.PortCounters, state last
    ("rejects", "<u8", (REJECT_REASONS,)),
    ("samples_lost", "<u8"),
    ("missed_own", "<u8"),
    ("missed_host", "<u8"),
    ("longest_streak", "<u8"),
    ("illegal_events", "<u8"),
    ("commands_refused", "<u8"),
    ("law_floors", "<u8"),  # denominators floored by the law
    ("evidence_total", "<u8"),  # of all ticks, what is beyond MAX_EVIDENCE in one included
    ("saturations", "<u8", _AXES),  # ticks in which the gate clamped or rate-limited
    # of the previous tick, written by the shell: ns of CPU per stage, and of run delay
    ("cpu_ns", "<u4", (5,)),  # read, estimate, control, gate, send
    ("run_delay_ns", "<u4"),
    # everything replay needs
    ("n_commands", "<u2"),
    ("n_received", "<u2"),
    ("n_sent", "<u2"),
    ("n_evidence", "<u2"),  # in this tick; the gravest MAX_EVIDENCE of them are kept
    ("commands", COMMAND, (MAX_COMMANDS,)),
    # what the detectors measured of the faults they flagged
    ("evidence_of", "<u4", (MAX_EVIDENCE,)),  # fault, and from bit 16 the axis; EVERY_AXIS: no axis
    ("evidence_value", "<f8", (MAX_EVIDENCE,)),
    ("evidence_limit", "<f8", (MAX_EVIDENCE,)),
    # goals (hil.cycle.goal), and what they and the task have come to
    ("motion", "u1"),  # MotionWord
    ("homing", "u1"),  # hil.cycle.axis_homing.Step in HOMING, else 0; from bit 4 on the axes that are yet to be homed
    ("outputs", "u1"),  # bit i: output i is set
    ("n_goals", "u1"),
    ("phase", "<u2"),  # of a cell
    ("reserved", "<u2"),
    ("cell", "<u4"),
    ("lease", "<u4"),
    ("goal_number", "<u4"),  # of the goal accepted last
    ("limited", "<u4"),  # knots brought within the limits, so far
    ("superseded", "<u4"),  # goals without effect as a newer one came with them
    ("goals_refused", "<u4"),
    ("readings", "<f8", (MAX_READINGS,)),
    ("reading_age", "<u2", (MAX_READINGS,)),  # ticks
    ("goals", GOAL, (MOST_GOALS,)),
    ("sent", FRAME, (MAX_SENT,)),
    ("received", FRAME, (MAX_RECEIVED,)),
]

_USED = np.dtype(_FIELDS).itemsize
RECORD_SIZE: Final = 5376
RECORD = np.dtype([*_FIELDS, ("padding", "u1", RECORD_SIZE - _USED)])

MOTION_FIELDS = (
    "position",
    "position_estimate",
    "velocity_estimate",
    "disturbance_estimate",
    "innovation",
    "setpoint_position",
    "setpoint_velocity",
    "following_error",
    "force_requested",
    "force",
)
