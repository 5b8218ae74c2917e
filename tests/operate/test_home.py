"""`hil home` says each step and how it ended, from what the control process recorded."""

from pathlib import Path

import pytest

from hil.cli.exit_status import EXIT_FAULT, EXIT_UNAVAILABLE
from hil.live.ring import RingReader, RingWriter
from hil.operate import home
from hil.telemetry.command_client import Verdict
from tests.support.homing import home_once, homing_rig


def watched(contact: str, folder: Path, *, cut: int = 0) -> int:
    """`hil home` of a homing that has been recorded; without its last `cut` ticks the control process is gone."""
    rig, records = homing_rig("switch", folder, contact=contact), []
    home_once(rig, folder, keep=lambda record: records.append(record.copy()))
    begun = next(index for index, record in enumerate(records) if record["homing"] & 15)
    metadata = {"rig": rig.model_dump(mode="json")}
    with RingWriter(folder / "ring", 8192, period_ns=rig.period_ns, metadata=metadata) as writer:
        writer.append(records[begun])
        with RingReader(folder / "ring") as reader:
            reader.next = 0
            for record in records[begun + 1 : len(records) - cut]:
                writer.append(record)
            if cut:
                writer.close()
            return home._watch("paper", reader)


def test_steps_are_told_until_the_rig_is_at_home(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert watched("sound", tmp_path) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "at home; READY"


def test_a_failure_names_axis_reason_and_what_to_look_at(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert watched("dead", tmp_path) == EXIT_FAULT
    told = capsys.readouterr().err
    assert "hil home: x: what it homes on is not found within home.farthest" in told
    assert "paper is FAULT, fault HOMING_FAILED; see hil events paper" in told


def test_a_control_process_that_ends_on_the_way_is_told(tmp_path: Path) -> None:
    assert watched("sound", tmp_path, cut=400) == EXIT_UNAVAILABLE


def test_a_refusal_says_what_to_do_next() -> None:
    told = home.refusal("r", Verdict(False, "HOME is not possible in state ACTIVE", "ACTIVE"))
    assert told == [
        "hil home: HOME is not possible in state ACTIVE",
        "hil home: next: hil command r stop, then hil command r home",
    ]
    assert home.refusal("r", Verdict(False, "refused: no recorder is alive", "READY")) == [
        "hil home: refused: no recorder is alive"
    ]
