"""A frame layout that a user brings, in every command: whole runs over its frames, and what ends them."""

import json
import shutil
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hil
from drivers.base.call_limit import Watch
from hil.analysis.stability import check_stability
from hil.cli.app import build_app
from hil.rig.file import build_rig, load_rig, rig_hash
from hil.rig.schema import RigConfig, RigError
from hil.studies.fault_campaign.matrix import displaced, plan_chunks, run_chunk
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.sim import simulate, usable
from tests.support.paths import RIGS, ROOT
from tests.support.wrong_layouts import MAKER, decode, drives, encode, write

MADE = "bus.protocol=./maker.py:Maker"
QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1", "law.name=structured-kalman"]
RUNNER = CliRunner()


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    """paper.toml in a folder of its own, with the layout beside it."""
    for path in (RIGS / "paper.toml", MAKER):
        shutil.copy(path, tmp_path)
    return tmp_path / "paper.toml"


def made(rig_file: Path, *more: str) -> RigConfig:
    return load_rig(rig_file, [MADE, *QUICK, *more])


def wrong(rig_file: Path, text: str) -> RigConfig:
    write(rig_file.parent, text)
    return load_rig(rig_file, ["bus.protocol=./wrong.py:Wrong", *QUICK])


@pytest.mark.long
@pytest.mark.replaces_methods
def test_a_call_of_what_a_user_brought_is_over_before_the_next_begins(
    rig_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Or else what ends calls that do not return would end the loop some seconds after the last one."""
    for path in (ROOT / "examples" / "laws" / "lqr.py", ROOT / "examples" / "estimators" / "luenberger.py"):
        shutil.copy(path, rig_file.parent)
    begun: list[tuple[Watch, object]] = []  # and for whom
    begin = Watch.begin

    def watched(watch: Watch) -> None:
        assert not watch.within, "the call before has not ended"
        begun.append((watch, sys._getframe(2).f_code))  # behind the guard
        begin(watch)

    monkeypatch.setattr(Watch, "begin", watched)
    rig = load_rig(rig_file, [MADE, *QUICK[:3], "law.name=./lqr.py:Lqr", "estimator.name=./luenberger.py:Luenberger"])
    report, _ = simulate(rig, rig_file.parent, 0.5)
    assert report.state == "ACTIVE"
    check_stability(rig)
    assert len(begun) > 5000
    assert not begun[-1][0].within
    assert len({caller for _, caller in begun}) >= 6


def test_a_rig_runs_over_a_users_layout(rig_file: Path) -> None:
    report, _ = simulate(made(rig_file), rig_file.parent, 1.0)
    assert (report.state, report.faults, report.samples_lost) == ("ACTIVE", {}, 0)
    assert max(axis["max_error"] for axis in report.axes.values()) < 5e-6
    assert simulate(made(rig_file), rig_file.parent, 1.0)[0].trace_sha256 == report.trace_sha256
    coarse, _ = simulate(made(rig_file, "bus.parameters.torque_unit=2e-2"), rig_file.parent, 1.0)
    assert coarse.state == "ACTIVE"
    assert coarse.trace_sha256 != report.trace_sha256


def test_it_is_part_of_the_rigs_hash_and_of_the_recording(rig_file: Path, tmp_path: Path) -> None:
    rig = made(rig_file)
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, rig_file)
    report, _ = simulate(rig, rig_file.parent, 0.4, observer=recorder.observe)
    recorder.close()
    file = rig_file.parent / "maker.py"
    file.write_text(file.read_text() + "\n# another version\n")
    assert rig_hash(made(rig_file)) != rig_hash(rig)
    file.unlink()
    assert hil.replay(tmp_path / "run.mcap", run_its_code=True).different == 0
    again = build_rig(json.loads(rig.model_dump_json()))
    assert rig_hash(again) == rig_hash(rig)
    assert simulate(again, rig_file.parent, 0.4)[0].trace_sha256 == report.trace_sha256


@pytest.mark.long
def test_a_slice_of_the_fault_campaign_passes_over_it(rig_file: Path) -> None:
    chunks = plan_chunks(displaced(load_rig(rig_file, [MADE])), rig_file.parent, stride=40)
    cells = [cell for chunk in (chunks[2], chunks[6], chunks[8]) for cell in run_chunk(chunk)]
    assert [f"{cell.trial}: {cell.why}" for cell in cells if not cell.passed] == []
    assert cells


@pytest.mark.slow
def test_a_third_of_the_fault_campaign_passes_over_it(rig_file: Path) -> None:
    rig = displaced(load_rig(rig_file, [MADE]))
    cells = [cell for chunk in plan_chunks(rig, rig_file.parent, stride=3) for cell in run_chunk(chunk)]
    assert [f"{cell.trial}, {cell.checkpoint}: {cell.why}" for cell in cells if not cell.passed] == []
    assert len(cells) > 400


def test_a_layout_that_raises_in_a_tick_ends_in_a_fault_that_names_its_line(rig_file: Path) -> None:
    report, traces = simulate(wrong(rig_file, encode("1 // (self.k - 300)")), rig_file.parent, 0.4)
    assert report.state == "FAULT"
    (told,) = [event.cause for event in report.events if "ZeroDivisionError" in event.cause]
    assert told.startswith("bus.protocol = './wrong.py:Wrong': host().encode: ./wrong.py:")
    assert abs(traces.force[-1]).max() == 0.0
    assert list(report.faults) == ["encoder_lost", "encoder_gap", "encoder_dead"]  # as of drives that do not answer


def test_a_layout_that_garbles_every_answer_ends_in_a_fault(rig_file: Path) -> None:
    report, _ = simulate(wrong(rig_file, decode("1 // max(0, 300 - self.k)")), rig_file.parent, 0.6)
    assert report.state == "FAULT"
    assert any("host().decode of " in event.cause for event in report.events)


LATE = """
    heard = 0

    def decode_command(self, frame):
        self.heard += 1
        return "go" if self.heard > 900 else super().decode_command(frame)
"""


def test_drives_that_go_wrong_end_the_run_with_their_line(rig_file: Path) -> None:
    write(rig_file.parent, drives(LATE))
    words = ["sim", str(rig_file), "--seconds", "0.6", "--set", "bus.protocol=./wrong.py:Wrong"]
    done = RUNNER.invoke(build_app("sim"), words)
    assert "drives().decode_command: returned 'go', expected a Command or a Reject" in str(done.exception)


def test_a_layout_that_is_none_is_refused_by_its_key(rig_file: Path) -> None:
    rig = wrong(rig_file, encode("1 / 0"))
    with pytest.raises(
        RigError, match=r"bus\.protocol = '\./wrong\.py:Wrong': host\(\)\.encode: \./wrong\.py:\d+: ZeroDivisionError"
    ):
        usable(rig, rig_file)
    with pytest.raises(RigError, match=r"none\.py: No such file"):
        load_rig(rig_file, ["bus.protocol=./none.py:Maker"])


def test_bought_drives_that_speak_otherwise_are_not_understood(rig_file: Path) -> None:
    """The emulated drives of another maker: nothing of the layout's own drives' side answers for them."""
    drive = "plant.drive={kind='moteus', turn=[0.01, 0.01]}"
    report, _ = simulate(made(rig_file, drive), rig_file.parent, 0.2)
    assert report.state == "CONNECTED"


@pytest.mark.parametrize("words", [["sim", "--seconds", "0.3"], ["check"]])
def test_commands_take_a_users_layout(words: list[str], rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(rig_file.parent)
    done = RUNNER.invoke(build_app(words[0]), [words[0], str(rig_file), *words[1:], "--set", MADE])
    assert done.exit_code == 0, done.output
    if words == ["check"]:
        assert "emulated drives: the drives' side of ./maker.py:Maker itself" in " ".join(done.output.split())
