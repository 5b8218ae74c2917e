"""The signals of a DBC file that a rig binds: found by name, and put onto the pages of their messages.

A signal that is there on some pages of a multiplexed message only is bound on these. One that is always there belongs
to the one page of its message that is bound otherwise. Where there is none, in feedback to any page, and in commands to
the page that a `constant` on the multiplexer names.
"""

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any

from cantools.database.can import Database
from cantools.database.can import Message as DbcMessage

from drivers.families.dbc.config import AskBinding, DbcBinding, FrameBinding, SignalBinding
from drivers.families.dbc.named_pages import pages_of
from drivers.families.dbc.page import Bound, BoundMessage, selection_of
from drivers.protocols.base import LayoutError

_COUNTERS = ("command_counter", "feedback_counter", "checksum")
_FEEDBACK = (
    "bus.dbc.position",
    "bus.dbc.status",
    "bus.dbc.error",
    "bus.dbc.feedback_counter",
    "bus.dbc.read_back",
    "bus.dbc.inputs",
)
_ALONE = {"bus.dbc.position", "bus.dbc.torque"}
_ONE_PER_AXIS = ("enable", "start", "stop")  # or one for all, or none


def check_binding(binding: DbcBinding, n_axes: int) -> None:
    """Lists have one entry per axis; counters come in pairs."""
    for key in ("position", "torque"):
        count = len(getattr(binding, key))
        if count != n_axes:
            raise LayoutError(f"bus.dbc.{key} has {count} signals for {n_axes} axes")
    for key in ("status", "error", "feedback_counter"):
        count = len(getattr(binding, key))
        if count not in (0, n_axes):
            raise LayoutError(f"bus.dbc.{key} has {count} signals for {n_axes} axes; it may also be left out")
    for key in _ONE_PER_AXIS:
        count = len(getattr(binding, key))
        if count not in (0, 1, n_axes):
            what = "signals" if key == "enable" else "frames"
            raise LayoutError(f"bus.dbc.{key} has {count} {what} for {n_axes} axes; it may also have one or none")
    for at, item in enumerate(binding.read_back):
        if item.axis >= n_axes:
            raise LayoutError(f"bus.dbc.read_back[{at}].axis = {item.axis}: 0 to {n_axes - 1} are there")
        if not item.least <= item.most:
            raise LayoutError(f"bus.dbc.read_back[{at}]: least = {item.least:g} is above most = {item.most:g}")
    _check_inputs(binding, n_axes)
    _check_pairs(binding)


def check_numbers(binding: DbcBinding) -> None:
    """A position or a torque has a signal to itself; positions of two axes in one are told elsewhere. Raises
    LayoutError.
    """
    told: dict[tuple[str, str], str] = {}
    for key, item in bound_items(binding):
        other = told.setdefault((item.message, item.signal), key)
        kinds = {other.partition("[")[0], key.partition("[")[0]}
        if other != key and kinds & _ALONE and kinds != {"bus.dbc.position"}:
            raise LayoutError(f"{key}: {item.message}.{item.signal} is {other} already; it needs a signal of its own")


def _check_inputs(binding: DbcBinding, n_axes: int) -> None:
    """Each of an axis that is there, and once."""
    seen: set[tuple[int, str]] = set()
    for at, item in enumerate(binding.inputs):
        if item.axis >= n_axes:
            raise LayoutError(f"bus.dbc.inputs[{at}].axis = {item.axis}: 0 to {n_axes - 1} are there")
        if (item.axis, item.input) in seen:
            raise LayoutError(f"bus.dbc.inputs[{at}]: {item.input} of axis {item.axis} is bound twice")
        seen.add((item.axis, item.input))


def _check_pairs(binding: DbcBinding) -> None:
    """Keys that go together, or not."""
    if len(binding.start) != len(binding.stop):
        raise LayoutError("bus.dbc: start enables what stop disables; bind as many of one as of the other")
    if binding.feedback_period_s and binding.feedback != "cyclic":
        raise LayoutError("bus.dbc.feedback_period_s: triggered drives answer commands and have no period of their own")
    if binding.remote and binding.feedback == "cyclic":
        bound = {item.message for item in binding.position}
        polled = sorted(bound.intersection(binding.remote))
        if polled:
            raise LayoutError(f"bus.dbc.remote: {polled[0]} is asked for, so bus.dbc.feedback is not 'cyclic'")
    if binding.checksum_algorithm != DbcBinding.model_fields["checksum_algorithm"].default and not binding.checksum:
        raise LayoutError("bus.dbc.checksum_algorithm: no bus.dbc.checksum is bound that it would act on")
    if bool(binding.feedback_counter) != bool(binding.command_counter):
        raise LayoutError("bus.dbc: feedback_counter echoes command_counter; bind both or neither")


def bound_items(binding: DbcBinding) -> Iterator[tuple[str, SignalBinding]]:
    """Every bound signal, with its key in the rig file."""
    keys = ("position", "torque", "status", "error", "enable", "reset", "constant", "read_back", "inputs", *_COUNTERS)
    for key in keys:
        yield from ((f"bus.dbc.{key}[{at}]", item) for at, item in enumerate(getattr(binding, key)))


def bound_names(binding: DbcBinding) -> set[str]:
    """Names of all messages that the binding uses."""
    names = {item.message for _, item in bound_items(binding)}
    names |= {item.message for item in (*binding.start, *binding.stop)}
    names |= {item.message for item in binding.periodic}
    names |= {item.ask.message for item in binding.read_back}
    names |= set(binding.on_change) | set(binding.remote)
    return {name.partition(".")[0] for name in names}


def bound_signals(binding: DbcBinding) -> set[tuple[str, str]]:
    """Names of message and signal of all that the binding names."""
    frames: list[FrameBinding | AskBinding] = [*binding.start, *binding.stop]
    frames += [item.ask for item in binding.read_back]
    pairs = {(item.message, item.signal) for _, item in bound_items(binding)}
    pairs |= {(item.message, item.signal) for item in frames}
    pairs |= {(frame.message, item.signal) for frame in (*binding.start, *binding.stop) for item in frame.constant}
    pages = [*binding.on_change, *(item.message for item in binding.periodic)]
    return pairs | {(message, signal) for message, _, signal in (name.partition(".") for name in pages)}


def refuse_selector(key: str, item: SignalBinding, page: BoundMessage) -> None:
    """Raise LayoutError for a signal that selects its page."""
    if item.signal in page.selection:
        raise LayoutError(
            f"{key}: {item.message}.{item.signal} is a multiplexer and says which page is bound: nothing but a "
            "bus.dbc.constant can be on it"
        )


class Pages:
    """All pages that a binding uses. Raises LayoutError with every name that is not in the file, and the nearest."""

    def __init__(self, database: Database, binding: DbcBinding, file: str) -> None:
        self._database, self._file = database, file
        self._algorithm = binding.checksum_algorithm
        self._pages: dict[str, list[BoundMessage]] = {}
        problems: list[str] = []
        for key, item in bound_items(binding):
            self._check(key, item.message, item.signal, problems)
        for key in ("start", "stop"):
            for at, frame in enumerate(getattr(binding, key)):
                self._check(f"bus.dbc.{key}[{at}]", frame.message, frame.signal, problems)
                for beside, item in enumerate(frame.constant):
                    self._check(f"bus.dbc.{key}[{at}].constant[{beside}]", frame.message, item.signal, problems)
        for at, asked in enumerate(binding.read_back):
            self._check(f"bus.dbc.read_back[{at}].ask", asked.ask.message, asked.ask.signal, problems)
        if problems:
            raise LayoutError("; ".join(problems))
        for key, item in bound_items(binding):
            self._open(key, item)
        for key, item in bound_items(binding):
            self._close(key, item)

    def __iter__(self) -> Iterator[BoundMessage]:
        return (page for pages in self._pages.values() for page in pages)

    def of(self, name: str) -> list[BoundMessage]:
        """The bound pages that MESSAGE or MESSAGE.SIGNAL names."""
        message, _, signal = name.partition(".")
        return [page for page in self._pages.get(message, []) if not signal or page.carries(signal)]

    def bound(self, key: str, item: SignalBinding, beside: BoundMessage | None = None) -> Bound:
        """The page that a signal is bound on, and its place there. beside: the page, where the signal is on it."""
        if beside is not None and beside.name == item.message and beside.carries(item.signal):
            page = beside
        else:
            page = self._page_of(key, item)
        if not key.startswith("bus.dbc.constant"):
            refuse_selector(key, item, page)
        return Bound(page, page.place(item))

    def _page_of(self, key: str, item: SignalBinding) -> BoundMessage:
        message = self._database.get_message_by_name(item.message)
        selection = selection_of(message, _signal(message, item.signal))
        pages = [page for page in self._pages[item.message] if page.carries(item.signal)]
        exact = [page for page in pages if page.selection == selection]
        if key.startswith("bus.dbc.constant") and not exact:
            exact = [page for page in pages if _names(page, item)]
        if not exact and len(pages) > 1 and key.startswith(_FEEDBACK):
            exact = [self._page(message, {})]
        if not exact and len(pages) > 1:
            raise LayoutError(
                f"{key}: {item.message}.{item.signal} is on {len(pages)} bound pages of a multiplexed message; bind "
                "the signals of one page"
            )
        return (exact or pages)[0]

    def alone(self, key: str, frame: FrameBinding) -> tuple[BoundMessage, list[Any]]:
        """A page for one frame that says something by itself, and its raw values."""
        message = self._database.get_message_by_name(frame.message)
        stated = _stated(key, frame)
        if not stated:
            if message.signals and not self.of(frame.message):
                raise LayoutError(f"{key}: message {frame.message} has signals; say which value with `signal`")
            page = BoundMessage(message, self._algorithm)
            return page, page.blank()
        page = BoundMessage(message, self._algorithm, _selection(key, message, stated))
        values = page.blank()
        for name, value in stated.items():
            place = page.place(SignalBinding(message=frame.message, signal=name))
            if not place.low <= value <= place.high:
                raise LayoutError(f"{key}: {frame.message}.{name} = {value}: allowed {place.low:g} to {place.high:g}")
            values[place.at] = value
        return page, values

    def empty(self, key: str, name: str) -> BoundMessage:
        """The page of a message without signals, which nothing can be bound in. Raises LayoutError for any other."""
        problems: list[str] = []
        self._check(key, name, "", problems)
        if problems:
            raise LayoutError(problems[0])
        message = self._database.get_message_by_name(name)
        if message.signals:
            raise LayoutError(f"{key}: no signal of {name!r} is bound: a bus.dbc.constant says what is in it")
        return self._page(message, {})

    def _check(self, key: str, name: str, signal: str, problems: list[str]) -> None:
        messages = [message for message in self._database.messages if message.name == name]
        if not messages:
            problems.append(f"{key}: {self._file} has no message {name!r}{_nearest(name, self._database.messages, '')}")
        elif len(messages) > 1:
            problems.append(f"{key}: {self._file} has {len(messages)} messages {name!r}; give them names of their own")
        elif signal:
            (message,) = messages
            found = sum(other.name == signal for other in message.signals)
            by_page = pages_of(signal, (other.name for other in message.signals))
            if not found and by_page:
                pages = " or ".join(map(repr, by_page))
                problems.append(f"{key}: {name}.{signal} stands on {len(by_page)} pages; name one: {pages}")
            elif not found:
                problems.append(
                    f"{key}: message {name} has no signal {signal!r}{_nearest(signal, message.signals, name + '.')}"
                )
            elif found > 1:
                problems.append(f"{key}: message {name} has {found} signals {signal!r}")

    def _page(self, message: DbcMessage, selection: dict[str, frozenset[int]]) -> BoundMessage:
        pages = self._pages.setdefault(str(message.name), [])
        for page in pages:
            if page.selection == selection:
                return page
        pages.append(BoundMessage(message, self._algorithm, selection))
        return pages[-1]

    def _open(self, key: str, item: SignalBinding) -> None:
        """A page for every signal that is not on all of them, and for every value that a multiplexer is told."""
        message = self._database.get_message_by_name(item.message)
        signal = _signal(message, item.signal)
        selection = selection_of(message, signal)
        if key.startswith("bus.dbc.constant") and signal.is_multiplexer:
            selection[item.signal] = frozenset({getattr(item, "value")})  # noqa: B009 (a ConstantBinding)
            if any(page.carries(item.signal) and _names(page, item) for page in self._pages.get(item.message, [])):
                return
        if selection or not message.is_multiplexed():
            self._page(message, selection)

    def _close(self, key: str, item: SignalBinding) -> None:
        """A page for the signals that are on all of them, where none is bound otherwise."""
        message = self._database.get_message_by_name(item.message)
        if any(page.carries(item.signal) for page in self._pages.get(item.message, [])):
            return
        if not key.startswith((*_FEEDBACK, "bus.dbc.checksum")):
            multiplexers = ", ".join(str(signal.name) for signal in message.signals if signal.is_multiplexer)
            raise LayoutError(
                f"{key}: message {item.message} is multiplexed; say which page it is with a bus.dbc.constant on "
                f"{multiplexers}"
            )
        self._page(message, {})


def _stated(key: str, frame: FrameBinding) -> dict[str, int]:
    """The raw values of a frame that says something by itself, by signal. Raises LayoutError for two of one signal."""
    stated = {frame.signal: frame.value} if frame.signal else {}
    for at, item in enumerate(frame.constant):
        if item.signal in stated:
            raise LayoutError(
                f"{key}.constant[{at}]: {frame.message}.{item.signal} = {item.value}: its value is stated as "
                f"{stated[item.signal]} already"
            )
        stated[item.signal] = item.value
    return stated


def _selection(key: str, message: DbcMessage, stated: Mapping[str, int]) -> dict[str, frozenset[int]]:
    """The page of all these signals. Raises LayoutError where there is none."""
    selection: dict[str, frozenset[int]] = {}
    for name, value in stated.items():
        signal = _signal(message, name)
        needs = selection_of(message, signal) | ({name: frozenset({value})} if signal.is_multiplexer else {})
        for multiplexer, numbers in needs.items():
            selection[multiplexer] = selection.get(multiplexer, numbers) & numbers
            if not selection[multiplexer]:
                raise LayoutError(
                    f"{key}: no value of the multiplexer {message.name}.{multiplexer} has a page with all of "
                    f"{', '.join(stated)}"
                )
    return selection


def _names(page: BoundMessage, item: SignalBinding) -> bool:
    """Whether a constant on a multiplexer is one of the values of the page."""
    return getattr(item, "value", None) in page.selection.get(item.signal, ())


def _signal(message: DbcMessage, name: str) -> Any:
    return next(signal for signal in message.signals if signal.name == name)


def _nearest(name: str, candidates: Sequence[Any], prefix: str) -> str:
    """'; did you mean ...?' with the nearest names, in any case; all of them where none is near."""
    names = [str(candidate.name) for candidate in candidates]
    lower = {candidate.lower(): candidate for candidate in reversed(names)}
    near = [lower[match] for match in get_close_matches(name.lower(), lower, n=3, cutoff=0.5)]
    if near:
        return f"; did you mean {' or '.join(prefix + candidate for candidate in near)}?"
    return f"; it has {', '.join(names[:8])}" + (", ..." if len(names) > 8 else "")
