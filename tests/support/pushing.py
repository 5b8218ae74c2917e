"""Torque on one axis of a rig whose drives are being brought up (hil/operate/bringup)."""

import time
from collections.abc import Sequence

from drivers.frame import Frame
from drivers.protocols.base import DriveStatus
from hil.operate.bringup.drive_host import DriveHost

PATIENCE_S = 60.0


class Push:
    """Torque on one axis until its drive has been enabled for `ticks` ticks, or has a fault."""

    def __init__(self, host: DriveHost, axis: int, force: float, ticks: int) -> None:
        self.done, self.enabled = False, 0
        self._host, self._axis, self._force, self._ticks = host, axis, force, ticks
        self._deadline = time.monotonic() + PATIENCE_S
        host.allow(axis, force)

    def step(self, now_ns: int, frames: Sequence[Frame]) -> list[Frame]:
        self._host.take(frames, now_ns)
        status = self._host.status(self._axis)
        self.enabled += bool(status & DriveStatus.ENABLED)
        late = time.monotonic() > self._deadline
        self.done = self.enabled >= self._ticks or bool(status & DriveStatus.FAULT) or late
        return self._host.push(self._axis, self._force)
