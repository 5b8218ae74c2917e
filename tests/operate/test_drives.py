"""`hil drives`: a drive's own file says whether and how it can be used; people and programs get the same answer."""

import json
from pathlib import Path

from typer.testing import CliRunner

from hil.cli.app import build_app
from hil.rig.bus_load import feedback_notes
from hil.rig.file import load_rig
from tests.support.foreign_drive import CST_DRIVE, U32, Fact, eds_text
from tests.support.paths import RIGS

APP = build_app("drives")


def ask(path: Path, *options: str) -> tuple[int, str]:
    result = CliRunner().invoke(APP, ["drives", "--eds", str(path), *options])
    return result.exit_code, result.output


def test_a_usable_drive_gets_its_steps(tmp_path: Path) -> None:
    eds = tmp_path / "drive.eds"
    eds.write_text(eds_text(CST_DRIVE))
    status, text = ask(eds, "--json", str(tmp_path / "plan.json"), "--axes", "4")
    assert status == 0
    assert "usable in cyclic synchronous torque (CST); an RPDO for each drive; SYNC without counter" in text
    plan = json.loads((tmp_path / "plan.json").read_text())
    assert (plan["usable"], plan["mode"], plan["reasons"]) == (True, "CST", [])
    steps = {step["object"]: step for step in plan["steps"]}
    assert steps["6060h:00"] == {
        "object": "6060h:00", "action": "write", "value": 10, "mask": None, "need": "required",
        "why": "cyclic synchronous torque", "skipped": None,
    }  # fmt: skip
    assert steps["6076h:00"]["action"] == "read"
    assert steps["1006h:00"]["skipped"] == "is not in the EDS"


def test_a_drive_without_cst_is_refused_with_the_object_that_decides(tmp_path: Path) -> None:
    eds = tmp_path / "drive.eds"
    eds.write_text(eds_text({**CST_DRIVE, (0x6502, 0): Fact(U32, "ro", "0x1E5")}))
    status, text = ask(eds, "--json", "-")
    plan = json.loads(text)
    assert status == 1
    assert (plan["usable"], plan["mode"]) == (False, "refused")
    assert [reason["object"] for reason in plan["reasons"]] == ["6502h:00"]
    assert "CSP, CSV" in plan["reasons"][0]["text"]
    assert "6502h:00 is 0x1e5" in ask(eds)[1]


def test_a_file_that_is_no_eds_is_said_to_be_none(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("Dear reader,")
    status, text = ask(tmp_path / "letter.txt")
    assert status == 74
    assert "not an EDS or DCF file" in text


def test_check_says_what_feedback_in_the_drives_own_time_costs() -> None:
    rig = load_rig(RIGS / "odrive.toml")
    (note,) = feedback_notes(rig, RIGS)
    assert "0.2 to 2.2 ms old" in note
    assert "0.2 ms, costs 0.06 degrees" in note
    assert feedback_notes(load_rig(RIGS / "paper.toml"), RIGS) == []
