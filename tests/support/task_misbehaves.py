"""A task that goes wrong in the way its parameter `how` names."""

import math

import numpy as np

from hil import Task

WAYS = {
    "raises": "ZeroDivisionError: division by zero",
    "exits": "SystemExit: 3",
    "not a number": "row 3, column x: nan",
    "unsorted": "row 3, column time_s",
    "empty": "0 rows",
    "shape": "positions of shape (5, 3), expected (n,) and (n, 2)",
    "huge": "20001 rows, at most 20000",
    "words": "no numbers",
    "nothing": "cannot unpack",
    "jumps": "axes.x.limits.speed",
}


class Misbehaves(Task):
    def __init__(self, axes, how="raises"):
        self.how = how

    def samples(self):
        rows = 20_001 if self.how == "huge" else 0 if self.how == "empty" else 5
        time, positions = np.arange(rows) * 0.1, np.zeros((rows, 3 if self.how == "shape" else 2))
        if self.how == "raises":
            return 1 / 0
        if self.how == "exits":
            raise SystemExit(3)
        if self.how == "nothing":
            return None
        if self.how == "words":
            return ["now", "then"], positions
        if self.how == "never returns":
            while True:
                pass
        if self.how == "not a number":
            positions[2, 0] = math.nan
        if self.how == "unsorted":
            time[2] = 0.0
        if self.how == "jumps":
            time *= 1e-3
            positions[2:, 0] = 0.4
        return time, positions
