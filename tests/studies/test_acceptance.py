"""`hil check --law`: what is accepted may go to a rig; what is not is told which step it failed, and where."""

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.cli.app import build_app
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from hil.studies.acceptance.law import Demand, accept_law
from hil.studies.acceptance.law_cost import law_cost
from hil.virtual.sim import simulate
from tests.support.paths import LAWS_OF_USERS, RIGS

PD = """\
from hil import Law

class Own(Law):
    def __init__(self, model, period, force_limit):
        self.model = model
        self.kp, self.kd, self.kept = model.mass * (0.25 / period) ** 2, 0.35 * model.mass / period, []

    def reset(self, position, force):
        pass

    def force(self, inputs):
        {extra}
        error = inputs.position_estimate - inputs.start.position
        rate = inputs.velocity_estimate - inputs.start.velocity
        return self.model.mass * inputs.mean_acceleration - self.kp * error - self.kd * rate
"""


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    for path in (RIGS / "paper.toml", *LAWS_OF_USERS):
        shutil.copy(path, tmp_path)
    return tmp_path / "paper.toml"


def own(rig_file: Path, extra: str = "pass") -> list[str]:
    (rig_file.parent / "own.py").write_text(PD.format(extra=extra))
    return ["law.name=./own.py:Own", "task.radius=0.01", "task.approach_s=0.2"]


def steps(rig_file: Path, overrides: list[str], until: str) -> dict[str, tuple[bool | None, str]]:
    """Findings by step, up to one of them."""
    found = {}
    for finding in accept_law(rig_file, overrides, Demand(stride=400)):
        found[finding.step] = (finding.passed, finding.text)
        if finding.step == until:
            break
    return found


def test_a_law_that_fails_its_task_is_told_the_line_and_tried_no_further(rig_file: Path) -> None:
    found = steps(rig_file, ["law.name=./misbehaves.py:Misbehaves"], "faults")
    passed, text = found["task"]
    assert passed is False
    assert "./misbehaves.py:31: ZeroDivisionError" in text
    assert "ended FAULT with zero torque" in text
    assert {found[name] for name in ("time and memory", "bytes", "margins", "faults")} == {(None, "the task failed")}


@pytest.mark.parametrize(
    ("law", "text"),
    [("nothing", "the laws are pd-feedforward"), ("./misbehaves.py:np", "'np' is no class with reset and force")],
)
def test_what_is_no_law_fails_the_contract(law: str, text: str, rig_file: Path) -> None:
    (finding,) = accept_law(rig_file, [f"law.name={law}"])
    assert (finding.step, finding.passed) == ("contract", False)
    assert text in finding.text


def test_a_rig_that_is_none_is_refused(rig_file: Path) -> None:
    with pytest.raises(RigError, match="rate_hz"):
        list(accept_law(rig_file, ["rate_hz=0"]))


@pytest.mark.slow
def test_a_law_that_keeps_something_in_every_tick_is_found_out(rig_file: Path) -> None:
    overrides = own(rig_file, "self.kept.append([inputs.position])")
    assert law_cost(load_rig(rig_file, overrides), rig_file.parent).grows > 100.0
    passed, text = steps(rig_file, overrides, "time and memory")["time and memory"]
    assert passed is False
    assert "memory that grows for ever" in text


@pytest.mark.slow
def test_a_law_slower_than_half_the_period_is_found_out(rig_file: Path) -> None:
    """Its loop takes several periods on any machine."""
    overrides = own(rig_file, "sum(range(200_000)) if 0.2e9 < inputs.task_ns < 0.21e9 else None")
    passed, text = steps(rig_file, overrides, "time and memory")["time and memory"]
    assert passed is False
    assert "more than 50% of the period" in text


@pytest.mark.long
def test_measuring_a_law_does_not_change_what_it_does(rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hil.studies.acceptance import law_cost as module

    rig = load_rig(rig_file, own(rig_file))
    traces = []

    class Kept(module.LockstepRun):
        def __init__(self, *arguments: object) -> None:
            super().__init__(*arguments)  # type: ignore[arg-type]
            traces.append(self)

    monkeypatch.setattr(module, "LockstepRun", Kept)
    law_cost(rig, rig_file.parent)
    seconds = traces[0].index * rig.period_ns * 1e-9
    assert len({run.trace_sha256 for run in traces[:3]}) == 1
    assert traces[0].trace_sha256 == simulate(rig, rig_file.parent, seconds)[0].trace_sha256


@pytest.mark.slow
def test_a_law_whose_bytes_come_from_its_process_is_found_out(rig_file: Path) -> None:
    overrides = own(rig_file, "self.kd += 1e-9 * (hash('x') % 1000)")
    passed, text = steps(rig_file, overrides, "bytes")["bytes"]
    assert (passed, text) == (False, "another trace in each process")


@pytest.mark.slow
def test_a_law_with_less_than_the_margins_demanded_is_found_out(rig_file: Path) -> None:
    findings = accept_law(rig_file, own(rig_file), Demand(gain_db=30.0))
    found = next(finding for finding in findings if finding.step == "margins")
    assert found.passed is False
    assert "wanted 30 dB, 30 deg" in found.text


@pytest.mark.slow
@pytest.mark.parametrize("law", ["network.py:Network", "mpc.py:PreviewMpc"])
def test_a_sound_law_is_accepted(law: str, rig_file: Path, tmp_path: Path) -> None:
    target = tmp_path / "accepted.json"
    words = ["check", str(rig_file), "--law", f"./{law}", "--stride", "200", "--json", str(target)]
    done = CliRunner().invoke(build_app("check"), [*words, "--margin", "2", "--phase-margin", "20"])
    assert done.exit_code == 0, done.output
    document = json.loads(target.read_text())
    assert document["accepted"] is True
    assert [step["step"] for step in document["steps"]] == [
        "contract", "task", "time and memory", "bytes", "margins", "faults",
    ]  # fmt: skip


def test_a_file_of_the_present_folder_is_found(rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(rig_file.parent)
    done = CliRunner().invoke(build_app("check"), ["check", "paper", "--law", "./misbehaves.py:Misbehaves"])
    assert done.exit_code == 1
    assert "ZeroDivisionError" in done.output
    assert "not accepted" in done.output
