"""A batch of cells (`[motion] name = "cells"`), told from the records of ticks: phase by phase, and what was measured.

What a record lacks is not told: which evidence decided, and where the first touch was before it was known.
"""

from dataclasses import replace
from math import inf, isnan, nan
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.control.motion.injection.senses import TARE
from hil.control.motion.injection.verdict import TOLD, CellResult, Phase, Verdict
from hil.cycle.goal import MotionWord
from hil.rig.schema import RigConfig
from hil.telemetry import telemetry_pb2 as pb

FIELDS: Final = ("index", "now_ns", "motion", "phase", "cell", "position", "setpoint_velocity", "readings")
MOST_POINTS: Final = 400  # of a cell's trace
PEAK_TICKS: Final = 10
_OUTSIDE: Final = (Phase.NONE, Phase.PAUSED)


class Told(NamedTuple):
    """A cell has come to a phase. tick: index of its first. phase: 100 and its verdict where it is over.
    result: so far.
    """

    tick: int
    now_ns: int
    phase: int
    result: CellResult

    @property
    def over(self) -> bool:
        """The cell has its verdict."""
        return self.phase >= TOLD

    @property
    def word(self) -> str:
        """Of the phase."""
        return "" if self.over else Phase(self.phase).name.lower()


class Trace:
    """Depth behind the cell's stated top (m) and force (N) of one cell, thinned out evenly to MOST_POINTS."""

    def __init__(self) -> None:
        self.depth: list[float] = []
        self.force: list[float] = []
        self._every = self._count = 0

    def add(self, depths: list[float], forces: list[float]) -> None:
        """The next ticks."""
        for depth, force in zip(depths, forces, strict=True):
            if self._count % (1 << self._every) == 0:
                self.depth.append(depth)
                self.force.append(force)
            self._count += 1
            if len(self.depth) > MOST_POINTS:
                self.depth, self.force = self.depth[::2], self.force[::2]
                self._every += 1


class CellWatch:
    """Follows every tick of a run of such a rig. traces: force over depth by number of the cell, where they are kept.
    number, phase: of the newest tick; the number counts from 1. total: cells of the list. run: number of the control
    process' ring. newest: what was told last of each cell, by its number.
    """

    def __init__(self, rig: RigConfig, *, keep: bool = False, run: int = 0) -> None:
        self.run = run
        self.newest: dict[int, pb.Cell] = {}
        known = rig.motion.parameters
        self._cells = known["cells"]
        self._axis = rig.axis_names.index(known.get("along", "z"))
        self._sign = int(known.get("direction", -1))
        sensors = list(rig.sensors)
        self._force = sensors.index(known.get("force", "force"))
        bolus = known.get("bolus", "")
        self._bolus = sensors.index(bolus) if bolus else -1
        self._period = rig.period_ns * 1e-9
        self.total = len(self._cells)
        self.number = self.phase = 0
        self.traces: dict[int, Trace] | None = {} if keep else None
        self.began = -1  # tick in which the motion first began
        self._open: CellResult | None = None
        self._tare: list[float] = []
        self._recent: list[float] = []
        self._bias = 0.0

    def add(self, records: NDArray[np.void]) -> list[Told]:
        """The next ticks, oldest first, with at least FIELDS; every phase that a cell came to in them."""
        if not len(records):
            return []
        found: list[Told] = []
        phases, cells = records["phase"].astype(np.int64), records["cell"].astype(np.int64)
        cuts = np.flatnonzero((np.diff(phases) != 0) | (np.diff(cells) != 0)) + 1
        for part in np.split(records, cuts):
            told = self._part(part)
            if told is not None:
                found.append(told)
        return found

    def _part(self, part: NDArray[np.void]) -> Told | None:
        """Ticks of one phase of one cell; what is told where they are its first ones."""
        first = part[0]
        if self.began < 0 and first["motion"] == MotionWord.MOTION:
            self.began = int(first["index"])
        phase, number = int(first["phase"]), int(first["cell"])
        entered = (number, phase) != (self.number, self.phase)
        self.number, self.phase = number, phase
        if phase in _OUTSIDE or not number:
            if phase == Phase.NONE or not entered:
                return None
            self._open = None
            return Told(int(first["index"]), int(first["now_ns"]), phase, CellResult(number - 1))
        result = self._result(number, self._time(first))
        if phase >= TOLD:
            result.verdict = Verdict(phase - TOLD)
            result.left = result.verdict is Verdict.SKIPPED
            result.ended_s = self._time(first)
            self._open = None
        elif entered:
            self._enter(result, Phase(phase), first)
        told = Told(int(first["index"]), int(first["now_ns"]), phase, replace(result)) if entered else None
        if phase < TOLD:
            self._measure(result, Phase(phase), part)
        return told

    def _time(self, record: np.void) -> float:
        """Since the motion began, s."""
        return (int(record["index"]) - self.began) * self._period

    def _result(self, number: int, now_s: float) -> CellResult:
        if self._open is None or self._open.number != number - 1:
            self._open = CellResult(number - 1, began_s=now_s)
        return self._open

    def _enter(self, result: CellResult, phase: Phase, record: np.void) -> None:
        """What the first tick of a phase says of the one before."""
        now_s, place = self._time(record), float(record["position"][self._axis])
        if phase is Phase.APPROACH:
            result.began_s = now_s
            self._tare.clear()
        elif phase is Phase.SEEK:
            self._bias = sum(self._tare) / len(self._tare) if self._tare else 0.0
        elif phase is Phase.PRESS:
            result.contact = result.found = place
            result.found_s = now_s
            self._recent.clear()
        elif phase is Phase.FREEZE:
            result.pierced, result.pierced_s = place, now_s
            result.pierced_force = max(self._recent, default=nan)
            result.pierced_speed = abs(float(record["setpoint_velocity"][self._axis]))
        elif phase is Phase.ADVANCE:
            result.rested = place
        elif phase is Phase.PULSE:
            result.deposit = (place - result.contact) * self._sign
        elif phase is Phase.CONFIRM:
            result.pulse_s = now_s
        elif phase is Phase.WITHDRAW and self._bolus >= 0 and not isnan(result.pulse_s):
            result.bolus = float(record["readings"][self._bolus])  # the frame that decided came in this tick

    def _measure(self, result: CellResult, phase: Phase, part: NDArray[np.void]) -> None:
        readings = part["readings"][:, self._force]
        if phase is Phase.TARE:
            self._tare = [*self._tare, *readings.tolist()][-TARE:]
        if phase < Phase.SEEK:
            return
        forces = readings - self._bias
        result.peak_force = max(result.peak_force, float(np.nanmax(forces, initial=-inf)))
        if phase is Phase.PRESS:
            self._recent = [*self._recent, *forces.tolist()][-PEAK_TICKS:]
        elif phase >= Phase.WITHDRAW:
            result.pull = max(result.pull, float(np.nanmax(-forces, initial=0.0)))
        if self.traces is not None and phase < Phase.LIFT:  # beyond that it is far above the cell
            depths = (part["position"][:, self._axis] - self._cells[result.number][2]) * self._sign
            self.traces.setdefault(result.number, Trace()).add(depths.tolist(), forces.tolist())

    def tell(self, told: Told) -> pb.Cell:
        """For the topic `cells`; from then on among the `newest`."""
        found = told.result
        message = self.newest[found.number + 1] = pb.Cell(
            number=found.number + 1, of=self.total, phase=told.word, index=told.tick, tick_ns=told.now_ns,
            verdict=found.verdict.name.lower() if told.over else "", began=found.began_s, ended=found.ended_s,
            contact=found.contact, pierced=found.pierced, pierced_force=found.pierced_force,
            peak_force=found.peak_force, deposit=found.deposit,
            pull=found.pull, pulse=found.pulse_s, bolus=found.bolus, run=self.run,
        )  # fmt: skip
        return message

    def told(self) -> bytes:
        """The newest word on each cell, for who asks."""
        return pb.Cells(cells=self.newest.values()).SerializeToString()
