"""`protocol = "dbc:<file>"`: drives that some other DBC file describes, bound to the rig by message and signal name.

Rules. What the binding (drivers.config.DbcBinding) means:
- position: one signal per axis, in any messages; those of several axes in one message are sampled together.
  counts = physical * scale.
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
  nothing but reset signals is sent when a reset is asked for, and never else. One without signals is a frame of the
  start.
- start, stop: frames that enable and disable by themselves, beside enable or instead of it; stop at the start, too, and
  each again while a drive's state is another than it was told.
- periodic: sent so often, and at once when a value in it changes. remote: feedback that is asked for in every tick, or
  as periodic says. The positions among them are sampled when they are asked for.
- read_back: values that a drive is asked for, behind the commands: drivers/protocols/read_back.py has the rules. Until
  all are right the drive counts as in fault. vesc: likewise, of a VESC's configurations (vesc_reader.py).
- endpoints: of ODrives, which can then be told to home by themselves (odrive_homing.py).
- Signals of multiplexed messages are on pages of their own (dbc_binding.py).
- command_counter, feedback_counter: the drives echo the commands' counter; both or none. Its length is the modulus;
  every command message may have one.
- checksum: any bound message's 8-bit checksum over its other bytes.

Theory of operation. The file is read once, before a bus is opened: dbc_binding.py finds the bound signals, and
dbc_codec.py compiles each message to shifts and masks on raw values. All command messages are sent every tick, the one
with the highest identifier last: its reception triggers the drives, as SYNC does. Frames of a DBC carry no sampling
time, so sampling_clock.py estimates it.
"""

from collections.abc import Container, Sequence
from typing import Any, NamedTuple

from drivers.config import BusConfig, Wiring
from drivers.families.dbc.homers import DbcHomers
from drivers.families.dbc.layout import COUNTS, ENABLED, FAULT
from drivers.families.dbc.page import BoundMessage
from drivers.frame import ECHO, ERROR, REMOTE, Frame
from drivers.frame_length import INTERMISSION, frame_bits
from drivers.protocols.base import EVERY_STATUS, Command, Reject, Sample
from drivers.protocols.common import check_force
from drivers.protocols.read_back import ReadBack
from drivers.protocols.sampling_clock import SamplingClock

STATE_TIMEOUT_NS = 500_000_000  # after which a state that came in such a message is no longer believed
REPEAT_NS = 100_000_000  # after which an enabling or disabling message is sent again that was not obeyed


class Turns(NamedTuple):
    """Of a position that begins anew with every turn: the last one, and the counts of all turns since the first."""

    counts: float
    turned: float


class DbcHost(DbcHomers):
    """HostProtocol of any DBC file."""

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        bus, n_axes, period_ns = wiring.bus, wiring.n_axes, wiring.period_ns
        self._clock = SamplingClock(n_axes, bus.bitrate, bus.data_bitrate, period_ns)
        self._axes: dict[BoundMessage, list[int]] = {}
        for axis, message in enumerate(self._feedback):
            self._axes.setdefault(message, []).append(axis)
        self._heard: dict[int, list[BoundMessage]] = {}
        for message in [*self._state_only, *self._axes]:  # states first: a sample shows them
            self._heard.setdefault(message.can_id, []).append(message)
        lone = [lone.message.can_id for lone in (*self._start, *self._stop)]
        self._own = {*(message.can_id for message in self._commands), *lone}
        self._own |= {REMOTE | message.can_id for message in self._requests}
        self._answers = {asked.answer.message for asked in self._read_back}
        for message in self._answers:
            self._heard.setdefault(message.can_id, []).append(message)
        self._own |= {asked.ask.message.can_id for asked in self._read_back}
        self._own |= set(self._vesc.asked_ids if self._vesc else ())
        self._asked_of = [[asked for asked in self._read_back if asked.axis == axis] for axis in range(n_axes)]
        self._proofs = [
            ReadBack(f"axis {axis}", [asked.question for asked in theirs]) for axis, theirs in enumerate(self._asked_of)
        ]
        self._reset_before = False
        self.echo_id: int | None = None if self._free_running else self._trigger_id()
        self.acts_ns: Sequence[int] = self._find_acts(bus) if self._free_running else []
        self._enabled = 0
        self._state, self._fault = [0] * n_axes, [0] * n_axes
        self._switches = [0] * n_axes  # DriveStatus bits of the digital inputs
        self._inputs_of = [[each for each in self._inputs if each.axis == axis] for axis in range(n_axes)]
        self._input_tick = [[-STATE_TIMEOUT_NS] * len(theirs) for theirs in self._inputs_of]  # when each was told
        self._told_tick = [-STATE_TIMEOUT_NS] * n_axes  # when a message with a state alone came
        self._tick = 0
        self._state_ticks = STATE_TIMEOUT_NS // period_ns
        self._sent: dict[BoundMessage, list[Any] | None] = {}
        self._told: list[bool | None] = [None] * n_axes  # by start and stop
        self._turns: list[Turns | None] = [None] * n_axes
        self._feedback_ns = self.feedback_ns or period_ns
        self._repeat_ticks = max(1, REPEAT_NS // period_ns)
        self._switched_tick = [0] * n_axes  # when each axis was last told its enable
        constant = {bound.message for bound, _ in self._constant}
        self._occasional = sorted((m for m in self._commands if m not in self._cyclic), key=lambda m: m not in constant)
        self._period_ticks = {page: max(1, round(ns / period_ns)) for page, ns in self._period_ns.items()}
        self._asked = [(m, Frame(REMOTE | m.can_id, bytes(m.length))) for m in self._requests]

    def _find_acts(self, bus: BusConfig) -> list[int]:
        """When each axis' torque has been sent, on a bus that is free at the tick's start: the frames of every tick
        follow each other.
        """
        out_ns, sent_ns = {}, 0.0
        for message in self._cyclic:
            nominal, data = frame_bits(message.frame(message.blank()))
            sent_ns += (nominal + INTERMISSION) * 1e9 / bus.bitrate + data * 1e9 / bus.data_bitrate
            out_ns[message] = round(sent_ns)
        return [out_ns[bound.message] for bound in self._torque]

    def decode(self, frame: Frame) -> Sample | Reject | tuple[Sample, ...]:
        """The samples in a message, their stamps estimated (sampling_clock.py). SERVICE for a state alone; no sample
        for a part of an answer that is waited for.
        """
        if self._homing:
            self._hear_homing(frame)
        pages = self._heard.get(frame.can_id)
        if pages is None:
            return self._unbound(frame)
        samples: list[Sample] = []
        for page in pages:
            values = page.read(frame)
            if values is None:
                continue
            if isinstance(values, Reject):
                return values
            if page in self._answers:
                self._note_answer(page, values)
                continue
            if not self._note_state(page, values):
                return Reject.INVALID_VALUE
            for axis in self._axes.get(page, ()):
                sample = self._sample(axis, frame, values)
                if sample is None:
                    return Reject.INVALID_VALUE
                samples.append(sample)
        if not samples:
            return Reject.SERVICE
        return samples[0] if len(samples) == 1 else tuple(samples)

    def _unbound(self, frame: Frame) -> Reject | tuple[Sample, ...]:
        """What a frame is in an identifier that no feedback is bound to."""
        if self._vesc and self._vesc.hears(frame.can_id):
            refused = self._vesc.take(frame, self._tick)
            return () if refused is None else refused
        if frame.flags & ECHO:
            self._clock.triggered(frame.timestamp_ns)
        return reject_id(frame.can_id, self._heard, self._own)

    def _sample(self, axis: int, frame: Frame, values: Sequence[Any]) -> Sample | None:
        """The sample of one axis in a frame, None where it is no position."""
        place = self._position[axis].place
        counts = place.value(values[place.at])
        if self._wrap[axis]:
            counts = self._unwrapped(axis, counts)
        if not -COUNTS <= counts <= COUNTS:  # also where it is not a number
            return None
        if self._vesc:
            self._vesc.sampled(axis, self._tick)
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

    def _note_answer(self, page: BoundMessage, values: Sequence[Any]) -> None:
        for asked, proof in zip(self._asked_of, self._proofs, strict=True):
            for number, (_, (message, place), _, _) in enumerate(asked):
                if message is page:
                    proof.answer(number, place.value(values[place.at]), self._tick)

    def _note_state(self, message: BoundMessage, values: Sequence[Any]) -> bool:
        """Keep what a message tells of drives; False where it has a status bit that nobody knows."""
        for axis, bound in enumerate(self._status):
            if bound.message is message:
                raw, meanings = int(values[bound.place.at]), self._maps[axis]
                if meanings is None and raw & ~EVERY_STATUS:
                    return False
                self._state[axis] = raw if meanings is None else meanings.get(raw, 0)
                self._told_tick[axis] = self._tick
        for axis, bound in enumerate(self._error):
            if bound.message is message:
                fault = FAULT if values[bound.place.at] else 0
                if self._fault[axis] and not fault:
                    self._proofs[axis].begin()
                self._fault[axis] = fault
        self._note_inputs(message, values)
        return True

    def _note_inputs(self, message: BoundMessage, values: Sequence[Any]) -> None:
        for axis, theirs in enumerate(self._inputs_of):
            for number, (_, bit, bound, closed) in enumerate(theirs):
                if bound.message is message:
                    is_closed = int(values[bound.place.at]) in closed
                    self._switches[axis] = self._switches[axis] & ~bit | (bit if is_closed else 0)
                    self._input_tick[axis][number] = self._tick

    def _untold(self, axis: int) -> bool:
        """Whether an input was not told for too long; who only listens asks nobody."""
        return bool(self._tick) and any(self._tick - told > self._state_ticks for told in self._input_tick[axis])

    def _status_of(self, axis: int) -> int:
        """What is known of a drive: nothing where it has been silent about its state for too long."""
        proved = self._proofs[axis].proved and (self._vesc is None or self._vesc.proved(axis))
        unproved = self._tick and not proved  # who only listens asks nobody
        told = (FAULT if unproved else self._fault[axis]) | self._switches[axis]
        if not self._status:
            told |= self._enabled >> axis & ENABLED
        elif self._tick - self._told_tick[axis] <= self._state_ticks:
            told |= self._state[axis]
        homer = self._homers[axis]
        return (told if homer is None else homer.status(told)) | (FAULT if self._untold(axis) else 0)

    @property
    def problems(self) -> list[str]:
        """What drives were told and do not keep, for people."""
        told = [proof.problem for proof in self._proofs if proof.problem]
        told += [homer.problem for homer in self._odrives if homer.problem]
        return told + self._vesc.problems if self._vesc else told

    def encode(self, command: Command) -> list[Frame]:
        """All command messages that are due. Raises ValueError for a force not finite or beyond its rated force."""
        check_force(command.force, self._rated)
        enable = command.enable
        self._tick += 1
        asked = [homer.request(self._tick) for homer in self._odrives]
        if enable & ~self._enabled:
            self._sent.clear()  # a drive that has restarted since has forgotten
        for axis in range(self.n_axes):
            if (enable ^ self._enabled) >> axis & 1:
                self._switched_tick[axis] = self._tick
        self._enabled = enable
        self._clock.trigger()
        values = {message: message.blank() for message in self._commands}
        for (message, place), raw in self._constant:
            values[message][place.at] = raw
        for axis, (message, place) in enumerate(self._torque):
            homer = self._homers[axis]
            told = enable >> axis & 1 and (homer is None or not homer.by_itself)
            values[message][place.at] = place.raw(command.force[axis] if told else 0.0)
        self._put_enable(values, enable)
        for (message, place), (on, off) in zip(self._reset, self._reset_switch, strict=True):
            values[message][place.at] = on if command.reset else off
        for message, place in self._counters:
            values[message][place.at] = command.sequence % self.sequence_modulus
        due = self._due(values, reset=command.reset) if self._occasional else []
        frames = [message.frame(values[message]) for message in due]
        if self._start:
            frames += self._switching()
        frames += [message.frame(values[message]) for message in self._cyclic]
        if self._asked:
            frames += self._asking()
        if self._read_back or self._vesc:
            frames += self._reading_back(reset=command.reset)
        return [*frames, *(frame for frame in asked if frame is not None)]

    def _reading_back(self, *, reset: bool) -> list[Frame]:
        """The questions that are due."""
        frames: list[Frame] = []
        begins, self._reset_before = reset and not self._reset_before, reset
        if self._vesc:
            if begins:
                self._vesc.begin()
            frames += [] if self._enabled else self._vesc.ask(self._tick)
        homing = {homer.axis for homer in self._odrives if homer.busy}  # their values are others meanwhile
        for axis, (asked, proof) in enumerate(zip(self._asked_of, self._proofs, strict=True)):
            if begins:
                proof.begin()
            if axis in homing:
                proof.rest()
                continue
            number = proof.ask(self._tick)
            if number is not None:
                ask = asked[number].ask
                frames.append(ask.message.frame(ask.values))
        return frames

    def _put_enable(self, values: dict[BoundMessage, list[Any]], enable: int) -> None:
        if len(self._enable) == 1 < self.n_axes:
            ((message, place),), ((on, off),) = self._enable, self._switch
            switched = on if enable else off
            values[message][place.at] = enable if self._bit_per_axis else switched
            return
        for axis, ((message, place), (on, off)) in enumerate(zip(self._enable, self._switch, strict=True)):
            homer, wanted = self._homers[axis], on if enable >> axis & 1 else off
            values[message][place.at] = wanted if homer is None else homer.state(wanted)

    def _switching(self) -> list[Frame]:
        """The frames of start and stop that are due."""
        frames: list[Frame] = []
        for number, (start, stop) in enumerate(zip(self._start, self._stop, strict=True)):
            axes = range(self.n_axes) if len(self._start) == 1 else (number,)
            on = any(self._enabled >> axis & 1 for axis in axes)
            if self._told[number] is not on or any(self._due_again(axis) for axis in axes):
                self._told[number] = on
                lone = start if on else stop
                frames.append(lone.message.frame(lone.values))
        return frames

    def _asking(self) -> list[Frame]:
        """The remote frames that are due."""
        ticks = self._period_ticks
        return [frame for page, frame in self._asked if self._tick % ticks.get(page, 1) == 0]

    def _due(self, values: dict[BoundMessage, list[Any]], *, reset: bool) -> list[BoundMessage]:
        """The messages that are not sent every tick and are now: constants first."""
        for axis in range(self.n_axes if self._enable else 0):
            if self._due_again(axis):
                bound = self._enable[axis] if len(self._enable) == self.n_axes else self._enable[0]
                self._sent.pop(bound.message, None)
        due = []
        for message in self._occasional:
            now: list[Any] | None = values[message]
            if message in self._resets_alone:
                now = values[message] if reset else None
            period = self._period_ticks.get(message, 0)
            if (period and self._tick % period == 0) or message not in self._sent or now != self._sent[message]:
                self._sent[message] = now
                if now is not None:
                    due.append(message)
        return due

    def _due_again(self, axis: int) -> bool:
        return self._disobeyed(axis) and (self._tick - self._switched_tick[axis]) % self._repeat_ticks == 0

    def _disobeyed(self, axis: int) -> bool:
        """Whether a drive says that its state is another than it was told."""
        if not (self._enable or self._start) or not self._status or not self._told_tick[axis] >= 0:
            return False
        return bool(self._state[axis] & ENABLED) != bool(self._enabled >> axis & 1)


def reject_id(can_id: int, known: Container[int], own: Container[int]) -> Reject:
    """Why a frame carries nothing whose identifier nobody listens to."""
    if can_id & ERROR:
        return Reject.ERROR_FRAME
    if can_id & REMOTE:
        if can_id in own:
            return Reject.OWN_ECHO
        return Reject.WRONG_FORMAT if can_id & ~REMOTE in known else Reject.UNKNOWN_ID
    return Reject.OWN_ECHO if can_id in own else Reject.UNKNOWN_ID
