"""A law that goes wrong in the way its gain `how` names, `after` ticks of motion."""

import math

import numpy as np

from hil import Gain, Law

WAYS = ("raises", "not a number", "infinite", "shape", "word", "nothing", "exits", "never returns", "raises in reset")


class Misbehaves(Law):
    GAINS = {"how": Gain("raises", words=(*WAYS, "raises when made")), "after": 100.0}

    def __init__(self, model, period, force_limit, how="raises", after=100.0):
        if how == "raises when made":
            raise RuntimeError("no weights")
        self.model, self.how, self.left = model, how, after

    def reset(self, position, force):
        if self.how == "raises in reset":
            raise KeyError("state")

    def force(self, inputs):
        self.left -= 1
        if self.left > 0:
            return self.model.gravity
        if self.how == "raises":
            return 1.0 / len([])
        if self.how == "exits":
            raise SystemExit(3)
        if self.how == "never returns":
            while True:
                pass
        wrong = {"not a number": math.nan, "infinite": math.inf, "shape": np.zeros(3), "word": "much", "nothing": None}
        return wrong[self.how]
