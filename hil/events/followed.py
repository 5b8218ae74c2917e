"""Where setpoint and following error mean something: while the axes follow a task or goals, and nowhere else.

In FAULT, STOPPING or READY the cycle's record goes on holding numbers in these fields; nobody follows them. Whatever
shows or stores them asks here, so that all show the same.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import State

FIELDS: Final = ("setpoint_position", "setpoint_velocity", "following_error")
_FOLLOWING: Final = (int(State.HOMING), int(State.ACTIVE))


def followed(columns: Mapping[Any, NDArray[Any]] | NDArray[np.void]) -> NDArray[np.bool_]:
    """Ticks, (ticks,), in which a setpoint was followed. columns: by name, or records; of recordings made before there
    were goals, without "motion".
    """
    names = columns.dtype.names or () if isinstance(columns, np.ndarray) else columns
    moved = columns["motion"] != MotionWord.NONE if "motion" in names else False
    return np.isin(columns["state"], _FOLLOWING) & ((columns["task_ns"] >= 0) | moved)


def only_followed(columns: Mapping[Any, NDArray[Any]]) -> dict[Any, NDArray[Any]]:
    """The columns, (ticks,) or (ticks, axes), with NaN for FIELDS where nothing was followed."""
    where = followed(columns)[:, None]
    return {**columns, **{name: np.where(where, columns[name], np.nan) for name in FIELDS}}
