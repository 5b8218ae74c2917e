"""Signals that stand on several pages of a multiplexed message, named by page as a DBC file writes them: `S m2`.

Files have them in two ways: as several signals of one name, and as one signal with several values (SG_MUL_VAL_).
"""

import re
from collections import Counter
from collections.abc import Collection, Iterable
from copy import copy
from typing import Final

from cantools.database.can import Database, Message, Signal

from drivers.protocols.base import LayoutError

_BY_PAGE: Final = re.compile(r"(\w+) m(\d{1,9})")


def name_pages(database: Database, bound: Collection[tuple[str, str]]) -> None:
    """Name such signals of the bound messages by page. bound: names of message and signal, by page or not. Raises
    LayoutError where one is bound by page and without it, too.
    """
    by_message: dict[str, set[str]] = {}
    for name, signal in bound:
        by_message.setdefault(name, set()).add(signal)
    for message in database.messages:
        wanted = by_message.get(message.name)
        if wanted:
            _name_doubles(message)
            for by_page in sorted(wanted):
                _cut_out(message, by_page, wanted)


def pages_of(signal: str, names: Iterable[str]) -> list[str]:
    """Those of the names that are this signal on a page, by page."""
    found = (match for match in map(_BY_PAGE.fullmatch, names) if match and match[1] == signal)
    return [match[0] for match in sorted(found, key=lambda match: int(match[2]))]


def _name_doubles(message: Message) -> None:
    """Of several signals of one name, each that is on a page."""
    count = Counter(signal.name for signal in message.signals)
    for signal in message.signals:
        if count[signal.name] > 1 and signal.multiplexer_ids and not signal.is_multiplexer:
            signal.name = f"{signal.name} m{min(signal.multiplexer_ids)}"


def _cut_out(message: Message, by_page: str, wanted: Collection[str]) -> None:
    """Make a signal of its own of one page of a signal that is on several."""
    found = _BY_PAGE.fullmatch(by_page)
    signal = next((signal for signal in message.signals if found and signal.name == found[1]), None)
    if found is None or signal is None or signal.is_multiplexer or int(found[2]) not in (signal.multiplexer_ids or ()):
        return
    if signal.name in wanted:
        raise LayoutError(
            f"message {message.name}: {signal.name} is bound on page {by_page!r} and on all its pages; name the page "
            "each time"
        )
    others = [number for number in signal.multiplexer_ids or () if number != int(found[2])]
    message.signals.append(_on(signal, by_page, [int(found[2])]))
    if others:
        signal.multiplexer_ids = others
    else:
        message.signals.remove(signal)


def _on(signal: Signal, name: str, pages: list[int]) -> Signal:
    made = copy(signal)
    made.name, made.multiplexer_ids = name, pages
    return made
