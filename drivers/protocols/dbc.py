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
- constant: signals of command messages that never change. on_change: command messages that are not sent every tick,
  but when a value in them changes, and all anew before drives are enabled, which may have restarted since: constants
  first. One that enables or disables is sent again while its drive's state is another than it was told. A message with
  nothing but reset signals is sent when a reset is asked for, and never else.
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
from typing import Any, NamedTuple

from drivers.config import BusConfig
from drivers.frame import ECHO, ERROR, REMOTE, Frame
from drivers.frame_length import INTERMISSION, frame_bits
from drivers.protocols.base import UNHEALTHY, Command, Reject, Sample
from drivers.protocols.dbc_binding import Bound, BoundMessage
from drivers.protocols.dbc_layout import COUNTS, ENABLED, FAULT, DbcLayout
from drivers.protocols.sampling_clock import SamplingClock
from drivers.protocols.stage_common import STATUS_MASK, check_force

STATE_TIMEOUT_NS = 500_000_000  # after which a state that came in such a message is no longer believed
REPEAT_NS = 100_000_000  # after which an enabling or disabling message is sent again that was not obeyed


class Turns(NamedTuple):
    """Of a position that begins anew with every turn: the last one, and the counts of all turns since the first."""

    counts: float
    turned: float


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
        self.acts_ns: Sequence[int] = self._find_acts(bus) if self._free_running else []
        self._enabled = 0
        self._state, self._fault = [0] * n_axes, [0] * n_axes
        self._told_tick = [-STATE_TIMEOUT_NS] * n_axes  # when a message with a state alone came
        self._tick = 0
        self._state_ticks = STATE_TIMEOUT_NS // period_ns
        self._sent: dict[int, list[Any] | None] = {}
        self._turns: list[Turns | None] = [None] * n_axes
        self._feedback_ns = self._feedback_period_ns or period_ns
        self._repeat_ticks = max(1, REPEAT_NS // period_ns)
        self._switched_tick = [0] * n_axes  # when each axis was last told its enable
        constant = {bound.message.can_id for bound, _ in self._constant}
        self._occasional = sorted(
            (m for m in self._commands if m.can_id in self._on_change), key=lambda m: m.can_id not in constant
        )

    def _find_acts(self, bus: BusConfig) -> list[int]:
        """When each axis' torque has been sent, on a bus that is free at the tick's start: the frames of every tick
        follow each other.
        """
        out_ns, sent_ns = {}, 0.0
        for message in self._cyclic:
            nominal, data = frame_bits(message.frame([0] * len(message.codec.names)))
            sent_ns += (nominal + INTERMISSION) * 1e9 / bus.bitrate + data * 1e9 / bus.data_bitrate
            out_ns[message.can_id] = round(sent_ns)
        return [out_ns[bound.message.can_id] for bound in self._torque]

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
        if self._wrap[axis]:
            counts = self._unwrapped(axis, counts)
        if not -COUNTS <= counts <= COUNTS:  # also where it is not a number
            return Reject.INVALID_VALUE
        if not self._note_state(message, values):
            return Reject.INVALID_VALUE
        sequence = int(values[self._echo[axis].place.at]) if self._echo else -1
        clock = self._clock
        own_time = self._free_running
        stamp_ns = clock.begun(axis, frame, self._feedback_ns) if own_time else clock.instant(axis, frame)
        return Sample(axis, round(counts), self._status_of(axis), sequence, stamp_ns)

    def _unwrapped(self, axis: int, counts: float) -> float:
        """The nearest of the positions that these counts can mean."""
        wrap, last = self._wrap[axis], self._turns[axis]
        if counts - counts != 0.0:  # no number
            return counts
        turned = 0.0 if last is None else last.turned + round((last.counts - counts) / wrap) * wrap
        self._turns[axis] = Turns(counts, turned)
        return counts + turned

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
        enable = command.enable
        self._tick += 1
        if enable & ~self._enabled:
            self._sent.clear()  # a drive that has restarted since has forgotten
        for axis in range(self.n_axes):
            if (enable ^ self._enabled) >> axis & 1:
                self._switched_tick[axis] = self._tick
        self._enabled = enable
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
        due = self._due(values, reset=command.reset) + self._cyclic if self._on_change else self._commands
        return [message.frame(values[message.can_id]) for message in due]

    def _due(self, values: dict[int, list[Any]], *, reset: bool) -> list[BoundMessage]:
        """The messages that are not sent every tick and are now: constants first."""
        for axis, told in enumerate(self._switched_tick):
            if self._disobeyed(axis) and (self._tick - told) % self._repeat_ticks == 0:
                bound = self._enable[axis] if len(self._enable) == self.n_axes else self._enable[0]
                self._sent.pop(bound.message.can_id, None)
        due = []
        for message in self._occasional:
            can_id = message.can_id
            now: list[Any] | None = values[can_id]
            if can_id in self._resets_alone:
                now = values[can_id] if reset else None
            if now != self._sent.get(can_id):
                self._sent[can_id] = now
                if now is not None:
                    due.append(message)
        return due

    def _disobeyed(self, axis: int) -> bool:
        """Whether a drive says that its state is another than it was told."""
        if not self._enable or not self._status or not self._told_tick[axis] >= 0:
            return False
        return bool(self._state[axis] & ENABLED) != bool(self._enabled >> axis & 1)


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
        reset = self._reset_asked(received)
        for can_id in self._resets_alone:
            self._received.pop(can_id, None)
        if len(received.keys() - self._resets_alone) != len(self._commands) - len(self._resets_alone):
            return Reject.STALE
        return self._assemble(received, reset=reset)

    def _reset_asked(self, received: dict[int, Sequence[Any]]) -> bool:
        for (message, place), (on, _) in zip(self._reset, self._reset_switch, strict=True):
            values = received.get(message.can_id)
            if values is not None and (values[place.at] == on if on != 1 else values[place.at]):
                return True
        return False

    def _assemble(self, received: dict[int, Sequence[Any]], *, reset: bool) -> Command | Reject:
        def raw(bound: Bound) -> Any:
            return received[bound.message.can_id][bound.place.at]

        force = [bound.place.value(raw(bound)) for bound in self._torque]
        for value, rated, bound in zip(force, self._rated, self._torque, strict=True):
            if not abs(value) <= rated + 0.5 * abs(bound.place.gain):  # rounding; also where it is not a number
                return Reject.INVALID_VALUE
        enable = self._enabled([int(raw(bound)) for bound in self._enable])
        if not self._enable:  # the torque alone is permission
            enable = sum(1 << axis for axis, value in enumerate(force) if value)
        if enable & ~self._all_axes:
            return Reject.INVALID_VALUE
        counters = {int(raw(bound)) for bound in self._counters}
        if len(counters) > 1:
            return Reject.STALE  # parts of two commands
        force = [max(-rated, min(rated, value)) for value, rated in zip(force, self._rated, strict=True)]
        return Command(max(counters, default=0), force, enable, reset)

    def _enabled(self, raw: Sequence[int]) -> int:
        """Bit per axis from the raw values of the enable signals."""
        if len(raw) == 1 < self.n_axes:
            return raw[0] if self._bit_per_axis else self._all_axes * (raw[0] == self._switch[0][0])
        return sum(1 << axis for axis, (bit, (on, _)) in enumerate(zip(raw, self._switch, strict=True)) if bit == on)

    def encode_feedback(self, sample: Sample) -> Frame:
        """The feedback message of one axis; a position beyond its signal's range stays at its end."""
        axis = sample.axis
        message = self._feedback[axis]
        values: list[Any] = [0] * len(message.codec.names)
        place = self._position[axis].place
        wrap = self._wrap[axis]
        values[place.at] = place.raw(sample.position % wrap if wrap else sample.position)
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
                meant = FAULT if status & UNHEALTHY else ENABLED if status & ENABLED else 0
                raw = next((raw for raw, bits in meanings.items() if bits == meant), _unused(meanings))
            values[self._status[axis].place.at] = raw
        if self._error and self._error[axis].message is message:
            values[self._error[axis].place.at] = int(bool(status & UNHEALTHY))


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
