"""Whatever a file says and whatever an operator sends: a refusal that names the problem, or a safe run."""

import contextlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

from hil.control.trajectories import make_trajectory
from hil.cycle.state_machine import TABLE, Event, State, StateMachine
from hil.cycle.step import ControlCycle
from hil.cycle.tick import CommandKind, OperatorCommand
from hil.rig.file import build_rig, load_rig
from hil.rig.schema import RigConfig, RigError
from hil.virtual.invariants import Invariants
from hil.virtual.lockstep import LockstepRun
from sim_plant.config import PlantError
from sim_plant.scenario.language import KINDS, FaultConfig, Scenario, ScenarioError, load_scenario
from tests.support.paths import RIGS

NAMES = ("paper", "microscope-ideal")
RIG = {name: load_rig(RIGS / f"{name}.toml") for name in NAMES}
TICKS = 160  # READY after 25, so that two thirds of it are ACTIVE

# An example is a whole run: few of them, and no minutes spent on making a failing one small.
rare = settings(
    max_examples=40,
    phases=(Phase.explicit, Phase.generate),
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)


# scenario files -------------------------------------------------------------------------------------------------------

anything = st.one_of(
    st.booleans(), st.integers(-(2**63), 2**63 - 1), st.floats(), st.text(max_size=8), st.just([]), st.just({})
)
fault_keys = st.sampled_from([*FaultConfig.model_fields, "nonsense"])
fault_tables = st.dictionaries(fault_keys, anything | st.sampled_from(sorted(KINDS)), max_size=8)


def scenario_or_refusal(path: Path) -> None:
    try:
        scenario = load_scenario(path)
    except ScenarioError as error:
        refusal = error.problems
        assert refusal  # either outcome is right, neither is expected
        assert all(line.startswith(str(path)) for line in refusal)
    else:
        assert isinstance(scenario, Scenario)


@pytest.mark.requirement(id="SR-9.4")
@given(st.binary(max_size=200))
def test_any_bytes_are_a_scenario_or_a_refusal(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.toml"
    path.write_bytes(data)
    scenario_or_refusal(path)


@given(st.lists(fault_tables, max_size=3), st.dictionaries(st.sampled_from(["description", "x"]), anything))
def test_any_fault_table_is_a_scenario_or_a_refusal(
    tmp_path_factory: pytest.TempPathFactory, tables: list[dict[str, Any]], rest: dict[str, Any]
) -> None:
    path = tmp_path_factory.getbasetemp() / "tables.toml"
    path.write_text(tomlkit.dumps({**rest, "fault": tables}), encoding="utf-8")
    scenario_or_refusal(path)


# accepted scenarios ---------------------------------------------------------------------------------------------------


def triggers(rig: RigConfig) -> st.SearchStrategy[dict[str, Any]]:
    trajectory = make_trajectory(rig.task, rig.axis_names, np.zeros(len(rig.axes)), rig.period_ns)
    after = st.fixed_dictionaries({}, optional={"after_s": st.floats(0, 0.1), "occurrence": st.integers(1, 3)})
    where = st.one_of(
        st.fixed_dictionaries({"at_state": st.sampled_from([state.name for state in State])}),
        st.fixed_dictionaries({"at_phase": st.sampled_from(list(trajectory.phase_names))}),
    )
    return st.one_of(
        st.fixed_dictionaries({"at_tick": st.integers(0, TICKS)}),
        st.fixed_dictionaries({"at_s": st.floats(0, TICKS * 1e-3)}),
        st.builds(lambda a, b: a | b, where, after),
    )


@st.composite
def faults(draw: st.DrawFn, rig: RigConfig) -> dict[str, Any]:
    """One [[fault]] with an eye to what is valid; what is not is refused, and that is tested above."""
    name = draw(st.sampled_from(sorted(KINDS)))
    kind = KINDS[name]
    table: dict[str, Any] = {"kind": name, **draw(triggers(rig))}
    if kind.unit:
        table["value"] = draw(st.floats(kind.low, kind.high))
    ends = st.fixed_dictionaries({}, optional={"duration_ticks": st.integers(1, 60), "probability": st.floats(0.1, 1)})
    table |= draw(ends)
    axes = st.sampled_from(rig.axis_names)
    if not name.startswith("wire_"):
        return table | draw(st.fixed_dictionaries({}, optional={"axis": axes}))
    nodes = st.sampled_from([*rig.axis_names, "host", "drives"])
    keys: dict[str, st.SearchStrategy[Any]] = {
        "receiver": nodes,
        "can_id": st.integers(0, 2**32 - 1),
        "count": st.integers(0, 20),
        "delay_s": st.floats(0, 0.02),
        "bit": st.integers(-1, 1000),
        "period_s": st.floats(1e-12, 0.01),
        "length": st.integers(0, 8),
    }
    return table | {"node": draw(nodes)} | draw(st.fixed_dictionaries({}, optional=keys))


kinds = st.sampled_from(list(CommandKind))
orders = st.lists(st.tuples(st.integers(0, TICKS), kinds), max_size=6)


@st.composite
def stories(draw: st.DrawFn) -> tuple[str, list[dict[str, Any]], list[tuple[int, CommandKind]]]:
    name = draw(st.sampled_from(NAMES))
    return name, draw(st.lists(faults(RIG[name]), min_size=1, max_size=4)), draw(orders)


@pytest.mark.long
@rare
@given(stories())
def test_any_accepted_scenario_runs_without_an_exception_and_within_the_invariants(
    story: tuple[str, list[dict[str, Any]], list[tuple[int, CommandKind]]],
) -> None:
    name, tables, plan = story
    rig = RIG[name]
    scenario = scenario_of(tables)

    def operator(run: LockstepRun, index: int) -> Sequence[CommandKind]:
        eager = [CommandKind.ACTIVATE] if run.cycle.state is State.READY else []
        return [kind for tick, kind in plan if tick == index] + eager

    run = LockstepRun(rig, RIGS, operator=operator, observer=Invariants(rig, RIGS).observe, scenario=scenario)
    for _ in range(TICKS):
        run.tick()


def scenario_of(tables: list[dict[str, Any]]) -> Scenario:
    """Those of the tables that are valid."""
    accepted = []
    for table in tables:
        try:
            accepted.append(FaultConfig.model_validate(table))
        except ValueError:
            continue
    return Scenario(fault=accepted)


# operators ------------------------------------------------------------------------------------------------------------

numbers = st.integers(0, 12) | st.sampled_from([0, 2**63, 2**64 - 1]) | st.integers(0, 2**64 - 1)
expiries = st.integers(-(2**63), 2**63 - 1) | st.integers(0, 10**9)
commands = st.builds(OperatorCommand, kinds | st.integers(-(2**40), 2**40), numbers, expiries)  # type: ignore[arg-type]
mail = st.dictionaries(st.integers(0, TICKS), st.lists(commands, max_size=6), max_size=20)


class Correspondence(LockstepRun):
    """A run whose mail is what the test says, numbers and expiries included, besides an honest operator's ACTIVATE."""

    def __init__(self, letters: dict[int, list[OperatorCommand]]) -> None:
        rig = RIG["paper"]
        super().__init__(rig, RIGS, observer=Invariants(rig, RIGS).observe)
        self._letters = letters

    def _commands(self, now: int) -> tuple[OperatorCommand, ...]:
        honest = super()._commands(now) if self.index % 7 == 0 else ()
        return (*self._letters.get(self.index, []), *honest)


class Watched(StateMachine):
    """walked: every event there was, with the states before and after it."""

    def __init__(self) -> None:
        super().__init__()
        self.walked: list[tuple[State, Event, State]] = []

    def handle(self, event: Event) -> bool:
        before = self.state
        taken = super().handle(event)
        self.walked.append((before, event, self.state))
        return taken


@pytest.mark.long
@rare
@given(mail)
@example({30: [OperatorCommand(CommandKind.ESTOP, 2**64 - 1, -1)]})
@example({30: [OperatorCommand(CommandKind.HEARTBEAT, 2**64 - 1, 2**63 - 1)], 40: [OperatorCommand(9, 1, 2**63 - 1)]})  # type: ignore[arg-type]
def test_any_mail_is_refused_or_leads_along_the_table(letters: dict[int, list[OperatorCommand]]) -> None:
    run = Correspondence(letters)
    run.cycle.supervisor.machine = machine = Watched()
    walked = machine.walked
    before = State.BOOT
    for _ in range(TICKS):
        first = len(walked)
        run.tick()
        for state, event, after in walked[first:]:
            assert state is before, "a state changed without an event"
            assert after is TABLE.get((state, event), state)
            before = after
    assert run.cycle.state is before


def test_a_number_seen_before_is_refused_and_an_emergency_stop_is_not() -> None:
    last = OperatorCommand(CommandKind.HEARTBEAT, 2**64 - 1, 2**63 - 1)
    run = Correspondence({1: [last], 60: [OperatorCommand(CommandKind.ESTOP, 0, 0)]})
    for _ in range(60):
        run.tick()
    assert run.cycle.state is State.READY, "the greatest number there is leaves room for no further ACTIVATE"
    assert run.cycle.commands.refused > 0
    run.tick()
    assert run.cycle.state is State.ESTOP


# rig files ------------------------------------------------------------------------------------------------------------


def leaves(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths to all numbers of a document."""
    if isinstance(node, dict | list):
        pairs = node.items() if isinstance(node, dict) else enumerate(node)
        return [leaf for key, child in pairs for leaf in leaves(child, (*path, key))]
    return [path] if isinstance(node, int | float) and not isinstance(node, bool) else []


WHOLE = {name: rig.model_dump(mode="json") for name, rig in RIG.items()}
LEAVES = {name: leaves(document) for name, document in WHOLE.items()}


def changed(value: float, draw: st.DrawFn) -> float:
    """A value near, far from, or at the edge of the one there."""
    how = draw(st.sampled_from(["scale", "float", "edge"]))
    if how == "scale":
        new = value * 10.0 ** draw(st.floats(-12, 12))
    elif how == "float":
        new = draw(st.floats(allow_nan=False, allow_infinity=False))
    else:
        new = draw(st.sampled_from([0.0, -1.0, 1.0, 5e-324, 1e-300, 1e-9, 1e9, 1e300, -value]))
    return int(new) if isinstance(value, int) and abs(new) < 2**63 else new


@st.composite
def rigs(draw: st.DrawFn) -> tuple[str, list[tuple[tuple[Any, ...], float]]]:
    name = draw(st.sampled_from(NAMES))
    paths = draw(st.lists(st.sampled_from(LEAVES[name]), min_size=1, max_size=3, unique=True))
    changes = []
    for path in paths:
        node = WHOLE[name]
        for key in path:
            node = node[key]
        changes.append((path, changed(node, draw)))  # type: ignore[arg-type]
    return name, changes


def altered(name: str, changes: list[tuple[tuple[Any, ...], float]]) -> dict[str, Any]:
    document = RIG[name].model_dump(mode="json")
    for path, value in changes:
        node = document
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] = value
    return document


@pytest.mark.requirement(id="SR-9.4")
@pytest.mark.long
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # overflow in a nonsensical plant is not the control's
@settings(rare, max_examples=120)
@given(rigs())
def test_any_rig_that_validates_runs_safely_or_is_refused(
    changes: tuple[str, list[tuple[tuple[Any, ...], float]]],
) -> None:
    name, edits = changes
    try:
        rig = build_rig(altered(name, edits))
        ControlCycle(rig, RIGS)
    except (RigError, ValueError) as error:
        assert str(error)  # noqa: PT017  # either outcome is right, neither is expected
        return
    run = LockstepRun(rig, RIGS, observer=Invariants(rig, RIGS).observe)
    with contextlib.suppress(PlantError):  # the emulated stage itself is nonsense
        for _ in range(50):
            run.tick()
    assert all(math.isfinite(force) for force in run.cycle.gate.force)
