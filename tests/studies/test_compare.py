"""`hil compare`: every combination asked for, gains at other rates, and its tables, pictures and rows."""

from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

from hil.analysis.stability import refuse_unstable
from hil.cli.app import build_app
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from hil.studies.compare.cases import LEARNING, case_rig, cases, disturbances, run_case
from hil.studies.compare.report import comparison_table, draw, summary_table, worst_of
from hil.studies.tune.search_space import at_rate
from tests.support.paths import RIGS

PAPER, MICROSCOPE = RIGS / "paper.toml", RIGS / "microscope-ideal.toml"
QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1", "plant.modelling_error=0.1"]


def test_compare_runs_every_combination_asked_for() -> None:
    chosen = ["pid", "pd-feedforward" + LEARNING]
    work = cases(PAPER, chosen, QUICK, [500.0], corners=True, disturbed=True, seconds=1.0)
    assert len(work) == 2 * (5 + 5 + 1)
    assert {case.rate_hz for case in work} == {1000.0, 500.0}
    row = run_case(work[0])
    assert row["law"] == "pid"
    assert row["state"] == "ACTIVE"
    assert row["refused"] == []
    assert row["axes"]["x"]["max_error"] > 0
    with pytest.raises(RigError, match="the laws are"):
        cases(PAPER, ["magic"], [], [], corners=False, disturbed=False, seconds=1.0)


@pytest.mark.parametrize(
    ("law", "change", "rates", "reason"),
    [
        ("pid", "law.tuned.pid.kp=[1.0]", [], "law.gains.kp has 1 values for 2 axes"),
        ("pid" + LEARNING, "task.kind=hold", [], "the task does not repeat"),
        ("pid", "rate_hz=500", [50.0], "drives.watchdog_s = 0.01"),
    ],
)
def test_compare_refuses_what_cannot_run_before_anything_runs(
    law: str, change: str, rates: list[float], reason: str
) -> None:
    with pytest.raises(RigError, match=reason):
        cases(PAPER, ["pd-feedforward", law], [change], rates, corners=False, disturbed=False, seconds=1.0)


@pytest.mark.long
def test_at_another_rate_gains_are_what_their_unit_makes_of_them() -> None:
    """A stiffness of 1 kHz would shake the axis at 250 Hz; gains without a unit of time stay."""
    changes = ["law.name=pid", "law.gains.kp=1600", "law.gains.kd=8", "law.gains.ki=[320, 640]"]
    rig = load_rig(PAPER, changes)
    scaled = at_rate(rig, "pid", rig.law.effective_gains(), 250.0)
    assert scaled == {"kp": [100.0] * 2, "kd": [2.0] * 2, "ki": [5.0, 10.0]}
    noises = load_rig(PAPER, ["law.name=structured-kalman"])
    assert at_rate(noises, "structured-kalman", noises.law.effective_gains(), 250.0) == noises.law.effective_gains()
    for law in rig.law.tuned:
        (_, slow) = cases(PAPER, [law], [], [250.0], corners=False, disturbed=False, seconds=1.0)
        refuse_unstable(case_rig(slow))


def test_disturbances_fit_the_rig() -> None:
    assert disturbances(load_rig(PAPER))["ripple"] == [
        "plant.ripple_amplitude=[0.05, 0.05]",
        "plant.ripple_period=0.05",
    ]
    for law, extra in disturbances(load_rig(MICROSCOPE)).items():
        assert load_rig(MICROSCOPE, extra), law
    assert "off grid" not in disturbances(load_rig(MICROSCOPE))


def test_a_run_that_ended_in_a_fault_is_the_worst_of_all(tmp_path: Path) -> None:
    rig = load_rig(PAPER)

    def row(law: str, corner: str, largest: float, state: str = "ACTIVE") -> dict[str, Any]:
        figures = {"max_error": largest, "rms_error": largest / 2, "peak_force": 1.0, "chatter": 0.1}
        axes = {"x": figures, "y": figures}
        base = {"law": law, "corner": corner, "rate_hz": 1000.0, "axes": axes, "state": state, "faults": {}}
        return {**base, "refused": ["unstable"] if state == "FAULT" else []}

    rows = [row("pid", "nominal", 2e-6), row("pid", "ripple", float("nan"), "FAULT"), row("pid", "stribeck", 9e-6)]
    assert worst_of(rows, "x")["corner"] == "ripple"
    console = Console(width=130, record=True, file=StringIO())
    console.print(comparison_table(rig, rows), summary_table(rig, rows))
    text = console.export_text()
    assert "2 / 2" in text
    assert "FAULT, unstable: hil run refuses" in text
    assert "(ripple)" in text
    draw(tmp_path / "c.png", rig, rows)
    assert (tmp_path / "c.png").stat().st_size > 1000


@pytest.mark.slow
def test_the_velocity_table_ranks_a_model_of_the_error_above_differences(tmp_path: Path) -> None:
    from hil.studies.compare.velocity_estimators import compare_velocity

    rig = load_rig(PAPER, ["task.radius=0.1", "task.approach_s=0.5", "task.settle_s=0.5", "plant.modelling_error=0.3"])
    found = compare_velocity(rig, RIGS, 4.0)
    rows = {row["estimator"]: row["axes"]["x"]["rms_error"] for row in found if row["case"] == "own task"}
    assert rows["Kalman, constant acceleration of the error"] < 0.6 * rows["finite difference"]
    assert rows["Kalman, constant velocity of the error"] < 0.6 * rows["Kalman, constant velocity"]
    assert rows["Kalman, structured"] < 0.6 * rows["Kalman, model, input and disturbance"]
    by_case: dict[str, dict[str, float]] = {case: {} for case in {row["case"] for row in found}}
    for row in found:
        by_case[row["case"]][row["estimator"]] = row["axes"]["x"]["rms_error"]
    assert len(by_case) == 7
    for case, errors in by_case.items():
        best = min(errors.values())
        assert errors["the rig's own, shown"] <= 1.2 * errors["finite difference"] + 2e-6, case
        assert errors["the rig's own, shown"] <= 3.0 * best + 2e-6, case


def test_compare_on_the_command_line_writes_rows(tmp_path: Path) -> None:
    target = tmp_path / "rows.json"
    settings = [word for change in QUICK for word in ("--set", change)]
    result = CliRunner().invoke(
        build_app("compare"),
        [
            *("compare", str(PAPER), "--laws", "pid", "--seconds", "1", "--json", str(target)),
            "--undisturbed",
            *(*settings, "--picture", str(tmp_path / "c.png"), "--workers", "1"),
        ],
    )
    assert result.exit_code == 0, result.output
    assert '"law": "pid"' in target.read_text()
    assert (tmp_path / "c.png").stat().st_size > 1000
