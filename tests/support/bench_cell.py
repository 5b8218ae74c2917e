"""A bench for motions without any stage: axes that are where they were asked to be, a cell as a formula, a camera.

Written apart from sim_plant: what the phases of an injection do is seen here tick by tick.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil.control.motion.contract import Observation, References, Request, Surroundings
from hil.control.plans.axis_plan import MotionLimits
from hil.control.reading import Reading

PERIOD_NS = 1_000_000
LINEAR = MotionLimits(0.05, 14.0, 1370.0, -0.006, 0.006)
AROUND = Surroundings(
    ["x", "y", "z"], 1e-3, [LINEAR, LINEAR, LINEAR], ["force", "shift", "tip", "bolus", "dimple"],
    [5e-6, 1e-6, 1e-6, 0.02, 1e-6], {"valve": 0},
)  # fmt: skip
PARAMETERS: dict[str, Any] = {
    "cells": [[0.001, 0.0, -0.002]], "safe": 0.0, "force": "force", "shift": "shift", "tip": "tip", "bolus": "bolus",
    "valve": "valve",
}  # fmt: skip


@dataclass
class BenchCell:
    """top: m. pierced_at: depth, m; None: never. again_at: of the far side. gone: there is none. slips: s that the
    force takes to go. Everything else by tick of the bench: what sensor and camera show.
    """

    top: float = -0.002
    stiffness: float = 0.75e-3 / 180e-6**2
    pierced_at: float | None = 180e-6
    again_at: float | None = None
    gone: bool = False
    dead_after: int | None = None  # tick of the phase PRESS
    camera_until: int | None = None
    shift: float = 0.0
    tip: float = 0.0
    flow: float = 20.0  # bolus per s of pulse
    closes_after: int | None = None  # ticks of the pulse: the gate keeps the valve shut from then on
    cut_after: int | None = None  # the same, until the motion has asked for a shut valve once
    stays: float = 0.0  # N that pulls on the tip once it has been in
    pulses: list[float] = field(default_factory=list)  # depth at each tick with the valve open, pierced
    unpierced_pulses: int = 0


class Bench:
    """Runs a motion. noise: N. peak: most force on the cell, N."""

    def __init__(self, motion: Any, cells: Sequence[BenchCell], seed: int = 1, noise: float = 5e-6) -> None:
        self.motion, self.cells = motion, list(cells)
        self._random = np.random.default_rng(seed)
        self._noise = noise
        self.state = [(0.0, 0.0, 0.0)] * 3
        self._past = [(0.0, 0.0, 0.0)] * 3
        self._pierced: list[float | None] = [None] * len(self.cells)
        self.bolus = 0.0
        self._twice = False
        self.tick = 0
        self.peak = 0.0
        self._camera = (0.0, 0.0, 0.0, 0.0, -1, 0)  # shift, tip, bolus, dimple, sequence, tick of its arrival
        self._waiting: list[tuple[int, float, float, float, float]] = []
        self.phases: list[int] = []
        self.places: list[float] = []  # of the tip, m
        self._dead: tuple[float, int] | None = None
        self.answer: References | None = None
        self._origin = 0  # tick in which the motion began
        self._given = 0  # outputs that were set a tick ago
        self._cut = False
        motion.begin([0.0, 0.0, 0.0])

    def run(self, most: int = 20_000) -> None:
        """Until the motion is over."""
        while self.answer is None or not self.answer.done:
            self.step()
            assert self.tick < most, "the motion does not end"

    def restart(self) -> None:
        """The rig has stopped: the axes are at rest where they are, and the motion begins anew."""
        self.state = [(place, 0.0, 0.0) for place, _, _ in self.state]
        self._past, self.answer, self._origin = self.state, None, self.tick
        self.motion.begin([place for place, _, _ in self.state])

    @property
    def _cell(self) -> int:
        """That under the tip: they lie 1 mm apart along x, the first one at 1 mm."""
        return max(0, min(round(self.state[0][0] * 1e3) - 1, len(self.cells) - 1))

    def _force(self) -> float:
        """On the tip where it was when the newest command came: a tick before the coming interval."""
        cell = self.cells[self._cell]
        depth = cell.top - self._past[2][0]
        if cell.gone or depth <= 0.0:
            return -cell.stays if self._pierced[self._cell] is not None else 0.0
        since = self._pierced[self._cell]
        if since is None and cell.pierced_at is not None and depth >= cell.pierced_at:
            self._pierced[self._cell] = since = self.tick
        if since is None:
            return cell.stiffness * depth * depth
        if cell.again_at is not None and not self._twice:
            if depth >= cell.again_at:
                self._twice = True
            return cell.stiffness * max(depth - cell.pierced_at * 0.9, 0.0) ** 2 * 8 if cell.pierced_at else 0.0
        assert cell.pierced_at is not None
        left = max(0.0, 1.0 - (self.tick - since) / 3.0)
        return cell.stiffness * cell.pierced_at**2 * left - cell.stays

    def _look(self) -> None:
        """A camera of 30 Hz whose frames come 50 ms after their exposure."""
        cell = self.cells[self._cell]
        if self.tick % 33 == 0 and (cell.camera_until is None or self.tick < cell.camera_until):
            self._waiting.append((self.tick + 50, cell.shift, cell.tip, self.bolus, self._dimple()))
        if self._waiting and self._waiting[0][0] <= self.tick:
            _, *shown = self._waiting.pop(0)
            self._camera = (shown[0], shown[1], shown[2], shown[3], self._camera[4] + 1, self.tick)

    def _dimple(self) -> float:
        """How deep the tip has pressed in a cell that is whole, m."""
        cell = self.cells[self._cell]
        is_whole = not cell.gone and self._pierced[self._cell] is None
        return max(0.0, cell.top - self._past[2][0]) if is_whole else 0.0

    def step(self, request: Request = Request.NONE) -> None:
        """One tick. request: of an operator."""
        cell = self.cells[self._cell]
        force = self._force()
        self.peak = max(self.peak, force)
        shown, sequence = force + self._noise * self._random.standard_normal(), self.tick % 256
        pressing = bool(self.phases) and self.phases[-1] == 4
        if cell.dead_after is not None and (self._dead or pressing):
            self._dead = self._dead or (shown, sequence)
            if sum(p == 4 for p in self.phases) >= cell.dead_after or not pressing:
                shown = self._dead[0]
            else:
                self._dead = (shown, sequence)
        self._look()
        *shown_by_camera, frame, came = self._camera
        readings = [
            Reading(0, shown, 0, sequence, True), *(
                Reading(k + 1, value, 0, frame % 256 if frame >= 0 else -1, frame >= 0)
                for k, value in enumerate(shown_by_camera)
            )
        ]  # fmt: skip
        ends = [(self.tick - self._origin + 1) * PERIOD_NS] * 3
        self.answer = self.motion.step(
            Observation(
                self.tick - self._origin, ends, [s[0] for s in self.state], [s[1] for s in self.state], self.state,
                readings,
                [0, *[self.tick - came] * 4], request, self._given,
            )
        )  # fmt: skip
        self.phases.append(self.answer.phase)
        self.places.append(self.answer.position[2])
        if cell.cut_after == len(cell.pulses):
            cell.cut_after, self._cut = None, True
        self._cut = self._cut and self.answer.outputs != 0
        shut = cell.closes_after is not None and len(cell.pulses) >= cell.closes_after
        self._given = 0 if shut or self._cut else self.answer.outputs
        if self._given:
            pierced = self._pierced[self._cell] is not None
            cell.unpierced_pulses += not pierced
            self.bolus += cell.flow * 1e-3 * pierced
            cell.pulses.append(cell.top - self.state[2][0])
        elif self.answer.phase <= 1:
            self.bolus, self._twice = 0.0, False
        self._past = self.state
        a = self.answer
        assert a.acceleration is not None
        self.state = list(zip(a.position, a.velocity, a.acceleration, strict=True))
        self.tick += 1
