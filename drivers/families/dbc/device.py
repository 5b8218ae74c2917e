"""The drives' side of a dbc: layout, for the emulated stage and for what reads commands off the bus."""

from collections.abc import Collection, Sequence
from typing import Any

from drivers.config import Wiring
from drivers.families.dbc.host import reject_id
from drivers.families.dbc.layout import ENABLED, FAULT, DbcLayout
from drivers.families.dbc.page import Bound, BoundMessage
from drivers.frame import REMOTE, Frame
from drivers.protocols.base import EVERY_STATUS, UNHEALTHY, Command, Reject, Sample

NEAREST = 0.5 + 1e-9  # steps between zero and the number beside it


class DbcDevice(DbcLayout):
    """DeviceProtocol of any DBC file: a command is whole once its last message came, after all the others.

    force_resolution: half of the coarsest axis' step as a fraction of its rated force.
    """

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        n_axes, rated_force = wiring.n_axes, wiring.rated_force
        self._by_id: dict[int, list[BoundMessage]] = {}
        for message in self._commands:
            self._by_id.setdefault(message.can_id, []).append(message)
        self._all_axes = (1 << n_axes) - 1
        self._lone: dict[tuple[int, bytes], tuple[int, bool]] = {}  # bit per axis, and whether it enables
        for lones, enables in ((self._stop, False), (self._start, True)):
            for number, lone in enumerate(lones):
                frame = lone.message.frame(lone.values)
                self._lone[frame.can_id, frame.data] = self._all_axes if len(lones) == 1 else 1 << number, enables
        self._lone_ids = {can_id for can_id, _ in self._lone}
        self._lone_ids |= {asked.ask.message.can_id for asked in self._read_back}
        self._lone_ids |= set(self._vesc.asked_ids if self._vesc else ())
        self._asked_ids = {REMOTE | message.can_id for message in self._requests}
        self._started = 0 if self._start else self._all_axes
        self._received: dict[BoundMessage, Sequence[Any]] = {}
        self._latest: list[Sample | None] = [None] * n_axes
        self._steps = [0.0 if bound.place.is_float else abs(bound.place.gain) for bound in self._torque]
        self.force_resolution = max(0.5 * step / rated for step, rated in zip(self._steps, rated_force, strict=True))

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command that this frame completes; SERVICE for a part of one, STALE where a part is missing."""
        if frame.can_id in self._asked_ids:
            return self._complete() if frame.can_id == self._trigger_id() else Reject.SERVICE
        lone = self._lone.get((frame.can_id, frame.data))
        if lone is not None:
            axes, enables = lone
            self._started = self._started | axes if enables else self._started & ~axes
            return Reject.SERVICE
        pages = self._by_id.get(frame.can_id)
        if pages is None:
            return Reject.SERVICE if frame.can_id in self._lone_ids else reject_id(frame.can_id, self._by_id, ())
        for page in pages:
            values = page.read(frame)
            if isinstance(values, Reject):
                return values
            if values is not None:
                self._received[page] = values
                return self._complete() if page is self._cyclic[-1] and not self._asked_ids else Reject.SERVICE
        return Reject.SERVICE  # a page that is not bound

    def _complete(self) -> Command | Reject:
        received = self._received
        self._received = {page: values for page, values in received.items() if page not in self._cyclic}
        reset = self._reset_asked(received)
        for page in self._resets_alone:
            self._received.pop(page, None)
        if len(received.keys() - self._resets_alone) != len(self._commands) - len(self._resets_alone):
            return Reject.STALE
        return self._assemble(received, reset=reset)

    def _reset_asked(self, received: dict[BoundMessage, Sequence[Any]]) -> bool:
        for (message, place), (on, _) in zip(self._reset, self._reset_switch, strict=True):
            values = received.get(message)
            if values is not None and (values[place.at] == on if on != 1 else values[place.at]):
                return True
        return False

    def _assemble(self, received: dict[BoundMessage, Sequence[Any]], *, reset: bool) -> Command | Reject:
        def raw(bound: Bound) -> Any:
            return received[bound.message][bound.place.at]

        force = [bound.place.value(raw(bound)) for bound in self._torque]
        for value, rated, bound in zip(force, self._rated, self._torque, strict=True):
            if not abs(value) <= rated + 0.5 * abs(bound.place.gain):  # rounding; also where it is not a number
                return Reject.INVALID_VALUE
        enable = self._started
        if self._enable:
            enable &= self._enabled([int(raw(bound)) for bound in self._enable])
        elif not self._start:  # the torque alone is permission
            enable = sum(1 << axis for axis, value in enumerate(force) if value)
        if enable & ~self._all_axes:
            return Reject.INVALID_VALUE
        counters = {int(raw(bound)) for bound in self._counters}
        if len(counters) > 1:
            return Reject.STALE  # parts of two commands
        force = [max(-rated, min(rated, value)) for value, rated in zip(force, self._rated, strict=True)]
        for axis, step in enumerate(self._steps):
            if not enable >> axis & 1 and abs(force[axis]) <= step * NEAREST:
                force[axis] = 0.0  # of a drive that is off: an offset may leave no number for zero
        return Command(max(counters, default=0), force, enable, reset)

    def _enabled(self, raw: Sequence[int]) -> int:
        """Bit per axis from the raw values of the enable signals."""
        if len(raw) == 1 < self.n_axes:
            return raw[0] if self._bit_per_axis else self._all_axes * (raw[0] == self._switch[0][0])
        return sum(1 << axis for axis, (bit, (on, _)) in enumerate(zip(raw, self._switch, strict=True)) if bit == on)

    def encode_feedback(self, sample: Sample) -> Frame:
        """The feedback message of one axis, with the latest of the others in it; a position beyond its signal's range
        stays at its end.
        """
        self._latest[sample.axis] = sample
        page = self._feedback[sample.axis]
        values = page.blank()
        for axis, message in enumerate(self._feedback):
            latest = self._latest[axis]
            if message is not page or latest is None:
                continue
            place, wrap = self._position[axis].place, self._wrap[axis]
            values[place.at] = place.raw(latest.position % wrap if wrap else latest.position)
            if self._echo:
                values[self._echo[axis].place.at] = latest.sequence % self.sequence_modulus
        self._put_states(page, values)
        return page.frame(values)

    def frames_of(self, sample: Sample) -> list[Frame]:
        """All messages that are due with the sample of one axis: those of several axes with the last of them."""
        feedback = self.encode_feedback(sample)
        page = self._feedback[sample.axis]
        last = max(axis for axis, message in enumerate(self._feedback) if message is page)
        frames = [feedback] if sample.axis == last else []
        for message, axis in self._state_only.items():
            if axis == sample.axis:
                values = message.blank()
                self._put_states(message, values)
                frames.append(message.frame(values))
        return frames

    def _put_states(self, message: BoundMessage, values: list[Any]) -> None:
        for axis, latest in enumerate(self._latest):
            if latest is not None:
                self._put_state(message, axis, latest.status, values)

    def _put_state(self, message: BoundMessage, axis: int, status: int, values: list[Any]) -> None:
        if self._status and self._status[axis].message is message:
            meanings = self._maps[axis]
            raw = status & EVERY_STATUS & (1 << self._status[axis].place.bits) - 1
            if meanings is not None:
                meant = FAULT if status & UNHEALTHY else ENABLED if status & ENABLED else 0
                raw = next((raw for raw, bits in meanings.items() if bits == meant), _unused(meanings))
            values[self._status[axis].place.at] = raw
        if self._error and self._error[axis].message is message:
            values[self._error[axis].place.at] = int(bool(status & UNHEALTHY))
        for each in self._inputs:
            if each.axis == axis and each.bound.message is message:
                values[each.bound.place.at] = min(each.closed) if status & each.bit else _unused(each.closed)


def _unused(meanings: Collection[int]) -> int:
    """The least raw value that means none of these."""
    return next(raw for raw in range(len(meanings) + 1) if raw not in meanings)
