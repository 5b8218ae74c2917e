"""A rig's life in exact virtual time: how it starts, follows, stops, faults, and comes back."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from drivers.protocols.base import DriveStatus
from drivers.wire.faults import FaultKind, WireFault
from hil.cycle.fault_table import Fault
from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.virtual.invariants import Invariants
from hil.virtual.lockstep import LockstepRun
from hil.virtual.sim import simulate
from tests.support.paths import RIGS

MakeRun = Callable[..., LockstepRun]


def paper_rig(*overrides: str) -> RigConfig:
    return load_rig(RIGS / "paper.toml", overrides)


def run_until(run: LockstepRun, state: State, limit: int = 400) -> LockstepRun:
    for _ in range(limit):
        run.tick()
        if run.cycle.state is state:
            return run
    raise AssertionError(f"not {state.name} after {limit} ticks, but {run.cycle.state.name}, {run.cycle.fault.name}")


def ticks(run: LockstepRun, count: int) -> LockstepRun:
    for _ in range(count):
        run.tick()
    return run


def commands(plan: dict[int, CommandKind]) -> Callable[[LockstepRun, int], Sequence[CommandKind]]:
    return lambda run, index: (plan[index],) if index in plan else ()


def test_a_rig_comes_up_to_ready_by_itself_and_never_further(lockstep: MakeRun, paper: RigConfig) -> None:
    run = lockstep(paper, operator=commands({}))
    run.tick()
    assert run.cycle.state is State.CONNECTED
    run_until(run, State.READY)
    ticks(run, 200)
    assert run.cycle.state is State.READY
    assert run.stage.applied_force == [0.0, 0.0]


def test_activation_starts_at_rest_where_the_axes_are(lockstep: MakeRun) -> None:
    run = lockstep(paper_rig("plant.initial_position=[0.01, -0.02]"))
    run_until(run, State.ACTIVE)
    assert [x.start.position for x in run.cycle.inputs] == pytest.approx([0.01, -0.02], abs=1e-7)
    ticks(run, 50)
    assert np.abs(run.stage.position - [0.01, -0.02]).max() < 1e-3  # the approach begins gently


@pytest.mark.long
def test_the_circle_is_followed_to_a_micrometre_where_nominal_model_and_plant_agree(paper: RigConfig) -> None:
    report, _ = simulate(paper, RIGS, 10.0, observer=Invariants(paper, RIGS).observe)
    assert report.state == "ACTIVE"
    assert not report.faults
    for axis in report.axes.values():
        assert axis["max_error"] < 1.0e-6


@pytest.mark.long
def test_a_modelling_error_leaves_a_plateau_of_delta_over_kp() -> None:
    rig = paper_rig("plant.modelling_error=0.3")
    report, _ = simulate(rig, RIGS, 10.0, observer=Invariants(rig, RIGS).observe)
    for axis, kp in zip(report.axes.values(), rig.law.effective_gains()["kp"], strict=True):
        assert axis["plateau_error"] == pytest.approx(0.3 / kp, rel=0.05)


@pytest.mark.long
def test_four_axes_follow_the_injection_plan_with_a_nominal_model_off_by_some_per_cent(
    ideal_microscope: RigConfig, lockstep: MakeRun
) -> None:
    run = lockstep(ideal_microscope)
    run_until(run, State.ACTIVE)
    ticks(run, 6500)
    assert run.cycle.state is State.ACTIVE
    assert not any(run.cycle.monitor.counts)
    assert run.stage.pierced.tolist()[2] == 1.0


def test_the_brake_holds_z_until_torque_does(ideal_microscope: RigConfig, lockstep: MakeRun) -> None:
    run = lockstep(ideal_microscope, operator=commands({100: CommandKind.ACTIVATE, 400: CommandKind.STOP}))
    ticks(run, 100)
    assert run.stage.position[2] == 0.0
    ticks(run, 300)
    fallen = run.stage.position[2]
    assert abs(fallen) < 1e-3
    ticks(run, 200)
    assert run.cycle.state is State.READY
    assert run.stage.velocity[2] == 0.0


OPENING = 40  # ticks


@pytest.fixture
def slow_brake() -> RigConfig:
    return load_rig(RIGS / "microscope-ideal.toml", [f"drives.brake_opening_s={OPENING}e-3"])


def test_the_law_takes_over_as_the_brake_opens_and_nothing_moves_before(
    slow_brake: RigConfig, lockstep: MakeRun
) -> None:
    run = run_until(lockstep(slow_brake), State.ACTIVE)
    goals, weights = run.cycle.supervisor.goals, [0.0, 0.0, 2.45, 0.0]
    for _ in range(OPENING):
        assert run.cycle.gate.force == weights
        assert goals.word is MotionWord.NONE
        assert run.cycle.setpoints.trajectory is None
        assert run.stage.position.tolist() == [0.0] * 4
        assert run.stage.drives[2].status & DriveStatus.BRAKE
        run.tick()
    run.tick()
    assert not run.stage.drives[2].status & DriveStatus.BRAKE
    assert goals.word is MotionWord.TASK
    assert run.cycle.setpoints.task_ns < 1_000_000
    ticks(run, 300)
    assert run.cycle.state is State.ACTIVE
    assert not any(run.cycle.monitor.counts)


@pytest.mark.parametrize(
    ("kind", "state"), [(CommandKind.STOP, State.READY), (CommandKind.ESTOP, State.ESTOP)], ids=["stop", "estop"]
)
@pytest.mark.parametrize("after", [1, 20, OPENING, OPENING + 2])
def test_a_stop_while_the_brake_opens_ends_with_it_closed(
    slow_brake: RigConfig, lockstep: MakeRun, kind: CommandKind, state: State, after: int
) -> None:
    run = lockstep(slow_brake, operator=commands({100: CommandKind.ACTIVATE, 100 + after: kind, 300: kind}))
    ticks(run, 200)
    assert run.cycle.state is state
    assert run.stage.drives[2].status & DriveStatus.BRAKE
    assert run.stage.applied_force == [0.0] * 4
    assert abs(run.stage.position[2]) < 1e-5


def test_a_fault_while_the_brake_opens_ends_with_it_closed(slow_brake: RigConfig, lockstep: MakeRun) -> None:
    run = run_until(lockstep(slow_brake), State.ACTIVE)
    ticks(run, OPENING // 2)
    run.stage.drives[0].fail()
    ticks(run, 2)
    assert (run.cycle.state, run.cycle.fault) == (State.FAULT, Fault.DRIVE_FAULT)
    ticks(run, 200)
    assert run.stage.drives[2].status & DriveStatus.BRAKE
    assert run.stage.position[2] == 0.0


def test_without_a_brake_nothing_waits_for_it(slow_brake: RigConfig) -> None:
    free = slow_brake.model_copy(update={"drives": slow_brake.drives.model_copy(update={"brake": False})})
    assert (slow_brake.opening_ticks, free.opening_ticks) == (OPENING, 0)


@pytest.mark.requirement(id="SR-2.2")
def test_stop_is_damped_and_over_within_fifty_milliseconds(lockstep: MakeRun, paper: RigConfig) -> None:
    run = lockstep(paper, operator=commands({100: CommandKind.ACTIVATE, 3000: CommandKind.STOP}))
    ticks(run, 3000)
    assert np.abs(run.stage.velocity).max() > 1.0
    run.tick()
    assert run.cycle.state is State.STOPPING
    run_until(run, State.READY, limit=51)
    assert run.stage.applied_force == [0.0, 0.0]
    assert np.abs(run.stage.velocity).max() < 0.05


def test_home_moves_the_axes_home_and_leads_back_to_ready(lockstep: MakeRun) -> None:
    rig = paper_rig("plant.initial_position=0.05")
    run = lockstep(rig, operator=commands({100: CommandKind.HOME}))
    ticks(run, 101)
    assert run.cycle.state is State.HOMING
    run_until(run, State.READY, limit=2000)
    assert np.abs(run.stage.position).max() < 5e-5


def test_exit_stops_the_axes_says_zero_last_and_then_nothing(lockstep: MakeRun, paper: RigConfig) -> None:
    run = lockstep(paper)
    ticks(run, 3000)
    run.stop = True
    sent = [run.tick().frames for _ in range(100)]
    assert run.cycle.state is State.SHUTDOWN
    last = [index for index, frames in enumerate(sent) if frames][-1]
    assert last <= 51
    assert not any(sent[last + 1 :])
    assert run.stage.applied_force == [0.0, 0.0]


@pytest.mark.requirement(id="SR-3.1")
def test_silent_drives_stop_the_run_and_a_reset_never_leads_to_active(lockstep: MakeRun, paper: RigConfig) -> None:
    cut = WireFault(kind=FaultKind.DROP, from_ns=1_000_000_000, until_ns=1_100_000_000)
    run = lockstep(paper, wire_faults=[cut], operator=commands({100: CommandKind.ACTIVATE, 1300: CommandKind.RESET}))
    ticks(run, 1200)
    assert run.cycle.state is State.FAULT
    assert run.cycle.fault is Fault.ENCODER_LOST
    assert run.stage.applied_force == [0.0, 0.0]
    ticks(run, 101)
    assert run.cycle.state is State.CONNECTED
    run_until(run, State.READY)
    ticks(run, 100)
    assert run.cycle.state is State.READY


@pytest.mark.requirement(id="SR-5.1")
def test_a_reset_is_refused_while_the_cause_lasts(lockstep: MakeRun, paper: RigConfig) -> None:
    down = WireFault(kind=FaultKind.DOWN, node="host", from_ns=500_000_000, until_ns=900_000_000)
    plan = {100: CommandKind.ACTIVATE, 700: CommandKind.RESET, 1000: CommandKind.RESET}
    run = lockstep(paper, wire_faults=[down], operator=commands(plan))
    ticks(run, 800)
    assert run.cycle.state is State.FAULT
    assert run.cycle.fault is Fault.INTERFACE_DOWN
    assert run.cycle.commands.refused == 1
    ticks(run, 250)
    assert run.cycle.state in (State.CONNECTED, State.READY)


@pytest.mark.requirement(id="SR-3.1")
def test_one_lost_answer_is_bridged_without_a_trace_in_the_position(lockstep: MakeRun, paper: RigConfig) -> None:
    lost = WireFault(kind=FaultKind.DROP, can_id=0x100, from_ns=5_000_000_000, count=1)
    run = lockstep(paper, wire_faults=[lost])
    ticks(run, 5200)
    assert run.cycle.state is State.ACTIVE
    assert run.cycle.monitor.counts[Fault.ENCODER_GAP] == 1
    assert abs(float(run.cycle.inputs[0].sample.position - run.true_position[0])) < 2e-6


@pytest.mark.requirement(id="SR-7.1")
@pytest.mark.parametrize("skipped", [1, 2, 5])
def test_the_filter_stays_with_the_axes_when_slots_are_skipped_all_the_time(lockstep: MakeRun, skipped: int) -> None:
    changes = ["rate_hz=50", "drives.watchdog_s=1.0", "safety.silent_zero_ticks=100"]
    rig = load_rig(RIGS / "microscope-ideal.toml", changes)
    run = lockstep(rig, operator=commands({}))
    run_until(run, State.READY)
    for _ in range(300):
        run.tick()
        run.skip(skipped)
    assert max(abs(f.position - q) for f, q in zip(run.cycle.filters, run.true_position, strict=True)) < 1e-6
    assert max(abs(f.velocity) for f in run.cycle.filters) < 1e-3


def test_an_expired_or_replayed_command_is_refused_but_an_emergency_stop_never(
    lockstep: MakeRun, paper: RigConfig
) -> None:
    def replayed(run: LockstepRun, index: int) -> Sequence[CommandKind]:
        if index == 99:
            run._command_sequence = 0  # numbers the cycle has seen already
        return {50: (CommandKind.HEARTBEAT,), 100: (CommandKind.ACTIVATE,), 200: (CommandKind.ESTOP,)}.get(index, ())

    run = lockstep(paper, operator=replayed)
    ticks(run, 150)
    assert run.cycle.state is State.READY
    assert run.cycle.commands.refused == 1
    ticks(run, 100)
    assert run.cycle.state is State.ESTOP


def test_a_run_that_ends_in_fault_says_for_what_also_where_a_law_lost_its_numbers() -> None:
    rig = load_rig(RIGS / "paper.toml", ["law.name=structured-kalman", "law.gains.mass_noise=1e300"])
    with np.errstate(all="ignore"):
        report, _ = simulate(rig, RIGS, 0.2)
    assert (report.state, report.faults) == ("FAULT", {"not_finite": 1})
