"""A PD law that goes wrong in the way its gain `how` names, `after` seconds into its task."""

import math

import numpy as np

from hil import Gain, Law

WAYS = ("raises", "not a number", "infinite", "shape", "word", "nothing", "exits", "never returns", "raises in reset")


class Misbehaves(Law):
    GAINS = {"how": Gain("raises", words=(*WAYS, "raises when made")), "after": Gain(0.1, least=-1.0)}

    def __init__(self, model, period, force_limit, how="raises", after=0.1):
        if how == "raises when made":
            raise RuntimeError("no weights")
        self.model, self.how, self.after_ns = model, how, after * 1e9
        self.kp, self.kd = model.mass * (0.25 / period) ** 2, 0.35 * model.mass / period

    def reset(self, position, force):
        if self.how == "raises in reset":
            raise KeyError("state")

    def force(self, inputs):
        if inputs.task_ns <= self.after_ns:
            error = inputs.position_estimate - inputs.start.position
            rate = inputs.velocity_estimate - inputs.start.velocity
            return self.model.gravity - self.kp * error - self.kd * rate
        if self.how == "raises":
            return 1.0 / len([])
        if self.how == "exits":
            raise SystemExit(3)
        if self.how == "never returns":
            while True:
                pass
        wrong = {"not a number": math.nan, "infinite": math.inf, "shape": np.zeros(3), "word": "much", "nothing": None}
        return wrong[self.how]
