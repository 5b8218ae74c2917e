"""An axis that moves without torque: named soon, in every state that should rest, and never where it does rest."""

from collections.abc import Iterable

import pytest

from hil.cycle.fault_table import Fault
from hil.cycle.limits import axis_limits
from hil.cycle.rest_watch import ENTRY_TICKS, RestWatch
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS

WINDOW, JUMP, PERIOD = 3e-5, 1.5e-4, 1e-3
NOISE = (2.0, -1.0, 0.5, 1.0, 1.5, -3.0, 4.0, -4.0)  # m


class Told(LockstepRun):
    """A run whose operator says what the test says."""

    def __init__(self, *overrides: str, rig: str = "microscope-ideal.toml") -> None:
        self.says: list[CommandKind] = []
        super().__init__(load_rig(RIGS / rig, overrides), RIGS, operator=lambda run, index: self._said())

    def _said(self) -> list[CommandKind]:
        said, self.says = self.says, []
        return said

    def go(self, ticks: int, *said: CommandKind) -> "Told":
        self.says = list(said)
        for _ in range(ticks):
            self.tick()
        return self

    def until(self, state: State, most: int = 3000) -> "Told":
        while self.cycle.state is not state:
            self.tick()
            assert self.index < most, self.cycle.state
        return self

    def rests_in(self, state: State) -> "Told":
        self.until(State.READY)
        return self if state is State.READY else self.go(2, CommandKind.ESTOP)

    def named_after(self, axis: int) -> tuple[int, float]:
        """Ticks until STANDSTILL, and how far the axis had gone, m (rad)."""
        begin = float(self.true_position[axis])
        for count in range(400):
            self.tick()
            if self.cycle.fault is not Fault.NONE:
                assert self.cycle.fault is Fault.STANDSTILL
                return count, abs(float(self.true_position[axis]) - begin)
        raise AssertionError("it moved unseen")


@pytest.mark.requirement(id="SR-5.2")
@pytest.mark.parametrize("state", [State.READY, State.ESTOP])
@pytest.mark.parametrize(
    ("axis", "force", "overrides"),
    [(0, -3.0, ()), (0, 1.2, ()), (1, 12.0, ()), (2, 0.0, ("plant.brake_force=1e-9",)), (2, 130.0, ())],
)
def test_an_axis_that_moves_is_named_within_a_tenth_of_a_millimetre_or_five_ticks(
    state: State, axis: int, force: float, overrides: tuple[str, ...]
) -> None:
    run = Told(*overrides).rests_in(state)
    if force:
        run.stage.push(axis, force)
    ticks, distance = run.named_after(axis)
    assert ticks <= 5 or distance <= 1e-4
    assert run.cycle.state is (State.FAULT if state is State.READY else State.ESTOP)
    assert run.go(5, CommandKind.RESET).cycle.state is not State.CONNECTED, "it moves"


@pytest.mark.requirement(id="SR-5.2")
def test_where_it_rests_again_reset_and_activate_are_taken() -> None:
    run = Told().rests_in(State.READY)
    run.stage.push(0, -3.0)
    run.named_after(0)
    run.stage.push(0, 0.0)
    for _ in range(200):
        if run.go(1, CommandKind.RESET).cycle.state is State.CONNECTED:
            break
    assert run.cycle.state is State.CONNECTED
    assert abs(float(run.true_velocity[0])) < 1e-6
    run.until(State.READY)
    assert run.go(2, CommandKind.ACTIVATE).cycle.state is State.ACTIVE


@pytest.mark.requirement(id="SR-5.2")
def test_before_ready_it_is_an_event_and_no_fault() -> None:
    run = Told("safety.ready_ticks=400")
    run.go(20)
    run.stage.push(0, -1.2)
    run.go(40)
    assert run.cycle.monitor.counts[Fault.AXIS_MOVED]
    assert (run.cycle.state, run.cycle.fault) == (State.CONNECTED, Fault.NONE)


@pytest.mark.long
@pytest.mark.parametrize("rig", ["paper.toml", "microscope-ideal.toml", "microscope.toml"])
@pytest.mark.parametrize("end", [CommandKind.ESTOP, CommandKind.STOP])
def test_an_axis_that_coasts_to_rest_behind_a_run_is_no_fault(rig: str, end: CommandKind) -> None:
    run = Told(rig=rig).until(State.READY)
    run.go(900, CommandKind.ACTIVATE)
    assert run.cycle.state is State.ACTIVE
    run.go(700, end)
    assert run.cycle.monitor.counts[Fault.STANDSTILL] == 0
    assert run.cycle.fault is Fault.NONE
    assert not any(watch.moving for watch in run.cycle.monitor.rest)


def test_an_axis_that_falls_behind_a_run_is_named() -> None:
    run = Told().until(State.READY).go(300, CommandKind.ACTIVATE)
    run.go(1, CommandKind.ESTOP)
    run.stage.push(2, -120.0)
    ticks, _ = run.named_after(2)
    assert ticks <= ENTRY_TICKS + 3


def test_drift_of_heat_is_followed_and_one_glitch_is_no_motion() -> None:
    watch, place = RestWatch(WINDOW, JUMP, 0.2, PERIOD), 0.0
    for tick in range(250_000):
        place += 0.5 * WINDOW * PERIOD / 100.0
        watch.take(place + (3 * WINDOW if tick % 3 == 1 else 0.0))
        assert not watch.moving
    assert place > 1.2 * WINDOW


def test_two_samples_outside_are_motion_and_it_ends_after_fifty_ticks_inside() -> None:
    watch, out = RestWatch(WINDOW, JUMP, 0.2, PERIOD), 1.01 * WINDOW
    shown = []
    for place in (0.0, out, 0.0, out, out, *[out] * 60):
        watch.take(place)
        shown.append(watch.moving)
    assert shown == [False] * 4 + [True] * 50 + [False] * 11
    assert watch.distance == pytest.approx(0.0)
    assert not watch.allowed


def test_an_encoder_that_jumps_does_not_move_its_axis() -> None:
    watch = RestWatch(WINDOW, JUMP, 0.2, PERIOD)
    for place in (0.0, 0.0, 3.0, 3.0, 3.0, -1.0, -1.0, *NOISE):
        watch.take(place)
        assert not watch.moving


def test_noise_of_its_encoder_makes_no_coasting_axis_faster() -> None:
    assert coasts([*(tick * WINDOW for tick in range(20)), *NOISE]).allowed


def test_while_its_encoder_leaps_no_axis_is_called_at_rest() -> None:
    watch = RestWatch(WINDOW, JUMP, 0.2, PERIOD)
    shown = []
    for place in (0.0, 3.0, 3.0, 1.0, 5.0, *[5.0] * 60):
        watch.take(place)
        shown.append(watch.restless)
    assert shown == [False] * 4 + [True] * 50 + [False] * 11, "one step is none"


def test_an_axis_that_coasts_fast_from_the_start_is_no_fault() -> None:
    assert coasts(2.0 * JUMP * tick for tick in range(30)).allowed


def test_leaps_that_go_on_in_one_direction_are_the_axis() -> None:
    watch = RestWatch(WINDOW, JUMP, 0.2, PERIOD)
    shown = []
    for tick in range(7):
        watch.take(1.1 * JUMP * tick)
        shown.append(watch.moving)
    assert shown == [False] * 4 + [True] * 3


def coasts(places: Iterable[float], skipped: int = 0) -> RestWatch:
    """An axis behind a run; before its last sample so many ticks are skipped."""
    watch, shown = RestWatch(WINDOW, JUMP, 1.0, PERIOD), list(places)
    watch.restart(coasting=True)
    for place in shown[:-1]:
        watch.take(place)
    watch.pass_ticks(skipped)
    watch.take(shown[-1])
    return watch


def test_neither_lost_ticks_nor_a_step_of_its_encoder_make_a_coasting_axis_faster() -> None:
    steady = [tick * WINDOW for tick in range(20)]
    assert coasts([*steady, 25 * WINDOW, 26 * WINDOW], skipped=0).allowed, "one fast step"
    assert coasts([*steady, 25 * WINDOW], skipped=5).allowed
    assert coasts([*steady, 3.0, 3.0 + WINDOW, 22 * WINDOW, 23 * WINDOW]).allowed, "3 m forth and back"
    assert not coasts([*steady, 22 * WINDOW, 26 * WINDOW]).allowed, "it gets faster"


def test_a_drive_that_falls_silent_does_not_keep_its_axis_moving_for_ever() -> None:
    watch = RestWatch(WINDOW, JUMP, 0.2, PERIOD)
    for place in (0.0, 1e-4, 1.2e-4):
        watch.take(place)
    assert watch.moving
    for _ in range(60):
        watch.pass_ticks(1)
    assert not watch.moving


def test_the_window_is_the_rigs_or_follows_from_its_encoder() -> None:
    plain = axis_limits(load_rig(RIGS / "microscope-ideal.toml"))
    assert [limits.rest_window for limits in plain] == pytest.approx([3e-5 + 2e-8] * 3 + [3e-4 + 2e-8])
    stated = axis_limits(load_rig(RIGS / "microscope-ideal.toml", ["axes.x.limits.standstill=2e-4"]))
    assert stated[0].rest_window == 2e-4
