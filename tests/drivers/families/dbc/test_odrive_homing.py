"""An ODrive that homes by itself when it is told to: bounded by way, time and torque, and back under the host's."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from drivers.families.dbc.odrive_homing import HOMING
from drivers.frame import Frame
from drivers.protocols.base import DriveStatus
from hil.cycle.axis_homing import Step as Sub
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.virtual.lockstep import LockstepRun
from sim_plant.drives import odrive
from sim_plant.drives.odrive_homing import Phase
from sim_plant.drives.servo import NEVER_NS
from tests.support.homing import (
    ABOVE,
    FARTHEST,
    FORCE,
    PLACE,
    home_once,
    homed_on,
    on_the_way,
    reset_to_ready,
    stopped_by,
)
from tests.support.odrive_homing import GEAR, node_of, rig_of

NEAR = 20e-6  # m


def test_the_drive_homes_and_comes_back(tmp_path: Path) -> None:
    forces: list[float] = []
    run, homed = homed_on(
        rig_of(tmp_path), tmp_path,
        lambda run: forces.append(abs(run.stage.drives[0].force)) if node_of(run).phase is not Phase.NONE else None,
    )  # fmt: skip
    assert (homed.state, homed.fault, homed.known) == (State.READY, Fault.NONE, True), homed.why
    assert homed.steps == [Sub.SEARCH, Sub.MOVE_TO]
    assert abs(run.cycle.inputs[0].position - run.true_position[0]) <= NEAR
    assert homed.way < FARTHEST
    assert 1.146 / GEAR < max(forces) <= FORCE / GEAR
    node = node_of(run)
    assert node._modes == (odrive.TORQUE_CONTROL, odrive.PASSTHROUGH)
    rated = run.stage.drives[0].rated_force
    assert node._value("config.torque_soft_max") == pytest.approx(rated), "as it was"
    assert node._value("config.torque_soft_min") == pytest.approx(-rated)
    paths = ("controller.config.homing_speed", "controller.config.vel_ramp_rate", "trap_traj.config.vel_limit")
    assert [node._value(path) for path in paths] == pytest.approx([5.0, 200.0, 2.0]), "turns"


def test_a_drive_mounted_the_other_way_round_homes_towards_its_own_endstop(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, start=-ABOVE, mirrored=True, home={"at": -PLACE})
    run, homed = homed_on(rig, tmp_path)
    assert (homed.state, homed.known) == (State.READY, True), (homed.why, homed.fault)
    assert run.true_position[0] == pytest.approx(-PLACE, abs=1e-3)
    assert abs(run.cycle.inputs[0].position - run.true_position[0]) <= NEAR


def test_where_the_drive_counts_0_is_home_at(tmp_path: Path) -> None:
    """Its endstop is at -0.5 turns: the drive goes 5 mm back to its zero."""
    rig = rig_of(tmp_path, home={"at": PLACE + 5e-3}, instead={"min_endstop.config.offset": -0.5})
    run, homed = homed_on(rig, tmp_path)
    assert homed.known, homed.why
    assert run.true_position[0] == pytest.approx(PLACE + 5e-3, abs=2e-4)
    assert abs(run.cycle.inputs[0].position - run.true_position[0]) <= NEAR


def test_a_torque_limit_of_its_own_that_is_lower_stays(tmp_path: Path) -> None:
    seen: set[tuple[float, float]] = set()

    def lower(run: LockstepRun) -> None:
        node = node_of(run)
        if node.phase is Phase.NONE and not seen:
            node._written["config.torque_soft_max"] = 0.003
        elif node.phase is not Phase.NONE:
            limits = (node._value("config.torque_soft_max"), node._value("config.torque_soft_min"))
            seen.add((round(limits[0] * GEAR, 4), round(limits[1] * GEAR, 4)))

    run, homed = homed_on(rig_of(tmp_path), tmp_path, lower)
    assert homed.known, run.cycle.problems
    assert seen == {(round(0.003 * GEAR, 4), -FORCE)}


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [("enable_watchdog", 0, "= 0; expected 1"), ("watchdog_timeout", 0.5, "= 0.5; expected 1e-06 to 0.1")],
)
def test_a_drive_that_would_not_let_go_is_not_told_to_home(path: str, value: float, words: str, tmp_path: Path) -> None:
    def forget(run: LockstepRun) -> None:
        node_of(run)._instead[f"config.{path}"] = value

    run, homed = homed_on(rig_of(tmp_path), tmp_path, forget)
    assert (homed.fault, homed.known) == (Fault.HOMING_FAILED, False)
    assert f"axis 0: axis0.config.{path} {words}" in run.cycle.problems
    assert homed.way < 1e-4


def test_it_is_told_no_torque_and_asked_for_no_value_of_the_rig_while_it_homes(tmp_path: Path) -> None:
    told: list[tuple[float, int]] = []

    def note(run: LockstepRun) -> None:
        proof = run.cycle.protocol.layout._proofs[0]  # type: ignore[attr-defined]
        if node_of(run).phase is not Phase.NONE:
            told.append((node_of(run)._torque, proof._waits))

    _, homed = homed_on(rig_of(tmp_path), tmp_path, note)
    assert homed.known
    assert len(told) > 100
    assert set(told[1:]) == {(0.0, False)}


def test_after_homing_the_axis_is_held_and_a_task_begins(tmp_path: Path) -> None:
    run, homed = homed_on(rig_of(tmp_path), tmp_path)
    assert homed.known
    run._operator = lambda run, index: [CommandKind.ACTIVATE_HOLD] if run.activated_at < 0 else ()
    for _ in range(300):
        run.tick()
    assert (run.cycle.state, run.cycle.fault) == (State.ACTIVE, Fault.NONE)
    assert run.cycle.inputs[0].position == pytest.approx(run.true_position[0], abs=NEAR)


def test_where_it_is_wanted_it_goes_under_torque_of_the_host(tmp_path: Path) -> None:
    run, homed = homed_on(rig_of(tmp_path, home={"move_to": PLACE + 0.01}), tmp_path)
    assert homed.known, homed.why
    assert run.true_position[0] == pytest.approx(PLACE + 0.01, abs=2e-3)


def test_a_weight_on_a_brake_does_not_fall_while_the_drive_lets_go(tmp_path: Path) -> None:
    places: list[list[float]] = []
    told: list[float] = []
    rig = rig_of(tmp_path, weight=-2.0, brake=True, home={"force": 4.5})
    run, homed = home_once(
        rig, tmp_path, places=places,
        tampered=lambda run: told.append(node_of(run)._torque) if node_of(run)._state == HOMING else None,
    )  # fmt: skip
    assert homed.known, (homed.why, run.cycle.problems)
    assert set(told[1:]) == {0.0}, "nor is the weight's torque added to the drive's own"
    assert max(abs(b[0] - a[0]) for a, b in pairwise(places)) < 2.0 * 0.05 * 2.5e-3, "no faster than twice the search"


# what ends it ---------------------------------------------------------------------------------------------------------


def back_as_before(run: LockstepRun) -> None:
    """A reset leads to READY, with the torque limits and the mode of before."""
    reset_to_ready(run)
    is_as_before(run)


def is_as_before(run: LockstepRun) -> None:
    node, rated = node_of(run), run.stage.drives[0].rated_force
    assert node._modes == (odrive.TORQUE_CONTROL, odrive.PASSTHROUGH)
    assert node._value("config.torque_soft_max") == pytest.approx(rated)
    assert node._value("config.torque_soft_min") == pytest.approx(-rated)


@pytest.mark.requirement(id="SR-4.5")
@pytest.mark.parametrize(
    ("case", "why", "words"),
    [
        ({"contact": "dead"}, "not found within home.farthest", ""),
        ({"home": {"farthest": 0.01}}, "not found within home.farthest", ""),
        ({"contact": "stuck"}, "its drive refuses", "axis0.min_endstop.state = 1; expected 0"),
        ({"contact": "inverted"}, "its drive refuses", "axis0.min_endstop.state = 1; expected 0"),
        ({"start": PLACE - 0.01}, "its drive refuses", "axis0.min_endstop.state = 1; expected 0"),
        ({"low": None}, "its drive refuses", "axis0.min_endstop.config.enabled = 0; expected 1"),
        (
            {"instead": {"config.torque_soft_max": 0.008}},
            "its drive refuses",
            "axis0.config.torque_soft_max = 0.008; expected 0.00477465, as written",
        ),
        (
            {"instead": {"controller.config.homing_speed": 50.0}},
            "its drive refuses",
            "axis0.controller.config.homing_speed = 50; expected 5, as written",
        ),
    ],
    ids=["dead", "too far", "stuck", "inverted", "pressed", "no endstop", "torque not kept", "speed not kept"],
)
def test_a_homing_that_does_not_end_well_is_a_fault_without_torque(
    case: dict[str, Any], why: str, words: str, tmp_path: Path
) -> None:
    run, homed = homed_on(rig_of(tmp_path, **case), tmp_path)
    assert (homed.state, homed.fault, homed.known) == (State.FAULT, Fault.HOMING_FAILED, False)
    assert why in homed.why
    assert homed.way <= FARTHEST
    assert words == "" or f"axis 0: {words}" in run.cycle.problems
    if why == "its drive refuses":
        assert homed.way < 1e-4, "nothing has moved"
    if "instead" not in case:
        back_as_before(run)


def requested(state: int) -> Callable[[LockstepRun], object]:
    """Another tool asks for a state."""
    return lambda run: node_of(run).receive(Frame(odrive.SET_AXIS_STATE, state.to_bytes(4, "little")))


def mute(run: LockstepRun, number: int) -> None:
    """It sends its positions (0) or its heartbeats (1) no more."""
    node_of(run)._periodic[number][0] = NEVER_NS


def refuses(result: int) -> Callable[[LockstepRun], None]:
    """It does not begin, with that procedure result."""

    def tamper(run: LockstepRun) -> None:
        node_of(run)._begin = lambda: setattr(node_of(run), "_result", result)  # type: ignore[method-assign]

    return tamper


def deaf(every: int) -> Callable[[LockstepRun], None]:
    """It does not hear one in so many of what it is asked or told by endpoints."""

    def tamper(run: LockstepRun) -> None:
        node, count = node_of(run), [0]
        if "_on_sdo" in vars(node):
            return
        hear = node._on_sdo

        def hears(data: bytes) -> list[Frame]:
            count[0] += 1
            return [] if count[0] % every == 0 else hear(data)

        node._on_sdo = hears  # type: ignore[method-assign]

    return tamper


def test_what_is_lost_on_the_way_is_told_and_asked_again(tmp_path: Path) -> None:
    run, homed = homed_on(rig_of(tmp_path), tmp_path, deaf(3))
    assert homed.known, run.cycle.problems
    is_as_before(run)


ERROR, SILENT = "its drive says that its homing failed", "its drive refuses"


@pytest.mark.parametrize(
    ("tampered", "why", "words"),
    [
        (on_the_way(lambda run: run.stage.drives[0].fail()), ERROR,
         "axis error 0x20 (DRV_FAULT), axis state 1 (IDLE), procedure result 3 (DISARMED)"),
        (on_the_way(requested(1)), ERROR, "axis state 1 (IDLE), procedure result 2 (CANCELLED)"),
        (on_the_way(requested(8)), ERROR, "axis state 8 (CLOSED_LOOP_CONTROL), procedure result 0 (SUCCESS)"),
        (refuses(12), ERROR, "axis state 1 (IDLE), procedure result 12 (HOMING_WITHOUT_ENDSTOP)"),
        (refuses(0), SILENT, "it does not say that it homes; axis state 1"),
        (deaf(1), SILENT, "axis0.min_endstop.config.enabled gave no answer"),
        (on_the_way(lambda run: mute(run, 1)), SILENT, "no heartbeat for 41 ticks"),
        (on_the_way(lambda run: node_of(run)._restart()), SILENT, "homing_speed = 0.25; expected 5"),
    ],
    ids=["axis error", "idle", "another state", "refused", "never begins", "deaf", "no heartbeat", "reboot"],
)  # fmt: skip
def test_what_the_drive_says_of_its_homing_ends_it(
    tampered: Callable[[LockstepRun], None], why: str, words: str, tmp_path: Path
) -> None:
    run, homed = homed_on(rig_of(tmp_path), tmp_path, tampered)
    assert (homed.state, homed.fault, homed.known) == (State.FAULT, Fault.HOMING_FAILED, False)
    assert why in homed.why
    assert any(words in problem for problem in run.cycle.problems), run.cycle.problems
    if "heartbeat" not in words and "no answer" not in words:
        back_as_before(run)


@pytest.mark.long
def test_a_drive_that_is_blocked_pushes_with_no_more_than_home_force_until_its_time_is_over(tmp_path: Path) -> None:
    forces: list[float] = []

    def jam(run: LockstepRun) -> None:
        forces.append(abs(run.stage.drives[0].force))
        if run.true_position[0] < ABOVE - 5e-3:
            run.stage.jam(0, 50.0)

    _, homed = homed_on(rig_of(tmp_path, home={"farthest": 0.05, "latch_speed": 0.05}), tmp_path, jam)
    assert (homed.fault, homed.why) == (Fault.HOMING_FAILED, "its drive does not end its homing in time")
    assert max(forces) == pytest.approx(FORCE / GEAR, rel=1e-6)


def test_a_drive_that_is_not_enabled_again_is_a_fault(tmp_path: Path) -> None:
    def stays_idle(run: LockstepRun) -> None:
        if node_of(run).phase is Phase.TO_ENDSTOP:
            node_of(run)._enable_delay_ns = 1 << 60

    run, homed = homed_on(rig_of(tmp_path), tmp_path, stays_idle)
    assert homed.fault is Fault.HOMING_FAILED
    assert "axis 0: it does not say that it is enabled again; axis state 1" in run.cycle.problems


@pytest.mark.parametrize("command", [CommandKind.STOP, CommandKind.ESTOP])
def test_an_operator_ends_it_at_once(command: CommandKind, tmp_path: Path) -> None:
    is_as_before(stopped_by(command, rig_of(tmp_path), tmp_path))


def test_a_drive_that_is_not_put_right_is_refused_until_it_is(tmp_path: Path) -> None:
    """Its torque limit stays low: it counts as in fault, by the endpoint's name."""
    run, homed = homed_on(rig_of(tmp_path), tmp_path, on_the_way(requested(1)))
    assert homed.fault is Fault.HOMING_FAILED
    node_of(run)._instead["config.torque_soft_max"] = 0.002
    for _ in range(200):
        run.tick()
    assert any("torque_soft_max = 0.002; expected" in problem for problem in run.cycle.problems)
    assert run.cycle.inbox.samples[0].status & DriveStatus.FAULT  # type: ignore[union-attr]
    del node_of(run)._instead["config.torque_soft_max"]
    back_as_before(run)


@pytest.mark.parametrize("silent", ["its answers", "the host"])
def test_silence_ends_it(silent: str, tmp_path: Path) -> None:
    if silent == "its answers":
        _, homed = homed_on(rig_of(tmp_path), tmp_path, on_the_way(lambda run: mute(run, 0)))
        assert homed.fault in (Fault.ENCODER_LOST, Fault.ENCODER_DEAD)
        assert not homed.known
        return
    run = LockstepRun(rig_of(tmp_path), tmp_path)
    run._operator = lambda run, index: [CommandKind.HOME] if run.cycle.state is State.READY else ()
    while run.true_position[0] > ABOVE - 5e-3:
        run.tick()
    begun_ns = node_of(run).now_ns
    while run.stage.now_ns < begun_ns + 50_000_000:
        run.stage.advance(run.stage.deadline_ns)
    assert run.stage.drives[0].force == 0.0
    assert node_of(run)._state == odrive.IDLE
    assert run.stage.drives[0].trips[-1].expired_ns <= begun_ns + 12_500_000, "drives.watchdog_s, and a tick"
