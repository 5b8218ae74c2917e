"""Frames in words, for people: what a frame means under a rig's layout, signal by signal."""

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cantools.database.can import Database

from drivers.config import BusConfig
from drivers.frame import ERROR, EXTENDED, FD, REMOTE, Frame
from drivers.protocols.base import Command, DriveStatus, LayoutError, Reject, Sample
from drivers.protocols.canopen import cia301
from drivers.protocols.canopen.emergency import emergency_words
from drivers.protocols.canopen.sdo import request_words, response_words
from drivers.protocols.mounting import Mounting

if TYPE_CHECKING:
    from drivers.protocols.base import DeviceProtocol, HostProtocol

Reader = Callable[[Frame], str]  # "" where it means nothing here

_COMMANDS = {command.value: command.name.lower().replace("_", " ") for command in cia301.NmtCommand}
_STATES = {state.value: state.name.lower().replace("_", "-") for state in cia301.NmtState}


def layout_reader(
    bus: BusConfig,
    axes: Sequence[str],
    rated_force: Sequence[float],
    base_dir: Path,
    mountings: Sequence[Mounting] = (),
) -> Reader:
    """For the layout of a rig. axes: their names; rated_force: N or N m of each. Raises LayoutError."""
    from drivers.protocols import device_protocol, host_protocol
    from drivers.protocols.dbc_binding import bound_names
    from drivers.protocols.dbc_file import load_used
    from drivers.protocols.dbc_layout import PREFIX

    if bus.protocol.startswith(PREFIX) and bus.dbc:
        return dbc_reader(load_used(base_dir / bus.protocol.removeprefix(PREFIX), bound_names(bus.dbc))[0])
    host = host_protocol(bus, len(axes), rated_force, base_dir, mountings=mountings)
    device: DeviceProtocol | None = None
    with contextlib.suppress(LayoutError):  # torques whose unit only the drive knows
        device = device_protocol(bus, len(axes), rated_force, base_dir, mountings)
    cyclic = _CyclicReader(host, device, axes)
    if bus.protocol != "cia402":
        return cyclic.text
    # What is heard is not for this master, which asked for nothing: only the process data are looked at by it.
    return lambda frame: service_text(frame) or cyclic.text(frame)


class _CyclicReader:
    """The samples and commands of one of our own layouts."""

    def __init__(self, host: "HostProtocol", device: "DeviceProtocol | None", axes: Sequence[str]) -> None:
        self._host, self._device, self._axes = host, device, axes

    def text(self, frame: Frame) -> str:
        """A sample or a command in words."""
        sample = self._host.decode(frame)
        if isinstance(sample, Sample):
            status = DriveStatus(sample.status).name or "not enabled"
            sequence = f", answers {sample.sequence}" if sample.sequence >= 0 else ""
            return f"{self._axes[sample.axis]}: position {sample.position}, {status}{sequence}"
        command = self._device.decode_command(frame) if self._device else sample
        if isinstance(command, Command):
            return command_text(command, self._axes)
        for reason in (sample, command):
            if reason in (Reject.WRONG_LENGTH, Reject.WRONG_FORMAT, Reject.BAD_CHECKSUM, Reject.INVALID_VALUE):
                return reason.name.lower().replace("_", " ")
        return ""


def command_text(command: Command, axes: Sequence[str]) -> str:
    """A command in words."""
    parts = [
        f"{name} {force:+.4g}{'' if command.enable >> axis & 1 else ' (disabled)'}"
        for axis, (name, force) in enumerate(zip(axes, command.force, strict=True))
    ]
    return f"force {', '.join(parts)}" + (", reset" if command.reset else "")


def service_text(frame: Frame) -> str:
    """CANopen's own traffic (CiA 301): NMT, SYNC, emergencies, heartbeats, SDO. Empty for process data."""
    can_id, data = frame.can_id, frame.data
    if frame.flags & FD or can_id & (EXTENDED | REMOTE | ERROR):
        return ""
    node, kind = can_id & 0x7F, can_id & 0x780
    if can_id == cia301.NMT_ID and len(data) == 2:
        return f"NMT {_COMMANDS.get(data[0], f'command {data[0]:#x}')}, {f'node {data[1]}' if data[1] else 'all nodes'}"
    if can_id == cia301.SYNC_ID:
        return "SYNC" + (f" {data[0]}" if len(data) == 1 else "")
    if kind == cia301.HEARTBEAT_ID and node and len(data) == 1:
        return f"node {node}: {_STATES.get(data[0] & 0x7F, f'state {data[0]:#x}')}"
    if len(data) != 8 or not node:
        return ""
    if kind in (cia301.EMCY_ID, 0x680):
        return f"node {node}: {emergency_words(data)}"
    if kind == cia301.SDO_REQUEST_ID:
        return f"to node {node}: {request_words(data)}"
    return f"node {node}: {response_words(data)}" if kind == cia301.SDO_RESPONSE_ID else ""


def dbc_reader(database: Database) -> Reader:
    """For a DBC file: message name, and each signal with its value, unit and name of the value where the file has
    them.
    """
    by_id = {
        message.frame_id | (EXTENDED if message.is_extended_frame else 0): message for message in database.messages
    }

    def text(frame: Frame) -> str:
        message = by_id.get(frame.can_id)
        if message is None:
            return ""
        try:
            values = message.decode(frame.data, decode_choices=True, allow_truncated=True)
        except Exception as error:  # whatever the package makes of a payload that does not fit
            return f"{message.name}: {type(error).__name__} {error}"
        assert isinstance(values, dict)
        units = {signal.name: signal.unit or "" for signal in message.signals}
        shown = (f"{name} {_value(value)}{' ' * bool(units[name])}{units[name]}" for name, value in values.items())
        return f"{message.name}: {', '.join(shown)}"

    return text


def _value(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
