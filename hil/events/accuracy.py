"""Is the stage as accurate as it was? Quiet faults, which stop nothing: told from the records of ticks, none in a tick.

Windows of 128 ms in which a task, goals or homing are followed are judged one by one, axis by axis, at rest and in
motion apart. What is measured is robust: medians over a window, so that neither a contact nor a breakaway counts. A
window is held against the largest of the windows before it, and against bounds in encoder counts, below which nothing
is said. Two windows in a row beyond their bound are an event, which says what it looks like (its signature).

- noise, oscillation, periodic error: the second difference of the following error, over one tick (about 100 Hz and
  above) and over eight (15 to 100 Hz). Which of the three it is, its spectrum says: over time one line, over the travel
  one line, or neither.
- friction up, bias: what the forces say (forces.py).
- encoder jump: a step, in one tick, that neither the force nor friction explains. Those that are larger than the axis'
  speed allows are faults.
- encoder stuck: not one new count in a whole window, where the setpoint moved, or where an axis at rest showed many in
  every window before. An axis without noise rests on one count for ever, and is not suspected.
"""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.events.axis_model import AxisModel, Floats, steps
from hil.events.followed import followed
from hil.events.forces import ForceJudge

WINDOW_S: Final = 0.128
SLOW_LAG_S: Final = 0.008
SETTLED: Final = 2  # windows at rest before an axis counts as resting
KNOWN: Final = 4  # windows before what they showed is a reference
FACTOR: Final = 3.0  # beyond the largest of those
LOST_IN: Final = 2  # windows in a row
LINE: Final = 0.4  # share of the spectrum's power that makes a line
CALM: Final = 16  # good windows in a row, after which the same is told again
_SPAN, _SHORTEST = 200.0, 8.0  # counts: least travel, and least period along it, for an error that repeats along it
_UNLIKE: Final = 0.05  # a line in time is one along the travel, too, where the speed is constant
_STILL: Final = 0.3  # of ticks in which a resting axis with noise shows a new count
# Least bounds, in counts: at rest and in motion, of the fast and the slow difference; before and after there are KNOWN.
_LEAST: Final = {
    (True, "fast"): (6.0, 3.0),
    (True, "slow"): (60.0, 15.0),
    (False, "fast"): (60.0, 25.0),
    (False, "slow"): (np.inf, 60.0),  # a law that learns, or is just begun, follows by its own swing at first
}
_SINGLE: Final = 8  # ticks of a window, at most, that a jump or a few glitches fill
_GAUSS: Final = 0.6745 * 6.0**0.5  # of the median of |second difference| of white noise
_FIELDS: Final = ("index", "position", "following_error", "setpoint_position", "setpoint_velocity", "force")


class Loss(NamedTuple):
    """An axis that is not what it was. at: place of the window's last tick in the records. axis: 0-based."""

    at: int
    axis: int
    signature: str
    measured: str
    value: float
    limit: float
    unit: str
    cause: str
    action: str


class _Look(NamedTuple):
    """What a trembling axis looks like. words: what was measured besides. clear: it can be nothing else."""

    signature: str
    words: str
    cause: str
    action: str
    clear: bool = True


class AccuracyWatch:
    """Watches one run's axes. period_ns: of the control loop."""

    def __init__(self, axes: Sequence[AxisModel], period_ns: int) -> None:
        self._axes, self._period_s = list(axes), period_ns * 1e-9
        self._ticks = max(16, round(WINDOW_S / self._period_s))
        self._lag = max(2, round(SLOW_LAG_S / self._period_s))
        self._held: dict[str, NDArray[Any]] = {}
        self._judges = [_Judge(axis, self._period_s) for axis in self._axes]

    def take(self, records: NDArray[np.void]) -> list[Loss]:
        """What these ticks show, with those before them. The windows lie at fixed ticks, however the records come."""
        new: dict[str, NDArray[Any]] = {name: records[name] for name in _FIELDS}
        new["followed"] = followed(records)
        new["state"] = records["state"]
        new["fresh"] = records["age_ticks"] == 0
        held = len(self._held["index"]) if self._held else 0
        if held:
            new = {name: np.concatenate((self._held[name], values)) for name, values in new.items()}
        found: list[Loss] = []
        numbers = new["index"] // self._ticks
        ends: list[int] = (np.flatnonzero(np.diff(numbers)) + 1).tolist()
        if len(numbers) and int(new["index"][-1]) % self._ticks == self._ticks - 1:
            ends.append(len(numbers))  # judged with its last tick, not with the next one
        begin = 0
        for end in ends:
            found += self._judge({name: values[begin:end] for name, values in new.items()}, end - 1 - held)
            begin = end
        self._held = {name: values[begin:].copy() for name, values in new.items()}
        return found

    def _judge(self, window: dict[str, NDArray[Any]], at: int) -> list[Loss]:
        whole = len(window["index"]) == self._ticks and window["followed"].all() and not np.ptp(window["state"])
        if not whole:
            for judge in self._judges:
                judge.rested = 0
            return []
        error, lag = window["following_error"], self._lag
        fast = np.median(np.abs(error[2:] - 2.0 * error[1:-1] + error[:-2]), axis=0)
        slow = np.median(np.abs(error[2 * lag :] - 2.0 * error[lag:-lag] + error[: -2 * lag]), axis=0)
        found = []
        for number, judge in enumerate(self._judges):
            if not window["fresh"][:, number].all():
                continue
            axis = {name: np.ascontiguousarray(window[name][:, number]) for name in _FIELDS[1:]}
            loss = judge.judge(axis, float(fast[number]) / _GAUSS, float(slow[number]) / _GAUSS)
            if loss:
                found.append(loss._replace(at=at, axis=number))
        return found


class _Judge:
    """One axis. rested: windows at rest in a row."""

    def __init__(self, axis: AxisModel, period_s: float) -> None:
        self._axis, self._period_s = axis, period_s
        self._forces = ForceJudge(axis, period_s)
        self.rested = 0
        self._step: tuple[float, float] | None = None  # of the window before
        self._most: dict[object, float] = defaultdict(float)  # by phase and figure: the largest of the good windows
        self._seen: dict[object, int] = defaultdict(int)
        self._least_new = 1.0  # share of ticks with a new count, of the resting window with fewest
        self._last_new = 1.0  # of the last one, which counts once the next has new counts, too: it may end in the fault
        self._beyond: dict[str, int] = defaultdict(int)  # windows in a row, by what is wrong
        self._calm: dict[str, int] = defaultdict(int)  # good ones in a row
        self._told: set[str] = set()
        self._clear: _Look | None = None  # what the window before, beyond too, clearly looked like

    def judge(self, axis: dict[str, Floats], fast: float, slow: float) -> Loss | None:
        """A whole window of one axis' fields; its differences, m."""
        resting = not axis["setpoint_velocity"].any()
        self.rested = self.rested + 1 if resting else 0
        if jumped := self._jumped(axis):
            return jumped
        if resting and self.rested <= SETTLED:
            return None
        if stuck := self._stuck(axis, resting=resting):
            return stuck
        forced, loss = self._forced(axis, resting=resting)
        if forced:  # which shakes the axis, too
            return loss
        return self._shaken(axis, {"fast": fast, "slow": slow}, resting=resting)

    def _once(self, what: str, loss: Loss, windows: int = LOST_IN) -> Loss | None:
        """Told once it has lasted; and again when it was gone for CALM windows in between."""
        self._calm[what] = 0
        self._beyond[what] += 1
        if self._beyond[what] < windows or what in self._told:
            return None
        self._told.add(what)
        return loss

    def _good(self, what: str) -> None:
        self._beyond[what] = 0
        self._calm[what] += 1
        if self._calm[what] >= CALM:
            self._told.discard(what)

    def _jumped(self, axis: dict[str, Floats]) -> Loss | None:
        """A step in one tick beyond what can act on the axis; told a window later, when it was not noise that began."""
        known = self._seen["step"] >= KNOWN and not self._beyond["tremble"]
        seen = self._most["step"] if known else np.inf
        found = steps(self._axis, self._period_s, axis["position"], axis["force"], axis["setpoint_velocity"], seen)
        beyond, before = found.beyond, self._step
        self._step = None
        if beyond:
            self._forces.forget()
            self._step = found.worst if beyond <= _SINGLE else None
            if beyond > _SINGLE:
                return None
        else:
            self._most["step"] = max(self._most["step"], float(found.size.max()))
            self._seen["step"] += 1
        if before is None:
            self._good("jump")
            return None
        loss = Loss(
            0, 0, "encoder jump", "step in one tick that no force explains", *before, "m",
            "the encoder lost or won counts: noise at its cable, a loose head, dirt on the scale",
            "home the axis; check the encoder's cable and head",
        )  # fmt: skip
        return self._once("jump", loss, windows=1)

    def _forced(self, axis: dict[str, Floats], *, resting: bool) -> tuple[bool, Loss | None]:
        """(whether forces are not as they were, what is to be told of it)."""
        found = self._forces.judge(axis, resting=resting, settled=self.rested > SETTLED)
        if found is None:
            self._good("force")
            return False, None
        loss = Loss(0, 0, found.signature, found.measured, found.value, found.limit, "N", found.cause, found.action)
        return True, self._once("force", loss)

    def _stuck(self, axis: dict[str, Floats], *, resting: bool) -> Loss | None:
        new = np.count_nonzero(np.diff(axis["position"])) / (len(axis["position"]) - 1)
        moved = float(np.ptp(axis["setpoint_position"]))
        if new:
            self._good("stuck")
            self._most["error"] = max(self._most["error"], float(np.abs(axis["following_error"]).max()))
            if resting:
                self._least_new, self._last_new = min(self._least_new, self._last_new), new
                self._seen["rest"] += 1
            return None
        if resting and (self._seen["rest"] < KNOWN or self._least_new < _STILL):
            self._least_new = 0.0  # it rests on one count
            self._seen["rest"] += 1
            return None
        if not resting and moved < 4.0 * self._axis.resolution + 2.0 * self._most["error"]:  # friction holds it as well
            return None
        loss = Loss(
            0, 0, "encoder stuck", "ticks without a new count", float(len(axis["position"])), 0.0, "ticks",
            "the encoder or the drive shows an old value, or the axis is blocked",
            "stop the stage; check the encoder's head and cable, then hil command NAME reset",
        )  # fmt: skip
        return self._once("stuck", loss, windows=1)

    def _shaken(self, axis: dict[str, Floats], figures: dict[str, float], *, resting: bool) -> Loss | None:
        """Error that trembles more than it did."""
        worst, limit = "", 0.0
        for name, value in figures.items():  # the fast one, if it is beyond: what is noise shakes the loop, too
            key = (resting, name)
            known = self._seen[key] >= KNOWN
            bound = max(_LEAST[key][known] * self._axis.resolution, FACTOR * self._most[key] if known else 0.0)
            if value > bound and not worst:
                worst, limit = name, bound
        if not worst:
            for name, value in figures.items():
                self._most[resting, name] = max(self._most[resting, name], value)
                self._seen[resting, name] += 1
            self._good("tremble")
            self._clear = None
            return None
        look = self._clear or self._look(axis, worst, resting=resting)
        self._clear = look if look.clear else None
        measured = f"following error's tremble, {worst}{look.words}"
        loss = Loss(0, 0, look.signature, measured, figures[worst], limit, "m", look.cause, look.action)
        return self._once("tremble", loss)

    def _look(self, axis: dict[str, Floats], worst: str, *, resting: bool) -> "_Look":
        """What the window's spectrum shows; of the fast difference where that is the worst, which makes the loop's
        answer small beside the noise that it answers.
        """
        error, travel = axis["following_error"], axis["setpoint_position"]
        if worst == "fast":
            error, travel = np.diff(error, 2), travel[1:-1]
        share, bins = _line(error)
        frequency = bins / (len(error) * self._period_s)
        span, repeats = float(np.ptp(travel)), False
        if not resting and span > _SPAN * self._axis.resolution:
            step = np.linspace(travel.min(), travel.max(), len(travel))
            order = np.argsort(travel)
            along, periods = _line(np.interp(step, travel[order], error[order]))
            repeats = along >= LINE and span > _SHORTEST * periods * self._axis.resolution
            if repeats and along > share + _UNLIKE:
                return _Look(
                    "periodic error", f", with a period of {span / periods:.3g} of travel",
                    "the encoder's scale or head is dirty or misaligned",
                    "clean the scale, align the head; hil report shows the error",
                )  # fmt: skip
        if share >= LINE:
            either = f", or with a period of {span / periods:.3g} of travel: the speed was constant" if repeats else ""
            return _Look(
                "oscillation", f", at {frequency:.3g} Hz{either}",
                "the floor or a machine shakes the stage, or the loop is near the edge of stability",
                "find what shakes at that frequency; hil check for the loop's margins",
                clear=not repeats,
            )  # fmt: skip
        return _Look(
            "noise", "", "noise of the encoder or its cable: a loose shield, a dirty scale, an edge",
            "check the encoder's cable, shield and scale",
        )  # fmt: skip


def _line(values: Floats) -> tuple[float, float]:
    """Share of the strongest line in the spectrum above two periods, and how many periods it has."""
    n = len(values)
    slope = np.linspace(-1.0, 1.0, n)
    level = values - values.mean()
    level = level - slope * float(level @ slope) / float(slope @ slope)
    power = np.abs(np.fft.rfft(level * np.hanning(n))) ** 2
    power[:2] = 0.0
    total, top = float(power.sum()), int(power.argmax())
    return (float(power[max(top - 1, 0) : top + 2].sum()) / total, float(top)) if total > 0.0 else (0.0, 1.0)
