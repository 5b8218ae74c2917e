"""Windows of 128 ms in which something is followed: what the axes' accuracy is judged by, and baselines are made of."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hil.events.followed import followed

WINDOW_S: Final = 0.128
SLOW_LAG_S: Final = 0.008
SETTLED: Final = 2  # windows at rest before an axis counts as resting
FIELDS: Final = (
    "position", "following_error", "setpoint_position", "setpoint_velocity", "force", "innovation", "stamp_ns",
)  # fmt: skip
STAMP: Final = "stamp_ns"  # zeros where the records have none: who needs it takes samples as even then


class Window:
    """A whole one. at: place of its last tick in the records that were taken last."""

    def __init__(self, fields: dict[str, NDArray[Any]], at: int) -> None:
        self._fields, self.at = fields, at

    def axis(self, number: int) -> dict[str, NDArray[np.float64]] | None:
        """FIELDS of one axis, (ticks,); None where it lacks a sample."""
        if not self._fields["fresh"][:, number].all():
            return None
        return {name: np.ascontiguousarray(self._fields[name][:, number]) for name in FIELDS}


class Windows:
    """Cuts the ticks of a run into windows, which lie at fixed ticks however the records come."""

    def __init__(self, period_s: float) -> None:
        self.ticks = max(16, round(WINDOW_S / period_s))
        self.lag = max(2, round(SLOW_LAG_S / period_s))
        self._held: dict[str, NDArray[Any]] = {}

    @staticmethod
    def _names(records: NDArray[np.void] | Mapping[Any, NDArray[Any]]) -> list[str]:
        """Of what is cut, what these have: an export may lack the samples' instants."""
        names = records.dtype.names or () if isinstance(records, np.ndarray) else records
        return [name for name in (*FIELDS, "index", "state") if name != STAMP or name in names]

    def take(self, records: NDArray[np.void] | Mapping[Any, NDArray[Any]]) -> Iterator[Window | None]:
        """The windows that end in these ticks; None for one in which ticks are missing, or nothing was followed, or
        only now and then. records: or columns by name.
        """
        new: dict[str, NDArray[Any]] = {name: records[name] for name in self._names(records)}
        if STAMP not in new:
            new[STAMP] = np.zeros(new["position"].shape)
        new["followed"], new["fresh"] = followed(records), records["age_ticks"] == 0
        held = len(self._held["index"]) if self._held else 0
        if held:
            new = {name: np.concatenate((self._held[name], values)) for name, values in new.items()}
        numbers = new["index"] // self.ticks
        ends: list[int] = (np.flatnonzero(np.diff(numbers)) + 1).tolist()
        if len(numbers) and int(new["index"][-1]) % self.ticks == self.ticks - 1:
            ends.append(len(numbers))  # judged with its last tick, not with the next one
        begins = [0, *ends]
        self._held = {name: values[begins[-1] :].copy() for name, values in new.items()}
        for begin, end in zip(begins, ends, strict=False):
            fields = {name: values[begin:end] for name, values in new.items()}
            whole = end - begin == self.ticks and fields["followed"].all() and not np.ptp(fields["state"])
            yield Window(fields, end - 1 - held) if whole else None
