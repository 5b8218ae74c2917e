"""The states and who may lead where."""

import itertools
from enum import IntEnum

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.cycle.state_machine import SILENT_STATES, TABLE, TORQUE_STATES, Event, State, StateMachine

ALL_PAIRS = list(itertools.product(State, Event))


def machine_in(state: State) -> StateMachine:
    machine = StateMachine()
    machine.state = state
    return machine


@pytest.mark.requirement(id="SR-1.2")
@pytest.mark.parametrize(("state", "event"), ALL_PAIRS, ids=lambda item: item.name)
def test_every_pair_follows_the_table_or_is_refused_and_counted(state: State, event: Event) -> None:
    machine = machine_in(state)
    taken = machine.handle(event)
    if (state, event) in TABLE:
        assert taken
        assert machine.state is TABLE[state, event]
        assert machine.refused == 0
    else:
        assert not taken
        assert machine.state is state
        assert machine.refused == 1


@pytest.mark.parametrize(("kind", "count"), [(State, 9), (Event, 14)])
def test_every_name_has_its_own_number_and_recordings_keep_their_meaning(kind: type[IntEnum], count: int) -> None:
    assert [int(member) for member in kind.__members__.values()] == list(range(count))


def test_a_fresh_machine_is_in_boot() -> None:
    assert StateMachine().state is State.BOOT


@pytest.mark.requirement(id="SR-1.2")
def test_torque_is_permitted_only_where_the_axes_may_move() -> None:
    assert {State.HOMING, State.ACTIVE, State.STOPPING} == TORQUE_STATES
    assert {State.BOOT, State.SHUTDOWN} == SILENT_STATES


@pytest.mark.requirement(id="SR-5.1")
@pytest.mark.parametrize("latched", [State.FAULT, State.ESTOP])
def test_a_latched_state_is_left_by_reset_alone_and_leads_to_connected(latched: State) -> None:
    ways_out = {event: target for (state, event), target in TABLE.items() if state is latched and target is not latched}
    stops = {Event.EXIT: State.SHUTDOWN, Event.ESTOP: State.ESTOP}
    assert {event: target for event, target in ways_out.items() if event not in stops} == {Event.RESET: State.CONNECTED}


@pytest.mark.requirement(id="SR-5.1")
def test_active_is_entered_from_ready_by_the_operator_alone() -> None:
    assert [pair for pair, target in TABLE.items() if target is State.ACTIVE] == [(State.READY, Event.ACTIVATE)]


def test_shutdown_is_the_end() -> None:
    assert not [pair for pair in TABLE if pair[0] is State.SHUTDOWN]


@pytest.mark.parametrize("state", sorted(set(State) - {State.SHUTDOWN, State.ESTOP}))
def test_a_fault_with_zero_reaction_latches_from_every_state(state: State) -> None:
    assert TABLE[state, Event.FAULT_ZERO] is State.FAULT


@pytest.mark.requirement(id="SR-2.1")
@pytest.mark.parametrize("state", sorted(set(State) - {State.SHUTDOWN}))
def test_an_emergency_stop_is_obeyed_from_every_state(state: State) -> None:
    assert TABLE[state, Event.ESTOP] is State.ESTOP


@pytest.mark.requirement(id="SR-5.1")
@pytest.mark.parametrize("state", sorted(set(State) - {State.BOOT, State.SHUTDOWN}))
def test_an_exit_and_a_stop_come_to_rest_first_where_there_is_torque_and_keep_a_fault(state: State) -> None:
    moves = state in TORQUE_STATES
    assert TABLE[state, Event.EXIT] is (State.STOPPING if moves else State.SHUTDOWN)
    stopped = (State.READY, State.FAULT, State.SHUTDOWN)
    ends = (Event.STOPPED, Event.STOPPED_IN_FAULT, Event.STOPPED_FOR_EXIT)
    found = tuple(TABLE.get((state, event)) for event in ends)
    assert found == (stopped if state is State.STOPPING else (None, None, None))


@pytest.mark.requirement(id="SR-5.1")
@given(st.lists(st.sampled_from(list(Event)), max_size=60))
def test_no_sequence_of_events_reaches_active_from_a_fault_without_passing_connected_and_ready(
    events: list[Event],
) -> None:
    machine = StateMachine()
    path = [machine.state]
    for event in events:
        machine.handle(event)
        if machine.state is not path[-1]:
            path.append(machine.state)
    for here, there in itertools.pairwise(path):
        if here in (State.FAULT, State.ESTOP):
            assert there in (State.CONNECTED, State.SHUTDOWN, State.ESTOP)
        if there is State.ACTIVE:
            assert here is State.READY
