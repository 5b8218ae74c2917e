from hil.telemetry import events_pb2 as _events_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Counters(_message.Message):
    __slots__ = ("received", "sent", "refused", "overflow", "discarded", "bus_errors", "samples_lost", "missed_own", "missed_host", "longest_streak", "illegal_events", "commands_refused", "law_floors", "saturations", "rejects", "bus_state")
    RECEIVED_FIELD_NUMBER: _ClassVar[int]
    SENT_FIELD_NUMBER: _ClassVar[int]
    REFUSED_FIELD_NUMBER: _ClassVar[int]
    OVERFLOW_FIELD_NUMBER: _ClassVar[int]
    DISCARDED_FIELD_NUMBER: _ClassVar[int]
    BUS_ERRORS_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_LOST_FIELD_NUMBER: _ClassVar[int]
    MISSED_OWN_FIELD_NUMBER: _ClassVar[int]
    MISSED_HOST_FIELD_NUMBER: _ClassVar[int]
    LONGEST_STREAK_FIELD_NUMBER: _ClassVar[int]
    ILLEGAL_EVENTS_FIELD_NUMBER: _ClassVar[int]
    COMMANDS_REFUSED_FIELD_NUMBER: _ClassVar[int]
    LAW_FLOORS_FIELD_NUMBER: _ClassVar[int]
    SATURATIONS_FIELD_NUMBER: _ClassVar[int]
    REJECTS_FIELD_NUMBER: _ClassVar[int]
    BUS_STATE_FIELD_NUMBER: _ClassVar[int]
    received: int
    sent: int
    refused: int
    overflow: int
    discarded: int
    bus_errors: int
    samples_lost: int
    missed_own: int
    missed_host: int
    longest_streak: int
    illegal_events: int
    commands_refused: int
    law_floors: int
    saturations: _containers.RepeatedScalarFieldContainer[int]
    rejects: _containers.RepeatedScalarFieldContainer[int]
    bus_state: int
    def __init__(self, received: _Optional[int] = ..., sent: _Optional[int] = ..., refused: _Optional[int] = ..., overflow: _Optional[int] = ..., discarded: _Optional[int] = ..., bus_errors: _Optional[int] = ..., samples_lost: _Optional[int] = ..., missed_own: _Optional[int] = ..., missed_host: _Optional[int] = ..., longest_streak: _Optional[int] = ..., illegal_events: _Optional[int] = ..., commands_refused: _Optional[int] = ..., law_floors: _Optional[int] = ..., saturations: _Optional[_Iterable[int]] = ..., rejects: _Optional[_Iterable[int]] = ..., bus_state: _Optional[int] = ...) -> None: ...

class Cycle(_message.Message):
    __slots__ = ("first", "lost", "index", "scheduled_ns", "lateness_ns", "flags", "port", "received_count", "sent_count", "command_count", "received", "sent", "commands", "cpu_ns", "run_delay_ns", "counters", "goal_count", "goals")
    FIRST_FIELD_NUMBER: _ClassVar[int]
    LOST_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    SCHEDULED_NS_FIELD_NUMBER: _ClassVar[int]
    LATENESS_NS_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    PORT_FIELD_NUMBER: _ClassVar[int]
    RECEIVED_COUNT_FIELD_NUMBER: _ClassVar[int]
    SENT_COUNT_FIELD_NUMBER: _ClassVar[int]
    COMMAND_COUNT_FIELD_NUMBER: _ClassVar[int]
    RECEIVED_FIELD_NUMBER: _ClassVar[int]
    SENT_FIELD_NUMBER: _ClassVar[int]
    COMMANDS_FIELD_NUMBER: _ClassVar[int]
    CPU_NS_FIELD_NUMBER: _ClassVar[int]
    RUN_DELAY_NS_FIELD_NUMBER: _ClassVar[int]
    COUNTERS_FIELD_NUMBER: _ClassVar[int]
    GOAL_COUNT_FIELD_NUMBER: _ClassVar[int]
    GOALS_FIELD_NUMBER: _ClassVar[int]
    first: int
    lost: int
    index: _containers.RepeatedScalarFieldContainer[int]
    scheduled_ns: _containers.RepeatedScalarFieldContainer[int]
    lateness_ns: _containers.RepeatedScalarFieldContainer[int]
    flags: _containers.RepeatedScalarFieldContainer[int]
    port: _containers.RepeatedScalarFieldContainer[int]
    received_count: _containers.RepeatedScalarFieldContainer[int]
    sent_count: _containers.RepeatedScalarFieldContainer[int]
    command_count: _containers.RepeatedScalarFieldContainer[int]
    received: FrameColumns
    sent: FrameColumns
    commands: _containers.RepeatedCompositeFieldContainer[Command]
    cpu_ns: _containers.RepeatedScalarFieldContainer[int]
    run_delay_ns: _containers.RepeatedScalarFieldContainer[int]
    counters: Counters
    goal_count: _containers.RepeatedScalarFieldContainer[int]
    goals: _containers.RepeatedCompositeFieldContainer[TakenGoal]
    def __init__(self, first: _Optional[int] = ..., lost: _Optional[int] = ..., index: _Optional[_Iterable[int]] = ..., scheduled_ns: _Optional[_Iterable[int]] = ..., lateness_ns: _Optional[_Iterable[int]] = ..., flags: _Optional[_Iterable[int]] = ..., port: _Optional[_Iterable[int]] = ..., received_count: _Optional[_Iterable[int]] = ..., sent_count: _Optional[_Iterable[int]] = ..., command_count: _Optional[_Iterable[int]] = ..., received: _Optional[_Union[FrameColumns, _Mapping]] = ..., sent: _Optional[_Union[FrameColumns, _Mapping]] = ..., commands: _Optional[_Iterable[_Union[Command, _Mapping]]] = ..., cpu_ns: _Optional[_Iterable[int]] = ..., run_delay_ns: _Optional[_Iterable[int]] = ..., counters: _Optional[_Union[Counters, _Mapping]] = ..., goal_count: _Optional[_Iterable[int]] = ..., goals: _Optional[_Iterable[_Union[TakenGoal, _Mapping]]] = ...) -> None: ...

class TakenGoal(_message.Message):
    __slots__ = ("number", "kind", "mask", "flags", "due_ns", "valid_ns", "position", "velocity", "speed", "lease", "refusal")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    MASK_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    DUE_NS_FIELD_NUMBER: _ClassVar[int]
    VALID_NS_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    LEASE_FIELD_NUMBER: _ClassVar[int]
    REFUSAL_FIELD_NUMBER: _ClassVar[int]
    number: int
    kind: int
    mask: int
    flags: int
    due_ns: int
    valid_ns: int
    position: _containers.RepeatedScalarFieldContainer[float]
    velocity: _containers.RepeatedScalarFieldContainer[float]
    speed: float
    lease: int
    refusal: int
    def __init__(self, number: _Optional[int] = ..., kind: _Optional[int] = ..., mask: _Optional[int] = ..., flags: _Optional[int] = ..., due_ns: _Optional[int] = ..., valid_ns: _Optional[int] = ..., position: _Optional[_Iterable[float]] = ..., velocity: _Optional[_Iterable[float]] = ..., speed: _Optional[float] = ..., lease: _Optional[int] = ..., refusal: _Optional[int] = ...) -> None: ...

class Stream(_message.Message):
    __slots__ = ("can_id", "flags", "length", "crc32")
    CAN_ID_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    LENGTH_FIELD_NUMBER: _ClassVar[int]
    CRC32_FIELD_NUMBER: _ClassVar[int]
    can_id: int
    flags: int
    length: int
    crc32: bool
    def __init__(self, can_id: _Optional[int] = ..., flags: _Optional[int] = ..., length: _Optional[int] = ..., crc32: _Optional[bool] = ...) -> None: ...

class FrameColumns(_message.Message):
    __slots__ = ("timestamp_ns", "streams", "stream", "data", "timestamp_unit")
    TIMESTAMP_NS_FIELD_NUMBER: _ClassVar[int]
    STREAMS_FIELD_NUMBER: _ClassVar[int]
    STREAM_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    TIMESTAMP_UNIT_FIELD_NUMBER: _ClassVar[int]
    timestamp_ns: _containers.RepeatedScalarFieldContainer[int]
    streams: _containers.RepeatedCompositeFieldContainer[Stream]
    stream: _containers.RepeatedScalarFieldContainer[int]
    data: bytes
    timestamp_unit: int
    def __init__(self, timestamp_ns: _Optional[_Iterable[int]] = ..., streams: _Optional[_Iterable[_Union[Stream, _Mapping]]] = ..., stream: _Optional[_Iterable[int]] = ..., data: _Optional[bytes] = ..., timestamp_unit: _Optional[int] = ...) -> None: ...

class Command(_message.Message):
    __slots__ = ("kind", "sequence", "expires_ns", "accepted")
    KIND_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    EXPIRES_NS_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    kind: int
    sequence: int
    expires_ns: int
    accepted: bool
    def __init__(self, kind: _Optional[int] = ..., sequence: _Optional[int] = ..., expires_ns: _Optional[int] = ..., accepted: _Optional[bool] = ...) -> None: ...

class Status(_message.Message):
    __slots__ = ("rig", "rig_hash", "axes", "units", "law", "period_ns", "pid", "control_alive", "control_ended", "state", "fault", "faults_active", "realtime", "index", "now_ns", "task_ns", "tick_ns", "counters", "position", "setpoint", "max_error", "force", "lateness_p50", "lateness_p99", "lateness_max", "drive_status", "produced", "sent", "dropped", "recording", "recorder_errors", "recording_path", "drive_problems", "answer_age", "tip", "motion", "latched")
    RIG_FIELD_NUMBER: _ClassVar[int]
    RIG_HASH_FIELD_NUMBER: _ClassVar[int]
    AXES_FIELD_NUMBER: _ClassVar[int]
    UNITS_FIELD_NUMBER: _ClassVar[int]
    LAW_FIELD_NUMBER: _ClassVar[int]
    PERIOD_NS_FIELD_NUMBER: _ClassVar[int]
    PID_FIELD_NUMBER: _ClassVar[int]
    CONTROL_ALIVE_FIELD_NUMBER: _ClassVar[int]
    CONTROL_ENDED_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    FAULT_FIELD_NUMBER: _ClassVar[int]
    FAULTS_ACTIVE_FIELD_NUMBER: _ClassVar[int]
    REALTIME_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    NOW_NS_FIELD_NUMBER: _ClassVar[int]
    TASK_NS_FIELD_NUMBER: _ClassVar[int]
    TICK_NS_FIELD_NUMBER: _ClassVar[int]
    COUNTERS_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    SETPOINT_FIELD_NUMBER: _ClassVar[int]
    MAX_ERROR_FIELD_NUMBER: _ClassVar[int]
    FORCE_FIELD_NUMBER: _ClassVar[int]
    LATENESS_P50_FIELD_NUMBER: _ClassVar[int]
    LATENESS_P99_FIELD_NUMBER: _ClassVar[int]
    LATENESS_MAX_FIELD_NUMBER: _ClassVar[int]
    DRIVE_STATUS_FIELD_NUMBER: _ClassVar[int]
    PRODUCED_FIELD_NUMBER: _ClassVar[int]
    SENT_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    RECORDING_FIELD_NUMBER: _ClassVar[int]
    RECORDER_ERRORS_FIELD_NUMBER: _ClassVar[int]
    RECORDING_PATH_FIELD_NUMBER: _ClassVar[int]
    DRIVE_PROBLEMS_FIELD_NUMBER: _ClassVar[int]
    ANSWER_AGE_FIELD_NUMBER: _ClassVar[int]
    TIP_FIELD_NUMBER: _ClassVar[int]
    MOTION_FIELD_NUMBER: _ClassVar[int]
    LATCHED_FIELD_NUMBER: _ClassVar[int]
    rig: str
    rig_hash: str
    axes: _containers.RepeatedScalarFieldContainer[str]
    units: _containers.RepeatedScalarFieldContainer[str]
    law: str
    period_ns: int
    pid: int
    control_alive: bool
    control_ended: bool
    state: str
    fault: str
    faults_active: _containers.RepeatedScalarFieldContainer[str]
    realtime: str
    index: int
    now_ns: int
    task_ns: int
    tick_ns: int
    counters: Counters
    position: _containers.RepeatedScalarFieldContainer[float]
    setpoint: _containers.RepeatedScalarFieldContainer[float]
    max_error: _containers.RepeatedScalarFieldContainer[float]
    force: _containers.RepeatedScalarFieldContainer[float]
    lateness_p50: float
    lateness_p99: float
    lateness_max: float
    drive_status: _containers.RepeatedScalarFieldContainer[int]
    produced: int
    sent: int
    dropped: int
    recording: bool
    recorder_errors: int
    recording_path: str
    drive_problems: _containers.RepeatedScalarFieldContainer[str]
    answer_age: _containers.RepeatedScalarFieldContainer[float]
    tip: str
    motion: str
    latched: _events_pb2.Event
    def __init__(self, rig: _Optional[str] = ..., rig_hash: _Optional[str] = ..., axes: _Optional[_Iterable[str]] = ..., units: _Optional[_Iterable[str]] = ..., law: _Optional[str] = ..., period_ns: _Optional[int] = ..., pid: _Optional[int] = ..., control_alive: _Optional[bool] = ..., control_ended: _Optional[bool] = ..., state: _Optional[str] = ..., fault: _Optional[str] = ..., faults_active: _Optional[_Iterable[str]] = ..., realtime: _Optional[str] = ..., index: _Optional[int] = ..., now_ns: _Optional[int] = ..., task_ns: _Optional[int] = ..., tick_ns: _Optional[int] = ..., counters: _Optional[_Union[Counters, _Mapping]] = ..., position: _Optional[_Iterable[float]] = ..., setpoint: _Optional[_Iterable[float]] = ..., max_error: _Optional[_Iterable[float]] = ..., force: _Optional[_Iterable[float]] = ..., lateness_p50: _Optional[float] = ..., lateness_p99: _Optional[float] = ..., lateness_max: _Optional[float] = ..., drive_status: _Optional[_Iterable[int]] = ..., produced: _Optional[int] = ..., sent: _Optional[int] = ..., dropped: _Optional[int] = ..., recording: _Optional[bool] = ..., recorder_errors: _Optional[int] = ..., recording_path: _Optional[str] = ..., drive_problems: _Optional[_Iterable[str]] = ..., answer_age: _Optional[_Iterable[float]] = ..., tip: _Optional[str] = ..., motion: _Optional[str] = ..., latched: _Optional[_Union[_events_pb2.Event, _Mapping]] = ...) -> None: ...

class Motion(_message.Message):
    __slots__ = ("index", "tick_ns", "state", "fault", "motion", "goal", "position", "velocity", "target", "setpoint", "setpoint_velocity", "moving", "in_position", "limited", "lag", "lease", "stream_delay", "stream_late", "stream_disordered")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    TICK_NS_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    FAULT_FIELD_NUMBER: _ClassVar[int]
    MOTION_FIELD_NUMBER: _ClassVar[int]
    GOAL_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_FIELD_NUMBER: _ClassVar[int]
    TARGET_FIELD_NUMBER: _ClassVar[int]
    SETPOINT_FIELD_NUMBER: _ClassVar[int]
    SETPOINT_VELOCITY_FIELD_NUMBER: _ClassVar[int]
    MOVING_FIELD_NUMBER: _ClassVar[int]
    IN_POSITION_FIELD_NUMBER: _ClassVar[int]
    LIMITED_FIELD_NUMBER: _ClassVar[int]
    LAG_FIELD_NUMBER: _ClassVar[int]
    LEASE_FIELD_NUMBER: _ClassVar[int]
    STREAM_DELAY_FIELD_NUMBER: _ClassVar[int]
    STREAM_LATE_FIELD_NUMBER: _ClassVar[int]
    STREAM_DISORDERED_FIELD_NUMBER: _ClassVar[int]
    index: int
    tick_ns: int
    state: str
    fault: str
    motion: str
    goal: int
    position: _containers.RepeatedScalarFieldContainer[float]
    velocity: _containers.RepeatedScalarFieldContainer[float]
    target: _containers.RepeatedScalarFieldContainer[float]
    setpoint: _containers.RepeatedScalarFieldContainer[float]
    setpoint_velocity: _containers.RepeatedScalarFieldContainer[float]
    moving: bool
    in_position: bool
    limited: int
    lag: float
    lease: str
    stream_delay: float
    stream_late: int
    stream_disordered: int
    def __init__(self, index: _Optional[int] = ..., tick_ns: _Optional[int] = ..., state: _Optional[str] = ..., fault: _Optional[str] = ..., motion: _Optional[str] = ..., goal: _Optional[int] = ..., position: _Optional[_Iterable[float]] = ..., velocity: _Optional[_Iterable[float]] = ..., target: _Optional[_Iterable[float]] = ..., setpoint: _Optional[_Iterable[float]] = ..., setpoint_velocity: _Optional[_Iterable[float]] = ..., moving: _Optional[bool] = ..., in_position: _Optional[bool] = ..., limited: _Optional[int] = ..., lag: _Optional[float] = ..., lease: _Optional[str] = ..., stream_delay: _Optional[float] = ..., stream_late: _Optional[int] = ..., stream_disordered: _Optional[int] = ...) -> None: ...

class Cell(_message.Message):
    __slots__ = ("number", "of", "phase", "verdict", "index", "tick_ns", "began", "ended", "contact", "pierced", "pierced_force", "peak_force", "deposit", "pull", "pulse", "bolus", "run")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    OF_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    TICK_NS_FIELD_NUMBER: _ClassVar[int]
    BEGAN_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    CONTACT_FIELD_NUMBER: _ClassVar[int]
    PIERCED_FIELD_NUMBER: _ClassVar[int]
    PIERCED_FORCE_FIELD_NUMBER: _ClassVar[int]
    PEAK_FORCE_FIELD_NUMBER: _ClassVar[int]
    DEPOSIT_FIELD_NUMBER: _ClassVar[int]
    PULL_FIELD_NUMBER: _ClassVar[int]
    PULSE_FIELD_NUMBER: _ClassVar[int]
    BOLUS_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    number: int
    of: int
    phase: str
    verdict: str
    index: int
    tick_ns: int
    began: float
    ended: float
    contact: float
    pierced: float
    pierced_force: float
    peak_force: float
    deposit: float
    pull: float
    pulse: float
    bolus: float
    run: int
    def __init__(self, number: _Optional[int] = ..., of: _Optional[int] = ..., phase: _Optional[str] = ..., verdict: _Optional[str] = ..., index: _Optional[int] = ..., tick_ns: _Optional[int] = ..., began: _Optional[float] = ..., ended: _Optional[float] = ..., contact: _Optional[float] = ..., pierced: _Optional[float] = ..., pierced_force: _Optional[float] = ..., peak_force: _Optional[float] = ..., deposit: _Optional[float] = ..., pull: _Optional[float] = ..., pulse: _Optional[float] = ..., bolus: _Optional[float] = ..., run: _Optional[int] = ...) -> None: ...

class Cells(_message.Message):
    __slots__ = ("cells",)
    CELLS_FIELD_NUMBER: _ClassVar[int]
    cells: _containers.RepeatedCompositeFieldContainer[Cell]
    def __init__(self, cells: _Optional[_Iterable[_Union[Cell, _Mapping]]] = ...) -> None: ...

class Challenge(_message.Message):
    __slots__ = ("nonce", "now_ns")
    NONCE_FIELD_NUMBER: _ClassVar[int]
    NOW_NS_FIELD_NUMBER: _ClassVar[int]
    nonce: bytes
    now_ns: int
    def __init__(self, nonce: _Optional[bytes] = ..., now_ns: _Optional[int] = ...) -> None: ...

class Authenticated(_message.Message):
    __slots__ = ("body", "mac")
    BODY_FIELD_NUMBER: _ClassVar[int]
    MAC_FIELD_NUMBER: _ClassVar[int]
    body: bytes
    mac: bytes
    def __init__(self, body: _Optional[bytes] = ..., mac: _Optional[bytes] = ...) -> None: ...

class CommandRequest(_message.Message):
    __slots__ = ("kind", "sequence", "expires_ns", "task", "more", "goal")
    KIND_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    EXPIRES_NS_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    MORE_FIELD_NUMBER: _ClassVar[int]
    GOAL_FIELD_NUMBER: _ClassVar[int]
    kind: int
    sequence: int
    expires_ns: int
    task: bytes
    more: bool
    goal: GoalRequest
    def __init__(self, kind: _Optional[int] = ..., sequence: _Optional[int] = ..., expires_ns: _Optional[int] = ..., task: _Optional[bytes] = ..., more: _Optional[bool] = ..., goal: _Optional[_Union[GoalRequest, _Mapping]] = ...) -> None: ...

class GoalRequest(_message.Message):
    __slots__ = ("act", "kind", "mask", "flags", "due_ns", "valid_ns", "position", "velocity", "speed", "sent_ns")
    ACT_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    MASK_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    DUE_NS_FIELD_NUMBER: _ClassVar[int]
    VALID_NS_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    SENT_NS_FIELD_NUMBER: _ClassVar[int]
    act: int
    kind: int
    mask: int
    flags: int
    due_ns: int
    valid_ns: int
    position: _containers.RepeatedScalarFieldContainer[float]
    velocity: _containers.RepeatedScalarFieldContainer[float]
    speed: float
    sent_ns: int
    def __init__(self, act: _Optional[int] = ..., kind: _Optional[int] = ..., mask: _Optional[int] = ..., flags: _Optional[int] = ..., due_ns: _Optional[int] = ..., valid_ns: _Optional[int] = ..., position: _Optional[_Iterable[float]] = ..., velocity: _Optional[_Iterable[float]] = ..., speed: _Optional[float] = ..., sent_ns: _Optional[int] = ...) -> None: ...

class GoalReply(_message.Message):
    __slots__ = ("number", "refusal", "motion", "rig")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    REFUSAL_FIELD_NUMBER: _ClassVar[int]
    MOTION_FIELD_NUMBER: _ClassVar[int]
    RIG_FIELD_NUMBER: _ClassVar[int]
    number: int
    refusal: int
    motion: Motion
    rig: bytes
    def __init__(self, number: _Optional[int] = ..., refusal: _Optional[int] = ..., motion: _Optional[_Union[Motion, _Mapping]] = ..., rig: _Optional[bytes] = ...) -> None: ...

class CommandReply(_message.Message):
    __slots__ = ("accepted", "reason", "now_ns", "state", "sequence", "posted", "tick", "challenge", "goal")
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    NOW_NS_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    POSTED_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    CHALLENGE_FIELD_NUMBER: _ClassVar[int]
    GOAL_FIELD_NUMBER: _ClassVar[int]
    accepted: bool
    reason: str
    now_ns: int
    state: str
    sequence: int
    posted: int
    tick: int
    challenge: Challenge
    goal: GoalReply
    def __init__(self, accepted: _Optional[bool] = ..., reason: _Optional[str] = ..., now_ns: _Optional[int] = ..., state: _Optional[str] = ..., sequence: _Optional[int] = ..., posted: _Optional[int] = ..., tick: _Optional[int] = ..., challenge: _Optional[_Union[Challenge, _Mapping]] = ..., goal: _Optional[_Union[GoalReply, _Mapping]] = ...) -> None: ...

class CommandEntry(_message.Message):
    __slots__ = ("who", "kind", "when_ns", "accepted", "reason", "state", "posted", "task")
    WHO_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    WHEN_NS_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    POSTED_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    who: str
    kind: int
    when_ns: int
    accepted: bool
    reason: str
    state: str
    posted: int
    task: bytes
    def __init__(self, who: _Optional[str] = ..., kind: _Optional[int] = ..., when_ns: _Optional[int] = ..., accepted: _Optional[bool] = ..., reason: _Optional[str] = ..., state: _Optional[str] = ..., posted: _Optional[int] = ..., task: _Optional[bytes] = ...) -> None: ...

class Telemetry(_message.Message):
    __slots__ = ("batch", "first", "lost", "axes", "index", "scheduled_ns", "now_ns", "state", "fault", "faults_active", "task_ns", "position", "position_estimate", "velocity_estimate", "disturbance_estimate", "innovation", "setpoint_position", "setpoint_velocity", "following_error", "force_requested", "force", "stamp_ns", "age_ticks", "drive_status", "cpu_ns", "run_delay_ns", "counters")
    BATCH_FIELD_NUMBER: _ClassVar[int]
    FIRST_FIELD_NUMBER: _ClassVar[int]
    LOST_FIELD_NUMBER: _ClassVar[int]
    AXES_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    SCHEDULED_NS_FIELD_NUMBER: _ClassVar[int]
    NOW_NS_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    FAULT_FIELD_NUMBER: _ClassVar[int]
    FAULTS_ACTIVE_FIELD_NUMBER: _ClassVar[int]
    TASK_NS_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    POSITION_ESTIMATE_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_ESTIMATE_FIELD_NUMBER: _ClassVar[int]
    DISTURBANCE_ESTIMATE_FIELD_NUMBER: _ClassVar[int]
    INNOVATION_FIELD_NUMBER: _ClassVar[int]
    SETPOINT_POSITION_FIELD_NUMBER: _ClassVar[int]
    SETPOINT_VELOCITY_FIELD_NUMBER: _ClassVar[int]
    FOLLOWING_ERROR_FIELD_NUMBER: _ClassVar[int]
    FORCE_REQUESTED_FIELD_NUMBER: _ClassVar[int]
    FORCE_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    AGE_TICKS_FIELD_NUMBER: _ClassVar[int]
    DRIVE_STATUS_FIELD_NUMBER: _ClassVar[int]
    CPU_NS_FIELD_NUMBER: _ClassVar[int]
    RUN_DELAY_NS_FIELD_NUMBER: _ClassVar[int]
    COUNTERS_FIELD_NUMBER: _ClassVar[int]
    batch: int
    first: int
    lost: int
    axes: int
    index: _containers.RepeatedScalarFieldContainer[int]
    scheduled_ns: _containers.RepeatedScalarFieldContainer[int]
    now_ns: _containers.RepeatedScalarFieldContainer[int]
    state: _containers.RepeatedScalarFieldContainer[int]
    fault: _containers.RepeatedScalarFieldContainer[int]
    faults_active: _containers.RepeatedScalarFieldContainer[int]
    task_ns: _containers.RepeatedScalarFieldContainer[int]
    position: _containers.RepeatedScalarFieldContainer[float]
    position_estimate: _containers.RepeatedScalarFieldContainer[float]
    velocity_estimate: _containers.RepeatedScalarFieldContainer[float]
    disturbance_estimate: _containers.RepeatedScalarFieldContainer[float]
    innovation: _containers.RepeatedScalarFieldContainer[float]
    setpoint_position: _containers.RepeatedScalarFieldContainer[float]
    setpoint_velocity: _containers.RepeatedScalarFieldContainer[float]
    following_error: _containers.RepeatedScalarFieldContainer[float]
    force_requested: _containers.RepeatedScalarFieldContainer[float]
    force: _containers.RepeatedScalarFieldContainer[float]
    stamp_ns: _containers.RepeatedScalarFieldContainer[int]
    age_ticks: _containers.RepeatedScalarFieldContainer[int]
    drive_status: _containers.RepeatedScalarFieldContainer[int]
    cpu_ns: _containers.RepeatedScalarFieldContainer[int]
    run_delay_ns: _containers.RepeatedScalarFieldContainer[int]
    counters: Counters
    def __init__(self, batch: _Optional[int] = ..., first: _Optional[int] = ..., lost: _Optional[int] = ..., axes: _Optional[int] = ..., index: _Optional[_Iterable[int]] = ..., scheduled_ns: _Optional[_Iterable[int]] = ..., now_ns: _Optional[_Iterable[int]] = ..., state: _Optional[_Iterable[int]] = ..., fault: _Optional[_Iterable[int]] = ..., faults_active: _Optional[_Iterable[int]] = ..., task_ns: _Optional[_Iterable[int]] = ..., position: _Optional[_Iterable[float]] = ..., position_estimate: _Optional[_Iterable[float]] = ..., velocity_estimate: _Optional[_Iterable[float]] = ..., disturbance_estimate: _Optional[_Iterable[float]] = ..., innovation: _Optional[_Iterable[float]] = ..., setpoint_position: _Optional[_Iterable[float]] = ..., setpoint_velocity: _Optional[_Iterable[float]] = ..., following_error: _Optional[_Iterable[float]] = ..., force_requested: _Optional[_Iterable[float]] = ..., force: _Optional[_Iterable[float]] = ..., stamp_ns: _Optional[_Iterable[int]] = ..., age_ticks: _Optional[_Iterable[int]] = ..., drive_status: _Optional[_Iterable[int]] = ..., cpu_ns: _Optional[_Iterable[int]] = ..., run_delay_ns: _Optional[_Iterable[int]] = ..., counters: _Optional[_Union[Counters, _Mapping]] = ...) -> None: ...

class Traffic(_message.Message):
    __slots__ = ("first", "index", "scheduled_ns", "now_ns", "flags", "port", "received_count", "sent_count", "command_count", "received", "sent", "commands")
    FIRST_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    SCHEDULED_NS_FIELD_NUMBER: _ClassVar[int]
    NOW_NS_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    PORT_FIELD_NUMBER: _ClassVar[int]
    RECEIVED_COUNT_FIELD_NUMBER: _ClassVar[int]
    SENT_COUNT_FIELD_NUMBER: _ClassVar[int]
    COMMAND_COUNT_FIELD_NUMBER: _ClassVar[int]
    RECEIVED_FIELD_NUMBER: _ClassVar[int]
    SENT_FIELD_NUMBER: _ClassVar[int]
    COMMANDS_FIELD_NUMBER: _ClassVar[int]
    first: int
    index: _containers.RepeatedScalarFieldContainer[int]
    scheduled_ns: _containers.RepeatedScalarFieldContainer[int]
    now_ns: _containers.RepeatedScalarFieldContainer[int]
    flags: _containers.RepeatedScalarFieldContainer[int]
    port: _containers.RepeatedScalarFieldContainer[int]
    received_count: _containers.RepeatedScalarFieldContainer[int]
    sent_count: _containers.RepeatedScalarFieldContainer[int]
    command_count: _containers.RepeatedScalarFieldContainer[int]
    received: Frames
    sent: Frames
    commands: _containers.RepeatedCompositeFieldContainer[Command]
    def __init__(self, first: _Optional[int] = ..., index: _Optional[_Iterable[int]] = ..., scheduled_ns: _Optional[_Iterable[int]] = ..., now_ns: _Optional[_Iterable[int]] = ..., flags: _Optional[_Iterable[int]] = ..., port: _Optional[_Iterable[int]] = ..., received_count: _Optional[_Iterable[int]] = ..., sent_count: _Optional[_Iterable[int]] = ..., command_count: _Optional[_Iterable[int]] = ..., received: _Optional[_Union[Frames, _Mapping]] = ..., sent: _Optional[_Union[Frames, _Mapping]] = ..., commands: _Optional[_Iterable[_Union[Command, _Mapping]]] = ...) -> None: ...

class Frames(_message.Message):
    __slots__ = ("timestamp_ns", "can_id", "flags", "length", "data")
    TIMESTAMP_NS_FIELD_NUMBER: _ClassVar[int]
    CAN_ID_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    LENGTH_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    timestamp_ns: _containers.RepeatedScalarFieldContainer[int]
    can_id: _containers.RepeatedScalarFieldContainer[int]
    flags: _containers.RepeatedScalarFieldContainer[int]
    length: _containers.RepeatedScalarFieldContainer[int]
    data: bytes
    def __init__(self, timestamp_ns: _Optional[_Iterable[int]] = ..., can_id: _Optional[_Iterable[int]] = ..., flags: _Optional[_Iterable[int]] = ..., length: _Optional[_Iterable[int]] = ..., data: _Optional[bytes] = ...) -> None: ...
