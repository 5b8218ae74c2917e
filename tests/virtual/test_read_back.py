"""A drive that acknowledges and does otherwise: no rig with it gets READY, and the difference is told."""

from typing import Any

import pytest

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import EDS
from drivers.frame import Frame
from drivers.protocols.base import DriveStatus
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.studies.fault_campaign.checkpoints import CampaignRun
from sim_plant.drives.object_dictionary import key_of
from sim_plant.drives.vesc import Vesc
from tests.support.paths import RIGS

pytestmark = pytest.mark.long

CIA402 = ("bus.protocol=cia402", "plant.drive.kind=cia402")
Case = tuple[str, tuple[str, ...], str, float, str]
CASES: dict[str, Case] = {
    "cia402, mode": ("microscope-ideal", CIA402, "6061h", 8, "6061h = 0x8; expected 0xa"),
    "cia402, limit": ("microscope-ideal", CIA402, "6072h", 1, "6072h = 0x1; expected 0x"),
    "odrive, mode": ("odrive", (), "controller.config.control_mode", 3, "Control_Mode = 3; expected 1"),
    "odrive, limit": ("odrive", (), "config.torque_soft_max", 0.001, "Torque_Soft_Max = 0.001; expected 0.007957 to"),
    "odrive, watchdog": ("odrive", (), "config.enable_watchdog", 0, "Enable_Watchdog = 0; expected 1"),
    "vesc, current": ("vesc", (), "l_current_max", 0.1, "l_current_max = 0.1; expected 0.1592 to 0.161"),
    "vesc, current back": ("vesc", (), "l_current_min", -1.0, "l_current_min = -1; expected -0.161 to -0.1592"),
    "vesc, timeout": ("vesc", (), "timeout_msec", 1000, "timeout_msec = 1000; expected 10"),
    "vesc, no timeout": ("vesc", (), "timeout_msec", 0, "timeout_msec = 0; expected 10"),
    "vesc, firmware": (
        "vesc",
        (),
        "mcconf_signature",
        1470992211,
        "motor configuration = 1470992211; expected 788332866",
    ),
    "moteus, loop": ("moteus", (), "kp_scale", 1, "kp_scale = 1; expected 0"),
    "moteus, watchdog": ("moteus", (), "watchdog_timeout", 0.5, "watchdog_timeout = 0.5; expected 0.00999"),
}


def run_of(rig: str, overrides: tuple[str, ...], **instead: float) -> CampaignRun:
    path = RIGS / f"{rig}.toml"
    stated = [f"plant.drive.instead={{'{name}'={value!r}}}" for name, value in instead.items()]
    return CampaignRun(load_rig(path, [*overrides, *stated]), path.parent)


def to_ready(run: CampaignRun, ticks: int) -> bool:
    for _ in range(ticks):
        run.tick()
        if run.cycle.state is State.READY:
            return True
    return False


@pytest.mark.requirement(id="SR-5.6")
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_the_rig_never_gets_ready_and_the_difference_is_told(case: Case) -> None:
    rig, overrides, name, value, told = case
    run = run_of(rig, overrides, **{name: value})
    assert not to_ready(run, 1000 if rig == "microscope-ideal" else 250)
    assert run.cycle.state is State.CONNECTED
    assert len(run.cycle.problems) == len(run.rig.axes)
    assert all(told in problem for problem in run.cycle.problems)


@pytest.mark.parametrize(("rig", "within_s"), [("cia402", 0.8), ("odrive", 0.16), ("vesc", 0.16), ("moteus", 0.03)])
def test_one_that_does_as_it_is_told_is_ready_soon(rig: str, within_s: float) -> None:
    run = run_of("microscope-ideal", CIA402) if rig == "cia402" else run_of(rig, ())
    assert to_ready(run, round(within_s * run.rig.rate_hz))
    assert run.cycle.problems == []


FORGOTTEN: dict[str, tuple[str, Any, float]] = {
    "odrive": ("controller.config.control_mode", "Control_Mode = 3; expected 1", 3),
    "moteus": ("kp_scale", "kp_scale = 1; expected 0", 1),
    "vesc": ("timeout_msec", "timeout_msec = 500; expected 10", 500),
}


def forget(run: CampaignRun, name: str, value: float) -> None:
    """From the next write on the first axis' drive has another value."""
    node: Any = run.stage.nodes[0]
    if isinstance(node, Vesc):
        node.configure({name: value})
        return
    node._instead[{"kp_scale": 0x23}.get(name, name)] = value


@pytest.mark.parametrize("rig", FORGOTTEN)
def test_after_a_reset_it_is_read_back_again(rig: str) -> None:
    run = run_of(rig, ())
    assert to_ready(run, 200)
    if rig == "vesc":  # it tells no fault
        run.estop = True
    run.stage.drives[0].fail()
    for _ in range(30):
        run.tick()
    assert run.cycle.state is (State.ESTOP if rig == "vesc" else State.FAULT)
    name, told, value = FORGOTTEN[rig]
    forget(run, name, value)
    if rig == "odrive":
        node: Any = run.stage.nodes[0]
        node._modes = 3, 1  # as after a restart of its own
    run.asks = CommandKind.RESET
    assert not to_ready(run, 400)
    assert any(told in problem for problem in run.cycle.problems)


def test_a_mode_that_an_odrive_changes_by_itself_stops_the_rig() -> None:
    run = run_of("odrive", ())
    assert to_ready(run, 200)
    run.asks = CommandKind.ACTIVATE  # then it is told its mode anew
    run.on(20)
    assert run.cycle.state.name == "ACTIVE"
    node: Any = run.stage.nodes[1]
    node._modes = 3, 1
    run.on(320)  # five values, one asked for every 50 ticks
    assert run.cycle.state is State.FAULT
    assert run.cycle.problems == ["axis 1: TxSdo1.Control_Mode = 3; expected 1: it does not keep what it was told"]


def test_a_vesc_whose_bus_loses_frames_is_asked_until_it_is_told() -> None:
    run = run_of("vesc", ("wire.drop_probability=0.002",))
    assert to_ready(run, 1000)
    assert run.cycle.problems == []


def test_vescs_on_a_slower_bus_are_read_back_more_slowly() -> None:
    run = run_of("vesc", ("bus.bitrate=500000",))
    assert not to_ready(run, 85)  # 0.16 s are enough at 1 Mbit/s
    assert to_ready(run, 60)
    assert run.cycle.problems == []


def test_a_vesc_that_does_not_answer_is_told_by_name() -> None:
    run = run_of("vesc", ("plant.drive.nodes=[0, 5]",))
    assert not to_ready(run, 300)
    assert "axis 1, VESC 1: signature of the motor configuration was read back and gave no answer" in run.cycle.problems


def test_no_vesc_is_asked_while_one_is_enabled() -> None:
    run = run_of("vesc", ())
    assert to_ready(run, 200)
    run.asks = CommandKind.ACTIVATE
    asked = {message.can_id for message in run.cycle.protocol.messages(run.rig.period_ns) if message.at_rest}
    said: list[Frame] = []
    run.wire.observer = lambda start, end, sender, frame, good: said.append(frame)
    run.on(500)
    assert run.cycle.state is State.ACTIVE
    assert said
    assert not [frame for frame in said if frame.can_id in asked]


WATCHED = (*CIA402, f'bus.cia402.eds=["{EDS}"]', "bus.cia402.watch_mode=true", "bus.cia402.write_rated_torque=true")


@pytest.mark.requirement(id="SR-5.6")
def test_a_cia402_drive_that_leaves_its_mode_is_in_fault_within_two_ticks() -> None:
    run = run_of("microscope-ideal", (*WATCHED, 'bus.cia402.stop_options="keep"'))
    assert to_ready(run, 1000)
    node: Any = run.stage.nodes[2]
    node.dictionary.getters[key_of(cia301.MODE_DISPLAY)] = lambda: 8
    run.on(3)
    assert run.cycle.state is State.FAULT
    assert run.cycle.fault is Fault.DRIVE_FAULT
    assert run.cycle.problems == ["node 3: 6061h = 0x8 in its answers; expected 0xa: it left the mode it was told"]


def test_a_moteus_in_another_mode_than_it_is_told_is_named() -> None:
    run = run_of("moteus", (), mode=7)
    assert to_ready(run, 200)  # it is told a mode with power first when it is enabled
    run.asks = CommandKind.ACTIVATE
    for _ in range(20):
        run.tick()
    assert "axis 0: mode = 7; told 10 (position) or 0 (stopped)" in run.cycle.problems
    assert not any(drive.status & DriveStatus.ENABLED and drive.force for drive in run.stage.drives)
