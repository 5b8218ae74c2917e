"""The paper's claims in short: integrators against closed forms and each other, and what is made of their figures."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hil.cli.app import build_app
from hil.studies.paper.claims import ARTEFACT, CLAIMS, FAILS, HOLDS, INFEASIBLE, agrees, judge
from hil.studies.paper.dormand_prince import solve
from hil.studies.paper.experiment import Job, Run, carry_out, jobs_of
from hil.studies.paper.figures import draw
from hil.studies.paper.moreau import Plan, Trace, integrate
from hil.studies.paper.outcome import outcome_of, page, problems
from hil.studies.paper.problem import COULOMB, DELTA, KP, MASS, ContinuousLaw, circle, paper_law
from hil.studies.paper.reproduce import run_claims
from sim_plant.config import PlantConfig
from sim_plant.physics.stage import Stage, Truth

PLATEAU = DELTA / np.array(KP) * 1e6  # um


def short_run(law: str, gains: dict[str, object], delta: float, h: float = 1e-4, duration: float = 0.4) -> Trace:
    """From the circle's start position: only the speed has to settle."""
    plan = Plan(h, duration, 0.25, round(1e-3 / h), 5.0)
    return integrate(ContinuousLaw(paper_law(law, gains), (3, 2)), COULOMB + delta, plan, circle(0.0).position)


def test_pd_feedforward_leaves_delta_over_kp_and_nothing_without_delta() -> None:
    with_delta = short_run("pd-feedforward", {}, DELTA)
    assert with_delta.peak_error * 1e6 == pytest.approx(PLATEAU, rel=1e-4)
    assert with_delta.unsolved == 0
    assert (short_run("pd-feedforward", {}, 0.0).peak_error < 1e-9).all()


@pytest.mark.parametrize(("reading", "share"), [("printed", 1.0), ("alpha-brackets", 1.0 / 60.0)])
def test_the_readings_of_the_robust_law_differ_by_where_alpha_stands(reading: str, share: float) -> None:
    trace = short_run("robust-pd", {"reading": reading}, DELTA)
    assert np.median(np.abs(trace.error[250:]), axis=0) * 1e6 == pytest.approx(PLATEAU * share, rel=0.01)


def test_the_error_of_the_time_stepping_falls_with_the_square_of_its_step() -> None:
    coarse, fine = (short_run("pd-feedforward", {}, 0.0, h=h).peak_error for h in (2e-4, 1e-4))
    assert coarse / fine == pytest.approx([4.0, 4.0], rel=0.1)


def test_the_time_stepping_agrees_with_the_emulated_stage_driven_in_ten_microsecond_steps() -> None:
    """Two integrators that share no line: implicit time stepping here, located events in sim_plant."""
    plant = PlantConfig(
        mass=[0.022180, 0.011386],
        coulomb=[1.146, 0.172],
        viscous=[-0.04749, 0.04023],
        quadratic=[0.00265, -0.001473],
        modelling_error=DELTA,
    )
    start = circle(0.0).position
    stage = Stage(Truth.from_config(plant, 2), start)
    law = ContinuousLaw(paper_law("pd-feedforward"), (2,))
    for step in range(12_000):
        stage.advance(10_000, law.force(step * 1e-5 + 0.5e-5, stage.position + 0.5e-5 * stage.velocity, stage.velocity))
    ours = short_run("pd-feedforward", {}, DELTA, duration=0.12)
    assert stage.position - circle(0.12).position == pytest.approx(ours.error[-1], rel=0.01)
    assert (np.abs(ours.error[-1]) > 50e-6).all()


def test_friction_holds_an_axis_that_the_law_cannot_move() -> None:
    law = ContinuousLaw(paper_law("pd-feedforward", {"kp": 0.1, "kd": 0.0}), (3, 2))
    trace = integrate(law, COULOMB + 10.0, Plan(1e-3, 0.1, 0.0, 1, 5.0), np.zeros(2))
    assert (trace.position == 0.0).all()


def test_the_adaptive_solver_keeps_its_tolerance_and_order_on_an_oscillator() -> None:
    def slope(_t: float, y: np.ndarray) -> np.ndarray:
        return np.array([y[1], -y[0]])

    errors = []
    for rtol in (1e-4, 1e-7):
        time, states = solve(slope, np.array([1.0, 0.0]), 10.0, rtol, rtol * 1e-3)
        assert time[-1] == pytest.approx(10.0, abs=1e-12)
        errors.append(np.abs(states[:, 0] - np.cos(time)).max())
        assert errors[-1] < 20 * rtol
    assert errors[1] < errors[0] / 100


@pytest.fixture(scope="module")
def runs() -> dict[Job, Run]:
    """Every run of every claim, a fiftieth as long as the real ones; their figures mean nothing."""
    jobs = [job for claim in CLAIMS for job in jobs_of(claim) if job.step == 0]
    return {job: carry_out(job, shorten=0.02) for job in jobs}


def test_each_claim_runs_at_two_steps_unless_its_solver_chooses_them() -> None:
    assert [len(jobs_of(claim)) for claim in CLAIMS] == [2, 1, 2, 2, 4, 2, 0]


@pytest.mark.long
def test_the_page_holds_all_ten_figures_and_needs_no_other_file(runs: dict[Job, Run], tmp_path: Path) -> None:
    figures = draw(runs, tmp_path)
    assert [figure.number for figure, _ in figures] == list(range(3, 13))
    text = page([outcome_of(claim, runs) for claim in CLAIMS.values()], figures)
    assert text.count("data:image/png;base64,") == 10
    assert "http" not in text
    assert all(claim in text for claim in CLAIMS)


def test_the_sampled_loop_of_the_papers_gains_is_unstable_at_a_kilohertz() -> None:
    outcome = outcome_of(CLAIMS["paper-gains-sampled"], {})
    document = outcome.as_json()
    assert document["verdict"] == INFEASIBLE
    assert document["stable_at_1khz"] == {"x": False, "y": False}
    assert list(document["lowest_stable_rate_hz"].values()) == pytest.approx([1296.0, 2842.0], rel=0.02)
    # the same by simulation: m ë = u one period late, velocity by finite difference
    for mass, kp, kd, rate in zip(MASS.tolist(), KP, [20.0, 25.0], (1296.0, 2842.0), strict=True):
        assert _grows(mass, kp, kd, 0.97 * rate)
        assert not _grows(mass, kp, kd, 1.03 * rate)


def _grows(mass: float, kp: float, kd: float, rate: float) -> bool:
    period, e, v, before, force = 1.0 / rate, 1e-6, 0.0, 1e-6, 0.0
    sizes = []
    for _ in range(4000):
        asked = -kp * e - kd * (e - before) * rate
        before = e
        e += v * period + 0.5 * force / mass * period**2
        v += force / mass * period
        force = asked
        sizes.append(abs(e))
        if not abs(e) < 1e3:
            return True
    return max(sizes[-200:]) > max(sizes[:200])


@pytest.mark.parametrize(
    ("claim", "max_um", "verdict", "same"),
    [
        ("pdff-exact", (1e-4, 1e-4), ARTEFACT, True),
        ("pdff-exact", (0.7, 1.7), HOLDS, False),
        ("pdff-solver-noise", (0.5, 1.7), ARTEFACT, True),
        ("pdff-solver-noise", (0.5, 17.0), FAILS, False),
        ("pdff-modelling-error", (100.0, 85.7), HOLDS, True),
        ("pdff-modelling-error", (100.0, 60.0), FAILS, False),
        ("robust-as-printed", (100.0, 85.7), FAILS, True),
        ("robust-as-printed", (1.6, 1.4), HOLDS, False),
        ("robust-filtered-error", (60.8, 55.7), FAILS, True),
        ("robust-alpha-brackets", (1.667, 1.429), HOLDS, True),
        ("robust-alpha-brackets", (1.72, 1.429), HOLDS, False),
    ],
)
def test_verdicts_follow_the_figures(claim: str, max_um: tuple[float, float], verdict: str, same: bool) -> None:
    assert judge(CLAIMS[claim], max_um) == verdict
    assert agrees(CLAIMS[claim], max_um) is same


def test_a_figure_that_depends_on_the_step_or_was_not_solved_is_reported_as_unreliable(runs: dict[Job, Run]) -> None:
    claim = CLAIMS["pdff-modelling-error"]
    first = dataclasses.replace(runs[Job(claim.id, 0, 0)], max_um=(100.0, 85.7))
    finer = dataclasses.replace(first, job=Job(claim.id, 0, 1), max_um=(99.8, 85.9))
    assert problems(outcome_of(claim, {first.job: first, finer.job: finer})) == []
    finer = dataclasses.replace(finer, max_um=(99.8, 87.9), unsolved=3)
    assert len(problems(outcome_of(claim, {first.job: first, finer.job: finer}))) == 3  # bar, step, unsolved


@pytest.mark.long
def test_runs_come_back_from_worker_processes_the_same(runs: dict[Job, Run]) -> None:
    shares: dict[Job, list[float]] = {}
    got = run_claims(
        [CLAIMS["pdff-solver-noise"]], lambda job, share: shares.setdefault(job, []).append(share), 1, shorten=0.02
    )
    job = Job("pdff-solver-noise", 0, 0)
    assert set(shares) == set(got)
    assert all(done[-1] == 1.0 for done in shares.values())
    assert got[job].max_um == runs[job].max_um


def test_the_command_writes_what_was_asked_for_and_refuses_unknown_claims(tmp_path: Path) -> None:
    app = build_app("reproduce")
    target = tmp_path / "claims.json"
    arguments = ["reproduce", "--claims", "paper-gains-sampled", "--json", str(target), "--out", str(tmp_path)]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    (document,) = json.loads(target.read_text())["claims"]
    assert document["id"] == "paper-gains-sampled"
    assert (tmp_path / "report.html").exists()
    refused = CliRunner().invoke(app, ["reproduce", "--claims", "pdff-exact", "cold-fusion", "--out", str(tmp_path)])
    assert refused.exit_code == 2
