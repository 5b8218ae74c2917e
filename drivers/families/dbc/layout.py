"""What both ends of a dbc: layout share: the messages that the rig binds, checked against each other."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from drivers.arbitration import arbitration_key
from drivers.config import Wiring
from drivers.families.dbc.agreement import Owned, check_owners, check_torques, count_size, per_axis
from drivers.families.dbc.binding import (
    Pages,
    bound_items,
    bound_names,
    bound_signals,
    check_binding,
    check_numbers,
    refuse_selector,
)
from drivers.families.dbc.config import AskBinding, DbcBinding, FrameBinding, SignalBinding, StatusBinding, dbc_keys
from drivers.families.dbc.endpoints import number_pages
from drivers.families.dbc.file import load_used
from drivers.families.dbc.identifiers import (
    Values,
    frame_look,
    heard_look,
    refuse_both_ways,
    refuse_hidden,
    refuse_one_page,
    tell_apart,
)
from drivers.families.dbc.named_pages import name_pages
from drivers.families.dbc.page import Bound, BoundMessage, Place
from drivers.families.dbc.vesc_reader import VescReader, vesc_ids
from drivers.frame import REMOTE
from drivers.protocols.base import EVERY_STATUS, DriveStatus, LayoutError
from drivers.protocols.read_back import Question

_NUMBERS = ("bus.dbc.position", "bus.dbc.torque", "bus.dbc.constant", "bus.dbc.read_back")
_CHECKSUM = "bus.dbc.checksum"
ENABLED, FAULT = int(DriveStatus.ENABLED), int(DriveStatus.FAULT)
COUNTS = 2.0**53  # beyond which a count is none that a float can tell from the next
_UNASKED = (
    "bus.dbc.read_back has no entry: whether the drives keep the mode and the limits that they were told is not asked"
)


class Lone(NamedTuple):
    """A frame that enables or disables by itself, and its raw values."""

    message: BoundMessage
    values: list[Any]


class Asked(NamedTuple):
    """A value that is read back: of which axis' drive, where in its answer, and the frame that asks for it."""

    axis: int
    answer: Bound
    ask: Lone
    question: Question


class Input(NamedTuple):
    """A digital input of an axis: its DriveStatus bit, and the raw values with which it is closed."""

    axis: int
    bit: int
    bound: Bound
    closed: frozenset[int]


class DbcLayout:
    """What both ends share: the bound messages. Raises LayoutError naming every signal that is not there.

    warnings: what is wrong with the file beside what is used of it, for people. unasked: what its drives are not asked.
    """

    name = "dbc"

    def __init__(self, wiring: Wiring) -> None:
        bus, n_axes, rated_force, _, base_dir = wiring
        binding = dbc_keys(bus).dbc
        if binding is None:
            raise LayoutError(f"bus.protocol = {bus.protocol!r} needs a table [bus.dbc] that binds its signals")
        path = base_dir / bus.file
        check_binding(binding, n_axes)
        self.n_axes = n_axes
        self._rated = list(rated_force)
        database, self.warnings = load_used(path, bound_names(binding))
        name_pages(database, bound_signals(binding))
        number_pages(database, binding, base_dir)
        self.unasked = () if binding.read_back or binding.vesc else (_UNASKED,)
        self._pages = Pages(database, binding, path.name)
        self._free_running = binding.feedback == "cyclic"
        self._bind(binding)
        self._sort(binding)
        self.positions: Sequence[tuple[float, float]] = [
            _reach(at.place, wrap) for at, wrap in zip(self._position, self._wrap, strict=True)
        ]
        self.count_sizes = [count_size(*pair) for pair in zip(self._position, binding.position, strict=True)]
        self.feedback_ns = round(binding.feedback_period_s * 1e9)
        self.state_ns = round(binding.state_period_s * 1e9) if self._state_only else 0
        if not self._state_only and binding.state_period_s != DbcBinding.model_fields["state_period_s"].default:
            raise LayoutError(
                "bus.dbc.state_period_s: no status, error or input is bound in a message without positions"
            )
        self.states = bool(self._status)
        self.stamp_wraps_ns: Sequence[int] = ()
        self.causes = bool(self._maps) and all(meanings is None for meanings in self._maps)
        self.resets = bool(self._reset)
        self.tells = self._carried()
        self.axis_tells = [sum(each.bit for each in self._inputs if each.axis == axis) for axis in range(n_axes)]
        self.checksum = all(message.checksum_at >= 0 for message in self._pages)
        self.fd = any(message.fd for message in self._pages)
        self._check_places(binding, path.name)
        self._check_identifiers(path.name)
        self._vesc = self._vesc_reader(binding, bus.bitrate, wiring.period_ns)
        self._check_agreement(binding)
        self._check_resets()
        self._check_zero()

    def _bind(self, binding: DbcBinding) -> None:
        """Every signal to its page."""
        for key, item in bound_items(binding):
            if not key.startswith((*_NUMBERS, _CHECKSUM)):
                self._bound(key, item).message.whole(key, item)
        self._position = self._all("position", binding.position)
        self._torque = self._all("torque", binding.torque)
        self._status = self._all("status", binding.status)
        self._enable = self._all("enable", binding.enable)
        self._reset = self._all("reset", binding.reset)
        self._error = self._all("error", binding.error)
        self._inputs = [
            Input(item.axis, int(DriveStatus[item.input.upper()]), bound, frozenset(item.closed))
            for item, bound in zip(binding.inputs, self._all("inputs", binding.inputs), strict=True)
        ]
        self._feedback = [bound.message for bound in self._position]
        constants = self._all("constant", binding.constant)
        self._constant = [(bound, item.value) for bound, item in zip(constants, binding.constant, strict=True)]
        self._echo = [
            self._bound(f"bus.dbc.feedback_counter[{axis}]", item, self._feedback[axis])
            for axis, item in enumerate(binding.feedback_counter)
        ]
        self._counters = self._all("command_counter", binding.command_counter)
        for at, checksum in enumerate(binding.checksum):
            for page in self._pages.of(f"{checksum.message}.{checksum.signal}"):
                refuse_selector(f"{_CHECKSUM}[{at}]", checksum, page)
                page.whole(f"{_CHECKSUM}[{at}]", checksum)
                page.protect(checksum)
        self._switch = [(item.on, item.off) for item in binding.enable]
        self._bit_per_axis = len(self._enable) == 1 and self._enable[0].place.bits > 1 and self._switch[0] == (1, 0)
        self._reset_switch = [(item.on, item.off) for item in binding.reset]
        self._maps = [_status_map(item) for item in binding.status]
        self._wrap = [item.wrap for item in binding.position]
        self._read_back = self._find_read_back(binding)
        self.sequence_modulus = 1 << self._counters[0].place.bits if self._counters else 0
        self._start, self._stop = (
            [Lone(*self._pages.alone(f"bus.dbc.{key}[{at}]", frame)) for at, frame in enumerate(frames)]
            for key, frames in (("start", binding.start), ("stop", binding.stop))
        )

    def _find_read_back(self, binding: DbcBinding) -> list[Asked]:
        found = []
        for at, item in enumerate(binding.read_back):
            key = f"bus.dbc.read_back[{at}]"
            question = Question(f"{item.message}.{item.signal}", item.least, item.most)
            answer = self._bound(key, item)
            ask = Lone(*self._pages.alone(key, _asking(key, item.ask, answer.message)))
            found.append(Asked(item.axis, answer, ask, question))
        return found

    def _vesc_reader(self, binding: DbcBinding, bitrate: int, period_ns: int) -> VescReader | None:
        """Who asks VESCs for their configurations, where the rig says so."""
        if binding.vesc is None:
            return None
        ids = vesc_ids([(bound.message.name, bound.message.can_id) for bound in self._torque])
        reader = VescReader(binding.vesc, ids, bitrate, period_ns)
        theirs = {*reader.asked_ids, *reader.heard_ids}
        for page in self._pages:
            if page.can_id in theirs:
                raise LayoutError(f"bus.dbc.vesc: {page.name} has an identifier in which VESCs are asked or answer")
        return reader

    def _carried(self) -> int:
        """DriveStatus bits that every axis' messages can tell."""
        tells = EVERY_STATUS if self._status else 0
        for bound, meanings in zip(self._status, self._maps, strict=True):
            tells &= (1 << bound.place.bits) - 1 if meanings is None else ENABLED | FAULT
        return tells | (FAULT if self._error else 0)

    def _all(self, key: str, items: Sequence[SignalBinding]) -> list[Bound]:
        return [self._bound(f"bus.dbc.{key}[{at}]", item) for at, item in enumerate(items)]

    def _bound(self, key: str, item: SignalBinding, beside: BoundMessage | None = None) -> Bound:
        return self._pages.bound(key, item, beside)

    def _sort(self, binding: DbcBinding) -> None:
        """Pages by when they are sent, and by what they tell."""
        carrying: dict[BoundMessage, int] = {}
        for group in (self._status, self._error):
            for axis, bound in enumerate(group):
                carrying.setdefault(bound.message, axis)
        for each in self._inputs:
            carrying.setdefault(each.bound.message, each.axis)
        self._state_only = {message: axis for message, axis in carrying.items() if message not in self._feedback}
        bound_commands = [*self._torque, *self._enable, *self._reset, *self._counters]
        commands = [bound.message for bound in [*bound_commands, *(bound for bound, _ in self._constant)]]
        self._requests = self._find_requests(binding)
        occasional = {name: self._named("on_change", name, commands) for name in binding.on_change}
        commands += [page for pages in occasional.values() for page in pages]
        asked_or_said = [*commands, *self._requests]
        periodic = {item.message: self._named("periodic", item.message, asked_or_said) for item in binding.periodic}
        commands += [page for pages in periodic.values() for page in pages if page not in self._requests]
        self._commands = sorted(dict.fromkeys(commands), key=lambda message: arbitration_key(message.can_id))
        others = [*self._torque, *self._enable, *self._counters, *(bound for bound, _ in self._constant)]
        carried = {bound.message for bound in others}
        self._on_change = {page for pages in occasional.values() for page in pages}
        self._resets_alone = {bound.message for bound in self._reset if bound.message in self._on_change} - carried
        self._period_ns = {
            page: round(item.period_s * 1e9) for item in binding.periodic for page in periodic[item.message]
        }
        twice = self._on_change.intersection(self._period_ns)
        if twice:
            raise LayoutError(f"bus.dbc: {twice.pop().name} is in both on_change and periodic")
        seldom = self._on_change.union(self._period_ns)
        self._cyclic = [message for message in self._commands if message not in seldom]
        if any(bound.message in seldom for bound in self._torque) or not self._cyclic:
            key = "on_change" if self._on_change else "periodic"
            raise LayoutError(f"bus.dbc.{key} names a message with a torque, which is sent every tick")

    def _named(self, key: str, name: str, commands: Sequence[BoundMessage]) -> list[BoundMessage]:
        """The pages of a command message, or of a feedback message that is asked for. Raises LayoutError."""
        pages = self._pages.of(name)
        found = [page for page in pages if page in commands]
        if found:
            return found
        if pages:
            raise LayoutError(f"bus.dbc.{key}: {name!r} is no bound command message")
        return [self._pages.empty(f"bus.dbc.{key}", name)]

    def _find_requests(self, binding: DbcBinding) -> list[BoundMessage]:
        """The feedback messages that are asked for, once each."""
        requests: dict[int, BoundMessage] = {}
        for name in binding.remote:
            pages = [page for page in self._pages.of(name) if page in self._feedback or page in self._state_only]
            if not pages:
                raise LayoutError(f"bus.dbc.remote: {name!r} is no bound feedback message")
            if pages[0].fd:
                raise LayoutError(f"bus.dbc.remote: {name} is a CAN FD message, for which there are no remote frames")
            requests[pages[0].can_id] = pages[0]
        return [requests[can_id] for can_id in sorted(requests, key=arbitration_key)]

    def _trigger_id(self) -> int:
        """Identifier of the last frame of every tick, whose reception triggers the drives."""
        return REMOTE | self._requests[-1].can_id if self._requests else self._cyclic[-1].can_id

    def _check_identifiers(self, file: str) -> None:
        """An identifier belongs to one bound message, or bits tell their frames apart."""
        values = Values()
        for bound, value in self._constant:
            values.stated(bound, [value])
        for bound, switch in zip(self._enable, self._switch, strict=True):
            if self._bit_per_axis:
                values.free(bound)
            else:
                values.stated(bound, switch)
        for bound, switch in zip(self._reset, self._reset_switch, strict=True):
            values.stated(bound, switch[:1] if bound.message in self._resets_alone else switch)
        for bound in (*self._torque, *self._counters):
            values.free(bound)
        looks = [(page, values.look(page)) for page in self._commands]
        lone = [(page, frame_look(page, raw)) for page, raw in self._frames_alone()]
        refuse_one_page(self._commands, self._heard_pages(), file)
        refuse_hidden(looks, lone, file)
        tell_apart([*looks, *lone], file)
        tell_apart([(page, heard_look(page)) for page in self._heard_pages()], file)

    def _frames_alone(self) -> list[Lone]:
        """The frames that say something by themselves."""
        return [*self._start, *self._stop, *(asked.ask for asked in self._read_back)]

    def _heard_pages(self) -> list[BoundMessage]:
        """Once each."""
        answers = (asked.answer.message for asked in self._read_back)
        return list(dict.fromkeys([*self._feedback, *self._state_only, *answers]))

    def _check_places(self, binding: DbcBinding, file: str) -> None:
        """Counters echo beside their position; torques reach; nothing is both said and heard; values fit."""
        for axis, bound in enumerate(self._echo):
            if bound.message is not self._feedback[axis]:
                raise LayoutError(
                    f"bus.dbc.feedback_counter[{axis}] is in message {bound.message.name}; it has to be in "
                    f"{self._feedback[axis].name}, which carries position[{axis}]"
                )
        if len({(bound.message, bound.place.at) for bound in self._position}) != self.n_axes:
            raise LayoutError(f"{file}: two axes with one position; each axis needs a signal of its own in a message")
        refuse_both_ways([*self._commands, *(lone.message for lone in self._frames_alone())], self._heard_pages(), file)
        check_numbers(binding)
        self._check_values()
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
        for start, stop in zip(self._start, self._stop, strict=True):
            if start.message.frame(start.values) == stop.message.frame(stop.values):
                raise LayoutError(f"bus.dbc: start and stop are the same frame of {start.message.name}")

    def _check_values(self) -> None:
        """What is sent as it is stated fits its signal."""
        stated = [(f"constant[{at}]", bound.place, value) for at, (bound, value) in enumerate(self._constant)]
        for name, bounds, switches in (
            ("enable", self._enable, self._switch),
            ("reset", self._reset, self._reset_switch),
        ):
            for at, (bound, switch) in enumerate(zip(bounds, switches, strict=True)):
                stated += [(f"{name}[{at}]", bound.place, value) for value in switch]
        for key, place, value in stated:
            if not place.low <= value <= place.high:
                raise LayoutError(f"bus.dbc.{key}: raw value {value}: allowed {place.low:g} to {place.high:g}")

    def _check_agreement(self, binding: DbcBinding) -> None:
        """What the file says of units and nodes goes with what is bound."""
        check_torques(self._torque, binding.torque)
        told = [Owned(f"inputs[{at}]", each.axis, each.bound) for at, each in enumerate(self._inputs)]
        told += [*per_axis("status", self._status, self.n_axes), *per_axis("error", self._error, self.n_axes)]
        check_owners(told, self._position, "position")
        said = [*per_axis("enable", self._enable, self.n_axes), *per_axis("reset", self._reset, self.n_axes)]
        check_owners(said, self._torque, "torque")
        check_owners(per_axis("torque", self._torque, self.n_axes), self._position, "position")

    def _check_zero(self) -> None:
        """A drive that obeys any torque it hears has to be told of none."""
        if self._enable or self._start:
            return
        for message, place in self._torque:
            least = place.value(place.raw(0.0))
            if abs(least) > 1e-6 * abs(place.gain):
                raise LayoutError(
                    f"bus.dbc.torque: {message.name} has no number for 0, the nearest is {least:.3g}, and nothing "
                    "switches the drive off: bind enable, or start and stop"
                )

    def _check_resets(self) -> None:
        """A reset that is asked for by nothing but the message has to be alone in it."""
        for (message, _), (on, off) in zip(self._reset, self._reset_switch, strict=True):
            if on == off and message not in self._resets_alone:
                raise LayoutError(
                    f"bus.dbc.reset: on = off = {on} in {message.name}, which is sent for more than resets, or every "
                    "tick: it would say nothing"
                )


def _asking(key: str, ask: AskBinding, answer: BoundMessage) -> FrameBinding:
    """The frame that asks, with the number of the answer's page where it states none."""
    value = ask.value
    if value is None and ask.signal:
        numbers = answer.selection.get(ask.signal, frozenset())
        if len(numbers) != 1:
            raise LayoutError(
                f"{key}.ask: say which value {ask.message}.{ask.signal} has with `value`; no multiplexer {ask.signal} "
                f"in {answer.name} says it"
            )
        value = min(numbers)
    return FrameBinding(message=ask.message, signal=ask.signal, value=value or 0)


def _status_map(binding: StatusBinding) -> dict[int, int] | None:
    """DriveStatus bits by raw value; None where the raw value is the bits."""
    if not binding.enabled and not binding.fault:
        return None
    return dict.fromkeys(binding.enabled, ENABLED) | dict.fromkeys(binding.fault, FAULT)


def _reach(place: Place, wrap: float) -> tuple[float, float]:
    """Least and greatest position (counts) that a signal can tell; one that wraps is unwrapped (dbc.py)."""
    if wrap:
        return -COUNTS, COUNTS
    ends = place.value(place.low), place.value(place.high)
    return max(min(ends), -COUNTS), min(max(ends), COUNTS)
