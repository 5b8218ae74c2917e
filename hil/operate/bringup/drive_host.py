"""A rig's drives through its frame layout, without the control cycle: for procedures that bring them up."""

from collections.abc import Sequence
from pathlib import Path

from drivers.families.cia402.host import Cia402Host
from drivers.frame import ECHO, Frame
from drivers.protocols.base import DriveStatus, HostProtocol, Reject, Sample
from drivers.protocols.mounting import MountedHost
from hil.cycle.gate import TorqueGate
from hil.cycle.limits import force_limits
from hil.rig.layout import host_layout
from hil.rig.schema import RigConfig

_ENABLED = int(DriveStatus.ENABLED)


class DriveHost:
    """The rig's host, tick by tick: `take` what was received, then `push` or `zero` once; both through a torque gate.

    protocol: the layout, in the terms of the axes. cia402: the CANopen master in it, None under other layouts.
    samples: the newest of each axis. heard_ns: when it came. stamps: (axis, reception) of all in the last `take`.
    rejects: why the newest frame of an identifier was none.
    Raises ValueError for a rig its layout cannot carry.
    """

    def __init__(self, rig: RigConfig, base_dir: Path) -> None:
        self.rig = rig
        axes = list(rig.axes.values())
        self.protocol: HostProtocol = host_layout(rig, base_dir)
        layout = self.protocol.layout if isinstance(self.protocol, MountedHost) else self.protocol
        self.cia402 = layout if isinstance(layout, Cia402Host) else None
        self._resolution = [axis.encoder_resolution for axis in axes]
        self._gate = TorqueGate(self.protocol, force_limits(rig), 0)
        self._sequence = -1
        self.samples: list[Sample | None] = [None] * len(axes)
        self.heard_ns = [0] * len(axes)
        self.stamps: list[tuple[int, int]] = []
        self.rejects: dict[int, Reject] = {}

    def take(self, frames: Sequence[Frame], now_ns: int) -> None:
        """What was received since the last call."""
        self.stamps.clear()
        for frame in frames:
            outcome = self.protocol.decode(frame)
            if isinstance(outcome, Reject):
                if not frame.flags & ECHO:
                    self.rejects[frame.can_id] = outcome
                continue
            for sample in (outcome,) if isinstance(outcome, Sample) else outcome:
                self.stamps.append((sample.axis, frame.timestamp_ns))
                self.samples[sample.axis], self.heard_ns[sample.axis] = sample, now_ns
            self.rejects.pop(frame.can_id, None)

    def allow(self, axis: int, most_force: float) -> None:
        """From here on `push` may enable the drive of this axis, and no other, with at most so much force (N, N m), its
        limits in the rig file apart.
        """
        limits = force_limits(self.rig)
        limits[axis] = limits[axis]._replace(force=min(limits[axis].force, most_force))
        self._gate = TorqueGate(self.protocol, limits, 1 << axis)

    def push(self, axis: int, force: float) -> list[Frame]:
        """The frames of one tick, with force (N, N m) on the allowed axis; zero while its position is unknown."""
        request = [0.0] * len(self.samples)
        request[axis] = force
        positions = [self.position(place) or 0.0 for place in range(len(self.samples))]
        self._sequence += 1
        known = self.samples[axis] is not None
        return self._gate.release(request, positions, permitted=known, sequence=self._sequence)

    def force(self, axis: int) -> float:
        """Told to the drive of the axis in the latest tick, N (N m)."""
        return self._gate.force[axis]

    @property
    def started(self) -> bool:
        """Something was told to the drives."""
        return self._sequence >= 0

    def zero(self, *, reset: bool = False) -> list[Frame]:
        """The frames of one tick: zero force, every drive disabled. reset: the drives' reset bit."""
        self._sequence += 1
        return self._gate.zero(self._sequence, reset)

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
            theirs = f"axis {axis}:", f"axis {axis},"
            return next((text for text in self.protocol.problems if text.startswith(theirs)), "")
        node = self.cia402.nodes[axis]
        return node.problem or node.emergency

    @property
    def any_enabled(self) -> bool:
        """A drive says that it applies torque."""
        return any(sample is not None and sample.status & _ENABLED for sample in self.samples)
