"""Frames in the words of a DBC file, for people."""

from collections.abc import Callable
from pathlib import Path

from cantools.database.can import Database, Message

from drivers.config import BusConfig
from drivers.families.dbc.binding import bound_names
from drivers.families.dbc.config import dbc_keys
from drivers.families.dbc.file import load_used
from drivers.frame import EXTENDED, EXTENDED_MASK, Frame

_BROADCAST = 240  # from this PDU format on, the second byte belongs to the parameter group (SAE J1939-21)


def reader(bus: BusConfig, base_dir: Path, cyclic: Callable[[Frame], str]) -> Callable[[Frame], str]:
    """For the file of a rig: its own words say more than those for samples and commands."""
    binding = dbc_keys(bus).dbc
    assert binding is not None  # the layout is made
    return dbc_reader(load_used(base_dir / bus.file, bound_names(binding))[0])


def dbc_reader(database: Database) -> Callable[[Frame], str]:
    """For a DBC file: message name, and each signal with its value, unit and name of the value where the file has
    them. Two messages with one identifier are both told. Messages of J1939 are found by their parameter group, with any
    source, destination and priority.
    """
    by_id: dict[int, list[Message]] = {}
    for message in database.messages:
        by_id.setdefault(message.frame_id | (EXTENDED if message.is_extended_frame else 0), []).append(message)
    by_group = {group_of(message.frame_id): message for message in database.messages if message.protocol == "j1939"}

    def text(frame: Frame) -> str:
        messages = by_id.get(frame.can_id, [])
        if not messages and frame.can_id & EXTENDED:
            message = by_group.get(group_of(frame.can_id & EXTENDED_MASK))
            return _told(message, frame, f" from {frame.can_id & 0xFF:02X}h") if message else ""
        return " or ".join(_told(message, frame, "") for message in messages)

    return text


def _told(message: Message, frame: Frame, source: str) -> str:
    """A frame as this message."""
    try:
        values = message.decode(frame.data, decode_choices=True, allow_truncated=True)
    except Exception as error:  # whatever the package makes of a payload that does not fit
        return f"{message.name}: {type(error).__name__} {error}"
    assert isinstance(values, dict)
    units = {signal.name: signal.unit or "" for signal in message.signals}
    shown = (f"{name} {_value(value)}{' ' * bool(units[name])}{units[name]}" for name, value in values.items())
    return f"{message.name}{source}: {', '.join(shown)}"


def group_of(can_id: int) -> int:
    """Parameter group number of an identifier of 29 bits (SAE J1939-21): without priority, source and destination."""
    group = can_id >> 8 & 0x3FFFF
    return group if group >> 8 & 0xFF >= _BROADCAST else group & 0x3FF00


def _value(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
