"""What the experiments tell of an axis: each one's fit, and all that they found."""

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hil.identify.elements import Elements, friction_at_rest
from hil.identify.estimate import Array, Estimate, Refused
from hil.identify.excitation import PERIOD_S, multisine_lines
from hil.identify.experiments import PASS_PERIODS, PASSES_EACH_WAY, RAMP_S, SETTLE_S, Known, Plan
from hil.identify.force_balance import Record, balance
from hil.identify.frequency_fit import Complex, Pass, Response, fit_axis, response_of
from hil.identify.late_friction import allow_for_late_friction
from hil.identify.places import SpeedPass
from hil.identify.prediction import AxisForces, Unexplained
from hil.identify.signals import Signals, signals
from hil.identify.travel_fit import TravelCurves, travel_fit
from hil.rig.schema import AxisConfig
from hil.runs.api import Run

SPAN_SETTLE_S = 0.15  # left out of a pass at constant speed
ROUGH_LAG = 2e-4  # s, until the frequency response has told it
WEIGHED = 0.06  # of a mass that is found from accelerations, what no block shows: a coarse encoder hides where it turns
MOST_UNEXPLAINED, LEAST_UNEXPLAINED = 2.0, 0.02  # of what moves leave; of Coulomb friction besides
LEAST_LOOP = 3  # encoder counts, of the smaller loops
FULL = 0.9  # of the largest triangle's range of force
NOT_SEEN = (
    "mode",
    "mode_beyond",
    "mode_unsure",
    "friction_variation",
    "cogging_amplitude",
    "cable_stiffness",
)  # an axis may have none
PUSH_OVER_COULOMB = 1.1  # where the push alone has to tell Coulomb friction


@dataclass
class Findings:
    """Of one axis: estimates and refusals by quantity; evidence: the hash of each run, by experiment; ended: the faults
    that ended the experiments, empty where none did. To look at: the frequency response, that of the axis fitted to it,
    what the travel showed, loops of position (m) and force (N), and the motion that no fit used (checked). validation:
    force that is left unexplained, N RMS, in that motion and in `moves`. slope: of friction over speed, N s/m, by the
    frequency response.
    """

    found: dict[str, Estimate] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    evidence: dict[str, str] = field(default_factory=dict)
    ended: str = ""
    response: Response | None = None
    fitted: Complex | None = None
    travel: TravelCurves | None = None
    loops: tuple[Array, Array] | None = None
    moved: Signals | None = None
    elements: Elements | None = None
    validation: tuple[float, float] | None = None
    checked: Unexplained | None = None
    slope: Estimate | None = None

    @property
    def missing(self) -> list[str]:
        """Names of what was refused, except what an axis may have none of."""
        return [name for name in self.refused if name not in NOT_SEEN]


def fitted(experiment: str, run: Run, name: str, folder: Path, plan: Plan, findings: Findings, known: Known) -> Known:
    """Add what the experiment's run tells; what the next ones are to go by. folder: where the rig's files are."""
    try:
        return FITS[experiment](signals(run, name, folder), plan, run.rig.axes[name], findings, known)
    except Refused as refused:
        findings.refused[experiment] = refused.reason
        return known


def _push(of: Signals, plan: Plan, axis: AxisConfig, findings: Findings, known: Known) -> Known:
    """Only what the next experiments need: about mass and Coulomb friction, and the force that holds."""
    part = of.cut(plan.gains["from_s"], plan.gains["until_s"])
    force, position = of.force[part], of.position[part]
    if not position.size:
        raise Refused("the run ended before the push began")
    if np.ptp(position) < plan.gains["excursion"]:
        raise Refused(f"the axis moved {np.ptp(position):.2g} at {np.abs(force).max():.3g} N: is it free to move?")
    triangles = _largest(force, round(1.0 / (plan.gains["frequency_hz"] * of.period)))
    low, high = float(force[triangles].min()), float(force[triangles].max())
    about = {"mass": known.mass, "constant": 0.5 * (low + high), "coulomb": 0.5 * (high - low) / PUSH_OVER_COULOMB}
    with contextlib.suppress(Refused):  # of no single bristle: the size of the push is near enough for what follows
        until = slice(0, triangles.stop)
        record = Record(force[until], position[until], of.period, of.count, ROUGH_LAG, triangles.start)
        found = balance([record], viscous=axis.model.viscous).found
        about |= {name: found[name].value for name in about if name in found}
    coulomb = about["coulomb"]
    findings.found["push_coulomb"] = Estimate(coulomb, 0.25 * coulomb, "N")
    return Known(about["mass"], about["constant"], coulomb)


def _largest(force: Array, cycle: int) -> slice:
    """The triangles of full size, and one cycle of rest behind them. cycle: ticks of a triangle."""
    count = len(force) // cycle
    sizes = np.ptp(force[: count * cycle].reshape(count, cycle), axis=1)
    sizes[0] = 0.0  # the loop changes there
    full = np.flatnonzero(sizes >= FULL * sizes.max())
    return slice(int(full[0]) * cycle, (int(full[-1]) + 2) * cycle)


def passes_of(of: Signals, plan: Plan) -> list[Pass]:
    """Passes of the frequency experiment during which the computer did not stall."""
    base = round(PERIOD_S / of.period)
    passes = []
    for number, (begin, _, speed) in enumerate(plan.spans):
        first = of.cut(begin + SETTLE_S, begin).start
        part = slice(first, first + PASS_PERIODS * base)
        start = round(float(of.seconds[first]) / of.period)
        sign = -1 if number // 2 % 2 else 1
        if not of.stalled[part].any():
            at = (of.step[part], of.late[part], of.position[part])
            passes.append(Pass(*at, 1 if speed > 0.0 else -1, sign, start, number // PASSES_EACH_WAY))
    return passes


def _frequency(of: Signals, plan: Plan, axis: AxisConfig, findings: Findings, known: Known) -> Known:
    base = round(PERIOD_S / of.period)
    passes = passes_of(of, plan)
    findings.response = response_of(passes, of.period, multisine_lines(of.period), base)
    fit = fit_axis(findings.response, of.period, known.mass)
    findings.fitted, findings.slope = fit.response, fit.found["viscous"]
    findings.found |= {name: one for name, one in fit.found.items() if name != "viscous"}
    findings.refused |= fit.refused
    if "mode" in fit.refused and 0.0 < axis.model.mode_frequency_hz < findings.response.frequency_hz[-1]:
        findings.found["mode_frequency_hz"] = Estimate(0.0, 0.0, "Hz")  # the model states one that is not there
    return replace(known, mass=fit.found["mass"].value)


def _moves(of: Signals, plan: Plan, axis: AxisConfig, findings: Findings, known: Known) -> Known:
    passes = []
    for begin, end, speed in plan.spans:
        part = of.cut(begin + SPAN_SETTLE_S, end)
        passes.append(SpeedPass(of.force[part], of.position[part], speed, np.flatnonzero(of.stalled[part]).tolist()))
    if "mass" not in findings.found:
        known = _weighed(of, plan, findings, known)
    fit = travel_fit(passes, of.period, known.mass, _lag(findings), of.rounding)
    findings.travel, findings.moved = fit.curves, of
    findings.found |= fit.found
    findings.refused |= fit.refused
    drift, most = fit.found.get("position_drift"), plan.gains["excursion"]
    if drift and abs(drift.value) - drift.half_width > most:
        findings.refused["position_drift"] = (
            f"positions shifted by {drift.value:.2g} between the first pass and the last (at most {most:.2g}): "
            "does the scale slip, or does something grow warm?"
        )
    wave = {name: fit.found[name].value for name in ("friction_variation", "friction_period") if name in fit.found}
    if fit.curves.curved:  # the loops are to reach friction at rest: what is nearest to it
        slowest = np.argmin(np.abs(fit.curves.speed))
        return replace(known, coulomb=float(fit.curves.friction_at_speed[slowest]), **wave)
    return replace(known, coulomb=fit.found["coulomb"].value, **wave)


def _weighed(of: Signals, plan: Plan, findings: Findings, known: Known) -> Known:
    """The mass from the accelerations into and out of the passes, where there is no frequency response. At rest the
    force may be anything within friction, so only the motion counts.
    """
    parts = [of.cut(begin - RAMP_S, end + RAMP_S) for begin, end, _ in plan.spans]
    try:
        fit = balance([Record(of.force[at], of.position[at], of.period, of.count, _lag(findings)) for at in parts])
    except Refused as refused:
        findings.refused["mass"] = refused.reason
        return known
    if "mass" not in fit.found:
        findings.refused["mass"] = fit.refused["mass"]
        return known
    mass = fit.found["mass"]
    findings.found["mass"] = mass._replace(half_width=math.hypot(mass.half_width, WEIGHED * mass.value))
    return replace(known, mass=mass.value)


def _loops(of: Signals, plan: Plan, axis: AxisConfig, findings: Findings, known: Known) -> Known:
    part = of.cut(plan.gains["from_s"], plan.gains["until_s"])
    skip = round(1.0 / plan.gains["frequency_hz"] / of.period)
    record = Record(of.force[part], of.position[part], of.period, of.count, _lag(findings), skip)
    findings.loops = of.position[part][skip:], of.force[part][skip:]
    small = of.position[part][len(of.position[part]) // 2 :]
    if np.ptp(small) < LEAST_LOOP * of.count:
        raise Refused(
            f"below Coulomb friction the axis moves {np.ptp(small) / of.count:.0f} encoder counts (at least "
            f"{LEAST_LOOP}): the encoder does not resolve its presliding"
        )
    viscous = findings.travel.viscous if findings.travel else axis.model.viscous
    found, refused, findings.elements = friction_at_rest(record, known.mass, viscous)
    if findings.elements or (findings.travel and findings.travel.curved):
        _over_stiffness(found, refused, findings, float(record.position.mean()))
    findings.found |= found
    findings.refused |= refused
    bent = findings.travel.curved if findings.travel else None
    if findings.slope and bent and not bent.drag:
        allow_for_late_friction(findings.found, findings.slope, bent.viscous)
    return known


def _over_stiffness(found: dict[str, Estimate], refused: dict[str, str], findings: Findings, at: float) -> None:
    """Presliding as Coulomb friction in motion over the stiffness at rest, where that is not the length over which
    friction turns: friction at rest is larger, and slip elements turn slowly. at: m, place of the loops.
    """
    if "stiffness" not in found:
        return
    stiffness, coulomb, travel = found["stiffness"], findings.found.get("coulomb"), findings.travel
    if coulomb is None and findings.elements and "coulomb" not in findings.refused:
        coulomb = findings.elements.coulomb
    if coulomb is None:
        del found["presliding"]
        refused["presliding"] = findings.refused["coulomb"]
        return
    there = float(np.interp(at, travel.position, travel.friction)) if travel else coulomb.value
    share = math.hypot(stiffness.half_width / stiffness.value, coulomb.half_width / coulomb.value)
    found["presliding"] = Estimate(there / stiffness.value, share * there / stiffness.value, "m")


def _check(of: Signals, plan: Plan, axis: AxisConfig, findings: Findings, known: Known) -> Known:
    """How much of the force of another motion the findings explain."""
    if findings.moved is None or findings.travel is None:
        raise Refused("without the experiment moves there is nothing to check")
    model = AxisForces.of(findings.found, findings.travel, known.mass, _lag(findings), findings.elements)
    findings.checked = model.held_against(of)
    error, own = findings.checked.rms, model.held_against(findings.moved).rms
    findings.validation = error, own
    most = MOST_UNEXPLAINED * own + LEAST_UNEXPLAINED * known.coulomb
    if error > most:
        raise Refused(
            f"{error:.2g} N RMS are unexplained in a motion that no fit used, {own:.2g} N in moves (at most {most:.2g})"
        )
    return known


def _lag(findings: Findings) -> float:
    return findings.found["torque_lag"].value if "torque_lag" in findings.found else ROUGH_LAG


FITS: Mapping[str, Callable[[Signals, Plan, AxisConfig, Findings, Known], Known]] = {
    "push": _push,
    "frequency": _frequency,
    "moves": _moves,
    "loops": _loops,
    "check": _check,
}


def from_run(run: Run, axis: str) -> Findings:
    """What an ordinary run tells of an axis: the force balance of its task's motion."""
    findings = Findings()
    lag = run.rig.axes[axis].model.torque_lag
    try:
        if faults := run.summary()["faults"]:
            raise Refused(f"the run ended in {', '.join(faults)}")
        of = signals(run, axis)
        if not of.force.size:
            raise Refused("no task ran")
        record = Record(of.force, of.position, of.period, of.count, lag, round(0.2 / of.period))
        fit = balance([record], ordinary=True)
    except Refused as refused:
        findings.refused["force balance"] = refused.reason
        return findings
    findings.found, findings.refused = dict(fit.found), dict(fit.refused)
    return findings
