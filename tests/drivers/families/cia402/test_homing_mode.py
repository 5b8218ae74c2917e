"""A bought drive that homes by itself when it is told to: bounded by way, time and torque, and back to torque mode."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from drivers.families.cia402 import cia301
from drivers.protocols.base import DriveStatus, LayoutError
from hil.cycle.axis_homing import Step as Sub
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.layout import host_layout
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from sim_plant.drives.homing_drive import HomingDrive, Phase
from tests.support.bought_drives import EDS, cia402
from tests.support.foreign_drive import CST_DRIVE, FULL_DRIVE, I8, I32, U8, U16, U32, Fact, eds_text
from tests.support.homing import (
    ABOVE,
    FARTHEST,
    FORCE,
    PLACE,
    ZERO,
    home_once,
    homed_by_drive,
    homed_on,
    reset_to_ready,
    stopped_by,
)

COUNT = 1e-7  # m
OBJECTS = {
    (0x6061, 0): Fact(I8, "ro", "1", True),
    (0x6072, 0): Fact(U16, "rw", "1000"),
    (0x607C, 0): Fact(I32),
    (0x6098, 0): Fact(I8),
    (0x6099, 0): Fact(U8, "ro", "2"),
    (0x6099, 1): Fact(U32),
    (0x6099, 2): Fact(U32),
    (0x609A, 0): Fact(U32),
    (0x60FD, 0): Fact(U32, "ro", "0", True),
}
NEGATIVE_SWITCH, INDEX_BELOW, HERE, UNKNOWN = 17, 33, 37, 99


def rig_of(
    folder: Path, method: int | None = INDEX_BELOW, *, start: float = ABOVE, mounted: int = 1, facts: Any = OBJECTS,
    home: dict[str, Any] | None = None, watch_mode: bool = False, weight: float = 0.0, switches: bool = False,
    **drive: Any,
) -> RigConfig:  # fmt: skip
    """The paper's stage on CST drives with a homing mode; X has its index and its negative switch at PLACE."""
    (folder / EDS).write_text(eds_text(CST_DRIVE | facts))
    document = cia402()
    document["bus"]["cia402"] |= {"watch_mode": watch_mode, "inputs": switches}
    document["axes"]["x"]["direction"] = mounted
    document["axes"]["x"]["limits"]["switches"] = switches
    told = {} if method is None else {"method": method, "acceleration": 2.0}
    there = {"zero": ZERO, "index": PLACE, "low": PLACE}
    return homed_by_drive(
        document, told | (home or {}), there, start=start, weight=weight, braked=weight != 0.0, **drive
    )


def node_of(run: LockstepRun) -> HomingDrive:
    node = run.stage.nodes[0]
    assert isinstance(node, HomingDrive)
    return node


@pytest.mark.parametrize("watch_mode", [False, True])
@pytest.mark.parametrize(("method", "within"), [(INDEX_BELOW, 1.001 * COUNT), (NEGATIVE_SWITCH, 50e-6)])
def test_the_drive_homes_and_comes_back(method: int, within: float, watch_mode: bool, tmp_path: Path) -> None:
    forces: list[float] = []
    run, homed = homed_on(
        rig_of(tmp_path, method, watch_mode=watch_mode), tmp_path,
        lambda run: forces.append(abs(run.stage.drives[0].force)) if node_of(run).phase is not Phase.IDLE else None,
    )  # fmt: skip
    assert (homed.state, homed.fault, homed.known) == (State.READY, Fault.NONE, True), homed.why
    assert homed.steps == [Sub.SEARCH, Sub.MOVE_TO]
    assert abs(run.cycle.inputs[0].position - run.true_position[0]) <= within
    assert homed.way < FARTHEST
    assert max(forces) <= FORCE, "6072h"
    dictionary = node_of(run).dictionary
    assert dictionary.number(cia301.MODE << 8) == cia301.TORQUE_MODE
    assert dictionary.number(cia301.TORQUE_MAX << 8) == 1000, "as it was"
    written = [dictionary.number(key) for key in (0x609800, 0x609901, 0x609902, 0x609A00)]
    assert written == [method, 500_000, 200_000, 20_000_000]


def test_a_drive_that_counts_anew_only_as_it_comes_back_is_followed(tmp_path: Path) -> None:
    """At home its counts go on; they begin anew once it is back in torque mode, and yet to be told 6072h."""
    modes: list[int] = []

    def late(run: LockstepRun) -> None:
        node, counter = node_of(run), run.stage.drives[0].counter
        assert counter is not None
        node._is_home = lambda _: setattr(node, "phase", Phase.HALT)  # type: ignore[method-assign]
        modes.append(node.dictionary.number(cia301.MODE << 8))
        if modes[-1] == cia301.TORQUE_MODE and cia301.HOMING_MODE in modes:
            counter.zero = PLACE

    _, homed = homed_on(rig_of(tmp_path), tmp_path, late)
    assert (homed.fault, homed.known) == (Fault.NONE, True), homed.why
    assert abs(homed.off) <= 1.001 * COUNT


def test_a_limit_switch_that_the_drive_homes_on_is_no_fault(tmp_path: Path) -> None:
    _, homed = homed_on(rig_of(tmp_path, NEGATIVE_SWITCH, switches=True), tmp_path)
    assert (homed.fault, homed.known) == (Fault.NONE, True), homed.why


def test_drives_that_share_their_commands_home_as_well(tmp_path: Path) -> None:
    rig = rig_of(tmp_path)
    (tmp_path / EDS).write_text(eds_text(FULL_DRIVE | OBJECTS, (3, 6)))
    run, homed = homed_on(rig, tmp_path)
    assert run.cycle.protocol.master._word_ids is not None  # type: ignore[attr-defined]
    assert (homed.state, homed.known) == (State.READY, True), homed.why
    assert abs(homed.off) <= 1.001 * COUNT


@pytest.mark.parametrize("shown", [Phase.DONE, Phase.FAILED])
def test_a_drive_that_shows_an_earlier_homing_homes_anew(shown: Phase, tmp_path: Path) -> None:
    def shows(run: LockstepRun) -> None:
        if node_of(run).phase is Phase.IDLE:
            node_of(run).phase = shown

    _, homed = homed_on(rig_of(tmp_path), tmp_path, shows)
    assert homed.known, homed.why
    assert abs(homed.off) <= 1.001 * COUNT


@pytest.mark.long
def test_after_homing_the_axis_is_held_and_a_task_begins(tmp_path: Path) -> None:
    run, homed = homed_on(rig_of(tmp_path), tmp_path)
    assert homed.known
    run._operator = lambda run, index: [CommandKind.ACTIVATE_HOLD] if run.activated_at < 0 else ()
    for _ in range(300):
        run.tick()
    assert (run.cycle.state, run.cycle.fault) == (State.ACTIVE, Fault.NONE)
    assert run.cycle.inputs[0].position == pytest.approx(run.true_position[0], abs=2e-6)


def test_a_weight_is_held_from_hand_to_hand(tmp_path: Path) -> None:
    """Beyond what friction holds: neither side lets it fall while the drive changes its mode."""
    places: list[list[float]] = []
    rig = rig_of(tmp_path, weight=-2.0, home={"force": 4.5})
    run, homed = home_once(rig, tmp_path, places=places)
    assert homed.known, homed.why
    steps = [abs(b[0] - a[0]) for a, b in pairwise(places)]
    assert max(steps) < 2.0 * 0.05 * 1e-3, "no faster than twice the search, ever"
    assert run.cycle.inputs[0].position == pytest.approx(run.true_position[0], abs=2e-6)


@pytest.mark.long
def test_where_it_is_wanted_it_goes_under_torque_of_the_host(tmp_path: Path) -> None:
    run, homed = homed_on(rig_of(tmp_path, home={"move_to": PLACE + 0.01}), tmp_path)
    assert homed.known, homed.why
    assert run.true_position[0] == pytest.approx(PLACE + 0.01, abs=2e-3)


def test_here_moves_nothing(tmp_path: Path) -> None:
    run, homed = homed_on(rig_of(tmp_path, HERE), tmp_path)
    assert homed.known, homed.why
    assert homed.way < 1e-5
    assert run.cycle.inputs[0].position == pytest.approx(PLACE, abs=1e-5)


# what ends it ---------------------------------------------------------------------------------------------------------


def back_in_torque_mode(run: LockstepRun) -> None:
    """The drive is told to come back, and a reset leads to READY."""
    reset_to_ready(run)
    dictionary = node_of(run).dictionary
    assert dictionary.number(cia301.MODE << 8) == cia301.TORQUE_MODE
    assert dictionary.number(cia301.TORQUE_MAX << 8) == 1000


@pytest.mark.requirement(id="SR-4.5")
@pytest.mark.parametrize(
    ("case", "why"),
    [
        ({"method": UNKNOWN}, "its drive says that its homing failed"),
        ({"start": PLACE - 0.01, "home": {"farthest": 0.03}}, "not found within home.farthest"),
        ({"home": {"farthest": 0.01}}, "not found within home.farthest"),
        ({"aborts": ["6098h"]}, "its drive refuses"),
        ({"instead": {"6072h": 1000}}, "its drive refuses"),
        ({"instead": {"6061h": 10}}, "its drive refuses"),
    ],
    ids=["homing error", "wrong direction", "too far", "no method", "torque not kept", "mode not taken"],
)
def test_a_homing_that_does_not_end_well_is_a_fault_without_torque(
    case: dict[str, Any], why: str, tmp_path: Path
) -> None:
    run, homed = homed_on(rig_of(tmp_path, **case), tmp_path)
    assert (homed.state, homed.fault, homed.known) == (State.FAULT, Fault.HOMING_FAILED, False)
    assert why in homed.why
    assert homed.way <= FARTHEST
    if "instead" not in case:
        back_in_torque_mode(run)


def test_a_drive_that_is_blocked_says_so(tmp_path: Path) -> None:
    def jam(run: LockstepRun) -> None:
        if run.true_position[0] < ABOVE - 5e-3:
            run.stage.jam(0, 50.0)

    run, homed = homed_on(rig_of(tmp_path), tmp_path, jam)
    assert (homed.fault, homed.why) == (Fault.HOMING_FAILED, "its drive says that its homing failed")
    assert any("homing error, bit 13" in problem for problem in run.cycle.problems)


def test_a_drive_that_does_not_come_back_is_refused(tmp_path: Path) -> None:
    def refuses(run: LockstepRun) -> None:
        if node_of(run).phase is Phase.HALT:
            node_of(run).dictionary._aborts = {cia301.MODE << 8: 0x08000000}

    run, homed = homed_on(rig_of(tmp_path), tmp_path, refuses)
    assert homed.fault in (Fault.HOMING_FAILED, Fault.DRIVE_FAULT)
    assert not homed.known
    for _ in range(10):
        run.tick()
    assert any("6060h:00 aborted with 0x08000000" in problem for problem in run.cycle.problems)
    assert run.cycle.inbox.samples[0].status & DriveStatus.FAULT  # type: ignore[union-attr]


@pytest.mark.long
def test_a_drive_that_never_ends_it_is_stopped_in_time(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, home={"farthest": 0.05, "latch_speed": 0.05})

    def stands(run: LockstepRun) -> None:
        if node_of(run).phase is Phase.TO_INDEX:
            node_of(run).dictionary.set(0x609902, 0)

    _, homed = homed_on(rig, tmp_path, stands)
    assert (homed.fault, homed.why) == (Fault.HOMING_FAILED, "its drive does not end its homing in time")


@pytest.mark.parametrize("command", [CommandKind.STOP, CommandKind.ESTOP])
def test_an_operator_ends_it_at_once(command: CommandKind, tmp_path: Path) -> None:
    run = stopped_by(command, rig_of(tmp_path), tmp_path)
    if command is CommandKind.ESTOP:
        back_in_torque_mode(run)
    assert node_of(run).dictionary.number(cia301.MODE << 8) == cia301.TORQUE_MODE


@pytest.mark.parametrize("silent", ["its answers", "the host"])
def test_silence_ends_it(silent: str, tmp_path: Path) -> None:
    def fall_silent(run: LockstepRun) -> None:
        if run.true_position[0] < ABOVE - 5e-3:
            node_of(run)._tpdos[0].can_id = -1

    if silent == "its answers":
        run, homed = homed_on(rig_of(tmp_path), tmp_path, fall_silent)
        assert homed.fault in (Fault.ENCODER_LOST, Fault.ENCODER_DEAD)
        assert not homed.known
        return
    run = LockstepRun(rig_of(tmp_path), tmp_path)
    run._operator = lambda run, index: [CommandKind.HOME] if run.cycle.state is State.READY else ()
    while run.true_position[0] > ABOVE - 5e-3:
        run.tick()
    until_ns = node_of(run).now_ns + 1_000_000_000
    run.stage.advance(until_ns)
    assert run.stage.drives[0].force == 0.0
    assert node_of(run).state is not cia301.DriveState.OPERATION_ENABLED


def test_a_drive_that_boots_on_the_way_is_configured_anew(tmp_path: Path) -> None:
    def reboot(run: LockstepRun) -> None:
        if run.true_position[0] < ABOVE - 5e-3:
            node_of(run)._boot()

    run, homed = homed_on(rig_of(tmp_path), tmp_path, reboot)
    assert (homed.state, homed.known) == (State.FAULT, False)
    back_in_torque_mode(run)


# the rig --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("missing", "says"),
    [
        ((0x6072, 0), "6072h:00 is not in the EDS, or cannot be written and read back"),
        ((0x6098, 0), "6098h:00 is not in the EDS"),
        ((0x6099, 2), "6099h:02 is not in the EDS"),
    ],
)
def test_a_drive_that_cannot_be_bounded_is_refused(missing: tuple[int, int], says: str, tmp_path: Path) -> None:
    facts = {place: fact for place, fact in OBJECTS.items() if place != missing}
    with pytest.raises(LayoutError) as refused:
        host_layout(rig_of(tmp_path, facts=facts), tmp_path)
    assert f"axes.x.home.method: {says}" in str(refused.value)


@pytest.mark.parametrize(
    ("facts", "says"),
    [
        ({(0x6072, 0): Fact(U16, "wo")}, "6072h:00 is not in the EDS, or cannot be written and read back"),
        ({(0x1016, 1): Fact(U32, "ro")}, "1016h:01 is not in the EDS, or cannot be written and read back"),
        ({(0x6502, 0): Fact(U32, "ro", "0x200")}, "6502h is 0x200: its drive offers no homing mode"),
    ],
)
def test_what_the_file_says_decides(facts: dict[tuple[int, int], Fact], says: str, tmp_path: Path) -> None:
    with pytest.raises(LayoutError) as refused:
        host_layout(rig_of(tmp_path, facts=OBJECTS | facts), tmp_path)
    assert says in str(refused.value)


def test_without_a_method_the_drive_has_to_say_that_it_is_homed(tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match="no bit for HOMED"):
        host_layout(rig_of(tmp_path, None), tmp_path)


def test_axes_that_their_drives_move_home_alone(tmp_path: Path) -> None:
    rig = rig_of(tmp_path).model_dump(mode="json", exclude_defaults=True)
    rig["axes"]["y"]["home"] = {"by": "here"}
    with pytest.raises(ValueError, match="no other axis may have that number"):
        RigConfig.model_validate(rig)
    rig["axes"]["y"]["home"]["order"] = 1
    assert RigConfig.model_validate(rig).axes["x"].home is not None
