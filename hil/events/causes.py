"""Why a fault came: what the records just before it say beyond the fault itself.

A silent axis may be a cable; it may as well be answers that came and were rejected, a whole bus that is cut, or this
computer, which was too busy. An error too large may be an encoder that shows one value. The records of the ticks before
tell these apart.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drivers.protocols.base import Reject
from hil.cycle.faults.row import RESET
from hil.events.axis_model import AxisModel
from hil.events.motion_causes import Cause, Motion, ringing, why_it_left
from hil.events.ringing import LONGEST
from hil.rig.schema import MAX_AXES

HELD: Final = 64  # ticks looked back on; of a swing LONGEST
_LATE: Final = 1  # ticks for which answers of all axes may be late before the bus is in question
_FIELDS: Final = (
    "index", "rejects", "age_ticks", "position", "setpoint_position", "setpoint_velocity", "following_error", "force",
)  # fmt: skip
_BUS: Final = "hil bus shows the frames"
_REPEATS: Final = "the drive or a gateway repeats old answers"
_OTHER: Final = "a drive of another layout, or damage in a gateway"
_TWICE: Final = (
    "a drive or a gateway sends them again, or two nodes have one identifier",
    "hil bus shows the frames; check the gateway, and the nodes' identifiers",
)
# Of answers that came and were not taken: what was wrong, whose doing it is, what to do.
_REJECTED: Final = {
    Reject.STALE: ("an old sequence number", _REPEATS, f"restart the drive; {_BUS}"),
    Reject.DUPLICATE: ("an old sequence number, answered before", _REPEATS, f"restart the drive; {_BUS}"),
    Reject.BAD_CHECKSUM: (
        "a wrong checksum",
        "damage in the drive or a gateway, which CAN's own checksum does not see",
        f"replace the drive or the gateway; {_BUS}",
    ),
    Reject.WRONG_LENGTH: ("a wrong length", _OTHER, f"check bus.protocol; {_BUS}"),
    Reject.WRONG_FORMAT: ("a wrong format", _OTHER, f"check bus.protocol and identifiers; {_BUS}"),
    Reject.INVALID_VALUE: ("a value beyond its range", _OTHER, f"check bus.protocol; {_BUS}"),
}


class History:
    """The last HELD ticks of an event stream. models: of every axis, or none."""

    def __init__(self, n_axes: int, period_s: float, models: Sequence[AxisModel] = ()) -> None:
        self._n_axes = min(n_axes, MAX_AXES)
        self._period_s, self._models = period_s, models
        self._kept: dict[str, NDArray[Any]] = {}
        self._now: NDArray[np.void] | None = None
        self._place = 0

    def begin(self, records: NDArray[np.void]) -> None:
        """These are looked at now."""
        self._now = records

    def look(self, place: int) -> None:
        """At this one of them."""
        self._place = place

    def end(self) -> None:
        """Keep the last of them for those that come."""
        if self._now is not None:
            self._kept = {name: self._column(name, len(self._now), LONGEST).copy() for name in _FIELDS}
        self._now = None

    def _column(self, name: str, end: int, ticks: int) -> NDArray[Any]:
        """The last `ticks` values of a field before place `end`, as far as they are there."""
        assert self._now is not None
        found: NDArray[Any] = self._now[name][max(0, end - ticks) : end]
        if end < ticks and self._kept:
            found = np.concatenate((self._kept[name], found))[-ticks:]
        return found

    def _last(self, name: str, ticks: int = HELD) -> NDArray[Any]:
        return self._column(name, self._place + 1, ticks)

    def silence(self) -> Cause | None:
        """Why axes do not answer in this tick; None where nothing more is known than that."""
        ages = self._last("age_ticks")[-1, : self._n_axes].astype(np.int64)
        silent = np.flatnonzero(ages)
        everyone = len(silent) == self._n_axes > 1
        axis = int(silent[0]) if len(silent) == 1 else -1
        ticks = min(int(ages.max(initial=0)), HELD - 1) or HELD - 1
        if (cause := self._rejections(ticks, int(ages.sum()), axis, everyone=everyone)) is not None:
            return cause
        if not everyone:
            alone = "this axis does not answer, the others do: its drive is off or its cable is loose"
            return Cause(alone, f"check the drive's supply and its cable, {RESET}", axis) if axis >= 0 else None
        skipped = int(np.sum(np.diff(self._last("index")) - 1))
        bus = f"look at the bus' adapter, supply and termination, {RESET}"
        if skipped:
            return Cause(f"this computer was too busy: it skipped {skipped} ticks just before", f"hil doctor, {RESET}")
        if ages.max() <= _LATE:
            late = "no axis answered in time: this computer, its adapter or the bus was late; it is not one cable"
            return Cause(late, "none, if it is rare; else hil doctor")
        why = "no axis answers: the bus is cut, or this computer or its adapter was held up; it is not one cable"
        return Cause(why, f"hil doctor; {bus}")

    def _rejections(self, ticks: int, missing: int, axis: int, *, everyone: bool) -> Cause | None:
        """Answers that came within the last ticks and were not taken."""
        counts = self._last("rejects").astype(np.int64)
        rejected = counts[-1] - counts[-1 - ticks] if len(counts) > ticks else counts[-1] - counts[0]
        found = {reason: int(rejected[reason]) for reason in _REJECTED if rejected[reason] > 0}
        if not found or 2 * sum(found.values()) < missing:  # others are silent besides
            return None
        worst = max(found, key=lambda reason: found[reason])
        if worst is Reject.DUPLICATE and not missing:
            return Cause(f"answers came twice ({found[worst]}): {_TWICE[0]}", f"{_TWICE[1]}, {RESET}", axis)
        what, why, action = _REJECTED[worst]
        number = sum(found.values())
        whose = " of all axes" if everyone else ""
        why = "the host or the bus: all axes at once" if everyone else why
        return Cause(f"answers{whose} came and were rejected ({number}), for {what}: {why}", f"{action}, {RESET}", axis)

    def why_it_left(self, axis: int) -> Cause | None:
        """Why the axis left its set-point."""
        return self.ringing(axis) or why_it_left(self._motion(axis, HELD), self._model(axis), self._period_s, axis)

    def ringing(self, axis: int) -> Cause | None:
        """Whether the axis swings to and fro by itself, and at what frequency."""
        return ringing(self._motion(axis, LONGEST + 1), self._model(axis), self._period_s, axis)

    def _motion(self, axis: int, ticks: int) -> Motion:
        names = ("position", "setpoint_position", "setpoint_velocity", "following_error", "force")
        return Motion(*(self._last(name, ticks)[:, axis] for name in names))

    def _model(self, axis: int) -> AxisModel | None:
        return self._models[axis] if axis < len(self._models) else None
