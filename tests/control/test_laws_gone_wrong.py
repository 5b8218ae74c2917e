"""What a user's law does wrong: it ends in zero torque and is named, and nothing it returns or does is trusted."""

import math
import threading
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.base import call_limit
from hil import Law
from hil.analysis.stability import check_stability
from hil.control.laws.base import Model, axis_inputs
from hil.control.laws.users import OnArrays, PerElement, UserAxes
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.virtual.lockstep import LockstepRun
from hil.virtual.sim import simulate, usable
from tests.control.test_laws_per_element import inputs_of
from tests.support.laws_of_users import QUICK, beside, rig_with_laws
from tests.support.misbehaves import WAYS
from tests.support.paths import MISBEHAVES


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    return rig_with_laws(tmp_path)


def fault_of(rig: RigConfig, folder: Path, ticks: int = 400) -> LockstepRun:
    run = LockstepRun(rig, folder)
    for _ in range(ticks):
        run.tick()
    return run


@pytest.mark.requirement(id="SR-1.4")
@pytest.mark.parametrize("how", [way for way in WAYS if way != "never returns"])
def test_a_law_that_goes_wrong_ends_in_zero_torque_and_is_named(how: str, rig_file: Path) -> None:
    run = fault_of(load_rig(rig_file, [beside("misbehaves"), f"law.gains.how={how}"]), rig_file.parent)
    assert (run.cycle.state, run.cycle.fault) == (State.FAULT, Fault.NOT_FINITE)
    assert run.cycle.gate.force == [0.0, 0.0]
    assert not any(run.stage.applied_force)
    assert "law ./misbehaves.py:Misbehaves: ./misbehaves.py:" in run.cycle.law.failure


def test_the_line_that_raised_is_named(rig_file: Path) -> None:
    run = fault_of(load_rig(rig_file, [beside("misbehaves")]), rig_file.parent)
    lines = MISBEHAVES.read_text().splitlines()
    number = next(index for index, line in enumerate(lines, 1) if "len([])" in line)
    assert run.cycle.law.failure.endswith(f"./misbehaves.py:{number}: ZeroDivisionError: float division by zero")


def test_the_same_text_under_two_names_is_told_by_each(rig_file: Path) -> None:
    whole = f"law.name={rig_file.parent}/misbehaves.py:Misbehaves"
    rigs = [load_rig(rig_file, [name]) for name in (beside("misbehaves"), whole)]
    failures = [fault_of(rig, rig_file.parent).cycle.law.failure for rig in (*rigs, rigs[0])]
    assert failures[0] == failures[2] != failures[1]
    assert all("ZeroDivisionError" in failure for failure in failures)


@pytest.mark.long
@pytest.mark.requirement(id="SR-1.4")
def test_a_law_that_never_returns_is_given_up(rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call_limit, "CALL_LIMIT_S", 0.3)
    run = fault_of(load_rig(rig_file, [beside("misbehaves"), "law.gains.how='never returns'"]), rig_file.parent)
    assert (run.cycle.state, run.cycle.fault) == (State.FAULT, Fault.NOT_FINITE)
    assert "no answer within 0.3 s" in run.cycle.law.failure


@pytest.mark.parametrize("how", ["exits", "never returns", "raises in reset"])
def test_on_arrays_it_is_ended_and_named_too(how: str, rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call_limit, "CALL_LIMIT_S", 0.3)
    call_limit.watch.disarm()  # a timer of an earlier call would look in its own time
    rig = load_rig(rig_file, [beside("misbehaves"), f"law.gains={{how={how!r}, after=-1.0}}"])
    with pytest.raises(ValueError, match=r"law \./misbehaves\.py:Misbehaves: \./misbehaves\.py:\d+: "):
        check_stability(rig)


def test_a_law_that_fails_on_arrays_is_named_as_well(rig_file: Path) -> None:
    rig = load_rig(rig_file, [beside("misbehaves"), "law.gains.after=-1.0"])
    with pytest.raises(ValueError, match=r"law \./misbehaves\.py:Misbehaves: \./misbehaves\.py:\d+: ZeroDivisionError"):
        check_stability(rig)


def test_after_a_reset_a_law_gets_another_chance(rig_file: Path) -> None:
    asked: list[CommandKind] = []
    run = LockstepRun(
        load_rig(rig_file, [beside("misbehaves")]),
        rig_file.parent,
        operator=lambda r, k: (asked.pop(),) if asked else (),
    )
    for state, command in ((State.READY, CommandKind.ACTIVATE), (State.FAULT, CommandKind.RESET)) * 2:
        for _ in range(400):
            if run.cycle.state is state:
                break
            run.tick()
        assert run.cycle.state is state
        asked.append(command)
    assert run.cycle.law.failure


def test_a_law_that_cannot_be_made_is_refused_before_anything_runs(rig_file: Path) -> None:
    rig = load_rig(rig_file, [beside("misbehaves"), "law.gains.how='raises when made'"])
    with pytest.raises(RigError, match=r"it cannot be made: \./misbehaves\.py:\d+: RuntimeError: no weights"):
        usable(rig, rig_file)


def test_outside_the_main_thread_a_law_runs_without_its_time_limit(rig_file: Path) -> None:
    found: list[Any] = []
    rig = load_rig(rig_file, [beside("lqr"), *QUICK])
    thread = threading.Thread(target=lambda: found.append(simulate(rig, rig_file.parent, 0.3)[0]))
    thread.start()
    thread.join()
    assert found[0].trace_sha256 == simulate(rig, rig_file.parent, 0.3)[0].trace_sha256


@pytest.mark.parametrize(
    ("answer", "asked"),
    [(1, 1.0), (np.float32(0.5), 0.5), (np.array(2.0), 2.0)]
    + [(no, None) for no in (None, True, "1.0", b"1.0", np.array([1.0]), [1.0], math.inf, np.float64("nan"), 1j)],
)
def test_a_number_is_a_force_and_nothing_that_only_looks_like_one(answer: Any, asked: float | None) -> None:
    class Answers(Law):
        def reset(self, position: Any, force: Any) -> None: ...

        def force(self, inputs: Any) -> Any:
            return answer

    laws = UserAxes([Answers(None, 1e-3, 5.0)], "answers", 1)
    laws.reset([0.0], [0.0])
    (force,) = laws.force([None])
    assert (math.isnan(force), bool(laws.failure)) == (asked is None, asked is None)
    assert asked is None or force == asked


@pytest.mark.parametrize("coupled", [False, True])
def test_every_call_of_a_users_law_is_under_the_time_limit_and_what_follows_is_not(coupled: bool) -> None:
    watch, noted = call_limit.watch, []

    class Notes(Law):
        def reset(self, position: Any, force: Any) -> None:
            noted.append((watch.within, watch.calls))

        def force(self, inputs: Any) -> Any:
            noted.append((watch.within, watch.calls))
            return np.zeros(1) if coupled else 0.0

    Notes.coupled = coupled
    one = UserAxes([Notes(None, 1e-3, 5.0)], "notes", 1)
    model = Model(*(np.ones((2, 1)) for _ in fields(Model)))
    many = OnArrays("notes", PerElement(Notes, model, 1e-3, np.ones(1), {}))
    for call in (
        lambda: one.reset([0.0], [0.0]),
        lambda: one.force([axis_inputs()]),
        lambda: many.reset(np.zeros((2, 1)), np.zeros((2, 1))),
        lambda: many.force(inputs_of(np.random.default_rng(1), (2, 1), 0)),
    ):
        call()
        assert not watch.within
    assert all(within for within, _ in noted)
    assert len({calls for _, calls in noted}) == len(noted) == 2 + 2 * 2
