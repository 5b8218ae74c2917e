"""`protocol = "moteus"`: moteus controllers, spoken to in their own register protocol (moteus_registers.py).

Rules:
- Every tick each drive gets one frame: what it is to do, and a query of mode, position and fault, which it answers at
  once. It samples and applies its torque when it receives its frame.
- Torque is position mode (10) with feedforward torque, and all scales of its own loop at zero. Position NaN: where it
  is. Every such frame carries the watchdog timeout; when it expires the drive goes to mode 11.
- A disabled drive gets a query alone. Mode 0 (stop) also clears faults and timeouts, so it is sent only where that is
  wanted. These are drives that were enabled, twice and until they say that they have no power; drives that say they
  have; and a reset that is asked for. No start of this process unlatches anything.
- What every command says besides its torque is written to the registers of a drive without power, without a mode, so
  that nothing acts, and read back: at the start and after every reset. Until a drive has told all of it rightly it
  counts as in fault (drivers/protocols/read_back.py). Its mode comes with every answer: another with power than the
  commanded one is told.
- Answers are self-describing: any type of value is taken. One without mode and position is no sample.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

from drivers.config import BusConfig, Wiring
from drivers.families.moteus.config import MoteusConfig, moteus_keys
from drivers.families.moteus.inputs import pins_of
from drivers.families.moteus.registers import (
    BITS,
    READ_ERROR,
    REPLY,
    WRITE,
    WRITE_ERROR,
    Mode,
    Register,
    Type,
    Value,
    padded,
    parse,
    read,
    step_of,
    write,
)
from drivers.frame import BRS, ECHO, ERROR, EXTENDED, EXTENDED_MASK, FD, REMOTE, Frame
from drivers.protocols.base import OF_DRIVES, Command, DriveStatus, LayoutError, Message, Reject, Sample
from drivers.protocols.common import check_force
from drivers.protocols.count_size import CountSize
from drivers.protocols.read_back import Question, ReadBack
from drivers.protocols.sampling_clock import SamplingClock, leads_ns
from drivers.protocols.segments import of_axes

COUNTS_PER_TURN = 100_000  # the step of a position sent as int32
HOST = 0  # our number; drives have 1 to 127
_REPLY_WANTED = 0x8000
_ENCODER_FAULTS = (35, 42, 43)  # encoder, theta invalid, position invalid
_LIMITING = range(96, 104)  # codes of what limits the torque in a mode that works
_UNPOWERED = (Mode.STOPPED, Mode.FAULT, Mode.TIMEOUT)
_PREPARING = (2, 3, 4)
_TYPES = {"int16": Type.INT16, "int32": Type.INT32, "float": Type.FLOAT}
_EXACT = 2.0**24  # counts of a turn's fractions that a float32 can tell from the next
_STOP = write(Register.MODE, Type.INT8, Mode.STOPPED)
_AT_REST = write(Register.COMMAND_POSITION, Type.INT8, -128, 0)  # where it is, not moving
_NO_LOOP = write(Register.KP_SCALE, Type.INT8, 0, 0) + write(Register.ILIMIT_SCALE, Type.INT8, 0)


# what every command says besides its torque, in the words of the drive's documentation
_SCALES = {Register.KP_SCALE: "kp_scale", Register.KD_SCALE: "kd_scale", Register.ILIMIT_SCALE: "ilimit_scale"}
_ASKED = (*_SCALES, Register.WATCHDOG_TIMEOUT)


class MoteusLayout:
    """What both ends share. Raises LayoutError for a rig that it cannot carry."""

    name = "moteus"
    sequence_modulus = 0
    checksum = False
    states = True
    causes = True
    resets = True
    tells = OF_DRIVES
    fd = True
    state_ns = 0

    def __init__(self, wiring: Wiring) -> None:
        bus, n_axes, rated_force = wiring.bus, wiring.n_axes, wiring.rated_force
        config = moteus_keys(bus).moteus or MoteusConfig()
        nodes = moteus_nodes(bus, n_axes)
        self.n_axes = n_axes
        self._rated = list(rated_force)
        turn = CountSize(2.0 * math.pi / COUNTS_PER_TURN, True, True, "1/100000 of a turn")
        self.count_sizes = [turn] * n_axes
        self.command_ids = [EXTENDED | _REPLY_WANTED | HOST << 8 | node for node in nodes]
        self.answer_ids = [_answer_id(node) for node in nodes]
        self._torque_type, self._position_type = _TYPES[config.torque], _TYPES[config.position]
        self._torque_step = step_of(Register.FEEDFORWARD_TORQUE, self._torque_type)
        if self._torque_type is not Type.FLOAT:
            reach = ((1 << (BITS[self._torque_type] - 1)) - 1) * self._torque_step
            for axis, rated in enumerate(rated_force):
                if rated > reach:
                    raise LayoutError(
                        f"bus.moteus.torque = {config.torque!r} reaches {reach:g} N m; axis {axis} has {rated:g}"
                    )
        self._pins = pins_of(config.inputs, n_axes)
        self.axis_tells = [pins.tells for pins in self._pins]
        self._query = (
            read(Register.MODE, Type.INT8)
            + read(Register.POSITION, self._position_type)
            + read(Register.FAULT, Type.INT8)
        )
        self._watchdog_s = config.watchdog_s
        self._watchdog = write(Register.WATCHDOG_TIMEOUT, Type.FLOAT, config.watchdog_s)

    def _torque(self, force: float) -> bytes:
        raw = force if self._torque_type is Type.FLOAT else round(force / self._torque_step)
        return write(Register.FEEDFORWARD_TORQUE, self._torque_type, raw)

    def _asking(self, axis: int) -> bytes:
        """What every frame to a drive asks for."""
        return self._query + self._pins[axis].query

    def _applying(self, axis: int, force: float) -> bytes:
        """What makes a drive apply a torque, N m; the mode has to come first."""
        mode = write(Register.MODE, Type.INT8, Mode.POSITION)
        return mode + _AT_REST + self._torque(force) + _NO_LOOP + self._watchdog + self._asking(axis)


def moteus_nodes(bus: BusConfig, n_axes: int) -> list[int]:
    """Number of each axis' controller. Raises LayoutError."""
    stated = moteus_keys(bus).moteus
    nodes = (stated.nodes if stated else []) or list(range(1, n_axes + 1))
    if len(nodes) != n_axes:
        raise LayoutError(f"bus.moteus.nodes has {len(nodes)} numbers for {n_axes} axes")
    if len(set(nodes)) != n_axes:
        raise LayoutError(f"bus.moteus.nodes = {nodes}: a number twice")
    return nodes


def cut(bus: BusConfig, n_axes: int) -> Callable[[range], dict[str, Any]]:
    """What another segment has otherwise: the controllers on it."""
    moteus, numbers = moteus_keys(bus).moteus or MoteusConfig(), moteus_nodes(bus, n_axes)

    def of_segment(axes: range) -> dict[str, Any]:
        theirs = [item for item in moteus.inputs if item.axis in axes]
        inputs = [item.model_copy(update={"axis": item.axis - axes.start}) for item in theirs]
        return {"moteus": moteus.model_copy(update={"nodes": of_axes(axes, numbers), "inputs": inputs})}

    return of_segment


def _answer_id(node: int) -> int:
    can_id = node << 8 | HOST
    return can_id if can_id <= 0x7FF else EXTENDED | can_id


class MoteusHost(MoteusLayout):
    """HostProtocol of moteus controllers. Forces are N m of the output shaft, counts are COUNTS_PER_TURN a turn."""

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        bus, n_axes = wiring.bus, wiring.n_axes
        reach = {Type.INT16: 327_670.0, Type.INT32: 2.0**31 - 1.0, Type.FLOAT: _EXACT}[self._position_type]
        self.positions: Sequence[tuple[float, float]] = [(-reach, reach)] * n_axes
        self._refused: list[str] = []
        questions = [Question(name, 0.0, 0.0) for name in _SCALES.values()]
        questions.append(Question("watchdog_timeout", 0.999 * self._watchdog_s, 1.001 * self._watchdog_s))  # a float32
        self._proofs = [ReadBack(f"axis {axis}", questions, apart=1) for axis in range(n_axes)]
        self._astray = [""] * n_axes
        self._tick = 0
        self._reset_before = False
        self.acts_ns: Sequence[int] = ()
        self.stamp_wraps_ns: Sequence[int] = ()
        self.echo_id: int | None = self.command_ids[-1]
        self._clock = SamplingClock(n_axes, bus.bitrate, bus.data_bitrate, wiring.period_ns)
        self._axis = {can_id: axis for axis, can_id in enumerate(self.answer_ids)}
        self._own = set(self.command_ids)
        self._mode = [-1] * n_axes  # said last; -1: nothing yet
        self._stopping = [False] * n_axes  # it was enabled, and has not said since that it is no more
        self._stops = [0] * n_axes
        self._enabled = 0
        self._bitrates = bus.bitrate, bus.data_bitrate
        self._lead_ns = [0] * n_axes  # by which each drive had its frame before the last one had

    def decode(self, frame: Frame) -> Sample | Reject:
        """Sample of an answer; SERVICE for one that tells something else."""
        axis = self._axis.get(frame.can_id)
        if axis is None:
            if frame.flags & ECHO and frame.can_id == self.echo_id:
                self._clock.triggered(frame.timestamp_ns)
            return self._reject_id(frame.can_id)
        if not frame.flags & FD:
            return Reject.WRONG_FORMAT
        try:
            values = parse(frame.data)
        except ValueError:
            return Reject.WRONG_LENGTH
        told: dict[int, Value] = {}
        for value in values:
            if value.operation == REPLY:
                told[value.register] = value
            elif value.operation in (READ_ERROR, WRITE_ERROR):
                self._note(axis, value)
        self._note_kept(axis, told)
        if Register.MODE not in told or Register.POSITION not in told:
            return Reject.SERVICE
        return self._sample(axis, frame, told)

    def _sample(self, axis: int, frame: Frame, told: dict[int, Value]) -> Sample | Reject:
        counts = told[Register.POSITION].number * COUNTS_PER_TURN
        mode = told[Register.MODE].number
        fault = told[Register.FAULT].number if Register.FAULT in told else 0.0
        least, most = self.positions[axis]
        if not least <= counts <= most or not 0 <= mode < 256 or not 0 <= fault < 256:  # also where it is not a number
            return Reject.INVALID_VALUE
        inputs = self._pins[axis].status(told)
        if inputs < 0:
            return Reject.SERVICE  # of another tool's query
        self._hear(axis, int(mode))
        stamp_ns = self._clock.instant(axis, frame)
        if stamp_ns >= 0:
            stamp_ns -= self._lead_ns[axis]
        return Sample(axis, round(counts), self._status(axis, int(mode), int(fault)) | inputs, -1, stamp_ns)

    def _note_kept(self, axis: int, told: dict[int, Value]) -> None:
        for number, register in enumerate(_ASKED):
            if register in told:
                self._proofs[axis].answer(number, told[register].number, self._tick)

    def _note(self, axis: int, value: Value) -> None:
        what = "write" if value.operation == WRITE_ERROR else "read"
        text = f"axis {axis}: {what} of register {value.register:03X}h refused, error {value.raw:g}"
        if text not in self._refused and len(self._refused) < 20:
            self._refused.append(text)

    @property
    def problems(self) -> list[str]:
        """What drives refused, and what they do otherwise than they were told, for people."""
        return [
            *self._refused,
            *(proof.problem for proof in self._proofs if proof.problem),
            *filter(None, self._astray),
        ]

    def _hear(self, axis: int, mode: int) -> None:
        self._mode[axis] = mode
        if mode in _UNPOWERED and self._stops[axis] > 1:  # an answer to an older command may say so
            self._stopping[axis] = False

        powered = mode not in (*_UNPOWERED, *_PREPARING)
        if powered and mode != Mode.POSITION:
            self._astray[axis] = f"axis {axis}: mode = {mode}; told {int(Mode.POSITION)} (position) or 0 (stopped)"
        elif powered:
            self._astray[axis] = ""

    def _status(self, axis: int, mode: int, fault: int) -> int:
        unproved = self._tick and not self._proofs[axis].proved  # who only listens asks nobody
        return self._status_by(axis, mode, fault) | (int(DriveStatus.FAULT) if unproved else 0)

    def _status_by(self, axis: int, mode: int, fault: int) -> int:
        if mode == Mode.FAULT:
            return int(DriveStatus.FAULT) | (int(DriveStatus.ENCODER_FAULT) if fault in _ENCODER_FAULTS else 0)
        if mode == Mode.TIMEOUT:
            return int(DriveStatus.WATCHDOG)
        limited = int(DriveStatus.TORQUE_LIMITED) if fault in _LIMITING else 0
        if mode == Mode.POSITION or (mode not in (*_UNPOWERED, *_PREPARING) and not self._enabled >> axis & 1):
            return int(DriveStatus.ENABLED) | limited  # powered in another mode: not as it was told
        return limited

    def _reject_id(self, can_id: int) -> Reject:
        if can_id & ERROR:
            return Reject.ERROR_FRAME
        if can_id & REMOTE:
            return Reject.WRONG_FORMAT if can_id & ~REMOTE in self._axis else Reject.UNKNOWN_ID
        if can_id & EXTENDED_MASK in self._axis:  # of the other length
            return Reject.WRONG_FORMAT
        return Reject.OWN_ECHO if can_id in self._own else Reject.UNKNOWN_ID

    def encode(self, command: Command) -> list[Frame]:
        """One frame a drive. Raises ValueError for a force not finite or beyond its rated force."""
        check_force(command.force, self._rated)
        self._clock.trigger()
        self._tick += 1
        begins, self._reset_before = command.reset and not self._reset_before, command.reset
        frames = []
        for axis, can_id in enumerate(self.command_ids):
            bit = command.enable >> axis & 1
            if begins:
                self._proofs[axis].begin()
            if bit:
                data = self._applying(axis, command.force[axis])
                self._stopping[axis], self._stops[axis] = True, 0
            elif command.reset or self._stopping[axis] or self._mode[axis] not in (*_UNPOWERED, -1):
                data = _STOP + self._asking(axis)
                self._stops[axis] += 1
            else:
                data = self._asking(axis) + self._proving(axis)
            frames.append(Frame(can_id, padded(data), FD | BRS))
        self._enabled = command.enable
        self._lead_ns = leads_ns(frames, *self._bitrates)
        return frames

    def _proving(self, axis: int) -> bytes:
        """What writes the registers of a drive without power, and reads one of them. Its answer is longer by that value
        and the command shorter than one that applies torque: together they are no longer than `messages` says.
        """
        number = self._proofs[axis].ask(self._tick)
        if number is None:
            return b""
        return self._watchdog + _NO_LOOP + read(_ASKED[number], Type.FLOAT)

    def messages(self, period_ns: int) -> list[Message]:
        """All of them every tick, commands as long as when torque is applied."""
        lengths = [len(padded(self._applying(axis, 0.0))) for axis in range(self.n_axes)]
        position = {Type.INT16: 2, Type.INT32: 4, Type.FLOAT: 4}[self._position_type]
        told = [3 + 2 + position + 3 + pins.answer_length for pins in self._pins]
        answers = [
            (len(padded(bytes(each))), len(padded(bytes(each + 2 + 4)))) for each in told
        ]  # the second: read back
        return [
            *(
                Message(f"command {axis}", can_id, lengths[axis], True, period_ns, period_ns, 0, "host")
                for axis, can_id in enumerate(self.command_ids)
            ),
            *(
                Message(
                    f"answer {axis}",
                    can_id,
                    answers[axis][0],
                    True,
                    period_ns,
                    period_ns,
                    0,
                    f"axis {axis}",
                    f"command {axis}",
                    also=(answers[axis][1],),
                )
                for axis, can_id in enumerate(self.answer_ids)
            ),
        ]


class MoteusListener(MoteusLayout):
    """DeviceProtocol of moteus: reads what the host tells the drives, without being one (sim_plant/drives/moteus.py).

    force_resolution: half of a torque's step as a fraction of the least rated force.
    """

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        n_axes, rated_force = wiring.n_axes, wiring.rated_force
        coarse = self._torque_type is not Type.FLOAT
        self.force_resolution = 0.5 * self._torque_step / min(rated_force) if coarse else 0.0
        self._axis = {can_id: axis for axis, can_id in enumerate(self.command_ids)}
        self._told = [(0.0, False, False)] * n_axes  # force, enabled, reset

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command that the last drive's frame completes; SERVICE for a part of one."""
        axis = self._axis.get(frame.can_id)
        if axis is None:
            return Reject.ERROR_FRAME if frame.can_id & ERROR else Reject.UNKNOWN_ID
        if not frame.flags & FD:
            return Reject.WRONG_FORMAT
        try:
            written = {value.register: value for value in parse(frame.data) if value.operation == WRITE}
        except ValueError:
            return Reject.WRONG_LENGTH
        mode = written[Register.MODE].number if Register.MODE in written else math.nan
        torque = written.get(Register.FEEDFORWARD_TORQUE)
        enabled = mode == Mode.POSITION
        force = torque.number if torque and enabled else 0.0
        if not abs(force) <= self._rated[axis] * (1 + 1e-6) + 0.5 * self._torque_step * self.force_resolution:
            return Reject.INVALID_VALUE
        self._told[axis] = (force, enabled, mode == Mode.STOPPED)
        if axis < self.n_axes - 1:
            return Reject.SERVICE
        enable = sum(1 << axis for axis, (_, enabled, _) in enumerate(self._told) if enabled)
        return Command(0, [force for force, _, _ in self._told], enable, any(reset for _, _, reset in self._told))

    def encode_feedback(self, sample: Sample) -> Frame:
        """The answer of one drive: mode and fault that mean the same as the sample's status."""
        status, mode, fault = sample.status, Mode.STOPPED, 0
        if status & DriveStatus.FAULT or status & DriveStatus.ENCODER_FAULT:
            mode, fault = Mode.FAULT, 35 if status & DriveStatus.ENCODER_FAULT else 33
        elif status & DriveStatus.WATCHDOG:
            mode = Mode.TIMEOUT
        elif status & DriveStatus.ENABLED:
            mode = Mode.POSITION
        raw = sample.position / COUNTS_PER_TURN / step_of(Register.POSITION, self._position_type)
        if self._position_type is not Type.FLOAT:
            most = (1 << (BITS[self._position_type] - 1)) - 1
            raw = max(-most, min(most, round(raw)))
        parts: tuple[tuple[int, Type, float], ...] = (
            (Register.MODE, Type.INT8, int(mode)),
            (Register.POSITION, self._position_type, raw),
            (Register.FAULT, Type.INT8, fault),
        )
        parts += self._pins[sample.axis].parts(status)
        data = b"".join(bytes((REPLY | write(*part)[0],)) + write(*part)[1:] for part in parts)
        return Frame(self.answer_ids[sample.axis], padded(data), FD | BRS)
