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
  every window before. An axis without noise rests on one count for ever, and is not suspected. One that sets off or
  turns back is held by friction at first: it takes two windows.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.events.axis_model import AxisModel, Floats, in_step, steps
from hil.events.baseline import BEYOND, phase_of, tremble
from hil.events.forces import ForceJudge
from hil.events.windows import SETTLED, Windows

KNOWN: Final = 4  # windows before what they showed is a reference
FACTOR: Final = 3.0  # beyond the largest of those
LOST_IN: Final = 2  # windows in a row
PLAIN: Final = 2.0  # times its bound: what needs no second window
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
_LEAST_COUNTS: Final = 3.0  # below which nothing is held against a baseline
_BIASED: Final = 0.8  # of an RMS, that is the mean's
_STRAYED: Final = {"rms": "RMS following error", "innovation": "RMS innovation"}


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


class _Tremor(NamedTuple):
    """An error that trembles more than it did. plain: needs no second window. noisy: plainly noise, from the window's
    beginning to its end: no force makes that.
    """

    loss: Loss
    look: _Look
    plain: bool
    noisy: bool


_OFFSET: Final = _Look(
    "bias", ", nearly all of it its mean",
    "the law no longer holds the axis where it should: a force or a gain changed",
    "hil diff with the baseline's run; hil check for the law",
)  # fmt: skip


class AccuracyWatch:
    """Watches one run's axes. period_ns: of the control loop. known: by axis, what a baseline bounds
    (baseline.known_of); none of it: bounds are learnt from the run's own beginning.
    """

    def __init__(
        self, axes: Sequence[AxisModel], period_ns: int, known: Sequence[Mapping[str, Mapping[str, float]]] = ()
    ) -> None:
        self._period_s = period_ns * 1e-9
        self._windows = Windows(self._period_s)
        of_axes = known or [{}] * len(axes)
        lag = self._windows.lag
        self._judges = [_Judge(axis, self._period_s, lag, of) for axis, of in zip(axes, of_axes, strict=True)]

    def take(self, records: NDArray[np.void] | Mapping[Any, NDArray[Any]]) -> list[Loss]:
        """What these ticks show, with those before them. records: or columns by name."""
        found: list[Loss] = []
        for window in self._windows.take(records):
            for number, judge in enumerate(self._judges):
                if window is None:
                    judge.rested = 0
                elif (axis := window.axis(number)) and (loss := judge.judge(axis)):
                    found.append(loss._replace(at=window.at, axis=number))
        return found


class _Judge:
    """One axis. rested: windows at rest in a row."""

    def __init__(self, axis: AxisModel, period_s: float, lag: int, known: Mapping[str, Mapping[str, float]]) -> None:
        self._axis, self._period_s, self._lag, self._known = axis, period_s, lag, known
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

        for phase, bounds in known.items():
            for name in ("fast", "slow"):
                key = (phase == "rest", name)
                self._most[key], self._seen[key] = max(self._most[key], bounds[name] / FACTOR), KNOWN
            for way, drag in ((1.0, "drag_up"), (-1.0, "drag_down")):
                if drag in bounds:
                    self._forces.know(way, bounds[drag] / BEYOND)

    def judge(self, axis: dict[str, Floats]) -> Loss | None:
        """A whole window of one axis' fields."""
        resting = not axis["setpoint_velocity"].any()
        self.rested = self.rested + 1 if resting else 0
        if jumped := self._jumped(axis):
            return jumped
        if self._step is not None or (resting and self.rested <= SETTLED):  # a step shakes the axis
            return None
        if stuck := self._stuck(axis, resting=resting):
            return stuck
        error = axis["following_error"]
        figures = {"fast": tremble(error, 1), "slow": tremble(error, self._lag)}
        tremor = self._tremor(axis, figures, resting=resting)
        if not (tremor and tremor.noisy):  # noise makes the law push; other forces shake the axis, too
            forced, loss = self._forced(axis, resting=resting)
            if forced:
                return loss
        if tremor:
            self._clear = tremor.look if tremor.look.clear else None
            return self._once("tremble", tremor.loss, windows=1 if tremor.plain else LOST_IN)
        self._steady(figures, resting=resting)
        return self._strayed(axis)

    def _strayed(self, axis: dict[str, Floats]) -> Loss | None:
        """What else is beyond the baseline of this rig and task: the error, what the model did not foresee."""
        phase = phase_of(axis["setpoint_velocity"])
        bounds = self._known.get(phase, {})
        for name, words in _STRAYED.items():
            values = axis["following_error" if name == "rms" else name]
            value = float(np.sqrt(np.mean(values**2)))
            bound = max(bounds.get(name, np.inf), _LEAST_COUNTS * self._axis.resolution)
            if value > bound:
                biased = abs(float(values.mean())) > _BIASED * value
                look = _OFFSET if biased else self._look(axis, "slow", resting=phase == "rest")
                loss = Loss(
                    0, 0, look.signature, f"{words}, {phase}, against the baseline{look.words}", value, bound, "m",
                    look.cause, look.action,
                )  # fmt: skip
                return self._once("baseline", loss)
        self._good("baseline")
        return None

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
        position = in_step(axis["position"], axis["setpoint_velocity"], axis["stamp_ns"] * 1e-9, self._period_s)
        found = steps(self._axis, self._period_s, position, axis["force"], axis["setpoint_velocity"], seen)
        shaken = "tremble" in self._told and self._beyond["tremble"]  # noise that was told steps, too
        beyond, before = 0 if shaken else found.beyond, self._step
        self._step = None
        if beyond:
            self._forces.forget()
            self._step = found.worst if beyond <= _SINGLE else None
            if beyond > _SINGLE:
                return None
        elif found.good:
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
        return True, self._once("force", loss, windows=1 if found.plain else LOST_IN)

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
        # Friction holds an axis that sets off or turns back until the force has grown: that takes a window more.
        steady = resting or bool(abs(np.sign(axis["setpoint_velocity"]).sum()) == len(axis["position"]))
        return self._once("stuck", loss, windows=1 if steady else LOST_IN)

    def _tremor(self, axis: dict[str, Floats], figures: dict[str, float], *, resting: bool) -> "_Tremor | None":
        """Where the error trembles more than it did."""
        for name, value in figures.items():  # the fast one, if it is beyond: what is noise shakes the loop, too
            key = (resting, name)
            known = self._seen[key] >= KNOWN
            bound = max(_LEAST[key][known] * self._axis.resolution, FACTOR * self._most[key] if known else 0.0)
            if value > bound:
                return self._tremor_of(axis, name, value, bound, self._clear or self._look(axis, name, resting=resting))
        return None

    @staticmethod
    def _tremor_of(axis: dict[str, Floats], name: str, value: float, bound: float, look: _Look) -> "_Tremor":
        measured = f"following error's tremble, {name}{look.words}"
        loss = Loss(0, 0, look.signature, measured, value, bound, "m", look.cause, look.action)
        noise = look.signature == "noise"
        halves = np.array_split(axis["following_error"], 2)
        noisy = noise and name == "fast" and min(tremble(half, 1) for half in halves) > PLAIN * bound
        return _Tremor(loss, look, noisy or (not noise and look.clear and value > PLAIN * bound), noisy)

    def _steady(self, figures: dict[str, float], *, resting: bool) -> None:
        """The error trembles no more than it did."""
        for name, value in figures.items():
            self._most[resting, name] = max(self._most[resting, name], value)
            self._seen[resting, name] += 1
        self._good("tremble")
        self._clear = None

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
            # Ticks further apart than half a period measure nothing of it: noise drawn out there has a line, too.
            repeats = repeats and float(np.diff(travel[order]).max()) * periods < 0.5 * span
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
