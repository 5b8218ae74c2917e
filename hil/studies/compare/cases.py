"""All laws on the same task in lockstep, over corners, rates and disturbances.

Every run is the full path (protocol, wire, drives, plant, cycle) of `hil sim`.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hil.control.law_registry import registered
from hil.rig.file import load_rig
from hil.rig.provenance import referenced_files, unpacked_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.crew import crew, resumed
from hil.studies.population import CORNERS
from hil.virtual.sim import usable

LEARNING = "+learning"  # suffix of a law's name: inside iterative learning
OFF_GRID = 0.3  # of a period
RIPPLE, RIPPLE_PERIOD = 0.01, 0.05  # of the force limit; m, where the rig file has no ripple of its own


class Case(NamedTuple):
    """One run: rig file, law, name of the corner or disturbance, rate, overrides, virtual seconds."""

    rig: str
    law: str
    corner: str
    rate_hz: float
    overrides: list[str]
    seconds: float


class Work(NamedTuple):
    """A case as it travels: the rig with the files it names (hil/rig/provenance.py)."""

    case: Case
    rig: str  # JSON
    files: dict[str, str]


def law_overrides(law: str) -> list[str]:
    """--set values that choose a law; with LEARNING at its end, inside iterative learning."""
    name = law.removesuffix(LEARNING)
    if ":" not in name and name not in registered():
        raise RigError([f"--laws {law}: the laws are {', '.join(registered())}, each also with {LEARNING}"])
    return [f"law.name={name}"] + (["law.iterative_learning=true"] if law.endswith(LEARNING) else [])


def disturbances(rig: RigConfig) -> dict[str, list[str]]:
    """Overrides by name: what a real stage does beside its corners. Reversals off the grid: for figures alone."""
    ripple = [RIPPLE * axis.limits.force for axis in rig.axes.values()]
    own = any(value > 0.0 for value in _listed(rig.plant.ripple_amplitude))
    found = {
        "jitter 50 us": ["wire.jitter=50e-6"],
        "1 % lost": ["wire.drop_probability=0.01"],
        "ripple": [f"plant.ripple_amplitude={ripple}"] + ([] if own else [f"plant.ripple_period={RIPPLE_PERIOD}"]),
        "stribeck": ["plant.stribeck_scale=0.2"],
    }
    if rig.task.kind in ("circle", "lissajous"):
        phase = rig.task.phase - 2.0 * math.pi * rig.task.frequency_hz * OFF_GRID / rig.rate_hz
        found["off grid"] = [f"task.phase={phase!r}"]
    return found


def _listed(value: Any) -> list[float]:
    return list(value) if isinstance(value, list) else [value]


def case_rig(case: Case) -> RigConfig:
    """The rig of a case. Gains found at the rig's own rate are scaled to another by their units (N/m with its square
    and so on), as `hil tune` would begin there.
    """
    rig = load_rig(case.rig, [*case.overrides, *law_overrides(case.law)])
    if case.rate_hz == rig.rate_hz:
        return rig
    from hil.studies.tune.search_space import at_rate

    gains = at_rate(rig, rig.law.name, rig.law.effective_gains(), case.rate_hz)
    law = rig.law.model_copy(update={"gains": gains})
    return rig.model_copy(update={"law": law, "rate_hz": case.rate_hz})


def run_case(case: Case) -> dict[str, Any]:
    """One row: law, corner, rate_hz, axes.<name>.{max_error, rms_error, peak_force, chatter}, state, faults, refused
    (why `hil run` would not start it; empty: it would).
    """
    return _run(case, case_rig(case), Path(case.rig).parent)


def _run(case: Case, rig: RigConfig, folder: Path) -> dict[str, Any]:
    from hil.analysis.stability import refuse_unstable
    from hil.virtual.sim import simulate

    refused = []
    try:
        refuse_unstable(rig)
    except RigError as error:
        refused = error.problems
    except ValueError as error:
        raise RigError([f"{case.law}: {error}"]) from None
    try:
        report, _ = simulate(rig, folder, case.seconds)
    except ValueError as error:
        raise RigError([f"{case.law}: {error}"]) from None
    return {
        "law": case.law,
        "corner": case.corner,
        "rate_hz": case.rate_hz,
        "axes": report.axes,
        "state": report.state,
        "faults": report.faults,
        "refused": refused,
    }


def cases(
    path: Path, laws: Sequence[str], overrides: Sequence[str], rates: Sequence[float], corners: bool, disturbed: bool,
    seconds: float,
) -> list[Case]:  # fmt: skip
    """Every combination asked for; corners and disturbances at the rig's own rate, other rates nominal."""
    rig = load_rig(path, overrides)
    chosen: dict[str, list[str]] = {"nominal": []}
    if corners:
        chosen |= {
            name: [f"plant.mass_scale={mass}", f"plant.friction_scale={friction}"]
            for name, (mass, friction) in CORNERS.items()
        }
    if disturbed:
        chosen |= disturbances(rig)
    for rate in rates:
        load_rig(path, [*overrides, f"rate_hz={rate!r}"])
    found = []
    for law in laws:
        usable(load_rig(path, [*overrides, *law_overrides(law)]), path)  # what cannot run is told before anything does
        found += [
            Case(str(path), law, name, rig.rate_hz, [*overrides, *extra], seconds) for name, extra in chosen.items()
        ]
        found += [
            Case(str(path), law, "nominal", rate, list(overrides), seconds) for rate in rates if rate != rig.rate_hz
        ]
    return found


def run_all(work: Sequence[Case], workers: int, scheduler: str = "") -> Iterator[dict[str, Any]]:
    """Rows in the order of the cases, each as soon as it and all before it are there."""
    if not scheduler and (workers == 1 or len(work) == 1):
        yield from map(run_case, work)
        return
    with crew(workers, scheduler) as hands:
        yield from resumed(hands, run_work, [packed(case) for case in work])


def packed(case: Case) -> Work:
    """A case with all that it needs."""
    rig, folder = case_rig(case), Path(case.rig).parent
    return Work(case, rig.model_dump_json(), referenced_files(rig, folder))


def run_work(work: Work) -> dict[str, Any]:
    """As run_case, on whatever machine this is."""
    with unpacked_rig(work.rig, work.files) as (rig, folder):
        return _run(work.case, rig, folder)
