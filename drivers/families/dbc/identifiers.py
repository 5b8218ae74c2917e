"""Bound messages that share an identifier: legal where some bit is never the same in their frames.

Of a command every bit counts that no value changes: those of constants and multiplexers, and the zeros of signals that
are not bound. Of a feedback message those of its multiplexers count.
"""

from collections.abc import Collection, Sequence
from itertools import combinations
from typing import Any

from drivers.families.dbc.page import Bound, BoundMessage, Mark, as_number
from drivers.frame import EXTENDED_MASK
from drivers.protocols.base import LayoutError


class Values:
    """What a rig puts into its command messages: values that are stated, and values that may be anything."""

    def __init__(self) -> None:
        self._stated: dict[BoundMessage, dict[int, set[Any]]] = {}
        self._free: dict[BoundMessage, int] = {}

    def stated(self, bound: Bound, raw: Collection[Any]) -> None:
        """These are the only raw values that are sent."""
        self._stated.setdefault(bound.message, {}).setdefault(bound.place.at, set()).update(raw)

    def free(self, bound: Bound) -> None:
        """Any raw value is sent."""
        self._free[bound.message] = self._free.get(bound.message, 0) | bound.message.bits(bound.place.at)

    def look(self, page: BoundMessage) -> Mark:
        """The bits that are the same in every frame of a command message."""
        values = page.blank()
        stated = self._stated.get(page, {})
        for at, raws in stated.items():
            values[at] = min(raws)
        sent = as_number(page.codec.pack(*values))
        changing = self._free.get(page, 0) | _checksum(page)
        for at, raws in stated.items():
            changing |= _changing(page, values, at, raws)
        mask = as_number(b"\xff" * page.length) & ~changing
        return Mark(mask, sent & mask)


def frame_look(page: BoundMessage, values: Sequence[Any]) -> Mark:
    """All bits of one frame."""
    return Mark(as_number(b"\xff" * page.length), as_number(page.frame(values).data))


def heard_look(page: BoundMessage) -> Mark:
    """The bits of a page's multiplexers, as far as they are the same for all their values."""
    values = page.blank()
    changing = 0
    for at, raws in page.chosen:
        changing |= _changing(page, values, at, raws)
    mask = _multiplexers(page) & ~changing
    return Mark(mask, as_number(page.codec.pack(*values)) & mask)


def _multiplexers(page: BoundMessage) -> int:
    """The bits of a page's multiplexers."""
    mask = 0
    for at, _ in page.chosen:
        mask |= page.bits(at)
    return mask


def _changing(page: BoundMessage, values: Sequence[Any], at: int, raws: Collection[Any]) -> int:
    """The bits in which these values of one place differ."""
    changing, first = 0, as_number(page.codec.pack(*values))
    for raw in raws:
        changing |= first ^ as_number(page.codec.pack(*values[:at], raw, *values[at + 1 :]))
    return changing


def _checksum(page: BoundMessage) -> int:
    return as_number(bytes(page.checksum_at) + b"\xff") if page.checksum_at >= 0 else 0


def _apart(one: Mark, other: Mark) -> int:
    """The bits that are never the same in frames of these two looks."""
    return one.mask & other.mask & (one.bits ^ other.bits)


def tell_apart(looks: Sequence[tuple[BoundMessage, Mark]], file: str) -> None:
    """Mark the messages that share an identifier. Raises LayoutError for two whose frames may be the same."""
    by_id: dict[int, list[tuple[BoundMessage, Mark]]] = {}
    for page, look in looks:
        by_id.setdefault(page.can_id, []).append((page, look))
    for sharing in by_id.values():
        for (one, first), (other, second) in combinations(sharing, 2):
            if one.name == other.name:
                continue
            mask = _apart(first, second)
            if not mask:
                raise LayoutError(
                    f"{file}: messages {one.name} and {other.name} are both bound, on one identifier, "
                    f"{_shown(one)}: nothing tells them apart. A multiplexer, or in commands a bus.dbc.constant, has "
                    "to have another value in each"
                )
            one.marked(Mark(mask, first.bits & mask))
            other.marked(Mark(mask, second.bits & mask))


def refuse_one_page(said: Sequence[BoundMessage], heard: Sequence[BoundMessage], file: str) -> None:
    """Raise LayoutError for two bound pages of a message that may be one by their multiplexers: values of the one would
    be zero in frames of the other.

    Pages of feedback may be one within the other, and a signal that is on all pages is read on each.
    """
    pairs = [*combinations(said, 2), *((a, b) for a, b in combinations(heard, 2) if {*a.selection} == {*b.selection})]
    for one, other in pairs:
        shared = one.selection.keys() & other.selection.keys() if one.name == other.name else set()
        both = [min(one.selection[name] & other.selection[name], default=-1) for name in shared]
        if both and min(both) >= 0:
            raise LayoutError(
                f"{file}: message {one.name}: two of its bound pages are one by their multiplexers, so that their "
                f"frames would undo each other; name the page of a signal that is on several: 'SIGNAL m{min(both)}'"
            )


def refuse_hidden(
    looks: Sequence[tuple[BoundMessage, Mark]], lone: Sequence[tuple[BoundMessage, Mark]], file: str
) -> None:
    """Raise LayoutError for a frame that says something by itself and may be a command of its own message."""
    for page, frame in lone:
        for command, look in looks:
            if command.name == page.name and not _apart(look, frame):
                raise LayoutError(
                    f"{file}: message {page.name} is bound as command, and a frame of it stands in bus.dbc.start, stop "
                    "or read_back: a command may be the same frame. A signal with another value in each has to tell "
                    "them apart"
                )


def refuse_both_ways(said: Sequence[BoundMessage], heard: Sequence[BoundMessage], file: str) -> None:
    """Raise LayoutError for an identifier that both ends would send."""
    names = {page.can_id: page.name for page in said}
    for page in heard:
        command = names.get(page.can_id)
        if command == page.name:
            raise LayoutError(f"{file}: message {page.name} is bound both as command and as feedback")
        if command is not None:
            raise LayoutError(
                f"{file}: {command} is bound as command and {page.name} as feedback, on one identifier, "
                f"{_shown(page)}: each needs one of its own"
            )


def _shown(page: BoundMessage) -> str:
    return f"{page.can_id & EXTENDED_MASK:#x}"
