"""A DBC file as far as it is used: what is wrong with messages that nobody binds is a warning.

A file that cannot be read whole is read again with the bound messages alone, and what is said about them: their value
types, multiplexer ranges and tables of values.
"""

import re
from collections.abc import Collection
from pathlib import Path

from cantools.database.can import Database
from cantools.database.errors import Error as CantoolsError

from drivers.base.toml_file import short
from drivers.frame import FD_LENGTHS
from drivers.protocols.base import LayoutError
from drivers.protocols.dbc_codec import (
    LONGEST_CLASSIC,
    fd_by_length,
    is_fd,
    parse_dbc,
    read_dbc,
)

_MESSAGE = re.compile(r"^[ \t]*BO_[ \t]+(\d+)[ \t]+(\w+)[ \t]*:[^\n]*(?:\n[ \t]*SG_[ \t][^\n]*)*", re.M)
_PAGED = re.compile(r"^[ \t]*SG_[ \t]+(\w+[ \t]+m\d+)M?[ \t]*:", re.M)
_ABOUT = re.compile(r"^[ \t]*(?:SIG_VALTYPE_|SG_MUL_VAL_|VAL_)[ \t]+(\d+)[ \t][^;]*;", re.M)
_FRAME_FORMAT = re.compile(
    r'^[ \t]*(?:BA_DEF_[ \t]+BO_[ \t]+"(?:VFrameFormat|CANFD_BRS)"[^;]*;'
    r'|BA_DEF_DEF_[ \t]+"(?:VFrameFormat|CANFD_BRS)"[^;]*;'
    r'|BA_[ \t]+"(?:VFrameFormat|CANFD_BRS)"[ \t]+BO_[ \t]+(?P<id>\d+)[^;]*;)',
    re.M,
)
_MOST = 5  # warnings told one by one


def load_used(path: Path, names: Collection[str]) -> tuple[Database, list[str]]:
    """The file with at least the messages of these names, and what is wrong with the rest, for people. Raises
    LayoutError where a message of these names cannot be read, or there is none of them.
    """
    text = read_dbc(path)
    try:
        database = parse_dbc(text, path)
    except LayoutError as error:
        used = _only(text, names)
        if not used:
            raise
        database = parse_dbc(used, path)
        unfit = [f"{path.name}: read as far as it is used, not whole: {short(str(error), 200)}"]
    else:
        unfit = _unfit(database, path.name, names)
    return database, _guessed(database, path.name, names) + _unselected(text, database, path.name, names) + unfit


def _only(text: str, names: Collection[str]) -> str:
    """The bound messages of a file, and what is said about them; empty where there are none."""
    messages = [found for found in _MESSAGE.finditer(text) if found[2] in names]
    ids = {found[1] for found in messages}
    if not messages:
        return ""
    kept = [found[0] for found in messages]
    kept += [found[0] for found in _FRAME_FORMAT.finditer(text) if found["id"] is None or found["id"] in ids]
    kept += [found[0] for found in _ABOUT.finditer(text) if found[1] in ids]
    return 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_:\n\n' + "\n\n".join(kept) + "\n"


def _guessed(database: Database, file: str, names: Collection[str]) -> list[str]:
    """Which bound messages are taken as CAN FD for their length alone."""
    longer = [message for message in database.messages if message.name in names and fd_by_length(message)]
    said = ", ".join(f"{message.name} ({message.length} bytes)" for message in longer)
    return [f"{file}: taken as CAN FD, as no classic frame is so long: {said}"] if longer else []


def _unselected(text: str, database: Database, file: str, names: Collection[str]) -> list[str]:
    """Which signals of bound messages are on a page that no multiplexer selects."""
    problems = []
    multiplexed = {message.name for message in database.messages if message.is_multiplexed()}
    for found in _MESSAGE.finditer(text):
        paged = [] if found[2] in multiplexed or found[2] not in names else _PAGED.findall(found[0])
        if paged:
            said = short(", ".join(paged), 100)
            problems.append(f"{file}: message {found[2]} has no multiplexer (M), so it is read as one page: {said}")
    return problems


def _unfit(database: Database, file: str, names: Collection[str]) -> list[str]:
    """Messages that nobody binds and no frame could carry, or whose signals overlap."""
    problems = []
    for message in database.messages:
        if message.name in names:
            continue
        longest = FD_LENGTHS[-1] if is_fd(message) else LONGEST_CLASSIC
        if message.length > longest:
            problems.append(f"{file}: message {message.name} has {message.length} bytes, more than a frame")
            continue
        try:
            message.refresh(strict=True)
        except CantoolsError as error:
            problems.append(f"{file}: message {message.name}: {short(str(error), 150)}")
    if len(problems) > _MOST:
        problems[_MOST:] = [
            f"{file}: {len(problems) - _MOST} more messages that are not used are not as they should be"
        ]
    return problems
