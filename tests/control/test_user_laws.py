"""Laws that users bring: found in every way, and run by every command. What they do wrong: test_laws_gone_wrong.py."""

import importlib.metadata
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from drivers.base import plugins
from hil import Law
from hil.analysis.stability import check_stability
from hil.control import law_registry
from hil.control.law_registry import law_class
from hil.control.laws import make_axis_laws, make_law
from hil.control.laws.base import axis_inputs
from hil.control.laws.coupled import gather
from hil.control.laws.users import UserAxes
from hil.control.nominal_model import rig_model
from hil.cycle.state_machine import State
from hil.rig import law_names
from hil.rig.file import build_rig, load_rig, rig_hash
from hil.rig.law_names import LAWS
from hil.rig.schema import LawConfig, RigError
from hil.studies.compare.cases import LEARNING, Case, run_case
from hil.studies.fault_campaign.matrix import displaced, plan_chunks, run_chunk
from hil.studies.sweep.plants import jobs, reproduce, save_worst
from hil.studies.sweep.plants import run_chunk as run_plants
from hil.studies.tune.candidate_simulation import Trial
from hil.studies.tune.objective import Bench
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.lockstep import LockstepRun
from hil.virtual.sim import simulate, usable
from tests.support.batch_equality import assert_batch_is_single
from tests.support.laws_of_users import GOOD, QUICK, beside, rig_with_laws
from tests.support.paths import RIGS

pytestmark = pytest.mark.usefixtures("examples_are_a_package")


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    return rig_with_laws(tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", GOOD)
def test_a_users_law_follows_the_circle(name: str, rig_file: Path) -> None:
    rig = load_rig(rig_file, [beside(name), *QUICK])
    report, _ = simulate(rig, rig_file.parent, 0.8)
    assert (report.state, report.faults, report.law_failure) == ("ACTIVE", {}, "")
    assert max(axis["max_error"] for axis in report.axes.values()) < 50e-6
    assert check_stability(rig).stable


def test_a_file_a_module_and_an_entry_point_are_the_same_law(rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = importlib.metadata.EntryPoint("my-lqr", "examples.laws.lqr:Lqr", law_names.KIND.group)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry] if group == "hil.laws" else [])
    hashes = set()
    for name in ("./lqr.py:Lqr", "examples.laws.lqr:Lqr", "my-lqr"):
        rig = load_rig(rig_file, [f"law.name={name}", *QUICK])
        hashes.add(simulate(rig, rig_file.parent, 0.4)[0].trace_sha256)
    assert len(hashes) == 1
    assert law_registry.registered() == [*LAWS, "my-lqr"]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("lqr2", "the laws are pd-feedforward, robust-pd"),
        ("no.such.module:Lqr", "No module named 'no'"),
        ("examples.laws.lqr:Nothing", "'Nothing' is no class with reset and force"),
        ("examples.laws.lqr:np", "'np' is no class"),
        ("unittest.mock:Mock", "'Mock' is no class with reset and force"),
        ("./lqr.py:Lqr2", "'Lqr2' is no class"),
        ("./broken.py:Lqr", "./broken.py:2: invalid syntax"),
        ("./raises.py:Lqr", "./raises.py:3: ZeroDivisionError: division by zero"),
        ("./foreign.py:Lqr", "Lqr does not inherit from hil.Law"),
    ],
)
def test_a_law_that_is_not_to_be_had_is_refused_by_name(name: str, text: str, rig_file: Path) -> None:
    (rig_file.parent / "broken.py").write_text("x = 1\ndef def\n")
    (rig_file.parent / "raises.py").write_text("\n\n1 / 0\n")
    (rig_file.parent / "foreign.py").write_text(
        "class Lqr:\n    def reset(self, q, f): pass\n    def force(self, x): return 0.0\n"
    )
    with pytest.raises(RigError) as caught:
        usable(load_rig(rig_file, [f"law.name={name}"]), rig_file)
    assert text in str(caught.value)


def test_a_file_that_is_not_there_is_named(rig_file: Path) -> None:
    with pytest.raises(RigError, match=r"law\.name = './none\.py:Lqr': .*none\.py: No such file"):
        load_rig(rig_file, ["law.name=./none.py:Lqr"])


def test_a_law_chosen_by_an_override_is_a_file_where_the_user_stands(
    rig_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "own.py").write_text((tmp_path / "lqr.py").read_text() + "\nHERE = True\n")
    monkeypatch.chdir(tmp_path / "here")
    assert "HERE" in load_rig(rig_file, ["law.name=./own.py:Lqr"]).law.source
    shutil.copy(tmp_path / "lqr.py", tmp_path / "own.py")
    assert "HERE" in load_rig(rig_file, ["law.name=./own.py:Lqr"]).law.source  # not the one beside the rig file
    assert (
        "HERE" not in load_rig(rig_file, ["law.name=./lqr.py:Lqr"]).law.source
    )  # which serves where there is no other
    rig_file.write_text(rig_file.read_text().replace('name = "pd-feedforward"', 'name = "./own.py:Lqr"'))
    assert "HERE" not in load_rig(rig_file).law.source  # a path in a file is relative to the file


@pytest.mark.parametrize(
    ("gains", "takes", "refused"),
    [
        (
            "{'heard': 1.0, 'unheard': None}",
            "force_limit, heard=1.0",
            r"GAINS has unheard, which Own\(\) does not take",
        ),
        (
            "{'kp': None}",
            "kp=None, **others",
            r"kp, which Own\(\) does not take by name behind model",
        ),  # the limit's place
    ],
)
def test_a_gain_that_the_constructor_does_not_take_is_refused_with_its_name(
    gains: str, takes: str, refused: str, rig_file: Path
) -> None:
    text = f"from hil import Law\n\n\nclass Own(Law):\n    GAINS = {gains}\n"
    text += f"    def __init__(self, model, period, {takes}):\n        pass\n"
    text += "    def force(self, inputs):\n        return 0.0\n"
    (rig_file.parent / "own.py").write_text(text)
    rig = load_rig(rig_file, ["law.name=./own.py:Own"])
    with pytest.raises(ValueError, match=refused):
        make_axis_laws(rig.law, rig_model(rig), 1e-3, np.ones(2))


def test_gains_are_checked_by_what_the_law_declares(rig_file: Path) -> None:
    for override, text in (
        ("law.gains.error=0", "law.gains.error = 0: expected a finite number >= 1e-09"),
        ("law.gains.q=1", "law.gains.q: ./lqr.py:Lqr has error, effort, learning_rate"),
    ):
        with pytest.raises(RigError) as caught:
            usable(load_rig(rig_file, [beside("lqr"), override]), rig_file)
        assert text in str(caught.value)


def test_the_files_text_is_part_of_the_rig_and_travels_with_it(rig_file: Path) -> None:
    rig = load_rig(rig_file, [beside("lqr")])
    law = rig_file.parent / "lqr.py"
    law.write_text(law.read_text() + "\n# another version\n")
    other = load_rig(rig_file, [beside("lqr")])
    assert rig_hash(rig) != rig_hash(other)
    law.unlink()
    elsewhere = build_rig(rig.model_dump(mode="json"))
    assert rig_hash(elsewhere) == rig_hash(rig)
    assert law_class(elsewhere.law) is law_class(rig.law)
    assert load_rig(rig_file).law.source == ""


def test_a_recording_replays_without_the_file(rig_file: Path, tmp_path: Path) -> None:
    rig = load_rig(rig_file, [beside("lqg"), *QUICK])
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, rig_file)
    simulate(rig, rig_file.parent, 0.5, observer=recorder.observe)
    recorder.close()
    (rig_file.parent / "lqg.py").unlink()
    report = hil.replay(tmp_path / "run.mcap", run_its_code=True)
    assert (report.ticks, report.different) == (500, 0)


@pytest.mark.parametrize("name", GOOD)
def test_a_batch_equals_the_full_path_for_users_laws_too(name: str, rig_file: Path) -> None:
    """One object an axis on floats there; here on arrays, or an object for every axis of every plant."""
    rig = load_rig(rig_file, [beside(name), "wire.stuffing=worst", *QUICK])
    assert_batch_is_single(rig, rig_file.parent)


def test_a_laws_name_is_a_file_name_that_stays_in_its_folder() -> None:
    names = ["./lqr.py:Lqr", "/a/b/lqr.py:Lqr", "../lqr.py:Lqr", "my.laws:Lqr", "structured-kalman", "..:."]
    found = [law_registry.file_name(name) for name in names]
    assert found == ["lqr.py-Lqr", "a-b-lqr.py-Lqr", "lqr.py-Lqr", "my.laws-Lqr", "structured-kalman", "law"]


def test_a_law_that_looks_ahead_sees_the_reference_of_the_periods_to_come(rig_file: Path) -> None:
    rig = load_rig(rig_file, [beside("mpc"), *QUICK])
    run = LockstepRun(rig, rig_file.parent)
    for _ in range(300):
        run.tick()
    setpoints, x = run.cycle.setpoints, run.cycle.inputs[1]
    assert setpoints.trajectory is not None
    expected = [setpoints.trajectory.at(1, x.task_ns + k * rig.period_ns) for k in range(13)]
    seen, begins, ends = [
        [(reference.position, reference.velocity, reference.acceleration) for reference in references]
        for references in (x.preview, [x.start], [x.end])
    ]
    assert seen == expected
    assert seen[:2] == begins + ends


def test_before_a_task_begins_the_preview_rests(rig_file: Path) -> None:
    rig = load_rig(rig_file, [beside("mpc"), "plant.initial_position=[0.1, -0.2]", *QUICK])
    run = LockstepRun(rig, rig_file.parent)
    while run.cycle.state is not State.ACTIVE:
        run.tick()
    assert run.cycle.setpoints.trajectory is None
    assert {(r.position, r.velocity) for r in run.cycle.inputs[1].preview} == {(run.cycle.inputs[1].position, 0.0)}


def test_tune_searches_the_gains_a_law_declares_and_the_law_on_floats_too(rig_file: Path) -> None:
    rig = load_rig(rig_file, [beside("lqr"), "task.radius=1e-3"])
    bench = Bench(rig, rig.law.name, 0, [Trial("own", {"approach_s": 0.2}, 4.0)])
    assert list(bench.space) == ["error", "effort"]
    gains = bench.gains(np.array([[0.5, 0.5], [0.9, 0.1]]))
    assert bench.margins(gains)[0].gain_db > 0.0


def test_the_learning_wrapper_goes_around_a_users_law(rig_file: Path) -> None:
    row = run_case(Case(str(rig_file), "./lqr.py:Lqr" + LEARNING, "nominal", 1000.0, QUICK, 1.0))
    assert (row["state"], row["faults"]) == ("ACTIVE", {})


@pytest.mark.parametrize("name", ["lqr", "network"])
def test_a_sweeps_worker_needs_nothing_but_the_job(name: str, rig_file: Path, tmp_path: Path) -> None:
    rig = load_rig(rig_file, [beside(name), *QUICK])
    (job,) = jobs(rig, rig_file.parent, 2, 0.8, seed=1)
    (rig_file.parent / f"{name}.py").unlink()
    figures = run_plants(job)
    (path,) = save_worst(rig_file, rig, 1, False, [1], tmp_path)
    assert reproduce(path, 0.8, figures.max_error[1])


@pytest.mark.long
@pytest.mark.parametrize("name", GOOD)
def test_a_slice_of_the_fault_campaign_passes_with_a_users_law(name: str, rig_file: Path) -> None:
    chunks = plan_chunks(load_rig(rig_file, [beside(name)]), rig_file.parent, stride=60)
    cells = [cell for chunk in (chunks[4], chunks[8]) for cell in run_chunk(chunk)]
    assert [cell.why for cell in cells if not cell.passed] == []
    assert cells


@pytest.mark.slow
@pytest.mark.parametrize("name", GOOD)
def test_the_fault_campaign_passes_with_a_users_law(name: str, rig_file: Path) -> None:
    """Every third cell: all of them take five minutes for the four laws, and `hil faults` tries them."""
    for chunk in plan_chunks(displaced(load_rig(rig_file, [beside(name)])), rig_file.parent, stride=3):
        assert [f"{c.checkpoint} / {c.trial}: {c.why}" for c in run_chunk(chunk) if not c.passed] == []


def test_a_users_law_answers_one_axis_as_arrays_of_one() -> None:
    rig = load_rig(RIGS / "paper.toml")
    config = LawConfig(name="examples.laws.lqr:Lqr")
    limit = np.array([axis.limits.force for axis in rig.axes.values()])
    model = rig_model(rig)
    single = make_axis_laws(config, model, 1e-3, limit)
    inputs = [axis_inputs(), axis_inputs()]
    for x in inputs:
        x.position_estimate, x.mean_velocity, x.mean_sign = 1e-5, 0.1, 1.0
    whole = make_law(config, model, 1e-3, limit)
    assert single.force(inputs) == whole.force(gather(inputs)).tolist()


@pytest.mark.parametrize("coupled", [False, True])
def test_a_users_law_is_reset_with_position_and_force_of_its_axes(coupled: bool) -> None:
    told: list[tuple[Any, Any]] = []

    class Listens(Law):
        def reset(self, position: Any, force: Any) -> None:
            told.append((np.array(position).tolist(), np.array(force).tolist()))

        def force(self, inputs: Any) -> Any:
            return 0.0

    Listens.coupled = coupled
    n = 1 if coupled else 2
    UserAxes([Listens(None, 1e-3, 5.0) for _ in range(n)], "listens", 2).reset([1.0, 2.0], [3.0, 4.0])
    assert told == ([([1.0, 2.0], [3.0, 4.0])] if coupled else [(1.0, 3.0), (2.0, 4.0)])
