"""A batch of cells, one after another: `name = "cells"` of [motion]."""

from collections.abc import Sequence
from typing import Any

from hil.control.motion.contract import Motion, Observation, References, Request, Retreat, Surroundings
from hil.control.motion.glide import Glide
from hil.control.motion.injection.cell_run import CellRun
from hil.control.motion.injection.checked import settings
from hil.control.motion.injection.senses import Senses
from hil.control.motion.injection.verdict import TOLD, CellResult, Phase, Verdict


class CellInjection(Motion):
    """From cell to cell at the safe height, and into each. results: of the cells that are over, from `first` on.
    total: all cells of the list.

    The record has the phase, and in a cell's last tick 100 and its verdict. An operator's requests:

    - PAUSE: the tip leaves a cell that it has touched, which is then over; any other one begins anew. It waits at the
      safe height until RESUME.
    - SKIP: the cell in hand, or while paused the next one, is over.
    - ABORT: as PAUSE, and then the motion ends.

    Raises ValueError naming the key.
    """

    def __init__(self, rig: Surroundings, **parameters: Any) -> None:
        self._s = settings(rig, parameters)
        self.retreat = Retreat(self._s.along, self._s.safe, self._s.direction)
        self._period_ns = round(rig.period * 1e9)
        self._period = rig.period
        self._glides = [Glide(limits, self._period_ns) for limits in rig.limits]
        self._along = rig.axes.index(self._s.along)
        self._across = [rig.axes.index(name) for name in self._s.across]
        self._turn = [rig.axes.index(self._s.turn)] if self._s.turn else []
        self._senses = Senses(rig, self._s)
        self._valve = 1 << rig.outputs[self._s.valve] if self._s.valve else 0
        self.total = len(self._s.cells)
        self.results: list[CellResult] = []
        self._run: CellRun | None = None
        self._ending = self._paused = self._aborted = self._untold = False

    def begin(self, position: Sequence[float]) -> None:
        """See Motion. Cells that are over stay so; one that the tip had touched is over by what stopped the rig. A
        pause lasts until RESUME.
        """
        for glide, place in zip(self._glides, position, strict=True):
            glide.hold(place)
        if self._run is not None and self._run.touched:
            self.results.append(self._run.interrupted())
            self._untold = True
        self._run, self._ending, self._aborted = None, False, False

    def step(self, seen: Observation) -> References:
        """See Motion."""
        self._senses.take(seen)
        for glide, end, state in zip(self._glides, seen.ends_ns, seen.reference, strict=True):
            glide.follow(end, state)
        told = self._heed(seen) if seen.request else 0
        if seen.tick == 0:
            self._lift(seen)
            told = self._tell_interrupted() or told
        elif not told and self._run is not None and self._run.phase:
            told = self._inject(self._run, seen)
        elif not told and self._arrived(seen):
            self._next(seen)
        return self._references(seen, told)

    def _tell_interrupted(self) -> int:
        told = TOLD + self.results[-1].verdict if self._untold else 0
        self._untold = False
        return told

    @property
    def over(self) -> int:
        """Cells of the list that are over, those before `first` included."""
        return self._s.first - 1 + len(self.results)

    def _heed(self, seen: Observation) -> int:
        """The operator's request; what is told where a cell is over by it."""
        if self._ending:
            return 0
        request, run = seen.request, self._run
        self._paused = request is Request.PAUSE or (self._paused and request is not Request.RESUME)
        self._aborted = self._aborted or request is Request.ABORT
        if request is Request.RESUME:
            return 0
        if run is not None and run.touched:
            run.leave(f"the operator's {request.name.lower()} in {run.phase.name.lower()}", seen)
            return 0
        self._withdraw(seen)
        if request is not Request.SKIP or self.over == self.total:
            return 0
        now = seen.tick * self._period
        skipped = CellResult(self.over, Verdict.SKIPPED, now, now, evidence="the operator's skip", left=True)
        self.results.append(skipped)
        return TOLD + Verdict.SKIPPED

    def _withdraw(self, seen: Observation) -> None:
        """From a cell that the tip has not touched, or from the way to it; it stays as if it had never begun."""
        self._run = None
        for axis in [*self._across, *self._turn]:
            self._glides[axis].stop(seen.ends_ns[axis], seen.reference[axis])
        self._lift(seen)

    def _inject(self, run: CellRun, seen: Observation) -> int:
        run.step(seen)
        if not run.over:
            return 0
        self.results.append(run.result)
        self._run = None
        self._ending = run.result.verdict is Verdict.BROKEN
        self._next(seen)
        return TOLD + run.result.verdict

    def _lift(self, seen: Observation) -> None:
        """First of all to the safe height, from wherever the axes were found."""
        z = self._along
        self._glides[z].to(seen.ends_ns[z], seen.reference[z], self._s.safe, self._s.transfer_speed)

    def _arrived(self, seen: Observation) -> bool:
        return all(glide.rests(end) for glide, end in zip(self._glides, seen.ends_ns, strict=True))

    def _next(self, seen: Observation) -> None:
        """Across to the next cell; there, into it."""
        if self._run is not None:
            self._run.begin(seen)
            return
        if self._ending or self._aborted or self.over == self.total:
            self._ending = True
            return
        if self._paused:
            return
        number = self.over
        self._run = CellRun(number, self._s, self._senses, self._glides[self._along], self._along, self._period)
        for axis, place in zip(self._across, self._s.cells[number][:2], strict=True):
            self._glides[axis].to(seen.ends_ns[axis], seen.reference[axis], place, self._s.transfer_speed)
        for axis in self._turn:
            self._glides[axis].to(
                seen.ends_ns[axis], seen.reference[axis], self._s.cells[number][3], self._s.turn_speed
            )

    def _references(self, seen: Observation, told: int) -> References:
        at = [glide.at(end) for glide, end in zip(self._glides, seen.ends_ns, strict=True)]
        run = self._run
        return References(
            [place for place, _, _ in at],
            [speed for _, speed, _ in at],
            [acceleration for _, _, acceleration in at],
            outputs=self._valve if run is not None and run.pulse else 0,
            phase=told or int(self._phase),
            cell=self.over + (0 if told else 1),
            done=self._ending,
        )

    @property
    def _phase(self) -> Phase:
        if self._run is not None:
            return self._run.phase
        return Phase.PAUSED if self._paused and not self._ending else Phase.NONE
