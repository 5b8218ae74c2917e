"""A batch as an instrument: asked, cut short, gone on with, written down, and shown."""

import json
from pathlib import Path

import pytest

from hil.control.motion.contract import Request
from hil.control.motion.injection.verdict import TOLD, CellResult, Phase, Verdict
from hil.rig.schema import RigError
from hil.studies.inject.batch import Batch, Injected, inject
from hil.studies.inject.command import inject as command
from hil.studies.inject.equipment import grid, middle
from hil.studies.inject.judge import judged
from hil.studies.inject.report import batch_page
from hil.studies.inject.requests import PAUSE_S, Declared, Script, declared
from hil.studies.inject.sheet import COLUMNS, Sheet, read_sheet
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from tests.support.cells import RIG, RIGS, equipped

PLACES = [(0.0, 0.0), (1e-3, 0.0), (2e-3, 0.0)]


def over(number: int, verdict: Verdict = Verdict.OK, **more: float) -> Injected:
    return Injected(CellResult(number, verdict, 1.0, 2.0, **more), "", Verdict.OK, 1e-3)


# requests -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "", "skip", "skip@", "skip@0", "skip@-1", "skip@x", "resume@2", "stop@2", "skip@2:", "skip@2:paused", "@",
        "skip@²", "skip@" + "9" * 5000,
    ],
)  # fmt: skip
def test_a_declared_request_that_is_none_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(RigError, match="as skip@3 or pause@2:press"):
        declared(text)


def test_requests_are_made_in_their_order_and_a_pause_ends_by_itself() -> None:
    script = Script([declared("abort@3"), declared("pause@2:press")])
    assert script.due(2, Phase.SEEK, 0.0) is Request.NONE
    assert script.due(2, Phase.PRESS, 0.1) is Request.PAUSE
    assert script.due(2, Phase.PAUSED, 0.2) is Request.NONE
    assert script.due(2, Phase.PAUSED, 0.1 + PAUSE_S) is Request.RESUME
    assert script.due(2, TOLD + Verdict.OK, 2.0) is Request.NONE
    assert script.due(3, Phase.NONE, 2.1) is Request.ABORT
    assert script.due(3, Phase.NONE, 9.0) is Request.NONE


def test_a_request_for_a_cell_that_is_over_is_not_made_to_another() -> None:
    script = Script([Declared(Request.SKIP, 1, Phase.CONFIRM)])
    assert script.due(2, Phase.NONE, 0.0) is Request.NONE
    assert script.due(2, Phase.CONFIRM, 1.0) is Request.NONE


@pytest.mark.long
def test_asked_in_lockstep_a_recording_holds_it_and_replays_byte_for_byte(tmp_path: Path) -> None:
    rig = equipped(3)
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, RIG)
    run = LockstepRun(rig, RIGS, observer=recorder.observe)
    decided, script = run.cycle.supervisor.goals.decided, Script([declared("skip@2:press")])
    assert decided is not None
    from hil.cycle.goal import Goal, GoalKind

    while len(decided.motion.results) < 3:
        if request := script.due(decided.cell, decided.phase, run.index * 1e-3):
            run.goals.append(Goal(1, GoalKind.REQUEST, flags=request))
        run.tick()
        assert run.index < 5000
    recorder.close()
    assert [r.verdict for r in decided.motion.results] == [Verdict.OK, Verdict.SKIPPED, Verdict.OK]
    report = replay_run(tmp_path / "run.mcap")
    assert report.ticks == run.index
    assert not report.different


# the file of cells ----------------------------------------------------------------------------------------------------


def test_a_row_is_there_before_the_touch_and_final_once_the_cell_is_over(tmp_path: Path) -> None:
    path = tmp_path / "cells.csv"
    sheet = Sheet(path, PLACES)
    sheet.at(1, Phase.APPROACH, 0.0)
    assert len(path.read_text().splitlines()) == 1
    sheet.at(1, Phase.TARE, 0.0)
    assert path.read_text().splitlines()[1].startswith("1,none,0.0,0.0,")
    sheet.over(over(0, pierced_force=7e-4))
    sheet.at(2, Phase.NONE, 0.0)
    sheet.at(2, Phase.TARE, 0.0)
    sheet.at(2, Phase.PAUSED, 0.0)  # not touched
    sheet.close()
    assert [line.split(",")[:2] for line in path.read_text().splitlines()] == [["number", "verdict"], ["1", "ok"]]
    (cell,) = read_sheet(path, PLACES)
    assert (cell.result.pierced_force, cell.expected, cell.peak_force) == (7e-4, Verdict.OK, 1e-3)
    assert repr(cell) == repr(over(0, pierced_force=7e-4))


def test_a_cell_that_was_begun_is_unknown_and_not_touched_again(tmp_path: Path) -> None:
    path = tmp_path / "cells.csv"
    sheet = Sheet(path, PLACES, [over(0)])
    sheet.at(2, Phase.SEEK, 0.0)
    sheet.close()
    cells = read_sheet(path, PLACES)
    assert [(cell.result.number, cell.result.verdict) for cell in cells] == [(0, Verdict.OK), (1, Verdict.UNKNOWN)]
    assert cells[1].result.left
    path.write_bytes(path.read_bytes()[:-20])  # cut off while it was written
    assert [cell.result.verdict for cell in read_sheet(path, PLACES)] == [Verdict.OK, Verdict.UNKNOWN]


def test_the_cell_of_a_broken_tip_is_done_again(tmp_path: Path) -> None:
    path = tmp_path / "cells.csv"
    Sheet(path, PLACES, [over(0), over(1, Verdict.BROKEN)]).close()
    assert [cell.result.number for cell in read_sheet(path, PLACES)] == [0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("number,", "nummer,"), "no column 'number'"),
        (("2,ok", "3,ok"), "row 2 is cell 3; expected cell 2"),
        (("2,ok", "2,okay"), "row 2, column verdict: 'okay'"),
        (("2,ok,0.001,", "2,ok,0.0011,"), "row 2, column x: 0.0011; this batch has that cell at 0.001 m"),
        (("2,ok,0.001,", "2,ok,nan,"), "row 2, column x"),
        (("False", "maybe"), "row 1, column left"),
    ],
)
def test_a_file_of_another_batch_is_refused_by_row(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    path = tmp_path / "cells.csv"
    Sheet(path, PLACES, [over(0), over(1)]).close()
    path.write_text(path.read_text().replace(*change, 1))
    with pytest.raises(RigError, match=said):
        read_sheet(path, PLACES)


def test_a_file_that_cannot_be_written_is_told_by_its_name(tmp_path: Path) -> None:
    with pytest.raises(RigError, match="no/such"):
        Sheet(tmp_path / "no" / "such" / "cells.csv", PLACES)


@pytest.mark.long
def test_a_batch_that_was_aborted_goes_on_to_the_verdicts_of_one_that_was_not(tmp_path: Path) -> None:
    target = str(tmp_path / "cells.csv")
    words = {"grid_text": "1x3", "anomalies": 0.5, "seed": 6, "csv_target": target}
    with pytest.raises(SystemExit):
        command(RIG, **words, ask=["abort@2:approach"])  # type: ignore[arg-type]
    assert len(Path(target).read_text().splitlines()) == 2
    command(RIG, **words, resume=True)  # type: ignore[arg-type]
    parts = read_sheet(Path(target), grid(1, 3, 1e-3, (0.0, 0.0)))
    whole = tmp_path / "whole.csv"
    command(RIG, **{**words, "csv_target": str(whole)})  # type: ignore[arg-type]
    verdicts = [cell.result.verdict for cell in read_sheet(whole, grid(1, 3, 1e-3, (0.0, 0.0)))]
    assert [cell.result.verdict for cell in parts] == verdicts
    assert [cell.wrong_pulses for cell in parts] == [0, 0, 0]
    before = Path(target).read_text()
    command(RIG, **words, resume=True)  # type: ignore[arg-type]
    assert Path(target).read_text() == before  # nothing is left to do


def test_options_that_do_not_go_together_are_refused() -> None:
    import typer

    for options in (
        {"live": True, "judge": True}, {"attach": True, "live": True}, {"resume": True},
        {"resume": True, "csv_target": "/nowhere/cells.csv"}, {"tell": "stop"},
    ):  # fmt: skip
        with pytest.raises(typer.BadParameter):
            command(RIG, **options)  # type: ignore[arg-type]


# what is shown --------------------------------------------------------------------------------------------------------


def test_cells_that_an_operator_took_out_count_in_no_share() -> None:
    left = over(1, Verdict.SKIPPED)
    left.result.left = True
    lines = {line.name: line.reached for line in judged(Batch(cells=[over(0), left], seconds=3.0), 1.4e-3)}
    assert lines["verdicts"].startswith("1 of 1")


@pytest.mark.long
def test_the_page_shows_each_cell_its_force_and_its_share_and_runs_no_script() -> None:
    batch = inject(equipped(2, anomalies=("", "not_pierced")), RIGS, keep=True)
    places = grid(1, 2, 1e-3, middle(equipped(1)))
    page = batch_page(equipped(2), batch, [*places, (0.003, 0.0)], judged(batch, 1.4e-3))
    assert page.count("<circle") == 3
    assert "1: ok, x -0.500 mm" in page
    assert "3: not reached" in page
    assert page.count("<polyline") == 2
    assert page.count("<rect") == 2
    assert "1 of 2 [9.5%, 90.5%]" in page
    assert "<script" not in page
    assert "pulses into a cell that is whole" in page


def test_a_page_of_nothing_is_a_page() -> None:
    page = batch_page(equipped(1), Batch(planned=3, fault="ENCODER_LOST"), PLACES)
    assert page.count("not reached") == 3
    assert "ENCODER_LOST" in page


@pytest.mark.long
def test_the_command_writes_page_and_document(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, document = tmp_path / "batch.html", tmp_path / "batch.json"
    with pytest.raises(SystemExit):
        command(
            RIG, grid_text="1x2", ask=["abort@1:press"], report_target=str(page), json_target=str(document),
            csv_target=str(tmp_path / "cells.csv"),
        )  # fmt: skip
    found = json.loads(document.read_text())
    assert [cell["verdict"] for cell in found["cells"]] == ["skipped"]
    assert list(found["cells"][0]) == list(COLUMNS)
    assert page.read_text().count("<circle") == 2
