"""`hil drives`: a drive's own file says whether and how it can be used; people and programs get the same answer."""

import json
from pathlib import Path

from typer.testing import CliRunner

from hil.cli.app import build_app
from tests.support.foreign_drive import CST_DRIVE, U32, Fact, eds_text

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


def test_a_drive_whose_unit_of_torque_is_not_told_asks_for_it(tmp_path: Path) -> None:
    eds = tmp_path / "drive.eds"
    eds.write_text(eds_text({key: fact for key, fact in CST_DRIVE.items() if key[0] != 0x6076}))
    status, text = ask(eds)
    assert status == 1
    assert "can be used once you state bus.cia402.rated_torque in the rig file (here: --rated-torque):" in text
    assert "6076h:00 is not in the EDS" in text
    assert "cannot be used" not in text
    (reason,) = json.loads(ask(eds, "--json", "-")[1])["reasons"]
    assert reason["remedy"] == "bus.cia402.rated_torque"
    assert ask(eds, "--rated-torque", "0.5")[0] == 0
    eds.write_text(eds_text({key: fact for key, fact in CST_DRIVE.items() if key[0] not in (0x6076, 0x6071)}))
    assert "cannot be used" in ask(eds)[1]


def test_a_device_that_is_no_drive_is_said_to_be_none_and_nothing_else(tmp_path: Path) -> None:
    others = {key: fact for key, fact in CST_DRIVE.items() if key[0] < 0x6000}
    eds = tmp_path / "module.eds"
    eds.write_text(eds_text({**others, (0x1000, 0): Fact(U32, "ro", "0x30191")}))
    status, text = ask(eds, "--json", "-")
    (reason,) = json.loads(text)["reasons"]
    assert (status, reason["object"]) == (1, "1000h:00")
    assert "device profile 401, not 402" in reason["text"]
    assert "no drive by CiA 402" in reason["text"]
    eds.write_text(eds_text({**CST_DRIVE, (0x1000, 0): Fact(U32, "ro", "0x30191")}))
    (reason,) = json.loads(ask(eds, "--json", "-")[1])["reasons"]  # it has what a drive has: the rest is looked at
    assert reason["text"] == "is 0x30191: device profile 401, not 402"


def test_a_name_is_told_once(tmp_path: Path) -> None:
    eds = tmp_path / "drive.eds"
    for vendor, product, name in (
        ("Maker", "Maker Drive 5", "Maker Drive 5"),
        ("Maker", "Drive 5", "Maker Drive 5"),
        ("Maker", "", "Maker"),
        ("", "Drive 5", "Drive 5"),
        ("", "", "unnamed"),
    ):
        text = eds_text(CST_DRIVE).replace("VendorName=Maker", f"VendorName={vendor}")
        eds.write_text(text.replace("ProductName=Made", f"ProductName={product}"))
        assert json.loads(ask(eds, "--json", "-")[1])["drive"] == name


def test_a_file_that_is_no_eds_is_said_to_be_none(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("Dear reader,")
    status, text = ask(tmp_path / "letter.txt")
    assert status == 74
    assert "not an EDS or DCF file" in text
