"""Batches of cells in lockstep: the motion's verdicts beside the emulated dish's truth, and the command."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from hil.control.motion.injection.verdict import TOLD, Phase, Verdict
from hil.cycle.state_machine import State
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.inject.batch import Batch, inject
from hil.studies.inject.equipment import assumed, grid, middle, read_positions, words
from hil.studies.inject.judge import judged, quantile, wilson
from hil.virtual.lockstep import LockstepRun
from tests.support.cells import RIG, RIGS, equipped
from tests.support.paths import ROOT
from tests.support.records import kept


@pytest.fixture(scope="module")
def each_kind() -> Batch:
    """A good cell, one of each anomaly, and a broken tip that ends the batch."""
    kinds = ("", "no_cell", "rolled", "not_pierced", "double", "sensor_dead", "camera_frozen", "clogged", "stuck")
    return inject(equipped(11, anomalies=(*kinds, "broken", "")), RIGS)


@pytest.mark.long
def test_every_kind_of_cell_gets_the_verdict_that_its_truth_asks_for(each_kind: Batch) -> None:
    assert [(cell.anomaly, cell.result.verdict) for cell in each_kind.cells if not cell.right] == []
    assert len({cell.result.verdict for cell in each_kind.cells}) >= 9
    assert each_kind.cells[-1].result.verdict is Verdict.BROKEN
    assert (len(each_kind.cells), each_kind.planned, each_kind.fault) == (10, 11, "")


@pytest.mark.requirement(id="SR-8.3")
@pytest.mark.long
def test_no_pulse_into_a_whole_cell_and_no_force_beyond_the_limit(each_kind: Batch) -> None:
    assert [cell.wrong_pulses for cell in each_kind.cells] == [0] * 10
    assert max(cell.peak_force for cell in each_kind.cells) <= 1.05 * 1.4e-3
    assert each_kind.limited <= 2  # its own plans stay within what the axes have, but for a clock that steps by 1 us


@pytest.mark.long
def test_a_far_side_that_gives_way_before_the_tip_has_stopped_is_seen() -> None:
    """At 4 mm/s that is 5 ms after the puncture; it was taken for the end of the first membrane's force."""
    plain = load_rig(RIG)
    dish = words(plain, grid(5, 6, 1e-3, middle(plain))[:7], 1, 0.0, ["double"] * 7, fd=True)
    batch = inject(load_rig(RIG, (*dish, "motion.parameters.first=7")), RIGS)
    (cell,) = batch.cells
    assert (cell.anomaly, cell.result.verdict) == ("double", Verdict.DOUBLE)
    assert cell.result.evidence == "the force dropped a second time"
    assert cell.wrong_pulses == 0


@pytest.mark.long
def test_a_puncture_is_known_within_5_ms_and_the_tip_stops_within_7_ms_of_its_way(each_kind: Batch) -> None:
    good = each_kind.cells[0]
    assert 0.0 < good.known_after <= 5e-3
    assert 0.0 < good.lurch <= 6.7e-3 * good.result.pierced_speed


@pytest.mark.long
def test_a_tick_that_is_missed_in_the_pulse_costs_no_cell() -> None:
    """It stops nothing, but closes the valve. Live, such a cell had a quarter of its bolus and was called clogged."""
    run = LockstepRun(equipped(1), RIGS)
    decided = run.cycle.supervisor.goals.decided
    assert decided is not None
    since = 0
    while not decided.motion.results:
        run.tick()
        since += decided.phase == Phase.CONFIRM
        if since == 13:
            run.skip(1)
        assert run.index < 3000
    (result,) = decided.motion.results
    assert (result.verdict, since > 13, run.cycle.fault) == (Verdict.OK, True, 0)
    assert run.stage.dish is not None
    first, second = (pulse.bolus for pulse in run.stage.dish.cells[0].pulses)
    assert 0.2 < first < 0.4
    assert first + second == pytest.approx(1.0, abs=0.05)
    assert result.bolus == pytest.approx(1.0, abs=0.1)


@pytest.mark.long
def test_the_record_tells_phase_cell_verdict_and_valve() -> None:
    rig = equipped(2)
    rows = []
    run = LockstepRun(rig, RIGS, observer=lambda tick, frames, result: rows.append(kept(result.record)))
    while run.cycle.supervisor.goals.decided.runs or not rows or rows[-1]["motion"] in (0, 7):  # type: ignore[union-attr]
        run.tick()
        assert run.index < 5000
    told = [(int(row["cell"]), int(row["phase"])) for row in rows if row["phase"] >= TOLD]
    assert told == [(1, TOLD + Verdict.OK), (2, TOLD + Verdict.OK)]
    assert sum(int(row["outputs"]) for row in rows) == 100  # two pulses of 50 ms
    assert all(row["phase"] == 8 for row in rows if row["outputs"])
    assert run.cycle.state is State.ACTIVE


@pytest.mark.long
def test_the_same_batch_has_the_same_bytes_and_another_dish_others() -> None:
    def hashed(seed: int) -> str:
        run = LockstepRun(equipped(1, seed=seed), RIGS)
        for _ in range(900):
            run.tick()
        return run.trace_sha256

    assert hashed(1) == hashed(1) != hashed(2)


def test_a_grid_goes_to_and_fro_around_its_middle() -> None:
    assert grid(2, 2, 2.0, (1.0, 1.0)) == [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n", "no column 'x'"),
        ("x,y\n", "no cell"),
        ("x,y\n1e-3,oops\n", "row 1, column y"),
        ("x,y\n1e-3\n", "row 1: 1 values"),
        ("x,y\n1e-3,nan\n", "row 1: x = 0.001, y = nan"),
        ("x,y,x\n0,0,1\n", "two columns 'x'"),
    ],
)
def test_a_file_of_cells_that_is_none_is_refused_by_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "cells.csv").write_text(text)
    with pytest.raises(RigError, match=said):
        read_positions(tmp_path / "cells.csv")


def test_wilsons_interval_and_quantiles() -> None:
    low, high = wilson(939, 940)
    assert (round(low, 4), round(high, 4)) == (0.9940, 0.9998)
    assert wilson(0, 10)[0] == 0.0
    assert quantile([3.0, 1.0, 2.0], 0.5) == 2.0


def test_an_empty_batch_is_held_against_no_bar_that_it_cannot_meet() -> None:
    assert [line.holds for line in judged(Batch(), 1e-3)] == [True]  # no pulse was given


@pytest.mark.long
def test_the_command_prints_the_bars_and_writes_cells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from hil.studies.inject.command import inject as command

    command(RIG, grid_text="1x2", csv_target=str(tmp_path / "cells.csv"), json_target=str(tmp_path / "batch.json"))
    lines = (tmp_path / "cells.csv").read_text().splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("number,verdict,")
    document = json.loads((tmp_path / "batch.json").read_text())
    assert [cell["verdict"] for cell in document["cells"]] == ["ok", "ok"]
    assert "reference sensors" in capsys.readouterr().out.replace("\n", " ")


@pytest.mark.long
def test_the_same_cells_are_compared_by_every_z_law(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At 4 mm/s: press and ramp stop behind the puncture, position goes on, visual sees it far too late."""
    from hil.studies.inject.command import inject as command

    command(RIG, grid_text="1x2", compare=True, json_target=str(tmp_path / "compared.json"))
    document = json.loads((tmp_path / "compared.json").read_text())
    rows = {row["z_law"]: row for row in document["z_laws"]}
    assert list(rows) == ["press", "ramp", "impedance", "visual", "position"]
    assert {row["wrong_pulses"] for row in rows.values()} == {0}
    assert [row["fault"] for row in rows.values()] == [""] * 5
    assert max(row["force"][1] for row in rows.values()) <= 1.05 * 1.4e-3
    felt = max(rows["press"]["further"][1], rows["ramp"]["further"][1])
    assert felt < 30e-6
    assert rows["visual"]["further"][0] > 3 * felt
    assert "4 mm/s" in capsys.readouterr().out


@pytest.mark.long
def test_the_sensors_of_a_rig_with_its_own_equipment_measure_the_dish(tmp_path: Path) -> None:
    """The rig file of docs/inject.md: its force sensor measured nothing, and each cell was no_cell."""
    page = (ROOT / "docs" / "inject.md").read_text(encoding="utf-8")
    own = page[page.index("```toml") :].split("```")[1].removeprefix("toml")
    plain = RIG.read_text(encoding="utf-8")
    path = tmp_path / "my-stage.toml"
    path.write_text(plain[: plain.index("[task]")] + own, encoding="utf-8")
    rig = load_rig(path)
    dish = words(rig, [middle(rig)], 1, 0.0, fd=True)
    (cell,) = inject(load_rig(path, dish), tmp_path).cells
    assert cell.wrong_pulses == 0
    assert cell.result.verdict is Verdict.UNKNOWN  # nothing shows the bolus
    assert cell.result.evidence == "nothing shows the bolus"
    assert 0.3e-3 < cell.result.pierced_force < 1.4e-3
    assert "plant.sensors is empty" in assumed(rig)


def test_a_cell_beyond_the_travel_is_refused_by_its_file_or_option(tmp_path: Path) -> None:
    from hil.studies.inject.command import inject as command

    path = tmp_path / "cells.csv"
    path.write_text("x,y\n0,0\n0,0.5\n")
    with pytest.raises(RigError, match=r"cells.csv: cell 2 has y = 0.5 m; allowed: -0.02575 to 0.02575"):
        command(RIG, cells=path)
    with pytest.raises(RigError, match=r"--grid 1x50 --pitch 0.01: cell 1 has x = -0.245 m; allowed"):
        command(RIG, grid_text="1x50", pitch=0.01)


def test_a_batch_in_virtual_time_that_is_interrupted_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from hil.studies.inject import command

    def interrupted(*_: object, **__: object) -> Batch:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "inject_batch", interrupted)
    monkeypatch.setattr("sys.argv", ["hil", "inject", "microscope", "--csv", "my cells.csv", "--resume"])
    with pytest.raises(KeyboardInterrupt):
        command.inject(RIG, csv_target=str(tmp_path / "cells.csv"))
    assert capsys.readouterr().err == "to go on: hil inject microscope --csv 'my cells.csv' --resume\n"


@pytest.mark.parametrize("text", ["", "x", "4", "0x5", "-1x3", "51x1", "1x1x1", "²x5", "4x5\n", "9" * 5000 + "x1"])
def test_a_grid_that_is_none_is_refused_with_an_example(text: str) -> None:
    from hil.studies.inject.command import inject as command

    with pytest.raises(RigError, match=r"expected ROWSxCOLUMNS such as 4x5, each from 1 to 50"):
        command(RIG, grid_text=text)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"z_law": "pres"}, "'pres': one of press, ramp"),
        ({"compare": True, "live": True}, "--json alone"),
        ({"attach": True, "speed": 1e-3}, "has its own"),
        ({"turn": "theta"}, "needs --cells with a column of that axis"),
    ],
)
def test_what_does_not_go_together_is_refused(given: dict[str, Any], said: str) -> None:
    from hil.studies.inject.command import inject as command

    with pytest.raises(typer.BadParameter, match=said):
        command(RIG, **given)


@pytest.mark.long
def test_the_command_turns_the_holder_to_the_angles_of_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hil.studies.inject import command

    planned: list[RigConfig] = []

    def kept_rig(rig: RigConfig, *more: Any, **named: Any) -> Batch:
        planned.append(rig)
        return inject(rig, *more, **named)

    monkeypatch.setattr(command, "inject_batch", kept_rig)
    x, y = middle(load_rig(RIG))
    file = tmp_path / "cells.csv"
    file.write_text(f"x,y,theta\n{x},{y},0.2\n{x + 1e-3},{y},-0.1\n")
    target = tmp_path / "injected.csv"
    command.inject(RIG, cells=file, turn="theta", csv_target=str(target))
    (rig,) = planned
    assert rig.motion.parameters["turn"] == "theta"
    assert [row[3] for row in rig.motion.parameters["cells"]] == [0.2, -0.1]
    with target.open(newline="") as written:
        assert [row["verdict"] for row in csv.DictReader(written)] == ["ok", "ok"]
    file.write_text(f"x,y\n{x},{y}\n")
    with pytest.raises(RigError, match=r"cells.csv: no column 'theta'; expected theta in rad"):
        command.inject(RIG, cells=file, turn="theta")
    file.write_text(f"x,y,theta\n{x},{y},9\n")
    with pytest.raises(RigError, match=r"row 1 takes theta to 9 rad; allowed: "):
        command.inject(RIG, cells=file, turn="theta")


@pytest.mark.long
def test_the_holder_is_turned_on_the_way_and_the_injector_has_pressure_in_the_pulse_alone() -> None:
    plain = load_rig(RIG)
    x, y = middle(plain)
    places = [(x, y), (x + 1e-3, y)]
    pressure = 'sensors.pressure={can_id=0x3F6, fd=true, unit="Pa", scale=0.01, noise=50.0, range=[-1e3, 1e6]}'
    first = words(plain, places, 1, 0.0, fd=True)
    entry = next(word for word in first if word.startswith("plant.sensors="))
    entry = entry.removesuffix("]") + ", {sensor='pressure', measures='pressure', axis='z'}]"
    flat = load_rig(RIG, tuple(first)).motion.parameters["cells"]
    cells = [[*row, angle] for row, angle in zip(flat, (0.2, -0.1), strict=True)]
    more = ("motion.parameters.turn=theta", f"motion.parameters.cells={json.dumps(cells)}", pressure, entry)
    rig = load_rig(RIG, (*first, *more))
    rows: list[np.void] = []
    run = LockstepRun(rig, RIGS, observer=lambda tick, frames, result: rows.append(kept(result.record)))
    decided = run.cycle.supervisor.goals.decided
    assert decided is not None
    while len(decided.motion.results) < 2:
        run.tick()
        assert run.index < 8000
    assert [result.verdict for result in decided.motion.results] == [Verdict.OK, Verdict.OK]
    theta, channel = rig.axis_names.index("theta"), list(rig.sensors).index("pressure")
    pressed = [row for row in rows if Phase.SEEK <= row["phase"] <= Phase.CONFIRM]
    for number, angle in ((1, 0.2), (2, -0.1)):
        held = [row["position"][theta] for row in pressed if row["cell"] == number]
        assert np.abs(np.array(held) - angle).max() < 1e-4
    shut = [row["readings"][channel] for row in rows[100:] if row["phase"] == Phase.SEEK]
    given = [row["readings"][channel] for row in rows if row["outputs"]]
    assert abs(np.mean(shut)) < 4.0 * 50.0 / len(shut) ** 0.5
    assert np.median(given) == pytest.approx(5e4, rel=0.01)
