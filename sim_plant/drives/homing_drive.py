"""An emulated CiA 402 drive that homes by itself (mode 6), by loops of its own on the stage that it moves.

Methods by CiA 402-2: 17 and 18 the limit switch at the negative and the positive end, 33 and 34 the encoder's index in
that direction, 35 and 37 where it stands. Any other ends in its homing error. The switch is searched at 6099h:01, left
at 6099h:02 until it opens, and home is there; the index is searched at 6099h:02. Then the drive counts from 607Ch.

Its loop demands a velocity, with ramps of 609Ah, and follows the position that this makes. It knows no mass: its gains
are those of its installer, for the force that it is rated for. What it asks for is held within 6072h; a position that
lags by more than LATE is its homing error. After that, and once it is home, it holds where it stands.
"""

from enum import Enum, auto

from drivers.families.cia402.cia301 import DriveState
from sim_plant.drives.canopen_drive import Cia402Drive
from sim_plant.drives.object_dictionary import key_of
from sim_plant.drives.servo import Counter

HOMING, HOMING_OFFERED = 6, 1 << 5  # 6060h, and its bit of 6502h
METHOD, FAST, SLOW, ACCELERATION, OFFSET = (
    key_of(0x6098), key_of(0x6099, 1), key_of(0x6099, 2), key_of(0x609A), key_of(0x607C),
)  # fmt: skip
START = 1 << 4  # of the controlword
REACHED, ATTAINED, ERROR = 1 << 10, 1 << 12, 1 << 13  # of the statusword in this mode
LATE = 2e-3  # m (rad)
STIFFNESS, DAMPING = 500.0, 15.0  # of the rated force a m, and a m/s
STEP_NS = 200_000  # between two looks of its loop
STILL = 1e-4  # m/s
NEGATIVE_SWITCH, POSITIVE_SWITCH = 1, 2  # of 60FDh
_MODE = key_of(0x6060)


class Phase(Enum):
    """Where its homing is."""

    IDLE = auto()
    TO_SWITCH = auto()
    OFF_SWITCH = auto()
    TO_INDEX = auto()
    HALT = auto()  # home is found, it comes to rest
    DONE = auto()
    FAILED = auto()


class HomingDrive(Cia402Drive):
    """phase: of its homing."""

    phase = Phase.IDLE
    _demand = _velocity = _before = 0.0  # m, m/s, m
    _seen_ns = 0
    _loop_force = 0.0

    # hooks of the drive -----------------------------------------------------------------------------------------------

    def _take_mode(self, value: int) -> None:
        if value != HOMING or not self._offers_homing():
            super()._take_mode(value)
            self.phase = Phase.IDLE
            return
        self.dictionary.set(_MODE, value)
        self.phase = Phase.IDLE
        self._hold_here()

    def _take_controlword(self, value: int) -> None:
        rising = value & ~self._controlword
        before = self.state
        super()._take_controlword(value)
        homes = self._is_homing()
        if homes and before is not DriveState.OPERATION_ENABLED:
            self._hold_here()
        if homes and rising & START:
            self._begin()
        elif homes and not value & START and self.phase not in (Phase.IDLE, Phase.DONE, Phase.FAILED):
            self.phase = Phase.IDLE

    def _live(self) -> None:
        if self._is_homing() and self.now_ns - self._seen_ns >= STEP_NS:
            self._follow()
        super()._live()

    def _target_force(self) -> float:
        return self._loop_force if self._is_homing() else super()._target_force()

    def _mode_bits(self) -> int:
        if self.dictionary.number(_MODE) != HOMING:
            return super()._mode_bits()
        bits = {
            Phase.HALT: ATTAINED,
            Phase.DONE: ATTAINED | REACHED,
            Phase.IDLE: REACHED,
            Phase.FAILED: ERROR | REACHED,
        }
        return bits.get(self.phase, 0)

    def _offers_homing(self) -> bool:
        offered = self.dictionary.number(key_of(0x6502), HOMING_OFFERED) & HOMING_OFFERED
        return bool(offered) and METHOD in self.dictionary.entries

    # homing -----------------------------------------------------------------------------------------------------------

    def _is_homing(self) -> bool:
        return self.dictionary.number(_MODE) == HOMING and self.state is DriveState.OPERATION_ENABLED

    def _hold_here(self) -> None:
        self._demand = self._before = self._position()
        self._velocity = self._loop_force = 0.0
        self._seen_ns = self.now_ns

    def _begin(self) -> None:
        self._hold_here()
        match self.dictionary.number(METHOD):
            case 17 | 18:
                self.phase = Phase.TO_SWITCH
            case 33 | 34:
                self.phase = Phase.TO_INDEX
            case 35 | 37:
                self._is_home(self._position())
            case _:
                self.phase = Phase.FAILED

    @property
    def _towards(self) -> int:
        return -1 if self.dictionary.number(METHOD) in (17, 33) else 1

    def _wanted(self) -> float:
        """Velocity, m/s."""
        number, count = self.dictionary.number, self.servo.resolution
        match self.phase:
            case Phase.TO_SWITCH:
                return self._towards * number(FAST) * count
            case Phase.OFF_SWITCH:
                return -self._towards * number(SLOW) * count
            case Phase.TO_INDEX:
                return self._towards * number(SLOW) * count
        return 0.0

    def _follow(self) -> None:
        """A step of its loop."""
        seconds = (self.now_ns - self._seen_ns) * 1e-9
        self._seen_ns = self.now_ns
        position, before = self._position(), self._before
        self._before = position
        self._look(before, position)
        step = self.dictionary.number(ACCELERATION) * self.servo.resolution * seconds
        self._velocity += max(-step, min(step, self._wanted() - self._velocity))
        self._demand += self._velocity * seconds
        late = self._demand - position
        if abs(late) > LATE and self.phase is not Phase.FAILED:
            self.phase, self._demand = Phase.FAILED, position
            self._velocity = late = 0.0
        speed = (position - before) / seconds
        asked = self.servo.rated_force * (STIFFNESS * late + DAMPING * (self._velocity - speed))
        most = self.dictionary.number(key_of(0x6072), 0xFFFF) * self._rated_torque() * 1e-6
        self._loop_force = max(-most, min(most, asked))
        self._limited = abs(asked) > most
        if self.phase is Phase.HALT and self._velocity == 0.0 and abs(speed) < STILL:
            self.phase = Phase.DONE
        self._command_servo(self._loop_force)

    def _look(self, before: float, position: float) -> None:
        """What it searches, between two looks."""
        if self.phase in (Phase.TO_SWITCH, Phase.OFF_SWITCH):
            closed = self._digital_inputs() & (NEGATIVE_SWITCH if self._towards < 0 else POSITIVE_SWITCH)
            if closed and self.phase is Phase.TO_SWITCH:
                self.phase = Phase.OFF_SWITCH
            elif not closed and self.phase is Phase.OFF_SWITCH:
                self._is_home(position)
        elif self.phase is Phase.TO_INDEX:
            index = self.index
            if index is not None and min(before, position) <= index <= max(before, position) and before != position:
                self._is_home(index)

    def _is_home(self, place: float) -> None:
        """It counts from there, and comes to rest."""
        counter = self.servo.counter
        if counter is None:
            counter = self.servo.counter = Counter(0.0, None)
        counter.zero = place - self.dictionary.number(OFFSET) * self.servo.resolution
        if self._probe is not None and self.index is not None:
            self._probe.index = (self.index - counter.zero) / self.servo.resolution
        self.phase = Phase.HALT
