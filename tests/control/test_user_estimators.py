"""Estimators that users bring: what the law sees is theirs, what protects the stage is not, and none is trusted."""

import importlib.metadata
import math
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.base import call_limit, plugins
from hil.analysis.stability import check_stability
from hil.control.estimator.gains import design_gains
from hil.control.estimator.users import EstimatedAxes, EstimatedLaw
from hil.control.nominal_model import blank_inputs, rig_model
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.rig.law_names import LAWS
from hil.rig.schema import RigConfig, RigError
from hil.rig.tables import ESTIMATOR_KIND, ESTIMATORS
from hil.studies.evidence.stages import only
from hil.studies.tune.candidate_simulation import Trial
from hil.studies.tune.objective import Bench
from hil.virtual.batch import BatchRun, rig_law
from hil.virtual.lockstep import LockstepRun
from hil.virtual.sim import simulate, usable
from sim_plant.physics.stage import Truth
from tests.support.batch_equality import assert_batch_is_single
from tests.support.paths import RIGS, ROOT
from tests.support.wrong_estimator import WAYS

SUPPORT = ROOT / "tests" / "support"
LUENBERGER = ROOT / "examples" / "estimators" / "luenberger.py"
QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1"]
MADE = ["estimator.name=./luenberger.py:Luenberger", *QUICK]
WRONG = "estimator.name=./wrong_estimator.py:Wrong"
OWN_ESTIMATE = {"disturbance-observer", "structured-kalman", "presliding-kalman"}


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    """paper.toml in a folder of its own, with the users' files beside it."""
    for path in (RIGS / "paper.toml", LUENBERGER, SUPPORT / "honest_filter.py", SUPPORT / "wrong_estimator.py"):
        shutil.copy(path, tmp_path)
    return tmp_path / "paper.toml"


def honest(rig_file: Path, *more: str) -> RigConfig:
    """The rig with its own filter, written anew by a user."""
    gains, _ = design_gains(load_rig(rig_file, [*QUICK, *more]))
    names = ("position_gain", "velocity_gain", "disturbance_gain")
    keys = [f"estimator.parameters.{name}={row.tolist()}" for name, row in zip(names, gains, strict=True)]
    return load_rig(rig_file, ["estimator.name=./honest_filter.py:HonestFilter", *keys, *QUICK, *more])


def run_of(rig: RigConfig, folder: Path, ticks: int = 400) -> LockstepRun:
    run = LockstepRun(rig, folder)
    for _ in range(ticks):
        run.tick()
    return run


@pytest.mark.long
@pytest.mark.parametrize("more", [
    (), ("wire.drop_probability=0.01",), ("law.name=pid",), ("law.iterative_learning=true", "task.frequency_hz=2.0"),
])  # fmt: skip
def test_the_rigs_own_filter_written_anew_changes_nothing(more: tuple[str, ...], rig_file: Path) -> None:
    ours, theirs = (
        simulate(rig, rig_file.parent, 1.5) for rig in (load_rig(rig_file, [*QUICK, *more]), honest(rig_file, *more))
    )
    assert theirs[0].state == ours[0].state == "ACTIVE"
    assert np.abs(theirs[1].force).max() > 0.5
    assert np.abs(theirs[1].force - ours[1].force).max() < 1e-6
    assert np.abs(theirs[1].true - ours[1].true).max() < 1e-12


@pytest.mark.long
def test_nor_do_the_margins_change_by_it(rig_file: Path) -> None:
    ours, theirs = (check_stability(rig).axes for rig in (load_rig(rig_file, QUICK), honest(rig_file)))
    for name, axis in ours.items():
        assert theirs[name].gain_db == pytest.approx(axis.gain_db, abs=1e-4)
        assert theirs[name].phase_deg == pytest.approx(axis.phase_deg, abs=1e-4)


@pytest.mark.long
def test_a_rate_that_an_estimator_refuses_is_none_the_loop_is_stable_at(rig_file: Path) -> None:
    """Luenberger takes a quarter of the rate at most, 60 Hz here."""
    for rig, least in ((load_rig(rig_file, MADE), 240.0), (load_rig(rig_file, QUICK), 0.0)):
        for axis in check_stability(rig, lowest_rate=True, ticks=400).axes.values():
            assert axis.lowest_stable_rate_hz is not None
            assert least <= axis.lowest_stable_rate_hz < 1000.0


@pytest.mark.slow
def test_nor_do_the_trials_of_a_search(rig_file: Path) -> None:
    trials = [Trial("own", {"approach_s": 0.2}, 4.0, loss=0.02), Trial("light", {}, 4.0, mass=0.9, jitter=5e-5)]
    found = []
    for rig in (load_rig(rig_file, [*QUICK, "task.radius=1e-3"]), honest(rig_file, "task.radius=1e-3")):
        bench = Bench(rig, rig.law.name, 1, trials)
        gains = bench.gains(np.array([[0.4] * len(bench.space), [0.6] * len(bench.space)]))
        outcome = bench.judge(gains)
        found.append([*outcome.error.tolist(), *outcome.gain_db.tolist()])
    assert found[1] == pytest.approx(found[0], rel=1e-6)


def test_an_estimator_is_what_the_law_sees_and_the_faults_do_not(rig_file: Path) -> None:
    ours, theirs = (load_rig(rig_file, keys) for keys in (QUICK, MADE))
    runs = [run_of(rig, rig_file.parent) for rig in (ours, theirs)]
    assert [run.cycle.state for run in runs] == [State.ACTIVE] * 2
    assert runs[0].cycle.gate.force != runs[1].cycle.gate.force
    cycle = runs[1].cycle
    for x, motion in zip(cycle.inputs, cycle.filters, strict=True):
        assert x.velocity_estimate != motion.ahead_velocity
        assert x.velocity_estimate == pytest.approx(motion.ahead_velocity, rel=0.05)
        assert x.disturbance_estimate == motion.disturbance
    assert cycle.axes.ahead_velocity() == [motion.ahead_velocity for motion in cycle.filters]


def test_one_that_lies_cannot_weaken_a_fault(rig_file: Path) -> None:
    """It tells the law that the axis rests at its setpoint: the stage is not held, and the rig's own filter sees it."""
    (rig_file.parent / "lies.py").write_text(
        "import hil\n\n\nclass Lies(hil.Estimator):\n    def reset(self, position):\n        self.at = position\n\n"
        "    def update(self, measurement):\n        return self.at, 0.0\n"
    )
    keys = ["estimator.name=./lies.py:Lies", *QUICK, "axes.x.limits.following_error=1e-3"]
    run = run_of(load_rig(rig_file, keys), rig_file.parent, 1200)
    assert run.cycle.state is State.FAULT
    assert run.cycle.fault in (Fault.FOLLOWING_ERROR, Fault.SPEED, Fault.TRAVEL)
    assert run.cycle.law.failure == ""
    assert run.cycle.gate.force == [0.0, 0.0]


@pytest.mark.parametrize("law", LAWS)
def test_laws_that_have_an_observer_of_their_own_say_so(law: str, rig_file: Path) -> None:
    hashes = {
        simulate(load_rig(rig_file, [*keys, f"law.name={law}"]), rig_file.parent, 0.3)[0].trace_sha256
        for keys in (QUICK, MADE)
    }
    assert (len(hashes) == 1) == (law in OWN_ESTIMATE)
    assert plugins.load(LAWS[law]).own_estimate == (law in OWN_ESTIMATE)


@pytest.fixture
def notes(rig_file: Path) -> Any:
    """The class in notes.py beside the rig, which writes down what it is told: `made`, and `told` of every object."""
    shutil.copy(SUPPORT / "notes.py", rig_file.parent)
    found = plugins.find(ESTIMATOR_KIND, "./notes.py:Notes", (SUPPORT / "notes.py").read_text())
    del found.made[:], found.told[:]
    return found


def test_it_is_told_what_was_measured_and_what_acted(notes: Any, rig_file: Path) -> None:
    rig = load_rig(rig_file, ["estimator.name=./notes.py:Notes", *QUICK, "wire.drop_probability=0.02"])
    run = LockstepRun(rig, rig_file.parent)
    assert [(m.mass, m.coulomb, period, resolution) for m, period, resolution in notes.made] == [
        (axis.model.mass, axis.model.coulomb, 1e-3, axis.encoder_resolution) for axis in rig.axes.values()
    ]
    cycle, age, lost = run.cycle, 0.0, 0
    while len(notes.told) < 800:
        known, before = len(notes.told), (cycle.axes.net_before[1], cycle.axes.net_last[1])
        run.tick()
        if len(notes.told) == known:
            continue
        x, (_, told) = cycle.inputs[1], notes.told[-1]
        age = 0.0 if x.fresh else age + x.sample_interval
        lost += not x.fresh
        if len(notes.told) == known + 4:  # reset in this tick: first with the position
            assert notes.told[known + 1][1] == x.position
            before = (0.0, 0.0)
        forces = (x.force_before, x.force_last)
        assert told[:9] == (x.position, x.fresh, age, x.sample_interval, x.ahead, *forces, *before)
        motion = cycle.filters[1]
        assert told[9:] == (motion.ahead_position, motion.ahead_velocity)
    assert lost > 5
    assert len({who for who, _ in notes.told}) == 2


@pytest.mark.parametrize("arrays", [False, True])
def test_after_a_reset_nothing_is_known_of_what_acted_before(arrays: bool, notes: Any, rig_file: Path) -> None:
    rig = load_rig(rig_file, ["estimator.name=./notes.py:Notes"])
    cycle = LockstepRun(rig, rig_file.parent).cycle
    law = rig_law(rig) if arrays else cycle.law
    inputs: Any = blank_inputs((2,)) if arrays else cycle.inputs  # compiled, of a class of its own
    x = inputs if arrays else inputs[1]

    def told(**values: float) -> list[float]:
        for name, value in values.items():
            setattr(x, name, np.full(2, value) if arrays else value)
        law.force(inputs)
        return [round(value, 12) for value in notes.told[-1][1][2:9]]

    model = rig.axes["y"].model
    for _ in range(2):
        law.reset(np.zeros(2), np.zeros(2))
        moving = {"mean_velocity": 0.1, "mean_sign": 1.0, "sample_interval": 1e-3}
        assert told(**moving, force_before=1.0, force_last=2.0, fresh=0.0) == [1e-3, 1e-3, 0.0, 1.0, 2.0, 0.0, 0.0]
        wet = model.viscous * 0.1 + model.quadratic * 0.01
        net = round(3.0 - model.coulomb - wet - (-model.gravity), 12)
        if arrays:
            x.mean_velocity *= 0.0  # the caller's own array, which it fills anew
        assert told(mean_velocity=-0.1, force_before=2.0, force_last=3.0) == [2e-3, 1e-3, 0.0, 2.0, 3.0, 0.0, net]
        assert told(force_before=3.0, force_last=0.0, fresh=1.0)[:6] == [0.0, 1e-3, 0.0, 3.0, 0.0, net]


@pytest.mark.parametrize("law", ["pd-feedforward", "structured-kalman"])
def test_a_batch_equals_the_full_path(law: str, rig_file: Path) -> None:
    """One object an axis there; here one for every axis of every plant."""
    rig = load_rig(rig_file, ["wire.stuffing=worst", f"law.name={law}", *MADE])
    assert_batch_is_single(rig, rig_file.parent)


def test_what_is_recorded_is_what_the_law_was_told(rig_file: Path) -> None:
    run = LockstepRun(load_rig(rig_file, MADE), rig_file.parent, observer=lambda tick, frames, result: rows.append(
        (result.record["position_estimate"][:2].tolist(), result.record["velocity_estimate"][:2].tolist())
    ))  # fmt: skip
    rows: list[Any] = []
    for _ in range(400):
        run.tick()
        told = [(x.position_estimate, x.velocity_estimate) for x in run.cycle.inputs]
        assert rows[-1] == tuple(map(list, zip(*told, strict=True)))


def test_a_file_a_module_and_an_entry_point_are_the_same_estimator(
    rig_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(LUENBERGER.parent))
    entry = importlib.metadata.EntryPoint("mine", "luenberger:Luenberger", ESTIMATOR_KIND.group)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry] if group == "hil.estimators" else [])
    hashes = {
        simulate(load_rig(rig_file, [f"estimator.name={name}", *QUICK]), rig_file.parent, 0.3)[0].trace_sha256
        for name in ("./luenberger.py:Luenberger", "luenberger:Luenberger", "mine")
    }
    assert len(hashes) == 1
    assert plugins.registered(ESTIMATOR_KIND) == [*ESTIMATORS, "mine"]


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        (["estimator.name=motion-filtre"], "the nearest is motion-filter; the estimators are motion-filter"),
        (["estimator.name=no.such:Thing"], "estimator.name = 'no.such:Thing': No module named 'no'"),
        (["estimator.name=./none.py:Thing"], "none.py: No such file"),
        (["estimator.name=./luenberger.py:math"], "'math' is no class with reset and update"),
        (["estimator.parameters.bandwidth_hz=30"], "of an estimator of your own; name = 'motion-filter' takes none"),
        ([*MADE, "estimator.parameters.bandwidth=30"], "./luenberger.py:Luenberger has bandwidth_hz"),
        ([*MADE, "estimator.parameters.bandwidth_hz=[30, 30, 30]"], "bandwidth_hz has 3 values for 2 axes"),
        ([*MADE, "estimator.parameters.bandwidth_hz=300"], "bandwidth_hz = 300: above 0, at most 250"),
        ([WRONG, "estimator.parameters.how='raises when made'"], "./wrong_estimator.py:16: RuntimeError: no poles"),
        (["estimator.name=./honest_filter.py:HonestFilter"], "estimator.parameters.position_gain: "),
    ],
)
def test_one_that_is_not_to_be_had_is_refused_by_its_key(keys: list[str], text: str, rig_file: Path) -> None:
    with pytest.raises(RigError) as caught:
        usable(load_rig(rig_file, keys), rig_file)
    assert text in str(caught.value)


@pytest.mark.long
def test_another_name_takes_no_parameters_of_the_files(rig_file: Path) -> None:
    text = '[estimator]\nname = "./luenberger.py:Luenberger"\nparameters = { bandwidth_hz = [20, 30] }\n'
    rig_file.write_text(rig_file.read_text().replace("[estimator]\n", text))
    rig = load_rig(rig_file)
    assert [rig.estimator.parameters_of(axis) for axis in (0, 1)] == [{"bandwidth_hz": 20}, {"bandwidth_hz": 30}]
    assert load_rig(rig_file, ["estimator.name=motion-filter"]).estimator.parameters == {}
    assert load_rig(rig_file, [WRONG, "estimator.parameters.after=1"]).estimator.parameters == {"after": 1}
    assert only(rig, ["y"]).estimator.parameters == {"bandwidth_hz": [30]}
    bench = Bench(rig, rig.law.name, 1, [Trial("own", {"approach_s": 0.2}, 4.0)])
    alone = load_rig(rig_file, ["estimator.parameters.bandwidth_hz=30"])
    point = np.full((1, len(bench.space)), 0.5)
    expected = Bench(alone, rig.law.name, 1, [Trial("own", {"approach_s": 0.2}, 4.0)]).run(point)
    assert [values.tolist() for values in bench.run(point)] == [values.tolist() for values in expected]


@pytest.mark.requirement(id="SR-1.4")
@pytest.mark.parametrize("how", [way for way in WAYS if way != "never returns"])
@pytest.mark.parametrize("law", ["pd-feedforward", "structured-kalman"])
def test_one_that_goes_wrong_ends_in_zero_torque_and_is_named(how: str, law: str, rig_file: Path) -> None:
    """Also behind a law that does not look at it."""
    keys = [WRONG, f"estimator.parameters.how={how}", f"law.name={law}"]
    report, traces = simulate(load_rig(rig_file, keys), rig_file.parent, 0.5)
    assert (report.state, list(report.faults)) == ("FAULT", ["not_finite"])
    assert np.abs(traces.force[-1]).max() == 0.0
    assert (np.abs(traces.force).max() > 0.0) == (how != "raises in reset")
    assert report.law_failure.startswith("estimator ./wrong_estimator.py:Wrong: ./wrong_estimator.py:")
    assert any(report.law_failure in event.cause for event in report.events)


def test_the_line_that_raised_is_named(rig_file: Path) -> None:
    failure = run_of(load_rig(rig_file, [WRONG]), rig_file.parent).cycle.law.failure
    lines = (SUPPORT / "wrong_estimator.py").read_text().splitlines()
    number = next(index for index, line in enumerate(lines, 1) if "len([])" in line)
    assert failure.endswith(f"./wrong_estimator.py:{number}: ZeroDivisionError: float division by zero")


def test_one_that_never_returns_is_given_up(rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call_limit, "CALL_LIMIT_S", 0.3)
    call_limit.watch.disarm()  # a timer of an earlier call would look in its own time
    run = run_of(load_rig(rig_file, [WRONG, "estimator.parameters.how='never returns'"]), rig_file.parent)
    assert (run.cycle.state, run.cycle.fault) == (State.FAULT, Fault.NOT_FINITE)
    assert "no answer within 0.3 s" in run.cycle.law.failure


def test_after_a_reset_it_gets_another_chance(rig_file: Path) -> None:
    asked: list[CommandKind] = []
    rig = load_rig(rig_file, [WRONG])
    run = LockstepRun(rig, rig_file.parent, operator=lambda r, k: (asked.pop(),) if asked else ())
    active = 0
    for state, command in ((State.READY, CommandKind.ACTIVATE), (State.FAULT, CommandKind.RESET)) * 2:
        for _ in range(400):
            active += run.cycle.state is State.ACTIVE
            if run.cycle.state is state:
                break
            run.tick()
        assert run.cycle.state is state
        asked.append(command)
    assert active > 150


@pytest.mark.parametrize("how", ["raises", "word", "exits", "never returns", "raises in reset"])
def test_one_that_fails_on_arrays_is_named_as_well(how: str, rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call_limit, "CALL_LIMIT_S", 0.3)
    call_limit.watch.disarm()
    rig = load_rig(rig_file, [WRONG, f"estimator.parameters={{how={how!r}, after=-1.0}}"])
    with pytest.raises(ValueError, match=r"estimator \./wrong_estimator\.py:Wrong: \./wrong_estimator\.py:\d+: "):
        check_stability(rig)


def test_a_laws_own_failure_behind_it_is_the_laws(rig_file: Path) -> None:
    shutil.copy(SUPPORT / "misbehaves.py", rig_file.parent)
    run = run_of(load_rig(rig_file, [*MADE, "law.name=./misbehaves.py:Misbehaves"]), rig_file.parent)
    assert run.cycle.fault is Fault.NOT_FINITE
    assert run.cycle.law.failure.startswith("law ./misbehaves.py:Misbehaves: ")


def test_a_plant_that_has_diverged_has_no_estimate(rig_file: Path) -> None:
    text = LUENBERGER.read_text().replace(
        "        m = measurement\n", "        m = measurement\n        int(m.position)\n"
    )
    (rig_file.parent / "luenberger.py").write_text(text)  # raises where there is no position
    rig = load_rig(rig_file, MADE)
    truth = Truth.from_config(rig.plant, len(rig.axes), rig.axis_names)
    batch = BatchRun(rig, Truth.stack([truth, truth]))
    for _ in range(20):
        batch.tick()
    with np.errstate(all="ignore"):
        batch._stage.position[1] = math.nan
        batch.tick()
    assert np.isnan(batch.force[1]).all()
    assert np.isfinite(batch.force[0]).all()


def test_what_a_law_has_learnt_is_read_through_it(rig_file: Path) -> None:
    law = run_of(load_rig(rig_file, MADE), rig_file.parent, 1).cycle.law
    assert isinstance(law, EstimatedAxes)
    assert len(law.laws) == 2


@pytest.mark.parametrize(("coupled", "preview"), [(False, 0), (True, 3)])
def test_a_law_behind_it_is_told_what_it_would_be_told_in_front(coupled: bool, preview: int, rig_file: Path) -> None:
    rig, told = load_rig(rig_file, MADE), list[Any]()
    law = SimpleNamespace(coupled=coupled, preview=preview, reset=lambda *begin: told.append(begin))
    behind = EstimatedLaw(law, rig, rig_model(rig), range(2))  # type: ignore[arg-type]
    assert (behind.coupled, behind.preview) == (coupled, preview)
    position, force = np.array([1e-3, 2e-3]), np.array([0.5, -0.25])
    behind.reset(position, force)
    assert [[values.tolist() for values in begin] for begin in told] == [[position.tolist(), force.tolist()]]
