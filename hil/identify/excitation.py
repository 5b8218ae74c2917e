"""The law of an experiment: it holds the axis loosely on its reference and adds a force of the task's time.

Named in a rig as a law of users is, `hil.identify.excitation:Excitation`; gate, fault detectors, recorder and replay
are those of every other run.
"""

import math
from typing import Any, ClassVar

from hil.control.gain import Gain
from hil.control.laws.base import Law, LawInputs, Model

NAME = "hil.identify.excitation:Excitation"
NONE, GROWING, TRIANGLES, MULTISINE = 0, 1, 2, 3  # shapes of the force
GROWTH = 1.25  # from one triangle to the next
TRIANGLES_AT_SIZE = 3  # after growing
PERIOD_S = 0.5  # of the multisine
FIRST_LINE, LAST_LINE, LINES = 2, 199, 90  # multiples of 1 / PERIOD_S: 4 to 398 Hz
FULL_FROM_HZ = 30.0  # lines below are smaller in proportion, for the axis gives way more
NS = 1e-9


def multisine_lines() -> list[int]:
    """Multiples of 1 / PERIOD_S that the multisine has, evenly spread; LINES of them."""
    step = (LAST_LINE - FIRST_LINE) / (LINES - 1)
    return sorted({round(FIRST_LINE + step * k) for k in range(LINES)})


def multisine_table(period: float) -> list[float]:
    """One period at unit amplitude of each line, a value a tick of `period` s: Schroeder's phases keep its peak low."""
    lines, n = multisine_lines(), round(PERIOD_S / period)
    phases = [-math.pi * k * (k + 1) / len(lines) for k in range(len(lines))]
    sizes = [min(1.0, line / PERIOD_S / FULL_FROM_HZ) for line in lines]
    waves = list(zip(lines, phases, sizes, strict=True))
    return [sum(a * math.cos(2.0 * math.pi * line * i / n + b) for line, b, a in waves) for i in range(n)]


def triangle(cycles: float) -> float:
    """Unit triangle, 0 at whole cycles, beginning upwards."""
    part = cycles - math.floor(cycles)
    return 4.0 * part if part < 0.25 else 2.0 - 4.0 * part if part < 0.75 else 4.0 * part - 4.0


def _gain(default: float, unit: str, text: str) -> Gain:
    return Gain(default, unit, text)


class Excitation(Law):
    """PD on the reference with an integrator until the force begins, Coulomb friction along the reference, and a force.

    The force of each shape depends on task time alone, but for growing triangles: they stop growing, and end after
    three more, once a cycle has moved the axis by `excursion`, and end at once beyond four times that.
    """

    GAINS: ClassVar[dict[str, Gain]] = {
        "mass": _gain(0.0, "kg", "that the loop is made for; 0: the model's"),
        "bandwidth_hz": _gain(12.0, "Hz", "of the loop"),
        "coulomb": _gain(0.0, "N", "fed forward along the reference"),
        "gravity": Gain(0.0, "N", "that holds the axis; 0: the model's", least=-1e15),
        "integral_s": _gain(0.15, "s", "of the integrator, until `from_s`"),
        "shape": _gain(0.0, "1", "0 none, 1 growing triangles, 2 triangles of changing size, 3 multisine"),
        "amplitude": _gain(0.0, "N", "first triangle of shape 1; last triangle of shape 2; each line of the multisine"),
        "amplitude_from": _gain(0.0, "N", "first triangle of shape 2"),
        "frequency_hz": _gain(4.0, "Hz", "of the triangles"),
        "from_s": _gain(0.0, "s", "task time from which the force acts"),
        "until_s": _gain(0.0, "s", "task time until which it acts"),
        "excursion": _gain(20e-6, "m", "of shape 1: half the way of a cycle at which it stops growing"),
        "alternate_s": _gain(0.0, "s", "the multisine's sign changes after so long; 0: never"),
    }

    def __init__(self, model: Model, period: float, force_limit: Any, **gains: Any) -> None:
        g: dict[str, Any] = {key: gains.get(key, gain.default) for key, gain in self.GAINS.items()}
        mass = g["mass"] or model.mass
        omega = 2.0 * math.pi * g["bandwidth_hz"]
        self._kp, self._kd = mass * omega * omega, mass * 1.6 * omega
        self._mass, self._gravity, self._coulomb = mass, g["gravity"] or model.gravity, g["coulomb"]
        self._ki = self._kp * period / g["integral_s"]
        self._limit, self._g, self._period = force_limit, g, period
        self._shape = round(g["shape"])
        self._table = multisine_table(period) if self._shape == MULTISINE else []
        self.reset(0.0, 0.0)

    def reset(self, position: Any, force: Any) -> None:
        """The integrator and the triangles begin anew."""
        self._held = 0.0
        self._size, self._cycle, self._grown = self._g["amplitude"], 0, -1
        self._low = self._high = position
        self._over = False

    def force(self, inputs: LawInputs) -> Any:
        """Of the loop, and the experiment's own."""
        start, g = inputs.start, self._g
        error = start.position - inputs.position_estimate
        rate = start.velocity - inputs.velocity_estimate
        seconds = inputs.task_ns * NS
        if seconds < g["from_s"] or not self._shape:
            self._held = min(max(self._held + self._ki * error, -0.5 * self._limit), 0.5 * self._limit)
        loop = self._kp * error + self._kd * rate + self._held + self._gravity
        along = self._mass * inputs.mean_acceleration + self._coulomb * inputs.mean_sign
        return loop + along + self._added(seconds, inputs.position)

    def _added(self, seconds: float, position: float) -> float:
        """The experiment's force at that task time."""
        g = self._g
        if not self._shape or not g["from_s"] <= seconds < g["until_s"]:
            return 0.0
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
        self._low, self._high = min(self._low, position), max(self._high, position)
        if math.floor(cycles) > self._cycle:
            self._cycle = math.floor(cycles)
            if self._grown < 0 and self._high - self._low >= 2.0 * self._g["excursion"]:
                self._grown = self._cycle
            if self._grown < 0:
                self._size = min(self._size * GROWTH, 0.8 * self._limit)
            self._low = self._high = position
        ended = self._grown >= 0 and self._cycle - self._grown >= TRIANGLES_AT_SIZE
        self._over = self._over or ended or self._high - self._low > 8.0 * self._g["excursion"]
        return 0.0 if self._over else self._size * triangle(cycles)
