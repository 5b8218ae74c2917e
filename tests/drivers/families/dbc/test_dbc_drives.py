"""Drives as their makers' DBC files have them: values for enable and status, states apart from positions, constants."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from drivers.config import BusConfig
from drivers.families.dbc.device import DbcDevice
from drivers.families.dbc.host import STATE_TIMEOUT_NS
from drivers.frame import Frame
from drivers.protocols import LayoutError, device_protocol, host_protocol
from drivers.protocols.base import Command, DriveStatus, Reject, Sample
from hil.cycle.state_machine import State
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS

MS = 1_000_000
CLOSED_LOOP, IDLE = 8, 1


def both(message: str, signal: str, **more: Any) -> list[dict[str, Any]]:
    return [{"message": f"{message}{node}", "signal": signal, **more} for node in (0, 1)]


def odrive(**changes: Any) -> dict[str, Any]:
    """ODrive CANSimple: axis state 8 is closed loop, 1 idle; torque control and direct input are both 1."""
    table: dict[str, Any] = {
        "position": both("Get_Encoder_Estimates", "Pos_Estimate", scale=1e5),
        "torque": both("Set_Input_Torque", "Input_Torque"),
        "enable": both("Set_Axis_State", "Axis_Requested_State", on=CLOSED_LOOP, off=IDLE),
        "status": both("Heartbeat", "Axis_State", enabled=[CLOSED_LOOP]),
        "error": both("Heartbeat", "Axis_Error"),
        "reset": both("Clear_Errors", "Identify", on=0, off=0),
        "constant": [
            *both("Set_Controller_Mode", "Control_Mode", value=1),
            *both("Set_Controller_Mode", "Input_Mode", value=1),
        ],
        "on_change": [f"{m}{n}" for m in ("Set_Axis_State", "Set_Controller_Mode", "Clear_Errors") for n in (0, 1)],
        "feedback": "cyclic",
    }
    return {"protocol": "dbc:odrive_cansimple.dbc", "dbc": table | changes}


def ends(**changes: Any) -> tuple[Any, Any]:
    bus = BusConfig.model_validate(odrive(**changes))
    return host_protocol(bus, 2, [5.0, 5.0], RIGS, MS), device_protocol(bus, 2, [5.0, 5.0], RIGS)


def state_of(frames: list[Frame], node: int) -> int | None:
    found = [frame.data[0] for frame in frames if frame.can_id == node << 5 | 0x07]
    return found[-1] if found else None


def test_enable_is_sent_as_the_makers_value_and_only_when_it_changes() -> None:
    host, _ = ends()
    first = host.encode(Command(0, [0.0, 0.0], 0, False))
    assert [state_of(first, node) for node in (0, 1)] == [IDLE, IDLE]
    assert [frame.data for frame in first if frame.can_id == 0x0B] == [bytes((1, 0, 0, 0, 1, 0, 0, 0))]
    assert [frame.can_id for frame in first[-2:]] == [0x0E, 0x2E]  # the torques come last
    assert [frame.can_id for frame in host.encode(Command(1, [0.0, 0.0], 0, False))] == [0x0E, 0x2E]
    enabled = host.encode(Command(2, [1.0, 2.0], 0b10, False))
    assert [state_of(enabled, node) for node in (0, 1)] == [IDLE, CLOSED_LOOP]  # all anew


def test_errors_are_cleared_when_a_reset_is_asked_for_and_never_else() -> None:
    host, _ = ends()

    def cleared(command: Command) -> list[Frame]:
        return [frame for frame in host.encode(command) if frame.can_id in (0x18, 0x38)]

    assert cleared(Command(0, [0.0, 0.0], 0, False)) == []  # a host that has just been started unlatches nothing
    assert cleared(Command(1, [0.0, 0.0], 0, True)) == [Frame(0x18, b"\0"), Frame(0x38, b"\0")]
    assert cleared(Command(2, [0.0, 0.0], 0, True)) == cleared(Command(3, [0.0, 0.0], 0, False)) == []
    assert len(cleared(Command(4, [0.0, 0.0], 0, True))) == 2


def test_constants_go_out_again_and_first_before_drives_are_enabled() -> None:
    host, _ = ends()
    host.encode(Command(0, [0.0, 0.0], 0, False))
    sent = [frame.can_id & 0x1F for frame in host.encode(Command(1, [0.0, 0.0], 0b11, False))]
    assert sent == [0x0B, 0x0B, 0x07, 0x07, 0x0E, 0x0E]


def test_a_drive_that_does_not_obey_is_told_again() -> None:
    host, _ = ends()
    host.encode(Command(0, [0.0, 0.0], 0, False))
    host.decode(Frame(0x01, bytes((0, 0, 0, 0, CLOSED_LOOP, 0, 0, 0)), 0, MS))
    host.decode(Frame(0x21, bytes((0, 0, 0, 0, IDLE, 0, 0, 0)), 0, MS))
    told = [state_of(host.encode(Command(n, [0.0, 0.0], 0, False)), 0) for n in range(1, 250)]
    assert [n for n, state in enumerate(told) if state is not None] == [98, 198]
    host.decode(Frame(0x01, bytes((0, 0, 0, 0, IDLE, 0, 0, 0)), 0, MS))
    assert all(state_of(host.encode(Command(n, [0.0, 0.0], 0, False)), 0) is None for n in range(250))


def test_turns_are_counted_where_a_position_wraps() -> None:
    wrapping = [{**item, "scale": 2.0, "wrap": 360.0} for item in both("Get_Encoder_Estimates", "Pos_Estimate")]
    host, device = ends(position=wrapping)
    counts = []
    for place in (350, 10, 20, -5, -400, -700, -360, 0):
        frame = device.encode_feedback(Sample(0, place, 0, 0, 0))._replace(timestamp_ns=MS)
        sample = host.decode(frame)
        assert isinstance(sample, Sample)
        counts.append(sample.position)
    assert counts == [350, 370, 380, 355, 320, 380, 360, 360]


def test_status_and_error_come_in_a_message_of_their_own_and_go_stale() -> None:
    host, _ = ends()
    feedback = Frame(0x09, bytes(8), 0, 5 * MS)

    def status() -> int:
        sample = host.decode(feedback)
        assert isinstance(sample, Sample)
        return sample.status

    def heartbeat(error: int, state: int) -> None:
        data = error.to_bytes(4, "little") + bytes((state, 0, 0, 0))
        assert host.decode(Frame(0x01, data, 0, 4 * MS)) is Reject.SERVICE

    assert status() == 0  # nothing is known yet
    heartbeat(0, CLOSED_LOOP)
    assert status() == DriveStatus.ENABLED
    heartbeat(0, IDLE)
    assert status() == 0
    heartbeat(0x40, IDLE)
    assert status() == DriveStatus.FAULT
    heartbeat(0, CLOSED_LOOP)
    for _ in range(STATE_TIMEOUT_NS // MS + 1):
        host.encode(Command(0, [0.0, 0.0], 0, False))
    assert status() == 0


def test_a_drive_that_sends_in_its_own_time_is_stamped_by_its_own_frame() -> None:
    host, _ = ends()
    assert host.echo_id is None
    stamps = [host.decode(Frame(0x09, bytes(8), 0, at * MS)).stamp_ns for at in (10, 17, 18)]
    lags = [at * MS - stamp for at, stamp in zip((10, 17, 18), stamps, strict=True)]
    assert len(set(lags)) == 1
    assert 100_000 < lags[0] < 140_000  # eight bytes at 1 Mbit/s
    assert all(message.after is None for message in host.messages(MS))


def test_a_command_arrives_with_the_makers_values() -> None:
    host, device = ends()
    for enable, reset in ((0b01, False), (0b11, False), (0, True), (0b10, False)):
        force = [1.5 if enable & 1 else 0.0, -2.5 if enable & 2 else 0.0]
        commands = [device.decode_command(frame) for frame in host.encode(Command(0, force, enable, reset))]
        (command,) = (outcome for outcome in commands if isinstance(outcome, Command))
        assert (command.enable, command.reset) == (enable, reset)
        assert command.force == pytest.approx(force)


@pytest.mark.parametrize(("on", "means"), [(1, {0: False, 1: True, 3: True}), (5, {0: False, 1: False, 5: True})])
def test_a_reset_is_any_number_where_it_is_a_flag_and_one_value_where_the_maker_says_so(
    on: int, means: dict[int, bool]
) -> None:
    host, device = ends(reset=both("Clear_Errors", "Identify", on=on), on_change=[])
    for raw, reset in means.items():
        frames = host.encode(Command(0, [0.0, 0.0], 0, False))
        sent = [f._replace(data=bytes([raw]) + f.data[1:]) if f.can_id & 0x1F == 0x18 else f for f in frames]
        commands = [c for c in map(device.decode_command, sent) if isinstance(c, Command)]
        assert [c.reset for c in commands] == [reset], raw


def test_a_rig_of_odrives_does_its_task() -> None:
    document = tomllib.loads((RIGS / "paper-dbc.toml").read_text())
    document["bus"] |= odrive()
    for axis in document["axes"].values():
        axis["gear"] = 628.3185  # 10 mm a turn
    run = LockstepRun(RigConfig.model_validate(document), RIGS)
    for _ in range(3000):
        run.tick()
    assert run.cycle.state is State.ACTIVE
    assert abs(run.true_position).max() > 1e-3


def test_an_emulated_drive_without_states_of_their_own_sends_no_more_frames() -> None:
    bus = BusConfig.model_validate(tomllib.loads((RIGS / "paper-dbc.toml").read_text())["bus"])
    device = device_protocol(bus, 2, [5.0, 5.0], RIGS)
    assert isinstance(device, DbcDevice)
    assert len(device.frames_of(Sample(0, 0, 0, 0, 0))) == 1


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"on_change": ["Heartbeat0"]}, "'Heartbeat0' is no bound command message"),
        ({"on_change": ["Set_Input_Torque0"]}, "torque"),
        ({"on_change": ["Set_Axis_State0"]}, "on = off = 0 in Clear_Errors0"),
        ({"feedback": "triggered", "feedback_period_s": 0.001}, "feedback_period_s"),
        ({"checksum_algorithm": "sum8"}, "checksum_algorithm"),
        ({"status": both("Set_Axis_State", "Axis_Requested_State")}, "both as command and as feedback"),
        ({"status": [], "error": [], "state_period_s": 0.02}, "state_period_s: no status, error or input"),
        ({"error": both("Heartbeat", "Axis_Error")[:1]}, "error has 1 signals for 2 axes"),
    ],
)
def test_a_key_that_could_not_act_is_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(LayoutError, match=says):
        ends(**changes)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"feedback_period_s": 0.004}, "rate_hz = 400 has to be 250 or less"),
        ({"state_period_s": 0.2}, "within the 0.125 s of safety.disable_timeout_ticks = 50"),
    ],
)
def test_drives_that_say_too_little_for_the_rate_are_refused(changes: dict[str, Any], says: str) -> None:
    rig = tomllib.loads((RIGS / "odrive.toml").read_text())
    rig["bus"]["dbc"] |= changes
    with pytest.raises(ValueError, match=says):
        RigConfig.model_validate(rig)


def test_a_broken_message_that_nobody_binds_does_not_matter(tmp_path: Path) -> None:
    text = (RIGS / "odrive_cansimple.dbc").read_text()
    overlapping = 'BO_ 99 Broken: 8 Axis0\n SG_ A : 0|16@1+ (1,0) [0|0] "" Host\n'
    overlapping += ' SG_ B : 8|16@1+ (1,0) [0|0] "" Host\n\n'
    (tmp_path / "odrive_cansimple.dbc").write_text(text.replace("CM_ ", overlapping + "CM_ ", 1))
    bus = BusConfig.model_validate(odrive())
    assert host_protocol(bus, 2, [5.0, 5.0], tmp_path, MS).n_axes == 2
    broken = BusConfig.model_validate(odrive(error=[{"message": "Broken", "signal": "A"}] * 2))
    with pytest.raises(LayoutError, match=r"message Broken.*overlap"):
        host_protocol(broken, 2, [5.0, 5.0], tmp_path, MS)


def asked(**changes: Any) -> dict[str, Any]:
    ask = {"message": "RxSdo0", "signal": "Endpoint_ID", "value": 300}
    return {"axis": 0, "message": "TxSdo0", "signal": "Control_Mode", "ask": ask, "least": 1.0, "most": 1.0} | changes


def test_a_value_is_asked_for_behind_the_commands_and_until_it_is_right_the_drive_counts_as_in_fault() -> None:
    host, _ = ends(read_back=[asked()])
    frames = host.encode(Command(0, [0.0, 0.0], 0, False))
    assert frames[-1] == Frame(0x04, bytes((0, 0x2C, 0x01, 0, 0, 0, 0, 0)))
    feedback = [Frame(0x09, bytes(8), 0, MS), Frame(0x29, bytes(8), 0, MS)]
    assert [host.decode(frame).status for frame in feedback] == [DriveStatus.FAULT, 0]
    assert host.decode(Frame(0x05, bytes((0, 0x2C, 0x01, 0, 3, 0, 0, 0)), 0, MS)) is Reject.SERVICE
    assert host.problems == ["axis 0: TxSdo0.Control_Mode = 3; expected 1: it does not keep what it was told"]
    host.encode(Command(1, [0.0, 0.0], 0, True))  # a reset asks anew
    assert host.decode(Frame(0x05, bytes((0, 0x2C, 0x01, 0, 1, 0, 0, 0)), 0, MS)) is Reject.SERVICE
    assert host.problems == []
    assert host.decode(feedback[0]).status == 0


def test_who_only_listens_asks_nobody_and_calls_nobody_faulty() -> None:
    host, _ = ends(read_back=[asked()])
    assert host.decode(Frame(0x09, bytes(8), 0, MS)).status == 0


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        (asked(axis=2), r"bus.dbc.read_back\[0\].axis = 2: 0 to 1 are there"),
        (asked(least=2.0), r"bus.dbc.read_back\[0\]: least = 2 is above most = 1"),
        (asked(signal="Control_Mood"), "did you mean TxSdo0.Control_Mode"),
        (
            asked(ask={"message": "RxSdo", "signal": "Endpoint_ID"}),
            r"bus.dbc.read_back.*ask: .* no message 'RxSdo'",
        ),
    ],
)
def test_a_read_back_that_cannot_be_is_refused(entry: dict[str, Any], says: str) -> None:
    with pytest.raises(LayoutError, match=says):
        ends(read_back=[entry])
