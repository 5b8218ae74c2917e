"""`protocol = "dbc:<file>"`: drives that some other DBC file describes, bound to the rig by message and signal name.

Rules. What the binding (drivers.config.DbcBinding) means:
- position: one signal per axis, each in a message of its own (a frame gives one sample). counts = physical * scale.
- torque: one signal per axis, in any messages. N (N m) = physical * scale; it has to reach the rated force.
- enable: one signal per axis; or one for all, of a bit per axis, or of one bit (set while any axis is enabled). Without
  it disabled axes get zero torque.
- reset: clears latched faults; any number of signals. Without it the drives' own means have to.
- status: per axis, raw value = DriveStatus bits, or lists of values that mean enabled and fault. Without it a drive
  counts as enabled while it is told to be. It may come in a message of its own; it is then believed for half a second.
- error: per axis; anything but 0 is a fault.
- constant: signals of command messages that never change. on_change: command messages that are not sent every tick.
- command_counter, feedback_counter: the drives echo the commands' counter; both or none. Its length is the modulus;
  every command message may have one.
- checksum: any bound message's 8-bit checksum over its other bytes.

Theory of operation. The file is read once, before a bus is opened: dbc_binding.py finds the bound signals, and
dbc_codec.py compiles each message to shifts and masks on raw values. All command messages are sent every tick, the one
with the highest identifier last: its reception triggers the drives, as SYNC does. Frames of a DBC carry no sampling
time, so sampling_clock.py estimates it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drivers.arbitration import arbitration_key
from drivers.config import BusConfig, DbcBinding, SignalBinding, StatusBinding
from drivers.frame import ECHO, ERROR, REMOTE, Frame
from drivers.protocols.base import Command, DriveStatus, LayoutError, Message, Reject, Sample
from drivers.protocols.dbc_binding import Bound, BoundMessage, bind_messages, bound_items, check_binding
from drivers.protocols.dbc_codec import load_dbc
from drivers.protocols.sampling_clock import SamplingClock
from drivers.protocols.stage_common import STATUS_MASK, check_force

PREFIX = "dbc:"
ENABLED, FAULT = int(DriveStatus.ENABLED), int(DriveStatus.FAULT)
STATE_PERIOD_NS = 10_000_000  # least period of what is not sent every tick, for the schedulability analysis
STATE_TIMEOUT_NS = 500_000_000  # after which a state that came in such a message is no longer believed


class DbcLayout:
    """What both ends share: the bound messages. Raises LayoutError naming every signal that is not there."""

    name = "dbc"
    problems: Sequence[str] = ()

    def __init__(self, bus: BusConfig, n_axes: int, rated_force: Sequence[float], base_dir: Path) -> None:
        binding = bus.dbc
        if binding is None:
            raise LayoutError(f"bus.protocol = {bus.protocol!r} needs a table [bus.dbc] that binds its signals")
        path = base_dir / bus.protocol.removeprefix(PREFIX)
        check_binding(binding, n_axes)
        self.n_axes = n_axes
        self._rated = list(rated_force)
        self._messages = bind_messages(load_dbc(path), binding, path.name)
        for key, item in bound_items(binding):
            if not key.startswith(("bus.dbc.position", "bus.dbc.torque")):
                self._messages[item.message].whole(key, item)
        for checksum in binding.checksum:
            self._messages[checksum.message].protect(checksum)
        self._free_running = binding.feedback == "cyclic"
        self._position = [self._bound(item) for item in binding.position]
        ends = [sorted((at.place.value(at.place.low), at.place.value(at.place.high))) for at in self._position]
        self.positions: Sequence[tuple[float, float]] = [(low, high) for low, high in ends]
        self._torque = [self._bound(item) for item in binding.torque]
        self._status = [self._bound(item) for item in binding.status]
        self._enable = [self._bound(item) for item in binding.enable]
        self._reset = [self._bound(item) for item in binding.reset]
        self._error = [self._bound(item) for item in binding.error]
        self._constant = [(self._bound(item), item.value) for item in binding.constant]
        self._switch = [(item.on, item.off) for item in binding.enable]
        self._bit_per_axis = len(self._enable) == 1 and self._enable[0].place.bits > 1 and self._switch[0] == (1, 0)
        self._reset_switch = [(item.on, item.off) for item in binding.reset]
        self._maps = [_status_map(item) for item in binding.status]
        self._echo = [self._bound(item) for item in binding.feedback_counter]
        self._counters = [self._bound(item) for item in binding.command_counter]
        self.sequence_modulus = 1 << self._counters[0].place.bits if self._counters else 0
        bound_commands = [*self._torque, *self._enable, *self._reset, *self._counters]
        commands = [bound.message for bound in [*bound_commands, *(bound for bound, _ in self._constant)]]
        self._commands = sorted(dict.fromkeys(commands), key=lambda message: arbitration_key(message.can_id))
        self._on_change = {message.can_id for message in self._commands if message.name in binding.on_change}
        names = {message.name for message in self._commands}
        for name in binding.on_change:
            if name not in names:
                raise LayoutError(f"bus.dbc.on_change: {name!r} is no bound command message")
        self._cyclic = [message for message in self._commands if message.can_id not in self._on_change]
        if not {bound.message.can_id for bound in self._torque}.isdisjoint(self._on_change) or not self._cyclic:
            raise LayoutError("bus.dbc.on_change names a message with a torque, which is sent every tick")
        self._feedback = [bound.message for bound in self._position]
        carried = {bound.message: axis for group in (self._status, self._error) for axis, bound in enumerate(group)}
        self._state_only = {message: axis for message, axis in carried.items() if message not in self._feedback}
        self.checksum = all(message.checksum_at >= 0 for message in self._messages.values())
        self.fd = any(message.fd for message in self._messages.values())
        self._check_places(binding, path.name)

    def _bound(self, binding: SignalBinding) -> Bound:
        message = self._messages[binding.message]
        return Bound(message, message.place(binding))

    def _check_places(self, binding: DbcBinding, file: str) -> None:
        """Feedback signals of one axis share a message; each axis has its own; counters echo; torques reach."""
        for key, group in (("feedback_counter", self._echo),):
            for axis, bound in enumerate(group):
                if bound.message is not self._feedback[axis]:
                    raise LayoutError(
                        f"bus.dbc.{key}[{axis}] is in message {bound.message.name}; it has to be in "
                        f"{self._feedback[axis].name}, which carries position[{axis}]"
                    )
        if len({message.can_id for message in self._feedback}) != self.n_axes:
            raise LayoutError(f"{file}: two positions in one message; each axis needs a message of its own")
        for message in [*self._feedback, *self._state_only]:
            if message in self._commands:
                raise LayoutError(f"{file}: message {message.name} is bound both as command and as feedback")
        if len({bound.place.bits for bound in [*self._counters, *self._echo]}) > 1:
            raise LayoutError("bus.dbc: command_counter and feedback_counter have signals of different lengths")
        for axis, (bound, rated) in enumerate(zip(self._torque, self._rated, strict=True)):
            place = bound.place
            reach = min(abs(place.value(place.low)), abs(place.value(place.high)))
            if reach < rated * (1 - 1e-9) or not place.low <= -place.offset / place.gain <= place.high:
                raise LayoutError(
                    f"bus.dbc.torque[{axis}]: {bound.message.name}.{binding.torque[axis].signal} reaches +-{reach:g}; "
                    f"the rated force is {rated:g}: check its scale"
                )
        if self._bit_per_axis and self._enable[0].place.bits < self.n_axes:
            raise LayoutError(f"bus.dbc.enable has {self._enable[0].place.bits} bits; 1, or one per axis, is needed")

    def messages(self, period_ns: int) -> list[Message]:
        """All commands, then the feedbacks, which the last command triggers, and what is sent less often."""
        trigger = None if self._free_running else self._cyclic[-1].name
        slow_ns = max(period_ns, STATE_PERIOD_NS)
        return [
            *(Message(m.name, m.can_id, m.length, m.fd, period_ns, period_ns, 0, "host") for m in self._cyclic),
            *(
                Message(m.name, m.can_id, m.length, m.fd, period_ns, period_ns, 0, f"axis {axis}", trigger)
                for axis, m in enumerate(self._feedback)
            ),
            *(
                Message(m.name, m.can_id, m.length, m.fd, slow_ns, slow_ns, 0, f"axis {axis}")
                for m, axis in self._state_only.items()
            ),
            *(
                Message(m.name, m.can_id, m.length, m.fd, slow_ns, slow_ns, 0, "host")
                for m in self._commands
                if m not in self._cyclic
            ),
        ]


class DbcHost(DbcLayout):
    """HostProtocol of any DBC file."""

    def __init__(
        self, bus: BusConfig, n_axes: int, rated_force: Sequence[float], base_dir: Path, period_ns: int = 1_000_000
    ) -> None:
        super().__init__(bus, n_axes, rated_force, base_dir)
        self._clock = SamplingClock(n_axes, bus.bitrate, bus.data_bitrate, period_ns)
        self._axis = {message.can_id: axis for axis, message in enumerate(self._feedback)}
        self._states = {message.can_id: message for message in self._state_only}
        self._known = {*self._axis, *self._states}
        self._own = {message.can_id for message in self._commands}
        self.echo_id: int | None = None if self._free_running else self._cyclic[-1].can_id
        self._enabled = 0
        self._state, self._fault = [0] * n_axes, [0] * n_axes
        self._told_tick = [-STATE_TIMEOUT_NS] * n_axes  # when a message with a state alone came
        self._tick = 0
        self._state_ticks = STATE_TIMEOUT_NS // period_ns
        self._sent: dict[int, list[Any]] = {}

    def decode(self, frame: Frame) -> Sample | Reject:
        """Sample of a feedback message; its stamp is an estimate (sampling_clock.py). SERVICE for a state alone."""
        axis = self._axis.get(frame.can_id)
        if axis is None:
            if frame.flags & ECHO:
                self._clock.triggered(frame.timestamp_ns)
            state = self._states.get(frame.can_id)
            return self._decode_state(state, frame) if state else _reject_id(frame.can_id, self._known, self._own)
        message = self._feedback[axis]
        unfit = message.fits(frame)
        if unfit is not None:
            return unfit
        values = message.codec.unpack(frame.data)
        counts = self._position[axis].place.value(values[self._position[axis].place.at])
        if not -(2.0**53) <= counts <= 2.0**53:  # also where it is not a number
            return Reject.INVALID_VALUE
        if not self._note_state(message, values):
            return Reject.INVALID_VALUE
        sequence = int(values[self._echo[axis].place.at]) if self._echo else -1
        clock = self._clock
        stamp_ns = clock.begun(frame) if self._free_running else clock.instant(axis, frame)
        return Sample(axis, round(counts), self._status_of(axis), sequence, stamp_ns)

    def _decode_state(self, message: BoundMessage, frame: Frame) -> Reject:
        unfit = message.fits(frame)
        if unfit is not None:
            return unfit
        known = self._note_state(message, message.codec.unpack(frame.data))
        return Reject.SERVICE if known else Reject.INVALID_VALUE

    def _note_state(self, message: BoundMessage, values: Sequence[Any]) -> bool:
        """Keep what a message tells of drives; False where it has a status bit that nobody knows."""
        for axis, bound in enumerate(self._status):
            if bound.message is message:
                raw, meanings = int(values[bound.place.at]), self._maps[axis]
                if meanings is None and raw & ~STATUS_MASK:
                    return False
                self._state[axis] = raw if meanings is None else meanings.get(raw, 0)
                self._told_tick[axis] = self._tick
        for axis, bound in enumerate(self._error):
            if bound.message is message:
                self._fault[axis] = FAULT if values[bound.place.at] else 0
        return True

    def _status_of(self, axis: int) -> int:
        """What is known of a drive: nothing where it has been silent about its state for too long."""
        if not self._status:
            return self._enabled >> axis & ENABLED | self._fault[axis]
        if self._tick - self._told_tick[axis] > self._state_ticks:
            return self._fault[axis]
        return self._state[axis] | self._fault[axis]

    def encode(self, command: Command) -> list[Frame]:
        """All command messages that are due. Raises ValueError for a force not finite or beyond its rated force."""
        check_force(command.force, self._rated)
        self._enabled = enable = command.enable
        self._tick += 1
        self._clock.trigger()
        values = {message.can_id: [0] * len(message.codec.names) for message in self._commands}
        for (message, place), raw in self._constant:
            values[message.can_id][place.at] = raw
        for axis, (message, place) in enumerate(self._torque):
            values[message.can_id][place.at] = place.raw(command.force[axis] if enable >> axis & 1 else 0.0)
        if len(self._enable) == 1 < self.n_axes:
            ((message, place),), ((on, off),) = self._enable, self._switch
            switched = on if enable else off
            values[message.can_id][place.at] = enable if self._bit_per_axis else switched
        else:
            for axis, ((message, place), (on, off)) in enumerate(zip(self._enable, self._switch, strict=True)):
                values[message.can_id][place.at] = on if enable >> axis & 1 else off
        for (message, place), (on, off) in zip(self._reset, self._reset_switch, strict=True):
            values[message.can_id][place.at] = on if command.reset else off
        for message, place in self._counters:
            values[message.can_id][place.at] = command.sequence % self.sequence_modulus
        due = self._changed(values) + self._cyclic if self._on_change else self._commands
        return [message.frame(values[message.can_id]) for message in due]

    def _changed(self, values: dict[int, list[Any]]) -> list[BoundMessage]:
        """The messages that are sent on a change, and have one."""
        candidates = [message for message in self._commands if message.can_id in self._on_change]
        changed = [message for message in candidates if values[message.can_id] != self._sent.get(message.can_id)]
        self._sent |= {message.can_id: values[message.can_id] for message in changed}
        return changed


class DbcDevice(DbcLayout):
    """DeviceProtocol of any DBC file: a command is whole once its last message came, after all the others.

    force_resolution: half of the coarsest axis' step as a fraction of its rated force.
    """

    def __init__(self, bus: BusConfig, n_axes: int, rated_force: Sequence[float], base_dir: Path) -> None:
        super().__init__(bus, n_axes, rated_force, base_dir)
        self._by_id = {message.can_id: message for message in self._commands}
        self._received: dict[int, Sequence[Any]] = {}
        steps = [0.0 if bound.place.is_float else abs(bound.place.gain) for bound in self._torque]
        self.force_resolution = max(0.5 * step / rated for step, rated in zip(steps, rated_force, strict=True))
        self._all_axes = (1 << n_axes) - 1

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command that this frame completes; SERVICE for a part of one, STALE where a part is missing."""
        message = self._by_id.get(frame.can_id)
        if message is None:
            return _reject_id(frame.can_id, self._by_id, ())
        unfit = message.fits(frame)
        if unfit is not None:
            return unfit
        self._received[message.can_id] = message.codec.unpack(frame.data)
        if message is not self._cyclic[-1]:
            return Reject.SERVICE
        received = self._received
        self._received = {can_id: values for can_id, values in received.items() if can_id in self._on_change}
        if len(received) != len(self._commands):
            return Reject.STALE
        return self._assemble(received)

    def _assemble(self, received: dict[int, Sequence[Any]]) -> Command | Reject:
        def raw(bound: Bound) -> Any:
            return received[bound.message.can_id][bound.place.at]

        force = [bound.place.value(raw(bound)) for bound in self._torque]
        for value, rated, bound in zip(force, self._rated, self._torque, strict=True):
            if not abs(value) <= rated + 0.5 * abs(bound.place.gain):  # rounding; also where it is not a number
                return Reject.INVALID_VALUE
        enable = self._enabled([int(raw(bound)) for bound in self._enable])
        if enable & ~self._all_axes:
            return Reject.INVALID_VALUE
        counters = {int(raw(bound)) for bound in self._counters}
        if len(counters) > 1:
            return Reject.STALE  # parts of two commands
        force = [max(-rated, min(rated, value)) for value, rated in zip(force, self._rated, strict=True)]
        resets = zip(self._reset, self._reset_switch, strict=True)
        reset = any(raw(bound) == on if on != 1 else raw(bound) for bound, (on, _) in resets)
        return Command(max(counters, default=0), force, enable, reset)

    def _enabled(self, raw: Sequence[int]) -> int:
        """Bit per axis from the raw values of the enable signals."""
        if not raw:
            return self._all_axes
        if len(raw) == 1 < self.n_axes:
            return raw[0] if self._bit_per_axis else self._all_axes * (raw[0] == self._switch[0][0])
        return sum(1 << axis for axis, (bit, (on, _)) in enumerate(zip(raw, self._switch, strict=True)) if bit == on)

    def encode_feedback(self, sample: Sample) -> Frame:
        """The feedback message of one axis; a position beyond its signal's range stays at its end."""
        axis = sample.axis
        message = self._feedback[axis]
        values: list[Any] = [0] * len(message.codec.names)
        place = self._position[axis].place
        values[place.at] = place.raw(sample.position)
        self._put_state(message, axis, sample.status, values)
        if self._echo:
            values[self._echo[axis].place.at] = sample.sequence % self.sequence_modulus
        return message.frame(values)

    def encode_status(self, sample: Sample) -> list[Frame]:
        """The messages that carry the state of that axis' drive alone."""
        frames = []
        for message, axis in self._state_only.items():
            if axis == sample.axis:
                values: list[Any] = [0] * len(message.codec.names)
                self._put_state(message, axis, sample.status, values)
                frames.append(message.frame(values))
        return frames

    def _put_state(self, message: BoundMessage, axis: int, status: int, values: list[Any]) -> None:
        if self._status and self._status[axis].message is message:
            meanings = self._maps[axis]
            raw = status & STATUS_MASK
            if meanings is not None:
                meant = FAULT if status & FAULT else ENABLED if status & ENABLED else 0
                raw = next((raw for raw, bits in meanings.items() if bits == meant), _unused(meanings))
            values[self._status[axis].place.at] = raw
        if self._error and self._error[axis].message is message:
            values[self._error[axis].place.at] = int(bool(status & FAULT))


def _status_map(binding: StatusBinding) -> dict[int, int] | None:
    """DriveStatus bits by raw value; None where the raw value is the bits."""
    if not binding.enabled and not binding.fault:
        return None
    return dict.fromkeys(binding.enabled, ENABLED) | dict.fromkeys(binding.fault, FAULT)


def _unused(meanings: dict[int, int]) -> int:
    """The least raw value that means neither enabled nor fault."""
    return next(raw for raw in range(len(meanings) + 1) if raw not in meanings)


def _reject_id(can_id: int, known: Any, own: Any) -> Reject:
    """Why a frame whose identifier is none that is listened to carries nothing."""
    if can_id & ERROR:
        return Reject.ERROR_FRAME
    if can_id & REMOTE:
        return Reject.WRONG_FORMAT if can_id & ~REMOTE in known else Reject.UNKNOWN_ID
    return Reject.OWN_ECHO if can_id in own else Reject.UNKNOWN_ID
