"""The timing record: how punctual the loop is and what its ticks cost, without costing it anything to speak of.

Each tick counts up one bin in each of eight log-spaced histograms: every tick the same work, as one that folds what
others have left is what a loop's slowest ticks are made of. The counts are in the loop's own memory; a few times a
second each histogram is copied, one per tick, into one small memory-mapped file that anybody may read while the loop
runs. It is written in place and counts only grow, so a reader may see histograms of different ticks but never nonsense.
Nothing is kept per tick and no memory grows.
"""

import mmap
import os
import resource
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from librt.vecs import vec
from mypy_extensions import i64
from numpy.typing import NDArray

from drivers.base.runtime import read_private
from drivers.base.shared_map import map_shared
from hil.live.mapped_file import lay_out

STAGES = ("read", "estimate", "control", "gate", "send")
# lateness: wake against deadline. stages: time spent in each. cpu: CPU time from wake to wake.
# age: from the oldest of the newest samples to the sending of the torque computed from it. All ns.
METRICS: Final = ("lateness", *STAGES, "cpu", "age")

_SUB_BITS: Final = 4
SUB_BINS: Final = 1 << _SUB_BITS  # per octave: a quantile is known to 1/16
OCTAVES: Final = 36  # up to 2^36 ns = 69 s
BINS: Final = SUB_BINS * OCTAVES
WINDOW: Final = 4096  # ticks of the last complete window
SHOWN_NS: Final = 250_000_000  # readers see each histogram no older than this

MAGIC = b"HILTIME2"
TEXT_BYTES = 2048
COUNTERS = (
    "missed_own",
    "missed_host",
    "longest_streak",  # slots skipped in a row
    "run_delay_ns",  # waited for the core although runnable
    "major_faults",
    "minor_faults",
    "voluntary_switches",
    "involuntary_switches",
    "collector_runs",
)
_COUNTER_FIELDS: list[Any] = [(name, "<u8") for name in COUNTERS]
_LAYOUT = np.dtype(
    [
        ("magic", "S8"),
        ("pid", "<u8"),
        ("period_ns", "<u8"),
        ("realtime_ok", "<u8"),
        ("text_length", "<u8"),
        ("counters", np.dtype(_COUNTER_FIELDS)),
        ("maximum", "<i8", (len(METRICS),)),
        ("lifetime", "<u8", (len(METRICS), BINS)),
        ("window", "<u8", (len(METRICS), BINS)),
        ("text", "u1", (TEXT_BYTES,)),
    ]
)
_FIELDS: dict[str, Any] = dict(_LAYOUT.fields or {})
_LIFETIME_AT = int(_FIELDS["lifetime"][1])
_MAXIMUM_AT = int(_FIELDS["maximum"][1])


def bin_of(value: int) -> int:
    """Bin of a value (ns): 16 bins to the octave; values below 1 go to the first bin, above 2^36 to the last."""
    if value < 1:
        return 0
    octave = value.bit_length() - 1
    if octave >= OCTAVES:
        return BINS - 1
    return (octave << _SUB_BITS) + (value << _SUB_BITS >> octave) - SUB_BINS


def bin_edge(index: float) -> float:
    """Lower edge of a bin, ns."""
    octave, part = divmod(index, SUB_BINS)
    return float(2.0**octave * (1 + part / SUB_BINS))


def quantile(counts: NDArray[np.uint64], fraction: float) -> float:
    """Value below which `fraction` of the counted lie, ns, interpolated inside its bin; NaN without counts."""
    total = int(counts.sum())
    if not total:
        return float("nan")
    rank = fraction * total
    cumulative = np.cumsum(counts)
    index = min(int(np.searchsorted(cumulative, rank)), BINS - 1)
    below = int(cumulative[index - 1]) if index else 0
    inside = (rank - below) / max(int(counts[index]), 1)
    low, high = bin_edge(index), bin_edge(index + 1)
    return low + min(max(inside, 0.0), 1.0) * (high - low)


class TimingRecorder:
    """The control process's end. path: file to create. verdict: what the kernel granted, for readers."""

    def __init__(self, path: Path, period_ns: int, *, realtime_ok: bool, verdict: str) -> None:
        self.path = path
        self._map = _create(path)
        self._file = np.frombuffer(self._map, _LAYOUT, 1)[0]
        self._file["pid"] = os.getpid()
        self._file["period_ns"] = period_ns
        self._file["realtime_ok"] = realtime_ok
        text = verdict.encode()[:TEXT_BYTES]
        self._file["text"][: len(text)] = np.frombuffer(text, np.uint8)
        self._file["text_length"] = len(text)
        self._counters = self._file["counters"]
        self._lifetime = self._file["lifetime"]
        self._window = self._file["window"]
        self._before = np.zeros_like(self._lifetime)  # the lifetime's counts where the window began
        self._bins: vec[i64] = vec[i64]([0] * (len(METRICS) * BINS))
        size = 8 * BINS
        counted, shown = memoryview(self._bins).cast("B"), memoryview(self._map)[_LIFETIME_AT:]
        self._counted = [counted[size * metric : size * (metric + 1)] for metric in range(len(METRICS))]
        self._shown = [shown[size * metric : size * (metric + 1)] for metric in range(len(METRICS))]
        self._show_every = max(1, SHOWN_NS // period_ns // len(METRICS))  # ticks
        self._next_shown = 0
        self._longest: vec[i64] = vec[i64]([0] * len(METRICS))
        begin, end = _MAXIMUM_AT, _MAXIMUM_AT + 8 * len(METRICS)
        self._maximum, self._shown_maximum = memoryview(self._longest).cast("B"), memoryview(self._map)[begin:end]
        self._ticks = 0
        self._file["magic"] = MAGIC  # last: a reader that sees it sees a whole header

    def note(self, times: vec[i64]) -> None:
        """One tick: its METRICS in their order, ns."""
        bins, longest = self._bins, self._longest
        counted: i64
        for counted in range(len(METRICS)):
            value = times[counted]
            bins[counted * BINS + bin_of(value)] += 1
            if value > longest[counted]:
                longest[counted] = value
        self._ticks += 1
        metric = self._ticks % WINDOW
        if metric < len(METRICS) and self._ticks >= WINDOW:
            self._end_window(metric)
        elif self._ticks % self._show_every == 0:
            self._show(self._next_shown)
            self._next_shown = (self._next_shown + 1) % len(METRICS)

    def _show(self, metric: int) -> None:
        """Let readers see a histogram as it is now."""
        self._shown[metric][:] = self._counted[metric]
        self._shown_maximum[:] = self._maximum

    def show(self) -> None:
        """Let readers see all there is; for the loop's end."""
        for metric in range(len(METRICS)):
            self._show(metric)

    def _end_window(self, metric: int) -> None:
        """One metric a tick: what has come since the last window ended."""
        self._show(metric)
        counts = self._lifetime[metric]
        np.subtract(counts, self._before[metric], out=self._window[metric])
        self._before[metric] = counts

    def note_missed(self, own: int, host: int, streak: int) -> None:
        """Totals of slots lost to ourselves and to the host, and the longest run of them."""
        counters = self._counters
        counters["missed_own"], counters["missed_host"], counters["longest_streak"] = own, host, streak

    def note_usage(self, run_delay_ns: int, collector_runs: int) -> None:
        """Take stock of faults and switches of this thread; for now and then, not for every tick."""
        usage = resource.getrusage(resource.RUSAGE_THREAD)
        counters = self._counters
        counters["run_delay_ns"] = run_delay_ns
        counters["major_faults"] = usage.ru_majflt
        counters["minor_faults"] = usage.ru_minflt
        counters["voluntary_switches"] = usage.ru_nvcsw
        counters["involuntary_switches"] = usage.ru_nivcsw
        counters["collector_runs"] = collector_runs


def _create(path: Path) -> mmap.mmap:
    fd, temporary = lay_out(path, _LAYOUT.itemsize)
    try:
        mapped = map_shared(fd, _LAYOUT.itemsize)
    finally:
        os.close(fd)
    os.replace(temporary, path)
    return mapped


@dataclass(frozen=True)
class TimingSnapshot:
    """The timing file at one moment. lifetime, window: (metric, bin) counts; maximum: per metric, ns."""

    pid: int
    period_ns: int
    realtime_ok: bool
    verdict: str
    counters: dict[str, int]
    maximum: dict[str, int]
    lifetime: NDArray[np.uint64]
    window: NDArray[np.uint64]

    def quantile(self, metric: str, fraction: float, *, window: bool = False) -> float:
        """Quantile of one of METRICS over the lifetime or the last complete window, ns; NaN before the first chunk."""
        counts = self.window if window else self.lifetime
        return quantile(counts[METRICS.index(metric)], fraction)

    def summary(self, *, window: bool = False) -> dict[str, dict[str, float]]:
        """p50, p99, p999 of every metric, us, and its maximum over the lifetime."""
        fractions = {"p50": 0.5, "p99": 0.99, "p999": 0.999}
        return {
            metric: {
                **{name: self.quantile(metric, f, window=window) / 1e3 for name, f in fractions.items()},
                "max": self.maximum[metric] / 1e3,
            }
            for metric in METRICS
        }


def read_timing(path: Path) -> TimingSnapshot:
    """Snapshot of a timing file. Raises OSError when it is missing and ValueError when it is no timing file."""
    content = read_private(path)
    if len(content) != _LAYOUT.itemsize or content[: len(MAGIC)] != MAGIC:
        raise ValueError(f"{path}: not a timing file of this version")
    data = np.frombuffer(content, _LAYOUT, 1)[0]
    return TimingSnapshot(
        pid=int(data["pid"]),
        period_ns=int(data["period_ns"]),
        realtime_ok=bool(data["realtime_ok"]),
        verdict=bytes(data["text"][: int(data["text_length"])]).decode(errors="replace"),
        counters={"ticks": int(data["lifetime"][0].sum())} | {name: int(data["counters"][name]) for name in COUNTERS},
        maximum={name: int(value) for name, value in zip(METRICS, data["maximum"], strict=True)},
        lifetime=data["lifetime"].copy(),
        window=data["window"].copy(),
    )
