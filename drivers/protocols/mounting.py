"""How drives are mounted on their axes: direction, gear and offset, in one place for every layout.

Everything above a layout is in the terms of the axis: positive where the rig says, N (N m) at the axis, counts from the
rig's zero. Everything in a layout is in the terms of the drive: its own direction, its motor's torque, its encoder's
counts. `MountedHost` stands between them at the edge of the control process, `MountedDevice` at the edge of what reads
commands off the bus. Drives mounted straight (the default) need neither, and cost nothing.
"""

from collections.abc import Sequence
from typing import NamedTuple

from drivers.frame import Frame
from drivers.protocols.base import (
    Command,
    DeviceProtocol,
    DriveStatus,
    HostProtocol,
    Message,
    Reject,
    Sample,
    echo_ids,
)

_LOW, _HIGH = int(DriveStatus.LIMIT_LOW), int(DriveStatus.LIMIT_HIGH)


class Mounting(NamedTuple):
    """One drive on its axis.

    direction: -1 where the drive's positive direction is the axis' negative one, else 1. gear: force (torque) at the
    axis per unit that the drive makes, > 0. offset: the axis' count where the drive's is 0.
    """

    direction: int = 1
    gear: float = 1.0
    offset: int = 0

    def force_at_drive(self, force: float) -> float:
        """What the drive has to make for a force (torque) at the axis."""
        return self.direction * force / self.gear

    def force_at_axis(self, force: float) -> float:
        """What a force (torque) of the drive is at the axis."""
        return self.direction * force * self.gear

    def count_at_axis(self, count: int) -> int:
        """The axis' position where the drive's is `count`."""
        return self.direction * count + self.offset

    def counts_at_axis(self, ends: tuple[float, float]) -> tuple[float, float]:
        """The same for both ends of a range, in the order of the drive's."""
        return self.direction * ends[0] + self.offset, self.direction * ends[1] + self.offset

    def status(self, status: int) -> int:
        """DriveStatus at the axis where it is that at the drive, and the other way round: a drive that is mounted
        backwards has its limit switches at the other ends.
        """
        if self.direction > 0 or not status & (_LOW | _HIGH):
            return status
        low, high = status & _LOW, status & _HIGH
        return status & ~(_LOW | _HIGH) | (_HIGH if low else 0) | (_LOW if high else 0)

    def count_at_drive(self, count: int) -> int:
        """The drive's position where the axis' is `count`."""
        return self.direction * (count - self.offset)


STRAIGHT = Mounting()


def is_straight(mountings: Sequence[Mounting]) -> bool:
    """Whether nothing has to be transformed."""
    return all(mounting == STRAIGHT for mounting in mountings)


class MountedHost:
    """A HostProtocol in the terms of the axes, on one in the terms of the drives (`layout`). mountings: theirs."""

    def __init__(self, layout: HostProtocol, mountings: Sequence[Mounting]) -> None:
        self.layout = layout
        self.mountings = list(mountings)
        self.name, self.n_axes = layout.name, layout.n_axes
        self.sequence_modulus, self.checksum = layout.sequence_modulus, layout.checksum
        self.states, self.causes, self.state_ns = layout.states, layout.causes, layout.state_ns
        self.resets = layout.resets
        self.tells, self.stamp_wraps_ns = layout.tells, layout.stamp_wraps_ns
        self.fd, self.echo_id, self.acts_ns = layout.fd, layout.echo_id, layout.acts_ns
        self.echo_ids: Sequence[int | None] = echo_ids(layout)
        self.positions: Sequence[tuple[float, float]] = [
            (min(mounting.counts_at_axis(ends)), max(mounting.counts_at_axis(ends)))
            for mounting, ends in zip(mountings, layout.positions, strict=True)
        ]

    @property
    def problems(self) -> Sequence[str]:
        """Why drives were refused, for people."""
        return self.layout.problems

    def decode(self, frame: Frame) -> Sample | Reject | tuple[Sample, ...]:
        """As the layout's, with the axis' position."""
        outcome = self.layout.decode(frame)
        if isinstance(outcome, Reject):
            return outcome
        for sample in (outcome,) if isinstance(outcome, Sample) else outcome:
            mounting = self.mountings[sample.axis]
            sample.position = mounting.count_at_axis(sample.position)
            sample.status = mounting.status(sample.status)
        return outcome

    def encode(self, command: Command) -> list[Frame]:
        """As the layout's, of what the drives have to make."""
        force = [mounting.force_at_drive(f) for mounting, f in zip(self.mountings, command.force, strict=True)]
        return self.layout.encode(Command(command.sequence, force, command.enable, command.reset))

    def messages(self, period_ns: int) -> list[Message]:
        """As the layout's."""
        return self.layout.messages(period_ns)


class MountedDevice:
    """A DeviceProtocol in the terms of the axes. force_resolution, enable_lag: the layout's, where it has them."""

    def __init__(self, layout: DeviceProtocol, mountings: Sequence[Mounting]) -> None:
        self._layout = layout
        self._mountings = list(mountings)
        self.name, self.n_axes = layout.name, layout.n_axes
        self.fd = bool(getattr(layout, "fd", False))
        self.sequence_modulus = int(getattr(layout, "sequence_modulus", 0))
        self.force_resolution = float(getattr(layout, "force_resolution", 0.0))
        self.enable_lag = int(getattr(layout, "enable_lag", 0))

    def decode_command(self, frame: Frame) -> Command | Reject:
        """As the layout's, in forces at the axes."""
        command = self._layout.decode_command(frame)
        if not isinstance(command, Command):
            return command
        force = [mounting.force_at_axis(f) for mounting, f in zip(self._mountings, command.force, strict=True)]
        return command._replace(force=force)

    def encode_feedback(self, sample: Sample) -> Frame:
        """As the layout's, of the drive's position."""
        mounting = self._mountings[sample.axis]
        position, status = mounting.count_at_drive(sample.position), mounting.status(sample.status)
        return self._layout.encode_feedback(Sample(sample.axis, position, status, sample.sequence, sample.stamp_ns))
