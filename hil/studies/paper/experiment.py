"""Runs one variant of a claim, in a process of its own if need be, and boils it down to figures."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hil.control.laws.base import Array
from hil.studies.paper.claims import CLAIMS, Variant
from hil.studies.paper.dormand_prince import solve
from hil.studies.paper.moreau import Plan, Trace, integrate
from hil.studies.paper.problem import COULOMB, MASS, QUADRATIC, VISCOUS, ContinuousLaw, circle, paper_law

STEPS = (2e-4, 1e-4)  # s; the second shows how far the first is from its limit
RTOL, ATOL = 1e-3, 1e-6  # relative; m and m/s: the defaults of the ode45 family
FORCE_LIMIT = 5.0  # N, of the rig; the paper knows none
SAMPLE = 1e-3  # s between kept points

Progress = Callable[[float], None]


class Job(NamedTuple):
    """One run: claim, index of its variant, index into STEPS (0 for the adaptive solver)."""

    claim: str
    variant: int
    step: int

    @property
    def spec(self) -> Variant:
        """What to run."""
        return CLAIMS[self.claim].variants[self.variant]


@dataclass(frozen=True)
class Run:
    """Figures of one run, in um and N, (x, y) each; start of its steady window; its trace for the pictures (s, m)."""

    job: Job
    integrator: str
    step: str
    max_um: tuple[float, float]
    plateau_um: tuple[float, float]
    rms_um: tuple[float, float]
    peak_force: tuple[float, float]
    transient_force: tuple[float, float]
    saturations: int
    floors: int
    unsolved: int
    steady_from: float
    time: Array
    position: Array
    error: Array


def jobs_of(claim: str) -> list[Job]:
    """Every run a claim needs: each variant with each of STEPS, or once where the solver chooses its steps."""
    return [
        Job(claim, index, step)
        for index, variant in enumerate(CLAIMS[claim].variants)
        for step in ((0,) if variant.adaptive else range(len(STEPS)))
    ]


def carry_out(job: Job, progress: Progress | None = None, shorten: float = 1.0) -> Run:
    """Run a job; shorten < 1 scales its duration and window, for tests."""
    spec = job.spec
    if spec.adaptive:
        return _adaptive(job, progress, shorten)
    h = STEPS[job.step]
    plan = Plan(h, spec.duration * shorten, spec.steady_from * shorten, round(SAMPLE / h), FORCE_LIMIT)
    law = ContinuousLaw(paper_law(spec.law, spec.gains), (3, 2))
    trace = integrate(law, COULOMB + spec.delta, plan, np.zeros(2), progress)
    return _boil_down(job, plan, trace)


def _pair(values: Array, unit: float) -> tuple[float, float]:
    return float(values[0]) / unit, float(values[1]) / unit


def _boil_down(job: Job, plan: Plan, trace: Trace) -> Run:
    steady = np.abs(trace.error[trace.time >= plan.steady_from])
    return Run(
        job=job,
        integrator="Moreau time stepping, theta = 1/2, Sgn implicit; each step solved to 1e-13 m/s",
        step=f"{plan.h:g} s",
        max_um=_pair(trace.peak_error, 1e-6),
        plateau_um=_pair(np.median(steady, axis=0), 1e-6),
        rms_um=_pair(trace.rms_error, 1e-6),
        peak_force=_pair(trace.peak_force, 1.0),
        transient_force=_pair(trace.transient_force, 1.0),
        saturations=trace.saturations,
        floors=trace.floors,
        unsolved=trace.unsolved,
        steady_from=plan.steady_from,
        time=trace.time,
        position=trace.position,
        error=trace.error,
    )


def _adaptive(job: Job, progress: Progress | None, shorten: float) -> Run:
    spec = job.spec
    law = ContinuousLaw(paper_law(spec.law, spec.gains), (2,))

    def slope(t: float, y: Array) -> Array:
        q, v = y[:2], y[2:]
        friction = (COULOMB + spec.delta) * np.sign(v) + v * (VISCOUS + QUADRATIC * np.abs(v))
        return np.concatenate([v, (law.force(t, q, v) - friction) / MASS])

    time, states = solve(slope, np.zeros(4), spec.duration * shorten, RTOL, ATOL, progress)
    error = states[:, :2] - np.array([circle(t).position for t in time.tolist()])
    forces = np.array(
        [law.force(t, y[:2], y[2:]).copy() for t, y in zip(time.tolist(), states, strict=True)]
    )  # at the accepted steps
    window = time >= spec.steady_from * shorten
    steady = error[window]
    return Run(
        job=job,
        integrator=f"Dormand-Prince 5(4), ode45 step control, rtol {RTOL:g}, atol {ATOL:g}; sgn explicit",
        step=f"adaptive, median {np.median(np.diff(time)):.2g} s, {time.size - 1} steps",
        max_um=_pair(np.abs(steady).max(axis=0), 1e-6),
        plateau_um=_pair(np.median(np.abs(steady), axis=0), 1e-6),
        rms_um=_pair(np.sqrt((steady * steady).mean(axis=0)), 1e-6),
        peak_force=_pair(np.abs(forces[window]).max(axis=0), 1.0),
        transient_force=_pair(np.abs(forces).max(axis=0), 1.0),
        saturations=int(np.count_nonzero(np.abs(forces).max(axis=1) > FORCE_LIMIT)),
        floors=0,
        unsolved=0,
        steady_from=spec.steady_from * shorten,
        time=time,
        position=states[:, :2].copy(),
        error=error,
    )
