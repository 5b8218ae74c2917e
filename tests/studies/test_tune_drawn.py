"""`hil tune --trials drawn`: what is searched, on which stages, and when gains count as better."""

from dataclasses import replace
from pathlib import Path
from shutil import copy

import numpy as np
import pytest
from typer.testing import CliRunner

from hil.analysis.loop_corners import CornerFinding, CornerTrial, check_corners
from hil.analysis.pulse_loop import loop_of, try_together
from hil.cli.app import build_app
from hil.control.gain import Gain, Knob, declared
from hil.control.laws.presliding_kalman import PreslidingKalman
from hil.control.nominal_model import rig_model
from hil.control.trajectories import make_trajectory
from hil.control.trajectories.chosen_axes import ChosenAxes
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.evidence.stages import columns, only, stage_of
from hil.studies.tune.candidate_simulation import LOST, CandidateSimulation
from hil.studies.tune.drawn_stages import (
    FRESH_SEEDS,
    REFUSED,
    Compared,
    DrawnBench,
    Loop,
    StageFigures,
    drawn_trials,
    fresh_seeds,
    own_task,
    paired,
    shortfall,
)
from hil.studies.tune.evolution import evolve
from hil.studies.tune.objective import Kind, Margins, kind_for
from hil.studies.tune.search_space import at_rate, own_gains, space_of
from hil.virtual.batch import BatchRun
from tests.support.paths import RIGS

LAW = "presliding-kalman"
MICROSCOPE = RIGS / "microscope.toml"
MOVES = [
    "task.kind=point_to_point", "task.target=[0.0002,0,0,0]", "task.axes=['x','y','z','theta']", "task.move_s=0.04",
    "task.dwell_s=0.02",
]  # fmt: skip
GOOD = CornerFinding("x", "as the model says", False, True, True, 6.4, 31.0, 40.0)
FIT = Loop(GOOD, None, 0.0)


def bench_of(rig: RigConfig, count: int = 2) -> DrawnBench:
    return DrawnBench(rig, LAW, 0, drawn_trials(rig, [1], count))


def test_the_flagship_is_searched_around_the_gains_that_it_works_out_itself() -> None:
    rig = load_rig(MICROSCOPE)
    own, space = own_gains(rig, LAW), space_of(rig, LAW)
    assert {"bandwidth", "damping", "integral", "innovation_noise", "finest"} <= set(space) == set(own)
    assert all(knob.low < 1.0 < knob.high for knob in space.values())
    law = PreslidingKalman(rig_model(rig), 1e-3, np.full(4, 10.0))
    stated = PreslidingKalman(rig_model(rig), 1e-3, np.full(4, 10.0), **own)
    assert law.stiffness == pytest.approx(rig_model(rig).mass * (own["bandwidth"] * 1e3) ** 2)
    assert np.array_equal(law.stiffness, stated.stiffness)
    assert np.array_equal(law.damping, stated.damping)
    bench = bench_of(rig)
    back = bench.gains(bench.known()[None])
    assert {name: values[0] for name, values in back.items()} == pytest.approx({n: v[0] for n, v in own.items()})
    stiffer = own_gains(load_rig(MICROSCOPE, ["axes.x.model.mode_frequency_hz=0"]), LAW)
    assert stiffer["bandwidth"][0] > 1.2 * own["bandwidth"][0]
    assert stiffer["bandwidth"][1] == own["bandwidth"][1]


def test_gains_of_the_file_are_where_a_search_begins() -> None:
    rig = load_rig(MICROSCOPE, ["law.gains.bandwidth=0.1"])
    assert bench_of(rig).known_gains()["bandwidth"].tolist() == [0.1]
    assert bench_of(rig).known_gains()["damping"].tolist() == [own_gains(rig, LAW)["damping"][0]]


def test_a_unit_of_ones_own_needs_a_number_to_start_from(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="scale 'own' needs a default that is a number, or None; it is 'sign'"):
        declared({"switch": Gain("sign", words=("sign", "tanh"), tune=Knob(0.5, 2.0, "own"))})
    copy(MICROSCOPE, tmp_path)
    (tmp_path / "half.py").write_text(HALF)
    rig = load_rig(tmp_path / MICROSCOPE.name, ["law.name=./half.py:Half"])
    with pytest.raises(RigError, match="scale 'own' of kd: a default or own_gains"):
        own_gains(rig, rig.law.name)


HALF = """
import hil

class Half(hil.Law):
    GAINS = {"kp": hil.Gain(2.0, tune=hil.Knob(0.5, 2.0, "own")), "kd": hil.Gain(None, tune=hil.Knob(0.5, 2.0, "own"))}

    def reset(self, position, force): ...

    def force(self, inputs): return 0.0
"""


def test_at_another_rate_gains_are_the_same_multiples() -> None:
    rig = load_rig(MICROSCOPE)
    old, new = own_gains(rig, LAW), own_gains(rig, LAW, 0.5e-3)
    assert new["bandwidth"][0] != old["bandwidth"][0]
    scaled = at_rate(rig, LAW, {"bandwidth": (1.1 * old["bandwidth"]).tolist()}, 2000.0)
    assert scaled["bandwidth"] == pytest.approx((1.1 * new["bandwidth"]).tolist())


def test_only_laws_that_follow_from_the_model_are_tried_on_drawn_stages_unasked() -> None:
    rig = load_rig(MICROSCOPE)
    assert kind_for(rig) is Kind.DRAWN
    assert kind_for(rig, "pid") is Kind.STAGE
    with pytest.raises(RigError, match="--trials drawn: pid has no kd, ki, kp to compare with; try --trials stage"):
        DrawnBench(rig, "pid", 0, drawn_trials(rig, [1], 1))


@pytest.mark.long
def test_the_stages_are_those_of_evidence_bit_for_bit() -> None:
    """A candidate's peak on one is that of the batch that `hil evidence --measured` runs."""
    rig = load_rig(MICROSCOPE, MOVES)
    chosen = [trial._replace(learns=0.1) for trial in drawn_trials(rig, [7, 8], 3)]
    assert [trial.name for trial in chosen] == ["stage 7-0", "stage 8-0", "stage 7-1"]
    simulation = CandidateSimulation(rig, 0, chosen, 100, 300, 1)
    gains = {name: values[:1] for name, values in own_gains(rig, LAW).items()}
    figures = simulation.run(rig.law, gains)
    whole = make_trajectory(rig.task, rig.axis_names, [0.0] * 4, rig.period_ns, rig.counts)
    for index, (seed, number) in enumerate([(7, 0), (8, 0), (7, 1)]):
        truth = columns(stage_of(rig, seed, number, None), [0])
        batch = BatchRun(only(rig, ["x"]), type(truth).stack([truth]), ChosenAxes(whole, [0]))
        errors = []
        for _ in range(300):
            batch.tick()
            errors.append(abs(float(batch.error[0, 0])))
        assert figures.largest[0, index] == max(errors[100:])
        assert figures.ever[0, index] == max(errors)


def test_the_fresh_stages_are_never_those_of_the_search() -> None:
    assert fresh_seeds(1) == list(FRESH_SEEDS[:3])
    for seed in FRESH_SEEDS:
        assert seed not in fresh_seeds(seed)
        assert len(fresh_seeds(seed)) == 3


def test_a_plan_is_judged_from_its_second_cell_on() -> None:
    rig = load_rig(MICROSCOPE)
    plan = rig.task.injection
    assert plan is not None
    task = own_task(rig)
    assert task.changes["injection"].cells == 3
    assert task.changes["injection"].dwell_s == 0.3
    assert task.learns == pytest.approx(plan.transfer_s + plan.strike_s + 0.3 + plan.withdraw_s)
    assert own_task(load_rig(MICROSCOPE, MOVES)).learns == 4.0
    simulation = CandidateSimulation(rig, 0, drawn_trials(rig, [1], 1), None, None, 1)
    first, last = (int(ticks[0]) for ticks in simulation._window)
    assert first == pytest.approx(1e3 * (plan.approach_s + task.learns), abs=2)
    assert last - first == pytest.approx(1e3 * (2 * task.learns + plan.approach_s), abs=3)


@pytest.mark.long
@pytest.mark.replaces_methods
def test_what_lacks_margins_is_dear_and_not_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = bench_of(load_rig(MICROSCOPE, MOVES))
    gains = {name: np.repeat(values, 2) for name, values in bench.known_gains().items()}
    gains["bandwidth"] *= [1.15, 1.8]
    monkeypatch.setattr(bench, "figures", None)
    outcome = bench.judge(gains)
    assert (outcome.error == LOST).all()
    assert REFUSED < outcome.cost[0] < outcome.cost[1]


@pytest.mark.long
def test_corners_one_by_one_are_those_of_the_check() -> None:
    rig = only(load_rig(MICROSCOPE), ["x", "theta"])
    trial = CornerTrial(rig, 400)
    try_together(loop_of(rig, [trial]), [trial])
    found = check_corners(rig, 400)
    for index, name in enumerate(rig.axis_names):
        assert list(trial.of_axis(index)) == [finding for finding in found if finding.axis == name]


@pytest.mark.parametrize(
    ("changes", "lacks_db"),
    [
        ({}, 0.0),
        ({"gain_db": 5.5}, 0.5),
        ({"gain_db": 5.5, "measured": True}, 0.0),
        ({"phase_deg": 25.0}, 1.0),
        ({"nominal": False, "gain_db": 2.0, "phase_deg": 14.0}, 1.2),
        ({"at_rest": True, "gain_db": 4.0, "phase_deg": 1.0}, 0.5),
        ({"stable": False}, 32.0),
    ],
)
def test_the_margins_are_those_that_the_check_asks_for(changes: dict[str, float], lacks_db: float) -> None:
    finding = replace(GOOD, **changes)  # type: ignore[arg-type]
    assert shortfall(finding) == pytest.approx(lacks_db)
    assert bool(finding.lacks()) is (lacks_db > 0.0)
    assert shortfall(finding, Margins(0.5, 0.0)) >= lacks_db


def stages(peak: np.ndarray, lost: int = 0) -> StageFigures:
    return StageFigures(peak, 0.1 * peak, np.arange(peak.size) < lost)


OLD = np.geomspace(1e-7, 1e-6, 20)
NOISE = np.exp(0.02 * np.sin(np.arange(20.0)))


def test_a_change_is_told_stage_by_stage() -> None:
    """Stages that differ tenfold do not hide 5 %; what both lost says nothing."""
    found = paired(stages(OLD), stages(0.95 * OLD * NOISE))
    assert found.low < np.log(0.95) < found.high < -0.03
    without = paired(stages(OLD, lost=1), stages(OLD * NOISE, lost=2))
    assert without.mean == pytest.approx(np.log(NOISE[2:]).mean())
    assert paired(stages(OLD, lost=19), stages(OLD)).high == np.inf


def reasons(new: StageFigures, *, old: StageFigures | None = None, loops: tuple[Loop, Loop] = (FIT, FIT)) -> str:
    before = old or stages(OLD)
    return "; ".join(Compared((before, new), (before, new), loops).reasons_to_keep())


def test_gains_are_new_only_where_they_are_surely_better() -> None:
    better = stages(0.9 * OLD * NOISE)
    assert reasons(better) == ""
    assert reasons(stages(OLD * NOISE)) == "the mean error on fresh stages is not surely less"
    for times, kept in ((1.05, False), (1.15, True)):
        worst = better.peak.copy()
        worst[-2:] = times * OLD[-2:]
        found = reasons(better._replace(peak=worst))
        assert found == ("the 95 % of the peak on fresh stages is more than a tenth larger" if kept else "")
    assert reasons(stages(better.peak, lost=1)) == "those found lost 1 fresh stages, not 0"
    short = replace(GOOD, gain_db=5.0)
    lacks = Loop(GOOD, short, 1.0)
    assert reasons(better, loops=(FIT, lacks)) == (
        "those found lack margins, as the model says: a gain margin of 5.0 dB (at least 6) at 40 Hz"
    )
    assert reasons(stages(1.2 * OLD), loops=(lacks, FIT)) == ""  # margins count first
    assert reasons(stages(OLD), old=stages(OLD, lost=1), loops=(lacks, lacks)) != ""


def test_evolution_finds_the_bottom_of_a_narrow_valley() -> None:
    def valley(points: np.ndarray) -> np.ndarray:
        x, y = (points - [0.7, 0.6]).T
        return 100.0 * (x - y) ** 2 + (x + y) ** 2

    first: list[np.ndarray] = []

    def noted(points: np.ndarray) -> np.ndarray:
        first.append(points)
        return valley(points)

    start = np.array([0.3, 0.2])
    found = evolve(noted, start, 12, 25, np.random.default_rng(1))
    assert first[0][0].tolist() == start.tolist()
    assert len(first) == 26
    assert found == pytest.approx([0.7, 0.6], abs=0.02)
    assert evolve(valley, start, 12, 25, np.random.default_rng(1)).tolist() == found.tolist()
    assert all(((points >= 0.0) & (points <= 1.0)).all() for points in first)
    assert evolve(lambda points: np.arange(len(points)), start, 6, 0, np.random.default_rng(1)).tolist() == [0.3, 0.2]


def tuned(rig_file: Path, *words: str, law: str = LAW) -> tuple[int, str]:
    settings = [word for change in MOVES for word in ("--set", change)]
    size = ["--population", "6", "--generations", "1", "--unseen", "6", "--axes", "x"]
    result = CliRunner().invoke(build_app("tune"), ["tune", str(rig_file), "--law", law, *size, *settings, *words])
    return result.exit_code, f"{result.output}{result.exception or ''}"


def test_options_that_say_nothing_on_drawn_stages_are_refused() -> None:
    for words in (["--margin", "6"], ["--phase-margin", "30"], ["--start", "middle"], ["--repeats", "2"]):
        code, output = tuned(MICROSCOPE, *words)
        assert code != 0
        assert f"{words[0]}: not with --trials drawn" in output
    code, output = tuned(MICROSCOPE, law="pid")
    assert code != 0
    assert "--axes: the rig file states no kp, kd, ki of pid for the others" in output


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A rig file for a search of seconds."""
    monkeypatch.setattr("hil.studies.tune.drawn_stages.LEARN_S", 0.4)
    monkeypatch.setattr("hil.studies.tune.drawn_stages.STAGES", 2)
    copy(MICROSCOPE, tmp_path / "rig.toml")
    return tmp_path / "rig.toml"


@pytest.mark.long
def test_a_search_that_finds_better_gains_writes_them_for_its_axis(small: Path) -> None:
    poor = "\n[law.tuned.presliding-kalman]\nbandwidth = [0.05, 0.1488, 0.1488, 0.1488]\n"
    small.write_text(MICROSCOPE.read_text().replace("\n[estimator]", poor + "\n[estimator]", 1))
    code, output = tuned(small)
    assert code == 0, output
    assert "runs the task on 2 drawn stages (seed 1)" in output
    assert "6 fresh stages (seeds 20000, 20001, 20002)" in output
    assert "x: new gains: on 6 fresh stages median peak" in output
    assert f"next: hil check {small}" in output
    line = f"# hil tune {small} --law {LAW} --population 6 --generations 1 --seed 1 --trials drawn --unseen 6 --axes x "
    assert line in small.read_text()
    rig = load_rig(small)
    found = rig.law.tuned[LAW]
    assert set(found) == set(space_of(rig, LAW))
    assert found["bandwidth"][0] > 0.05
    assert found["bandwidth"][1:] == [0.1488, 0.1488, 0.1488]
    assert found["damping"][1:] == own_gains(rig, LAW)["damping"][1:].tolist()


@pytest.mark.long
def test_a_search_that_finds_nothing_better_writes_nothing(small: Path) -> None:
    """The noise of a resonance that the axis does not have changes nothing."""
    before = small.read_bytes()
    code, output = tuned(small, "--only", "mode_noise", "--set", "axes.x.model.mode_frequency_hz=0")
    assert code == 0, output
    assert "x: the default gains stand: the mean error on fresh stages is not surely less" in output
    assert "No better gains found" in output
    assert small.read_bytes() == before
