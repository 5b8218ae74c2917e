"""Frames in words, for people: what a frame means under a rig's layout, signal by signal."""

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.base.plugins import load
from drivers.config import BusConfig
from drivers.families import family_of
from drivers.frame import Frame
from drivers.protocols.base import Command, DriveStatus, LayoutError, Reject, Sample
from drivers.protocols.mounting import Mounting

if TYPE_CHECKING:
    from drivers.protocols.base import DeviceProtocol, HostProtocol

Reader = Callable[[Frame], str]  # "" where it means nothing here


def layout_reader(
    bus: BusConfig,
    axes: Sequence[str],
    rated_force: Sequence[float],
    base_dir: Path,
    mountings: Sequence[Mounting] = (),
) -> Reader:
    """For the layout of a rig. axes: their names; rated_force: N or N m of each. Raises LayoutError."""
    from drivers.protocols import device_protocol, host_protocol

    host = host_protocol(bus, len(axes), rated_force, base_dir, mountings=mountings)
    device: DeviceProtocol | None = None
    with contextlib.suppress(LayoutError):  # torques whose unit only the drive knows
        device = device_protocol(bus, len(axes), rated_force, base_dir, mountings)
    cyclic = _CyclicReader(host, device, axes).text
    family = family_of(bus.protocol)
    if family is None or not family.reader:
        return cyclic
    reader: Reader = load(family.reader)(bus, base_dir, cyclic)
    return reader


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
