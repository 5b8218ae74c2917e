"""What the law of a live run has learnt begins the next run of the same stage, is recorded, and can be left out."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hil.control.laws.presliding_kalman import KEPT
from hil.cycle.state_machine import State
from hil.cycle.step import ControlCycle
from hil.cycle.tick import CommandKind
from hil.live.kept_learnt import keep, kept_path, with_kept
from hil.rig.file import learning_hash, learning_hashes, load_rig, rig_hash
from hil.rig.learnt_file import write_learnt_file
from hil.rig.provenance import describe_run, rig_of_run
from hil.rig.schema import RigConfig, RigError
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.batch import rig_law
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from tests.support.paths import RIGS

SETS = ["law.name=presliding-kalman", "bus.interface=socketcan", "plant.presliding=5e-6"]
SMALL = ("task.radius=1e-3", "task.frequency_hz=5.0", "task.approach_s=0.1")
LASTS = 1000  # ticks until the operator stops
STATE = [[0.25] * KEPT, [0.5] * KEPT]


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)


def rig(*changes: str) -> RigConfig:
    return load_rig(RIGS / "paper.toml", [*SETS, *changes])


def test_a_first_run_begins_with_nothing_and_the_next_with_what_it_kept(tmp_path: Path) -> None:
    first, line = with_kept(rig(), fresh=False)
    assert (first.law.learnt_state, line) == ([[], []], "")
    path = keep(first, STATE)
    assert path == kept_path(first) == tmp_path / "state/hil/learnt/paper.json"
    again, line = with_kept(rig("task.radius=0.005"), fresh=False)
    assert again.law.learnt_state == STATE
    assert line == f"begins with what earlier runs have learnt of x, y ({path})"
    assert with_kept(rig(), fresh=True)[0].law.learnt_state == [[], []]


def test_an_axis_that_has_changed_begins_with_nothing_and_that_is_said() -> None:
    path = keep(with_kept(rig(), fresh=False)[0], STATE)
    changed, line = with_kept(rig("axes.y.model.mass=0.03"), fresh=False)
    assert changed.law.learnt_state == [STATE[0], []]
    assert line == (
        f"begins with what earlier runs have learnt of x ({path}); y: not with what {path} has, which was learnt on "
        "another stage, law or version"
    )


def test_an_emulated_stage_has_a_file_of_its_own() -> None:
    keep(rig(), STATE)
    emulated, line = with_kept(rig("bus.interface=local"), fresh=False)
    assert (emulated.law.learnt_state, line) == ([[], []], "")
    assert kept_path(emulated).parent != kept_path(rig()).parent


def test_a_damaged_file_is_said_and_does_not_keep_the_rig_from_running() -> None:
    path = keep(rig(), STATE)
    assert path is not None
    path.write_text("{")
    begun, line = with_kept(rig(), fresh=False)
    assert begun.law.learnt_state == [[], []]
    assert line.startswith(f"{path}: no file of")
    assert line.endswith("; nothing learnt is used")


def test_a_law_that_keeps_nothing_is_left_alone() -> None:
    plain = rig("law.name=pd-feedforward")
    assert with_kept(plain, fresh=False) == (plain, "")
    assert keep(plain, []) is None
    assert keep(plain, [[], []]) is None
    assert not kept_path(plain).exists()


def named(path: Path, x: float) -> RigConfig:
    """A rig whose file names what to begin with: of x alone, as `hil identify` writes of one axis."""
    state = {"x": [x] * KEPT, "y": list[float]()}
    write_learnt_file(path, "paper", learning_hash(rig()), learning_hashes(rig()), state)
    return rig(f"law.learnt={path}")


def test_a_named_state_begins_until_a_run_has_learnt_from_it(tmp_path: Path) -> None:
    first = named(tmp_path / "first.json", 0.125)
    begun, line = with_kept(first, fresh=False)
    assert (begun.law.learnt_state, line) == ([[0.125] * KEPT, []], f"begins with {tmp_path / 'first.json'}")
    assert begun.law.keeps
    keep(begun, STATE)
    assert with_kept(first, fresh=False)[0].law.learnt_state == STATE, "the newer one of the same stage"
    assert with_kept(rig(), fresh=False)[0].law.learnt_state == STATE
    assert with_kept(first, fresh=True)[0].law.learnt_state == [[0.125] * KEPT, []]
    keep(with_kept(first, fresh=False)[0], STATE[::-1])
    assert with_kept(first, fresh=False)[0].law.learnt_state == STATE[::-1], "and so on from run to run"
    second = named(tmp_path / "second.json", 0.375)
    assert with_kept(second, fresh=False)[0].law.learnt_state[0] == [0.375] * KEPT, "identified again"


def test_a_named_state_takes_the_place_of_what_runs_without_it_kept(tmp_path: Path) -> None:
    keep(with_kept(rig(), fresh=False)[0], STATE)
    one = named(tmp_path / "first.json", 0.125)
    assert with_kept(one, fresh=False)[0].law.learnt_state == [[0.125] * KEPT, []]
    kept_path(one).write_text("{")
    begun, line = with_kept(one, fresh=False)
    assert begun.law.learnt_state == [[0.125] * KEPT, []]
    assert line.endswith(f"; begins with {tmp_path / 'first.json'}")


def test_a_recording_has_all_of_it_beside_a_rig_that_is_the_same_as_without() -> None:
    keep(rig(), STATE)
    begun, _ = with_kept(rig(), fresh=False)
    metadata = json.loads(json.dumps(describe_run(begun, RIGS)))
    assert metadata["rig_hash"] == rig_hash(rig())
    with rig_of_run(metadata) as (again, _):
        assert again.law.learnt_state == STATE
        assert again.law.keeps
    with rig_of_run(metadata, ("law.name=pd-feedforward",)) as (other, _):
        assert other.law.learnt_state == []
    metadata["learnt"]["state"][0][3] = 0.75
    with pytest.raises(RigError, match="what its law had learnt before is damaged"), rig_of_run(metadata):
        pass


def test_an_axis_of_which_nothing_is_kept_begins_in_a_batch_as_ever() -> None:
    mixed = rig().model_copy(update={"law": rig().law.model_copy(update={"learnt_state": [STATE[0], []]})})
    law, fresh = rig_law(mixed), rig_law(rig())
    law.reset(np.zeros(2), np.zeros(2))
    kept = np.array(law.learnt_state())
    assert kept[:7, 0].tolist() == STATE[0][:7]
    assert kept[:, 1].tolist() == np.array(fresh.learnt_state())[:, 1].tolist()


def test_only_a_run_that_moved_and_ended_without_a_fault_is_kept() -> None:
    begun = rig().model_copy(update={"law": rig().law.model_copy(update={"learnt_state": [STATE[0], []]})})
    axes = ControlCycle(begun, RIGS).axes
    axes.rest()
    assert axes.kept() == [STATE[0], []]  # nothing has moved
    assert ControlCycle(rig(), RIGS).axes.kept() == []  # of a rig that keeps nothing


def operator(run: LockstepRun, index: int) -> Sequence[CommandKind]:
    """Activates whenever it can, and stops after a while."""
    if run.cycle.state is State.READY:
        return (CommandKind.ACTIVATE,)
    return (CommandKind.STOP,) if index == LASTS else ()


@pytest.mark.long
def test_what_one_activation_learnt_begins_the_next_and_a_replay_needs_no_file(tmp_path: Path) -> None:
    begun, _ = with_kept(rig(*SMALL), fresh=True)
    recorder = LockstepRecorder(tmp_path / "run.mcap", begun, RIGS / "paper.toml")
    run = LockstepRun(begun, RIGS, operator=operator, observer=recorder.observe)
    axes = run.cycle.axes
    for _ in range(LASTS):
        run.tick()
    assert axes.kept() == [[], []]  # that one goes on
    for _ in range(700):
        run.tick()
    assert run.cycle.state is State.ACTIVE
    kept = axes.kept()
    assert [len(values) for values in kept] == [KEPT, KEPT]
    fresh, _ = with_kept(rig(), fresh=True)
    assert kept[0][:7] != ControlCycle(fresh, RIGS).axes.law.laws[0].learnt_state()[:7]  # type: ignore[attr-defined]
    recorder.close()
    assert replay_run(tmp_path / "run.mcap").different == 0
    axes.distrust()  # as a fault does: what was learnt since is worth nothing
    axes.rest()
    assert axes.kept() == kept
    assert axes.law.laws[0].learnt_state()[:7] == kept[0][:7]  # type: ignore[attr-defined]
