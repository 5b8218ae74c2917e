"""Hostile references from a motion, by the million: `python -m tests.benchmarks.hostile_motion --references 1000000`.

The rig's own DecidedMotion, course and limits, without stage and bus. What the motion answers is drawn: jumps, huge and
tiny numbers, answers of long ago, NaN, wrong lengths, exceptions, none. Whatever it answers, every reference in force
stays inside fence, speed, acceleration and jerk; where no answer can be used, the axes come to rest by the plan in
hand.
"""

import argparse
import math
import random
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import hil
from hil.control.plans.course import Course
from hil.cycle.limits import motion_limits
from hil.cycle.step import ControlCycle
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig as RigConfig
from tests.support import told_motion

RIGS: Final = Path(__file__).parents[2] / "deploy" / "rigs"
ODD: Final = (1e300, -1e300, 1e-300, 0.0, 1.0, -1.0, 1e-9, 5e-324)
USELESS: Final[tuple[Callable[[], Any], ...]] = (
    lambda: hil.References([math.nan] * 4, [0.0] * 4),
    lambda: hil.References([0.0] * 4, [math.inf] * 4),
    lambda: hil.References([0.0] * 3, [0.0] * 4),
    lambda: hil.References([0.0] * 4, [0.0] * 4, outputs=-1),
    lambda: None,
    lambda: 1 / 0,
    lambda: hil.References(["x"] * 4, [0.0] * 4),  # type: ignore[list-item]
)
SHARE_USELESS: Final = 0.002  # of answers, so that most runs last
REST_S: Final = 2.0  # in which every axis is at rest


class Hostile:
    """Answers of one seed. useless: how many of them were none."""

    def __init__(self, seed: int) -> None:
        self._draw = random.Random(seed)
        self._place = [0.0] * 4
        self._long_ago: list[hil.References] = []
        self.useless = 0

    def step(self, seen: hil.Observation) -> Any:
        """See hil.Motion."""
        draw = self._draw
        if draw.random() < SHARE_USELESS:
            self.useless += 1
            return draw.choice(USELESS)()
        answer = self._answer(seen, draw.randrange(8))
        if len(self._long_ago) < 500:
            self._long_ago.append(answer)
        else:
            self._long_ago[draw.randrange(500)] = answer
        return answer

    def _answer(self, seen: hil.Observation, kind: int) -> hil.References:
        draw, four = self._draw, range(4)
        if kind == 0:
            return hil.References([draw.choice(ODD) for _ in four], [draw.choice(ODD) for _ in four])
        if kind == 1:
            self._place = [draw.uniform(-0.05, 0.05) for _ in four]
            return hil.References(self._place, [0.0] * 4, [draw.uniform(-1e6, 1e6) for _ in four])
        if kind == 2 and self._long_ago:
            return draw.choice(self._long_ago)
        if kind == 3:  # just beside what is in force
            near = [state[0] + draw.uniform(-1e-6, 1e-6) for state in seen.reference]
            return hil.References(near, [draw.gauss(0.0, 1e-2) for _ in four])
        if kind == 4:  # full speed at the fence
            return hil.References([draw.choice((-1.0, 1.0)) for _ in four], [draw.choice((-9.0, 9.0)) for _ in four])
        self._place = [place + draw.uniform(-1e-4, 1e-4) for place in self._place]
        return hil.References(self._place, [draw.gauss(0.0, 1e-3) for _ in four])


class Trial:
    """One rig and its motion. limited: ticks in which something was asked for that may not be."""

    def __init__(self, rig_file: Path, seed: int) -> None:
        rig = load_rig(rig_file, ("task.kind=hold", f"motion.name={told_motion.__file__}:Told"))
        cycle = ControlCycle(rig, rig_file.parent)
        decided = cycle.supervisor.goals.decided
        assert decided is not None
        self.hostile = Hostile(seed)
        decided.motion.told = self.hostile.step
        self._decided, self._limits, self._period_ns = decided, motion_limits(rig), rig.period_ns
        self._setpoints, self._sampling = cycle.axes.setpoints, cycle.sampling
        self._now_ns = 0
        self._before = [0.0] * len(rig.axes)
        self.rests = 0
        self._begin([0.0] * len(rig.axes))

    @property
    def limited(self) -> int:
        """See above."""
        return self._decided.limited

    def _begin(self, position: list[float]) -> None:
        self._course = Course(position)
        self._setpoints.follow(self._course, [self._now_ns] * len(position))
        self._decided.begin(position)

    def run(self, count: int) -> None:
        """So many answers."""
        for _ in range(count):
            self.tick()

    def tick(self) -> None:
        """One answer; where it is none, on to rest, and anew from there."""
        self._pass_time()
        self._decided.advance(self._course)
        self._check()
        if not self._decided.runs:
            self._come_to_rest()

    def _pass_time(self) -> None:
        self._now_ns += self._period_ns
        self._sampling.starts[:] = [self._now_ns] * len(self._before)
        self._sampling.instants[:] = [self._now_ns - self._period_ns] * len(self._before)

    def _come_to_rest(self) -> None:
        for _ in range(round(REST_S * 1e9) // self._period_ns):
            self._pass_time()
            states = self._check()
            if all(speed == bend == 0.0 for _, speed, bend in states):
                self.rests += 1
                self._begin([place for place, _, _ in states])
                return
        raise AssertionError(f"not at rest within {REST_S:g} s: {states}")

    def _check(self) -> list[tuple[float, float, float]]:
        """The references at the end of the coming interval. Raises AssertionError naming axis, value and limit."""
        end = self._now_ns + self._period_ns - self._setpoints.origin[0]
        states = [self._course.at(axis, end) for axis in range(len(self._before))]
        period = self._period_ns * 1e-9
        for axis, ((place, speed, bend), li) in enumerate(zip(states, self._limits, strict=True)):
            jerk = abs(bend - self._before[axis]) / period
            for name, value, most in (
                ("speed", abs(speed), li.speed), ("acceleration", abs(bend), li.acceleration), ("jerk", jerk, li.jerk),
            ):  # fmt: skip
                assert value <= most * (1 + 1e-6), f"axis {axis}: {name} {value} above {most}"
            assert li.low - 1e-12 <= place <= li.high + 1e-12, f"axis {axis}: {place} outside {li.low} to {li.high}"
            self._before[axis] = bend
        return states


def main() -> None:
    """Print what was asked, limited and stopped; an AssertionError says what was broken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--references", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=1e6, help="end sooner, after this time")
    asked = parser.parse_args()
    trial, until = Trial(RIGS / "microscope.toml", asked.seed), time.monotonic() + 60.0 * asked.minutes
    done = 0
    while done < asked.references and time.monotonic() < until:
        trial.tick()
        done += 1
    print(
        f"{done} references of 4 axes, seed {asked.seed}: {trial.limited} limited, {trial.hostile.useless} answers "
        f"that were none, each followed by rest ({trial.rests}); no limit broken"
    )


if __name__ == "__main__":
    main()
