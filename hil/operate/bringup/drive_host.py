"""A rig's drives through its frame layout, without the control cycle: for procedures that bring them up."""

from collections.abc import Sequence
from pathlib import Path

from drivers.frame import ECHO, Frame
from drivers.protocols import host_protocol
from drivers.protocols.base import Command, DriveStatus, HostProtocol, Reject, Sample
from drivers.protocols.canopen.host import Cia402Host
from drivers.protocols.mounting import MountedHost
from hil.rig.schema import RigConfig

_ENABLED = int(DriveStatus.ENABLED)


class DriveHost:
    """The rig's host, tick by tick: `take` what was received, then `command` once.

    protocol: the layout, in the terms of the axes. cia402: the CANopen master in it, None under other layouts.
    samples: the newest of each axis. heard_ns: when it came. rejects: why the newest frame of an identifier was none.
    Raises ValueError for a rig its layout cannot carry.
    """

    def __init__(self, rig: RigConfig, base_dir: Path) -> None:
        self.rig = rig
        axes = list(rig.axes.values())
        rated = [axis.rated_force for axis in axes]
        self.protocol: HostProtocol = host_protocol(rig.bus, len(axes), rated, base_dir, rig.period_ns, rig.mountings)
        layout = self.protocol.layout if isinstance(self.protocol, MountedHost) else self.protocol
        self.cia402 = layout if isinstance(layout, Cia402Host) else None
        self._resolution = [axis.encoder_resolution for axis in axes]
        self._zero = [0.0] * len(axes)
        self._sequence = -1
        self.samples: list[Sample | None] = [None] * len(axes)
        self.heard_ns = [0] * len(axes)
        self.rejects: dict[int, Reject] = {}

    def take(self, frames: Sequence[Frame], now_ns: int) -> None:
        """What was received since the last call."""
        for frame in frames:
            outcome = self.protocol.decode(frame)
            if isinstance(outcome, Sample):
                self.samples[outcome.axis], self.heard_ns[outcome.axis] = outcome, now_ns
                self.rejects.pop(frame.can_id, None)
            elif not frame.flags & ECHO:
                self.rejects[frame.can_id] = outcome

    def command(self, force: Sequence[float], enable: int) -> list[Frame]:
        """The frames of one tick. force: N or N m per axis. enable: bit i for axis i."""
        self._sequence += 1
        return self.protocol.encode(Command(self._sequence, force, enable, False))

    @property
    def started(self) -> bool:
        """Something was told to the drives."""
        return self._sequence >= 0

    def zero(self) -> list[Frame]:
        """The frames of one tick: zero force, every drive disabled."""
        return self.command(self._zero, 0)

    def position(self, axis: int) -> float | None:
        """Newest position, m (rad)."""
        sample = self.samples[axis]
        return None if sample is None else sample.position * self._resolution[axis]

    def status(self, axis: int) -> DriveStatus:
        """What the drive says of itself; nothing before its first sample."""
        sample = self.samples[axis]
        return DriveStatus(sample.status if sample else 0)

    def problem(self, axis: int) -> str:
        """What stands against the drive of one axis, in words; empty where nothing is known to."""
        if self.cia402 is None:
            return ""
        node = self.cia402.nodes[axis]
        return node.problem or node.emergency

    @property
    def any_enabled(self) -> bool:
        """A drive says that it applies torque."""
        return any(sample is not None and sample.status & _ENABLED for sample in self.samples)
