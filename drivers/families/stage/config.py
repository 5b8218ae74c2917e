"""What a rig says in [bus] of the project's own drives."""

from typing import Any

from drivers.base.keys import Table, key


class StageKeys(Table):
    """What this family adds to [bus]."""

    host_id: int = key(0x080, "stage layouts: identifier of the command frame", "1", ge=0, le=0x7FF)
    feedback_id: int = key(0x100, "stage layouts: axis i (from 0) answers on feedback_id + i", "1", ge=0, le=0x7F0)


def stage_keys(bus: Any) -> StageKeys:
    """The keys of this family in [bus]."""
    keys: StageKeys = bus
    return keys
