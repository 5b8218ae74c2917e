"""An estimator that goes wrong in the way its parameter `how` names, `after` seconds into its run."""

import math

import numpy as np

from hil import Estimator

WAYS = ("raises", "not a number", "infinite", "one number", "shape", "word", "nothing", "exits", "never returns",
        "raises in reset")  # fmt: skip


class Wrong(Estimator):
    def __init__(self, model, period, resolution, how="raises", after=0.1):
        if how == "raises when made":
            raise RuntimeError("no poles")
        self.how, self.after, self.time = how, after, 0.0

    def reset(self, position):
        if self.how == "raises in reset":
            raise KeyError("state")
        self.time = 0.0

    def update(self, measurement):
        m = measurement
        self.time += m.interval
        if self.time <= self.after:
            return m.position_estimate, m.velocity_estimate
        if self.how == "raises":
            return 1.0 / len([])
        if self.how == "exits":
            raise SystemExit(3)
        if self.how == "never returns":
            while True:
                pass
        wrong = {
            "not a number": (m.position, math.nan), "infinite": (math.inf, 0.0), "one number": m.position,
            "shape": (np.zeros(2), 0.0), "word": ("far", 0.0), "nothing": None,
        }  # fmt: skip
        return wrong[self.how]
