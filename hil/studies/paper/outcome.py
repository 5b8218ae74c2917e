"""What came of a claim: its figures, how far they can be trusted, and the verdict; as a document and as a page."""

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.analysis.stability import finite_difference_lowest_rate
from hil.studies.paper.claims import CLAIMS, HOLDS, INFEASIBLE, Claim, agrees, judge
from hil.studies.paper.experiment import Job, Run
from hil.studies.paper.figures import Figure, embedded
from hil.studies.paper.problem import KD, KP, MASS

SAMPLED_HZ = (1296.0, 2842.0)  # what the independent study found
SAMPLED_SHARE = 0.02
UNTRUSTED = 0.01  # change of the maximum between the two steps beyond which a figure counts as unreliable, relative and
UNTRUSTED_UM = 0.001  # absolute, whichever is greater


@dataclass(frozen=True)
class Outcome:
    """One claim's outcome. runs: by variant, the finest step each. step_change_um: how much the maximum moved when the
    step was halved, the worst axis, by variant (NaN: one run only). agrees: with the independent study.
    """

    claim: Claim
    runs: tuple[Run, ...]
    step_change_um: tuple[float, ...]
    verdict: str
    agrees: bool
    lowest_stable_rate_hz: tuple[float, float] | None = None

    def as_json(self) -> dict[str, Any]:
        """Keys: id, reading, paper_um, max_um, plateau_um, verdict and more; (x, y) as {x, y}; um, N, Hz."""
        document: dict[str, Any] = {
            "id": self.claim.id,
            "text": self.claim.text,
            "reading": self.claim.reading,
            "paper_um": _xy(self.claim.paper_um),
            "max_um": None,
            "plateau_um": None,
            "verdict": self.verdict,
            "agrees_with_study": self.agrees,
        }
        if self.lowest_stable_rate_hz is not None:
            document["lowest_stable_rate_hz"] = _xy(self.lowest_stable_rate_hz)
            stable = (rate <= 1000.0 for rate in self.lowest_stable_rate_hz)
            document["stable_at_1khz"] = dict(zip("xy", stable, strict=True))
        variants = [_run_json(run, change) for run, change in zip(self.runs, self.step_change_um, strict=True)]
        if variants:
            document |= variants[0]
            document["other_variants"] = variants[1:]
        return document


def _xy(pair: tuple[float, float] | None) -> dict[str, float] | None:
    return None if pair is None else dict(zip("xy", pair, strict=True))


def _run_json(run: Run, change: float) -> dict[str, Any]:
    return {
        "variant": run.job.spec.name,
        "integrator": run.integrator,
        "step": run.step,
        "max_um": _xy(run.max_um),
        "plateau_um": _xy(run.plateau_um),
        "rms_um": _xy(run.rms_um),
        "step_change_um": change,
        "peak_force": _xy(run.peak_force),
        "transient_force": _xy(run.transient_force),
        "saturations": run.saturations,
        "denominator_floors": run.floors,
        "unsolved_steps": run.unsolved,
    }


def outcome_of(claim: Claim, runs: Mapping[Job, Run]) -> Outcome:
    """Put the runs of a claim together."""
    if not claim.variants:
        return _sampled(claim)
    finest, changes = [], []
    for index in range(len(claim.variants)):
        mine = sorted((run for job, run in runs.items() if job[:2] == (claim.id, index)), key=lambda run: run.job.step)
        finest.append(mine[-1])
        pairs = zip(mine[0].max_um, mine[-1].max_um, strict=True)
        changes.append(max(abs(b - a) for a, b in pairs) if len(mine) > 1 else float("nan"))
    max_um = finest[0].max_um
    return Outcome(claim, tuple(finest), tuple(changes), judge(claim, max_um), agrees(claim, max_um))


def _sampled(claim: Claim) -> Outcome:
    """The lowest rate at which the paper's gains are stable, force one period late, velocity by finite difference."""
    axes = zip(MASS.tolist(), KP, KD, strict=True)
    x, y = (finite_difference_lowest_rate(mass, kp, kd) for mass, kp, kd in axes)
    verdict = INFEASIBLE if max(x, y) > 1000.0 else HOLDS
    same = all(abs(ours - said) <= SAMPLED_SHARE * said for ours, said in zip((x, y), SAMPLED_HZ, strict=True))
    return Outcome(claim, (), (), verdict, same, (x, y))


# the page -------------------------------------------------------------------------------------------------------------

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
table { border-collapse: collapse; width: 100%; font-size: 13px } td, th { padding: .25rem .5rem; text-align: left }
tr { border-bottom: 1px solid #ddd; vertical-align: top } img { max-width: 100% } .no { color: #a00 }
"""
_HEAD = (
    "claim", "reading", "paper X / Y", "max X / Y", "plateau X / Y", "RMS X / Y", "step change", "peak force X / Y, N",
    "over 5 N", "floors", "verdict",
)  # fmt: skip


def page(outcomes: Sequence[Outcome], figures: Sequence[tuple[Figure, Path]]) -> str:
    """The report as one HTML file that needs no other."""
    rows = "".join(_html_rows(outcome) for outcome in outcomes)
    head = "".join(f"<th>{cell}</th>" for cell in _HEAD)
    pictures = "".join(
        f'<h3>Figure {figure.number}</h3><img alt="{html.escape(figure.title)}" src="{embedded(path)}">'
        for figure, path in figures
    )
    integrators = sorted({run.integrator for outcome in outcomes for run in outcome.runs})
    how = "".join(f"<li>{html.escape(line)}</li>" for line in integrators)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>hil reproduce</title><style>{_STYLE}</style>'
        "<h1>The claims of Xu, Cai, Zou (2013), measured</h1>"
        "<p>Errors in µm over the steady window, between the true position and the setpoint. Step change: how far the "
        "maximum moves when the step is halved. Over 5 N: steps that ask for more than the rig's force limit (the "
        "paper has none; the 1 m initial error does it). Floors: steps with the robust law's denominator at its "
        "floor.</p>"
        f"<ul>{how}</ul><table><tr>{head}</tr>{rows}</table>"
        "<h2>Figures</h2><p>Grey lines: what the paper reads off its own figure.</p>"
        f"{pictures}</html>\n"
    )


def cells(outcome: Outcome) -> list[list[str]]:
    """One row of text per variant, in the order of the report's columns."""
    claim = outcome.claim
    if outcome.lowest_stable_rate_hz is not None:
        x, y = outcome.lowest_stable_rate_hz
        found = f"stable from {x:.0f} / {y:.0f} Hz on"
        return [[claim.id, claim.reading, "-", found, "-", "-", "-", "-", "-", "-", outcome.verdict]]
    rows = []
    for run, change in zip(outcome.runs, outcome.step_change_um, strict=True):
        first = run is outcome.runs[0]
        rows.append(
            [
                claim.id if first else "",
                claim.reading if len(outcome.runs) == 1 else f"{claim.reading}: {run.job.spec.name}",
                _pair(claim.paper_um) if first else "",
                _pair(run.max_um),
                _pair(run.plateau_um),
                _pair(run.rms_um),
                "-" if change != change else f"{change:.1g}",
                _pair(run.peak_force),
                str(run.saturations),
                str(run.floors),
                outcome.verdict if first else "",
            ]
        )
    return rows


def statements(outcome: Outcome) -> list[tuple[str, str]]:
    """The outcome for a terminal: what, and its value with units; the variants one after the other."""
    claim = outcome.claim
    said = [("claim", claim.text), ("reading", claim.reading)]
    if outcome.lowest_stable_rate_hz is not None:
        x, y = outcome.lowest_stable_rate_hz
        return [*said, ("stable from, X / Y", f"{x:.0f} / {y:.0f} Hz"), ("verdict", outcome.verdict)]
    said.append(("paper, X / Y", f"{_pair(claim.paper_um)} µm"))
    for run, change in zip(outcome.runs, outcome.step_change_um, strict=True):
        if len(outcome.runs) > 1:
            said.append(("variant", run.job.spec.name))
        halved = "" if change != change else f"; step halved: maximum moves {change:.1g} µm"
        said += [
            ("integrator", f"{run.integrator}; step {run.step}{halved}"),
            ("ours, max X / Y", f"{_pair(run.max_um)} µm"),
            ("plateau, RMS", f"{_pair(run.plateau_um)} µm, {_pair(run.rms_um)} µm"),
            ("peak force", f"{_pair(run.peak_force)} N steady, {_pair(run.transient_force)} N in the transient"),
            ("counted", f"over 5 N in {run.saturations} steps, denominator at its floor in {run.floors}"),
        ]
    return [*said, ("verdict", outcome.verdict)]


def _pair(pair: tuple[float, float] | None) -> str:
    return "-" if pair is None else f"{pair[0]:.3g} / {pair[1]:.3g}"


def _html_rows(outcome: Outcome) -> str:
    mark = "" if outcome.agrees else ' class="no"'
    return "".join(
        f"<tr{mark}>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in cells(outcome)
    )


def problems(outcome: Outcome) -> list[str]:
    """What should make a reader doubt this outcome."""
    found = [] if outcome.agrees else [f"{outcome.claim.id}: differs from the independent study"]
    for run, change in zip(outcome.runs, outcome.step_change_um, strict=True):
        if change > max(UNTRUSTED * max(run.max_um), UNTRUSTED_UM):
            found.append(f"{outcome.claim.id}: halving the step moves the maximum by {change:.2g} um")
        if run.unsolved:
            found.append(f"{outcome.claim.id}: {run.unsolved} steps were not solved to tolerance")
    return found


def find_claims(ids: Sequence[str]) -> list[Claim]:
    """The claims of these ids, all where none is given. Raises ValueError."""
    unknown = [name for name in ids if name not in CLAIMS]
    if unknown:
        raise ValueError(f"--claims {unknown[0]}: no such claim; there are {', '.join(CLAIMS)}")
    return [CLAIMS[name] for name in ids or CLAIMS]
