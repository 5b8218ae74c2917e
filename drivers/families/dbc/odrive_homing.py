"""Homing by an ODrive itself, over CANSimple: axis state 11, from torque control and back to it.

Source: ODrive's manual, pages "CAN Protocol" and "Endstops/Homing". The drive moves in its own negative direction at
controller.config.homing_speed until its min_endstop closes, then by its trapezoidal trajectory to its zero. It counts
from there, and rests in state 1. Its heartbeat tells axis error, axis state and procedure result.

Rules. While the axis rests under the host's torque the drive is asked whether its endstop is enabled and open, and its
watchdog on. Then it is told torque limits, speeds and accelerations; each is read back. While it homes it is told no
torque: that frame feeds its watchdog. It has homed where it goes from state 11 to state 1 with result 0, and still has
what it was told. Any other state or result, an axis error, and too few heartbeats end it. Then limits and controller
mode are as before, and read back, before it is told state 8 again.

However it ends, the drive is not enabled before limits and mode are as before.
"""

import math
from collections.abc import Mapping, Sequence
from enum import Enum, auto
from struct import Struct
from typing import Final, NamedTuple

from drivers.families.dbc.endpoints import Endpoint
from drivers.families.dbc.odrive_words import CLOSED_LOOP, IDLE, SUCCESS, told_words
from drivers.families.dbc.page import Place
from drivers.frame import FD, Frame
from drivers.protocols.base import DriveStatus
from drivers.protocols.finding import HomingTerms, Search
from drivers.protocols.read_back import ANSWER_TICKS, MOST_ASKED, RETRY_TICKS, Question

HOMING: Final = 11  # axis state, and the method of [axes.NAME.home]
HEARTBEAT, RX_SDO, TX_SDO = 0x01, 0x04, 0x05
BUSY: Final = 1  # Procedure_Result
SOFT_MAX, SOFT_MIN = "axis0.config.torque_soft_max", "axis0.config.torque_soft_min"
SPEED, RAMP = "axis0.controller.config.homing_speed", "axis0.controller.config.vel_ramp_rate"
TRAP_SPEED, TRAP_UP, TRAP_DOWN = (f"axis0.trap_traj.config.{name}_limit" for name in ("vel", "accel", "decel"))
ENDSTOP, PRESSED = "axis0.min_endstop.config.enabled", "axis0.min_endstop.state"
WATCHDOG, TIMEOUT = "axis0.config.enable_watchdog", "axis0.config.watchdog_timeout"
CONTROL_MODE, INPUT_MODE = "axis0.controller.config.control_mode", "axis0.controller.config.input_mode"
WRITTEN: Final = (SOFT_MAX, SOFT_MIN, SPEED, RAMP, TRAP_SPEED, TRAP_UP, TRAP_DOWN)
READ: Final = (ENDSTOP, PRESSED, WATCHDOG, TIMEOUT, CONTROL_MODE, INPUT_MODE)
LONGEST_WATCHDOG_S: Final = 0.1
HEARTBEATS: Final = 5  # of which none came: it is silent
PATIENCE_NS: Final = 1_000_000_000  # until it begins, or is enabled again
_ENABLED, _FAULT = int(DriveStatus.ENABLED), int(DriveStatus.FAULT)
_TOLD, _SDO, _MODES = Struct("<IBB"), Struct("<BHx"), Struct("<II")


class Stage(Enum):
    """Where it is."""

    NONE = auto()
    ASKS = auto()  # what stands in its way, and its torque limits
    TELLS = auto()
    BEGINS = auto()  # it is told to home
    HOMES = auto()
    RETURNS = auto()  # it has homed, and rests: limits and mode as before
    ENABLES = auto()
    HELD = auto()  # the host's torque acts again
    RIGHTS = auto()  # it ended before its time: limits and mode as before


_BY_ITSELF: Final = frozenset({Stage.BEGINS, Stage.HOMES, Stage.RETURNS})  # no torque of the host
_AWAY: Final = _BY_ITSELF | {Stage.ENABLES, Stage.HELD}
_MAY_BE: Final = {  # axis states; IDLE besides, without a failure
    Stage.BEGINS: (CLOSED_LOOP, HOMING),
    Stage.HOMES: (HOMING,),
    Stage.RETURNS: (),
    Stage.ENABLES: (CLOSED_LOOP,),
}


class Step(NamedTuple):
    """An endpoint that is read: what is sent before, and what it may be. told: its bytes, written first."""

    path: str
    least: float = -math.inf
    most: float = math.inf
    told: bytes = b""
    before: Frame | None = None


class OdriveHoming:
    """Homer of one drive. axis: its number. problem: why it failed, for people. stage: where it is. heard_ids: of the
    frames that it is to hear.
    """

    methods = range(HOMING, HOMING + 1)
    lets_go = True

    def __init__(
        self, axis: int, mode: Frame, places: tuple[Place, Place], endpoints: Mapping[str, Endpoint], period_ns: int,
        state_ns: int,
    ) -> None:  # fmt: skip
        """mode: Set_Controller_Mode. places: of its position and torque. state_ns: period of its heartbeat."""
        self.axis = axis
        self.problem = ""
        self.stage = Stage.NONE
        self._node = mode.can_id & ~0x1F  # first identifier of the drive's
        self._mode, self._endpoints = mode, endpoints
        self._position, self._torque = places
        self._silent_ticks = max(2, HEARTBEATS * state_ns // period_ns)
        self._patience = PATIENCE_NS // period_ns
        self._search = Search.NONE
        self._terms: HomingTerms | None = None
        self._state = 0  # as it told last
        self._refused = False  # limits and mode could not be put right
        self._tick = self._heard_tick = self._since_tick = self._next_tick = 0
        self._steps: list[Step] = []
        self._told = self._waits = False  # of the first step
        self._asked = 0
        self._values: dict[str, bytes] = {}
        self._before: dict[str, bytes] = {}  # torque limits
        self.heard_ids = (self._node | HEARTBEAT, self._node | TX_SDO)

    # Homer ------------------------------------------------------------------------------------------------------------

    @property
    def search(self) -> Search:
        """See Homer."""
        return self._search

    def begin(self, terms: HomingTerms) -> None:
        """See Homer."""
        self.problem, self._terms, self._search = "", terms, Search.ASKED
        self._run(
            Stage.ASKS,
            [
                Step(ENDSTOP, 1, 1),
                Step(PRESSED, 0, 0),
                Step(WATCHDOG, 1, 1),
                Step(TIMEOUT, 1e-6, LONGEST_WATCHDOG_S),
                Step(SOFT_MAX, least=0.0),
                Step(SOFT_MIN, most=0.0),
            ],
        )

    def end(self) -> None:
        """See Homer."""
        self._search = Search.NONE
        if self.stage is Stage.ASKS:
            self.stage = Stage.NONE
        elif self.stage is not Stage.NONE:
            self._run(Stage.RIGHTS, self._as_before())

    # of the layout ----------------------------------------------------------------------------------------------------

    @property
    def by_itself(self) -> bool:
        """It is told no torque."""
        return self.stage in _BY_ITSELF

    @property
    def busy(self) -> bool:
        """Endpoints have other values than the rig's, or are asked for."""
        return self.stage is not Stage.NONE

    def status(self, told: int) -> int:
        """DriveStatus bits of a drive that tells these. Until `end` it is the homing that says what went wrong: a drive
        that rests for a moment, or fails while it homes, has not left the host.
        """
        if self.stage is Stage.RIGHTS:
            return told | (_FAULT if self._refused else 0)
        return told & ~_FAULT | _ENABLED if self.stage in _AWAY else told

    def state(self, wanted: int) -> int:
        """The axis state that the drive is told, where the host's enabling says `wanted`."""
        if wanted == IDLE:
            return IDLE
        if self.stage in (Stage.BEGINS, Stage.HOMES):
            return HOMING
        return IDLE if self.stage in (Stage.RETURNS, Stage.RIGHTS) else wanted

    def request(self, tick: int) -> Frame | None:
        """The frame that is due in this tick."""
        self._tick = tick
        stage = self.stage
        if stage is Stage.NONE:
            return None
        if stage is Stage.HELD:
            self.stage, self._search = Stage.NONE, Search.FOUND
        elif stage in _MAY_BE and tick - self._heard_tick > self._silent_ticks:
            self._fail(Search.FAILED, f"no heartbeat for {tick - self._heard_tick} ticks (limit {self._silent_ticks})")
        elif stage in (Stage.BEGINS, Stage.ENABLES) and tick - self._since_tick > self._patience:
            what = "homes" if stage is Stage.BEGINS else "is enabled again"
            self._fail(Search.FAILED, f"it does not say that it {what}; axis state {self._state}")
        elif self._steps and tick >= self._next_tick:
            return self._ask()
        elif stage is Stage.RIGHTS and not self._steps and tick >= self._next_tick:
            self._run(Stage.RIGHTS, self._as_before())
        return None

    def hear(self, frame: Frame) -> None:
        """A frame in one of `heard_ids`."""
        data = frame.data
        if frame.flags & FD or len(data) < 5:
            return
        if frame.can_id & 0x1F == TX_SDO:
            self._on_answer(data)
        elif len(data) >= _TOLD.size:
            self._heard_tick = self._tick
            self._on_heartbeat(*_TOLD.unpack_from(data))

    def _on_heartbeat(self, error: int, state: int, result: int) -> None:
        self._state, stage = state, self.stage
        if stage not in _MAY_BE or self._search is not Search.RUNNING:
            return
        has_homed = stage in (Stage.RETURNS, Stage.ENABLES)
        rests = state == IDLE and (has_homed or result in (SUCCESS, BUSY))
        if error or not (rests or state in _MAY_BE[stage]):
            self._fail(Search.ERROR, told_words(error, state, result))
        elif stage is Stage.BEGINS and state == HOMING:
            self.stage = Stage.HOMES
        elif stage is Stage.HOMES and state == IDLE and result == SUCCESS:
            self._run(Stage.RETURNS, [*self._still(), *self._as_before()])
        elif stage is Stage.ENABLES and state == CLOSED_LOOP:
            self.stage, self._search = Stage.HELD, Search.ASKED

    def _fail(self, search: Search, words: str) -> None:
        if self.stage is Stage.RIGHTS:
            self._refused = True
        else:
            self._search = search
        self._steps = []
        self.problem = f"axis {self.axis}: {words}"

    # endpoints --------------------------------------------------------------------------------------------------------

    def _run(self, stage: Stage, steps: Sequence[Step]) -> None:
        self.stage, self._steps = stage, list(steps)
        self._begin_step()

    def _begin_step(self) -> None:
        self._told, self._waits, self._asked = False, False, 0

    def _ask(self) -> Frame | None:
        """What is written, or the question whether it is there."""
        step = self._steps[0]
        if not self._told and (step.told or step.before):
            self._told, self._next_tick = True, self._tick + ANSWER_TICKS
            return step.before or self._sdo(1, step)
        if self._asked == MOST_ASKED:
            self._end_early(f"{step.path} gave no answer")
            return None
        self._asked += 1
        self._told, self._waits, self._next_tick = False, True, self._tick + ANSWER_TICKS
        return self._sdo(0, step)

    def _sdo(self, opcode: int, step: Step) -> Frame:
        data = _SDO.pack(opcode, self._endpoints[step.path].number) + (step.told if opcode else b"")
        return Frame(self._node | RX_SDO, data.ljust(8, b"\0"))

    def _on_answer(self, data: bytes) -> None:
        if not self._waits or not self._steps:
            return
        step = self._steps[0]
        endpoint = self._endpoints[step.path]
        told = data[4:]
        if _SDO.unpack_from(data)[1] != endpoint.number or len(told) < endpoint.bits // 8:
            return
        self._waits = False
        told = told[: endpoint.bits // 8]
        value = endpoint.value(told)
        if step.least <= value <= step.most and step.told in (b"", told):
            self._values[step.path] = told
            self._steps.pop(0)
            self._begin_step()
            if not self._steps:
                self._conclude()
        elif self._asked == MOST_ASKED or not (step.told or step.before):
            expected = Question("", step.least, step.most).expected
            if step.told:
                expected = f"{endpoint.value(step.told):g}, as written"
            self._end_early(f"{step.path} = {value:g}; expected {expected}")

    def _end_early(self, words: str) -> None:
        self._fail(Search.FAILED, words)
        self._next_tick = self._tick + RETRY_TICKS

    def _conclude(self) -> None:
        """All steps of a stage are done."""
        if self.stage is Stage.ASKS:
            self._run(Stage.TELLS, self._limits())
        elif self.stage is Stage.RIGHTS:
            self.stage = Stage.NONE
            if self._refused:
                self._refused, self.problem = False, ""
        else:
            self.stage = Stage.BEGINS if self.stage is Stage.TELLS else Stage.ENABLES
            self._search = Search.RUNNING
            self._since_tick = self._heard_tick = self._tick

    def _limits(self) -> list[Step]:
        """What it homes within; its own torque limits where they are less."""
        terms, turn = self._terms, abs(self._position.gain)
        assert terms is not None
        force, rise = terms.force / abs(self._torque.gain), terms.acceleration / turn
        told = {
            SOFT_MAX: min(force, self._was(SOFT_MAX)),
            SOFT_MIN: max(-force, self._was(SOFT_MIN)),
            SPEED: terms.speed / turn,
            RAMP: rise,
            TRAP_SPEED: terms.latch_speed / turn,
            TRAP_UP: rise,
            TRAP_DOWN: rise,
        }
        self._before = {path: self._values[path] for path in (SOFT_MAX, SOFT_MIN)}
        return [Step(path, told=self._endpoints[path].packed(value)) for path, value in told.items()]

    def _was(self, path: str) -> float:
        return self._endpoints[path].value(self._values[path])

    def _still(self) -> list[Step]:
        """That it has not restarted meanwhile: an axis state and a result are after a start what they are at home."""
        return [Step(path, self._was(path), self._was(path)) for path in (SPEED, SOFT_MAX)]

    def _as_before(self) -> list[Step]:
        """Torque limits and controller mode."""
        control, passed = _MODES.unpack_from(self._mode.data)
        return [
            *(Step(path, told=told) for path, told in self._before.items()),
            Step(CONTROL_MODE, control, control, before=self._mode),
            Step(INPUT_MODE, passed, passed),
        ]
