"""Tasks that users bring: found in every way, made into a path when the rig is loaded, run by every command."""

import importlib.metadata
import json
import pickle
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.base import call_limit, plugins
from hil.analysis.feasibility import task_problems
from hil.cli.app import build_app
from hil.control.trajectories import make_trajectory
from hil.rig.file import build_rig, load_rig, rig_hash
from hil.rig.schema import RigConfig, RigError
from hil.rig.task_kinds import KIND, TASKS
from hil.studies.fault_campaign.matrix import plan_chunks, run_chunk
from hil.studies.sweep.plants import jobs
from hil.studies.sweep.plants import run_chunk as run_plants
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from hil.virtual.sim import simulate
from tests.support.paths import RIGS, ROOT
from tests.support.task_misbehaves import WAYS

pytestmark = pytest.mark.usefixtures("examples_are_a_package")

ROSE = ["task.kind=./rose.py:Rose", "task.axes=['x', 'y']", "task.approach_s=0.2", "task.settle_s=0.0"]
RUNNER = CliRunner()


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    """paper.toml in a folder of its own, with the users' files beside it."""
    for path in (RIGS / "paper.toml", ROOT / "examples/tasks/rose.py", ROOT / "tests/support/task_misbehaves.py"):
        shutil.copy(path, tmp_path)
    return tmp_path / "paper.toml"


def rose(rig_file: Path, *more: str) -> RigConfig:
    return load_rig(rig_file, [*ROSE, *more])


def test_a_users_task_is_followed(rig_file: Path) -> None:
    rig = rose(rig_file, "law.name=structured-kalman")
    assert task_problems(rig) == []
    report, traces = simulate(rig, rig_file.parent, 4.6)
    assert (report.state, report.faults) == ("ACTIVE", {})
    assert max(axis["max_error"] for axis in report.axes.values()) < 5e-6
    assert abs(traces.setpoint[:, 0]).max(where=traces.setpoint[:, 0] == traces.setpoint[:, 0], initial=0.0) > 4e-3
    trajectory = make_trajectory(rig.task, rig.axis_names, [0.0, 0.0], rig.period_ns)
    assert trajectory.duration_ns == 4_200_000_000


def test_a_file_a_module_and_an_entry_point_are_the_same_task(rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = importlib.metadata.EntryPoint("rose", "examples.tasks.rose:Rose", KIND.group)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry] if group == "hil.tasks" else [])
    found = [load_rig(rig_file, [f"task.kind={kind}", *ROSE[1:]]).task.samples
             for kind in ("./rose.py:Rose", "examples.tasks.rose:Rose", "rose")]  # fmt: skip
    assert found[0] == found[1] == found[2]
    assert plugins.registered(KIND) == [*TASKS, "rose"]


@pytest.mark.parametrize(("kind", "text"), [
    ("rosse", "the tasks are hold, circle"),
    ("no.such.module:Rose", "No module named 'no'"),
    ("examples.tasks.rose:Nothing", "'Nothing' is no class with samples"),
    ("./rose.py:Lily", "'Lily' is no class with samples"),
    ("./none.py:Rose", "none.py: No such file"),
    ("./broken.py:Rose", "./broken.py:2: invalid syntax"),
])  # fmt: skip
def test_a_task_that_is_not_to_be_had_is_refused_by_name(kind: str, text: str, rig_file: Path) -> None:
    (rig_file.parent / "broken.py").write_text("x = 1\ndef def\n")
    with pytest.raises(RigError) as caught:
        load_rig(rig_file, [f"task.kind={kind}", *ROSE[1:]])
    assert f"task.kind = '{kind.partition(':')[0]}" in str(caught.value)
    assert text in str(caught.value)


@pytest.mark.parametrize(("override", "text"), [
    ("task.parameters.petal=5", "task.parameters.petal: ./rose.py:Rose has radius, petals, seconds"),
    ("task.axes=[]", "./rose.py:Rose needs the names of the axes it moves"),
    ("task.axes=['x']", "./rose.py:16: ValueError: a rose needs two axes"),
    ("task.parameters.radius='far'", "./rose.py:23: "),
    ("task.parameters.radius=2.0", "is outside axes.x.limits.position"),
    ("task.parameters=5", "task.parameters = 5"),
])  # fmt: skip
def test_its_parameters_are_checked(override: str, text: str, rig_file: Path) -> None:
    with pytest.raises(RigError) as caught:
        rose(rig_file, override)
    assert text in str(caught.value)


@pytest.mark.parametrize("how", WAYS)
def test_a_task_that_goes_wrong_is_refused_with_its_line(how: str, rig_file: Path) -> None:
    with pytest.raises(RigError) as caught:
        load_rig(rig_file, ["task.kind=./task_misbehaves.py:Misbehaves", "task.axes=['x', 'y']",
                            f"task.parameters.how={how}"])  # fmt: skip
    assert WAYS[how] in str(caught.value)
    if how != "jumps":  # by then it is a path like any other: row and column
        assert "./task_misbehaves.py:" in str(caught.value)


@pytest.mark.long
def test_a_task_that_never_returns_is_given_up(rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call_limit, "CALL_LIMIT_S", 0.3)
    with pytest.raises(RigError, match=r"no answer within 0\.3 s"):
        load_rig(rig_file, ["task.kind=./task_misbehaves.py:Misbehaves", "task.axes=['x', 'y']",
                            "task.parameters.how='never returns'"])  # fmt: skip


def test_the_path_is_part_of_the_rig_and_travels_without_the_file(rig_file: Path) -> None:
    rig = rose(rig_file)
    (rig_file.parent / "rose.py").write_text((rig_file.parent / "rose.py").read_text() + "\n# another version\n")
    assert rig_hash(rose(rig_file)) != rig_hash(rig)
    (rig_file.parent / "rose.py").unlink()
    document = rig.model_dump(mode="json")
    assert rig_hash(build_rig(json.loads(json.dumps(document)))) == rig_hash(rig)
    other = build_rig(json.loads(json.dumps(document)), ["task.parameters.radius=1e-3"])  # made again from its text
    assert max(abs(row[1]) for row in other.task.samples) < 1.1e-3
    assert load_rig(rig_file).task.source == ""


def test_a_refusal_comes_back_whole_from_another_process() -> None:
    assert pickle.loads(pickle.dumps(RigError(["one: 1", "two: 2"]))).problems == ["one: 1", "two: 2"]


def test_a_recording_replays_without_the_file(rig_file: Path, tmp_path: Path) -> None:
    rig = rose(rig_file)
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, rig_file)
    simulate(rig, rig_file.parent, 0.5, observer=recorder.observe)
    recorder.close()
    (rig_file.parent / "rose.py").unlink()
    report = replay_run(tmp_path / "run.mcap")
    assert (report.ticks, report.different) == (500, 0)


def test_a_recording_replays_without_the_package(rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = importlib.metadata.EntryPoint("rose", "examples.tasks.rose:Rose", KIND.group)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry] if group == "hil.tasks" else [])
    document = load_rig(rig_file, ["task.kind=rose", *ROSE[1:]]).model_dump(mode="json")
    monkeypatch.undo()
    again = build_rig(document)
    LockstepRun(again, rig_file.parent).tick()
    assert (again.task.kind, len(again.task.samples)) == ("rose", 401)


def test_a_sweeps_worker_needs_nothing_but_the_job(rig_file: Path) -> None:
    (job,) = jobs(rose(rig_file), rig_file.parent, 2, 0.8, seed=1)
    (rig_file.parent / "rose.py").unlink()
    assert run_plants(job).max_error.max() < 0.01


def test_a_slice_of_the_fault_campaign_passes_with_a_users_task(rig_file: Path) -> None:
    chunks = plan_chunks(rose(rig_file), rig_file.parent, stride=60)
    cells = [cell for chunk in (chunks[4], chunks[8]) for cell in run_chunk(chunk)]
    assert [cell.why for cell in cells if not cell.passed] == []
    assert cells


@pytest.mark.parametrize("words", [
    ["check", "--json", "-"],
    ["sim", "--seconds", "0.6"],
    pytest.param(["compare", "--laws", "pd-feedforward", "--seconds", "1"], marks=pytest.mark.long),
    pytest.param(["tune", "--law", "pd-feedforward", "--trials", "task", "--dry-run", "--population", "5",
                  "--generations", "1", "--repeats", "1"], marks=pytest.mark.slow),
])  # fmt: skip
def test_commands_take_a_users_task(words: list[str], rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(rig_file.parent)
    overrides = [word for override in ROSE for word in ("--set", override)]
    done = RUNNER.invoke(build_app(words[0]), [words[0], str(rig_file), *words[1:], *overrides])
    assert done.exit_code == 0, done.output


def test_a_program_that_names_its_own_file_is_told_to_guard_what_it_runs(
    rig_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(rig_file.parent)
    program = f"import hil\n{(rig_file.parent / 'rose.py').read_text()}\nrig = hil.load_rig('paper.toml', {ROSE!r})\n"
    Path("rose.py").write_text(program)
    with pytest.raises(RigError, match=r"the file runs itself; put what it runs below `if __name__ == "):
        load_rig(rig_file, ROSE)
    Path("rose.py").write_text(program.replace("\nrig =", "\nif __name__ == '__main__':\n    rig ="))
    assert load_rig(rig_file, ROSE).task.kind == "./rose.py:Rose"
