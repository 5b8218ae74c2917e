"""Laws as users write them, and as they get them wrong: drawn source files with one class each."""

import random

from hil.control.gain import SCALES

UNITS = ("N/m", "N s/m", "1/s", "s", "")
WRONG_GAINS = (
    "Gain(5.0, most=1.0)",
    "Gain(None, tune=Knob(1.0, 0.1))",
    "Gain(None, tune=Knob(0.01, 1.0, 'm/T^2'))",
    "Gain('fast', words=('slow',))",
    "Gain(0.5, least='low')",
    "Gain(None, tune=(0.1, 1.0))",
    "Gain(None, tune=Knob(0.1, 1.0, of='nobody'))",
)
SIGNATURES = ("self, model, period, force_limit", "self, model, period, *args", "self, model, period", "self")
EXTRA = (  # what is added to PD with feedforward; self.memory is a number that reset sets to 0
    "0.0",
    "self.gains[0] * 0.01 * inputs.mean_sign",
    "self.remember(0.05 * self.kp * e * self.period)",
    "math.tanh(1e3 * e) * 0.01 * self.limit",
    "float(np.clip(self.kp * e, -self.limit, self.limit)) * 0.1",
    "0.1 * inputs.disturbance_estimate",
    "self.remember(inputs.sample.position - inputs.position)",
    "np.float64(0.0)",
    "0",
)
WRONG_EXTRA = (
    "float('nan')", "1.0 / (inputs.mean_velocity - inputs.mean_velocity)", "None", "'strong'", "inputs.nothing",
    "[0.0]", "self.undefined", "1j", "10.0 ** 400", "np.zeros(3)",
)  # fmt: skip
SOURCE = '''"""Drawn by tests/fuzz/generated_laws.py."""
import math

import numpy as np

from hil import Gain, Knob, Law


class Drawn(Law):
    GAINS = {{{gains}}}

    def __init__({signature}{keywords}):
        self.model, self.period = model, period
        self.limit = {limit}
        self.kp = {kp} * model.mass / period**2
        self.kd = {kd} * model.mass / period
        self.gains = [{values} or 0.0] if {values} is not None else [0.0]
        self.memory = 0.0

    def reset(self{reset}):
        self.memory = 0.0

    def remember(self, more):
        self.memory += more
        return self.memory

    def force(self, inputs):
        m, v = self.model, inputs.mean_velocity
        known = m.mass * inputs.mean_acceleration + m.coulomb * inputs.mean_sign + m.viscous * v + m.gravity
        e = inputs.start.position - inputs.position_estimate
        de = inputs.start.velocity - inputs.velocity_estimate
        return known + self.kp * e + self.kd * de + {extra}
'''


def law_source(chance: random.Random) -> str:
    """A file with the class Drawn. Two of three are right; the others have one thing that is not."""
    wrong = chance.choice(("gain", "signature", "extra", "reset", "keyword")) if chance.random() < 1 / 3 else ""
    names = [f"gain_{number}" for number in range(chance.randrange(4))]
    gains = {name: _gain(chance) for name in names}
    if wrong == "gain":
        gains[f"gain_{len(names)}"] = chance.choice(WRONG_GAINS)
    keywords = list(gains)
    if wrong == "keyword" and keywords:
        keywords.pop()
    return SOURCE.format(
        gains=", ".join(f"{name!r}: {gain}" for name, gain in gains.items()),
        signature=chance.choice(SIGNATURES[1:]) if wrong == "signature" else SIGNATURES[0],
        keywords="".join(f", {name}=None" for name in keywords),
        limit="force_limit" if wrong != "signature" else "1.0",
        kp=f"{10 ** chance.uniform(-3.0, -0.8):.4g}",
        kd=f"{10 ** chance.uniform(-2.0, -0.3):.4g}",
        values=keywords[0] if keywords else "0.0",
        reset=", position, force" if wrong != "reset" else chance.choice(("", ", position", ", *, force")),
        extra=chance.choice(WRONG_EXTRA if wrong == "extra" else EXTRA),
    )


def _gain(chance: random.Random) -> str:
    low, scale = 10 ** chance.uniform(-3.0, 0.0), chance.choice(SCALES)
    tune = (
        f", tune=Knob({low:.3g}, {low * 10 ** chance.uniform(0.0, 2.0):.3g}, {scale!r})"
        if chance.random() < 0.7
        else ""
    )
    default = chance.choice(("None", f"{chance.uniform(0.0, 5.0):.3g}"))
    return f"Gain({default}, {chance.choice(UNITS)!r}, 'drawn'{tune})"
