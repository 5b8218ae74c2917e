"""The law of an experiment: it holds the axis loosely on its reference and adds a force of the task's time.

Named in a rig in full, as a law of users is (hil/rig/law_names.py). Gate, fault detectors, recorder and replay are
those of every other run.
"""

import cmath
import math
from collections.abc import Callable
from typing import Any, ClassVar

from hil.control.gain import Gain
from hil.control.laws.base import Law, LawInputs, Model

NONE, GROWING, TRIANGLES, MULTISINE = 0, 1, 2, 3  # shapes of the force
GROWTH = 1.25  # from one triangle to the next
TRIANGLES_AT_SIZE = 3  # after growing
BEYOND = 1.1  # of the force at which the axis gave way, those
# Of its reach, the size of a triangle that stays clear of the end where the axis gave way, as it would creep on there;
# in steps, for it must not be moved by them.
CLEAR, CLEARER = 0.5, 0.9
LEAST_WAY = 0.02  # of the excursion, that a cycle must have gone to be centred by
PERIOD_S = 0.5  # of the multisine
FULL_PERIOD_S = 1e-3  # of ticks, for all lines
FIRST_LINE, LAST_LINE, LINES = 2, 240, 108  # multiples of 1 / PERIOD_S: 4 to 480 Hz, at 1 kHz or more
LAST_SHARE = 0.2  # of a slower rate, the last line: such drives sample in their own time
BANDWIDTH_HZ, DAMPING = 10.0, 0.8  # of the loop
# A weight that falls: how far it is off then (m), how long the stiff loop has it, and how fast that gives way.
CAUGHT, LONGEST_WAIT_S, CATCH_S, SOFTEN_S = 5e-6, 0.3, 0.03, 0.05
SOFTER = 0.5  # of its stiffness, that is left
FILTER_HZ, FILTER_DAMPING = 70.0, 0.7  # second order, behind the loop: a resonance that nobody knows yet must not ring
FULL_FROM_HZ = 30.0  # lines below are smaller in proportion, for the axis gives way more
NS = 1e-9


def multisine_lines(period: float) -> list[int]:
    """Multiples of 1 / PERIOD_S that the multisine has at ticks of `period` s, evenly spread and at least 2 apart.

    LINES of them, or fewer at a slow rate.
    """
    last = LAST_LINE if period <= FULL_PERIOD_S else math.floor(LAST_SHARE * PERIOD_S / period)
    count = min(LINES, (last - FIRST_LINE) // 2 + 1)
    step = (last - FIRST_LINE) / (count - 1)
    return sorted({round(FIRST_LINE + step * k) for k in range(count)})


def multisine_table(period: float) -> list[float]:
    """One period at unit amplitude of each line, a value a tick of `period` s: Schroeder's phases keep its peak low."""
    return _sum(multisine_lines(period), period, lambda s: 1.0)


def multisine_motion(mass: float) -> tuple[float, float]:
    """RMS way, m, and greatest speed, m/s, of an axis of that mass (kg) in the loop below, with 1 N a line; at slow
    rates hardly less, as the last lines move it least.
    """
    stiffness, damping = _loop(1.0, (2.0 * math.pi * BANDWIDTH_HZ) ** 2)
    corner = 2.0 * math.pi * FILTER_HZ

    def given(s: complex) -> complex:
        passed = corner * corner / (corner * corner + 2.0 * FILTER_DAMPING * corner * s + s * s)
        answer: complex = 1.0 / (s * s + passed * (stiffness + damping * s))
        return answer

    lines = multisine_lines(FULL_PERIOD_S)
    way = _sum(lines, FULL_PERIOD_S, given)
    speed = _sum(lines, FULL_PERIOD_S, lambda s: s * given(s))
    return math.sqrt(sum([each * each for each in way]) / len(way)) / mass, max(map(abs, speed)) / mass


def _sum(lines: list[int], period: float, answer: Callable[[complex], complex]) -> list[float]:
    """One period of the multisine's lines behind a linear answer at s = i omega, a value a tick of `period` s."""
    n, waves = round(PERIOD_S / period), []
    for k, (line, size) in enumerate(zip(lines, _sizes(lines), strict=True)):
        size, phase = cmath.polar(size * answer(2.0j * math.pi * line / PERIOD_S))
        waves.append((line, size, phase - math.pi * k * (k + 1) / len(lines)))
    return [sum(size * math.cos(2.0 * math.pi * line * i / n + phase) for line, size, phase in waves) for i in range(n)]


def _sizes(lines: list[int]) -> list[float]:
    return [min(1.0, line / PERIOD_S / FULL_FROM_HZ) for line in lines]


def triangle(cycles: float) -> float:
    """Unit triangle, 0 at whole cycles, beginning upwards."""
    part = cycles - math.floor(cycles)
    return 4.0 * part if part < 0.25 else 2.0 - 4.0 * part if part < 0.75 else 4.0 * part - 4.0


def _gain(default: float, unit: str, text: str) -> Gain:
    return Gain(default, unit, text)


def _loop(mass: Any, square: float) -> tuple[Any, Any]:
    """Stiffness (N/m) and damping (N s/m) of a loop of that frequency, which is squared: (rad/s)^2."""
    return mass * square, mass * 2.0 * DAMPING * math.sqrt(square)


class Excitation(Law):
    """PD on the reference with an integrator until the force begins, Coulomb friction along the reference, and a force.

    The force of each shape depends on task time alone, except for growing triangles. These stop growing, and end after
    three more, once they have moved the axis by `excursion` either way. A half of one that has moved it by twice that
    ends there, and all end beyond four times that. Each is centred by the drift of the one before it; where the axis
    gave way at one end of its friction, the next ones grow away from there.
    """

    GAINS: ClassVar[dict[str, Gain]] = {
        "mass": _gain(0.0, "kg", "that the loop is made for; 0: the model's"),
        "bandwidth_hz": _gain(BANDWIDTH_HZ, "Hz", "of the loop"),
        "hold_hz": _gain(0.0, "Hz", "of the loop that catches a weight at first; 0: as later"),
        "coulomb": _gain(0.0, "N", "fed forward along the reference"),
        "gravity": Gain(0.0, "N", "that holds the axis; 0: the model's", least=-1e15),
        "integral_s": _gain(0.15, "s", "of the integrator, until `from_s`"),
        "shape": _gain(0.0, "1", "0 none, 1 growing triangles, 2 triangles of changing size, 3 multisine"),
        "amplitude": _gain(0.0, "N", "first triangle of shape 1; last triangle of shape 2; each line of the multisine"),
        "amplitude_from": _gain(0.0, "N", "first triangle of shape 2"),
        "frequency_hz": _gain(4.0, "Hz", "of the triangles"),
        "from_s": _gain(0.0, "s", "task time from which the force acts"),
        "until_s": _gain(0.0, "s", "task time until which it acts"),
        "excursion": _gain(20e-6, "m", "of shape 1: half the way at which it stops growing; in which friction turns"),
        "alternate_s": _gain(0.0, "s", "the multisine's sign changes after so long; 0: never"),
    }

    def __init__(self, model: Model, period: float, force_limit: Any, **gains: Any) -> None:
        g: dict[str, Any] = {key: gains.get(key, gain.default) for key, gain in self.GAINS.items()}
        mass = g["mass"] or model.mass
        self._later = (2.0 * math.pi * g["bandwidth_hz"]) ** 2
        self._first = max(self._later, (2.0 * math.pi * g["hold_hz"]) ** 2)
        self._softest = max(self._later, SOFTER * self._first)
        self._mass, self._gravity, self._coulomb = mass, g["gravity"] or model.gravity, g["coulomb"]
        self._integral = period / g["integral_s"]
        self._limit, self._g, self._period = force_limit, g, period
        self._shape = round(g["shape"])
        self._table = multisine_table(period) if self._shape == MULTISINE else []
        self.reset(0.0, 0.0)

    def reset(self, position: Any, force: Any) -> None:
        """The integrator and the triangles begin anew."""
        self._held = self._passed = self._step = 0.0
        self._square, self._ticks, self._caught = self._first, 0, 0  # of the loop's frequency, (rad/s)^2
        self._reach = self._size = self._g["amplitude"]
        self._clear, self._cycle, self._grown = 1.0, -1, -1
        self._low = self._high = self._begun = position
        self._centre = self._turned = 0.0
        self._over = False
        self._half, self._half_from, self._half_over = -1, position, False
        self._top: float | None = None
        self._bottom: float | None = None

    def force(self, inputs: LawInputs) -> Any:
        """Of the loop, and the experiment's own."""
        start, g = inputs.start, self._g
        error = start.position - inputs.position_estimate
        rate = start.velocity - inputs.velocity_estimate
        seconds = inputs.task_ns * NS
        holds = seconds < g["from_s"] or not self._shape
        self._soften(error)
        stiffness, damping = _loop(self._mass, self._square if holds else self._later)
        if holds:
            self._hold(stiffness * self._integral * error)
        along = self._mass * inputs.mean_acceleration + self._coulomb * self._friction(inputs.mean_velocity)
        back = self._filtered(stiffness * error + damping * rate)
        return back + self._held + self._gravity + along + self._added(seconds, inputs.position)

    def _soften(self, error: float) -> None:
        """From the loop that catches a weight, which swings on stiff friction where the mass is not there, to the later
        one. The integrator takes over what the stiffness bore. It waits for the weight's fall.
        """
        self._ticks += 1
        if abs(error) > CAUGHT or self._ticks * self._period > LONGEST_WAIT_S:
            self._caught = self._caught or self._ticks
        if self._caught and (self._ticks - self._caught) * self._period > CATCH_S:
            less = (self._square - self._softest) * self._period / SOFTEN_S
            self._square -= less
            self._hold(self._mass * less * error)

    def _hold(self, force: float) -> None:
        self._held = min(max(self._held + force, -0.5 * self._limit), 0.5 * self._limit)

    def _friction(self, speed: Any) -> Any:
        """Of the reference, over Coulomb friction: it turns within `excursion`, not at once."""
        way = speed * self._period / self._g["excursion"]
        self._turned = (self._turned + way) / (1.0 + abs(way))
        return self._turned

    def _filtered(self, force: Any) -> Any:
        """The loop's force, low-pass, by implicit steps: stable at any rate."""
        angle = 2.0 * math.pi * FILTER_HZ * self._period
        self._step = (self._step + angle * angle * (force - self._passed)) / (
            1.0 + 2.0 * FILTER_DAMPING * angle + angle * angle
        )
        self._passed += self._step
        return self._passed

    def _added(self, seconds: float, position: float) -> float:
        """The experiment's force at that task time."""
        g = self._g
        if not self._shape or not g["from_s"] <= seconds < g["until_s"]:
            return self._centre
        inside = seconds - g["from_s"]
        if self._shape == MULTISINE:
            sign = -1.0 if g["alternate_s"] and int(inside / g["alternate_s"]) % 2 else 1.0
            return sign * float(g["amplitude"]) * float(self._table[round(seconds / self._period) % len(self._table)])
        cycles = inside * g["frequency_hz"]
        if self._shape == TRIANGLES:
            whole = (g["until_s"] - g["from_s"]) * g["frequency_hz"] - 1.0
            part = min(math.floor(cycles) / whole, 1.0) if whole > 0.0 else 1.0
            size = float(g["amplitude_from"] + (g["amplitude"] - g["amplitude_from"]) * part)
            return size * triangle(cycles)
        return self._growing(cycles, position)

    def _growing(self, cycles: float, position: float) -> float:
        if self._over:
            return self._centre
        self._low, self._high = min(self._low, position), max(self._high, position)
        if (cycle := math.floor(cycles)) > self._cycle:
            if self._cycle >= 0:
                self._next_size(cycle, position)
            self._cycle = cycle
            self._low = self._high = self._begun = position
        ended = self._grown >= 0 and self._cycle - self._grown >= TRIANGLES_AT_SIZE
        self._over = ended or self._high - self._low > 8.0 * self._g["excursion"]
        if self._over:
            return self._centre
        force = self._centre + self._size * triangle(cycles)
        return self._centre if self._slid(cycles, position, force) else force

    def _slid(self, cycles: float, position: float, force: float) -> bool:
        """Whether this half of a triangle has moved the axis far enough. Where it gave way is noted."""
        if (half := math.floor(2.0 * cycles)) > self._half:
            self._half, self._half_from, self._half_over = half, position, False
        way = position - self._half_from
        if half % 2 == 0 and self._top is None and way > self._g["excursion"]:
            self._top = force
        if half % 2 and self._bottom is None and -way > self._g["excursion"]:
            self._bottom = force
        self._half_over = self._half_over or abs(way) > 2.0 * self._g["excursion"]
        return self._half_over

    def _next_size(self, cycle: int, position: float) -> None:
        """It grows until both ends of friction are known; about the middle of them, or away from the one known end."""
        top, bottom = self._top, self._bottom
        if self._grown >= 0 or (top is None and bottom is None):
            self._centre -= self._size * self._drift(position)
        if self._grown >= 0:
            return
        if top is not None and bottom is not None:
            self._grown, self._size, self._centre = cycle, BEYOND * 0.5 * (top - bottom), 0.5 * (top + bottom)
            return
        self._reach = min(self._reach * GROWTH, 0.8 * self._limit)
        self._size = self._clear * self._reach
        if top is not None or bottom is not None:
            self._clear = max(CLEARER * self._clear, CLEAR)
        if top is not None:
            self._centre = top - 2.0 * self._reach + self._size
        elif bottom is not None:
            self._centre = bottom + 2.0 * self._reach - self._size

    def _drift(self, position: float) -> float:
        """Of the cycle that ends, over its way, -1 to 1: what holds the axis may be anywhere within its friction."""
        way = self._high - self._low
        return (position - self._begun) / way if way > LEAST_WAY * self._g["excursion"] else 0.0
