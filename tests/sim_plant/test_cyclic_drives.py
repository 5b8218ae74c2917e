"""Emulated ODrive and VESC: frames in, frames and force out, as their makers' pages say."""

import struct

import pytest

from drivers.frame import EXTENDED, REMOTE, Frame
from sim_plant.drives.odrive import Odrive
from sim_plant.drives.servo import NEVER_NS, ServoDrive
from sim_plant.drives.vesc import Motor, Vesc

MS = 1_000_000
NODE = 3
IDLE, CLOSED_LOOP = 1, 8
WATCHDOG, ESTOP = 1 << 24, 1 << 25


class OdriveBench:
    """One ODrive with node number 3, a motor of 2 N m and a watchdog of 10 ms, at 1.5 turns."""

    def __init__(self, **more: int) -> None:
        self.servo = ServoDrive(0, 2.0, 1e-7, 10 * MS, False, 0)
        self.drive = Odrive(NODE, self.servo, lambda: 1.5, 0, feedback_ns=MS, heartbeat_ns=20 * MS, **more)
        self.now = 0

    def send(self, command: int, data: bytes = b"", *, remote: bool = False) -> list[Frame]:
        self.now += MS
        self.drive.advance(self.now)  # what it sends in its own time
        return self.drive.on_frame(Frame(NODE << 5 | command | (REMOTE if remote else 0), data, 0, self.now))

    def heartbeat(self) -> tuple[int, int, int]:
        """Axis_Error, Axis_State, Procedure_Result."""
        (frame,) = self.send(0x01, remote=True)
        return struct.unpack("<IBBBx", frame.data)[:3]  # type: ignore[return-value]

    def torque_control(self, torque: float = 1.0) -> None:
        self.send(0x0B, struct.pack("<II", 1, 1))
        self.send(0x07, struct.pack("<I", CLOSED_LOOP))
        self.send(0x0E, struct.pack("<f", torque))


def test_odrive_heartbeat_is_told_byte_for_byte() -> None:
    """Axis_Error, Axis_State, Procedure_Result, Trajectory_Done_Flag."""
    bench = OdriveBench()
    (frame,) = bench.send(0x01, remote=True)
    assert (frame.can_id, frame.data) == (NODE << 5 | 0x01, bytes.fromhex("00000000 01 00 00 00"))
    bench.torque_control()
    (frame,) = bench.send(0x01, remote=True)
    assert frame.data == bytes.fromhex("00000000 08 00 00 00")


def test_odrive_applies_torque_in_closed_loop_torque_control_alone() -> None:
    bench = OdriveBench()
    bench.send(0x0E, struct.pack("<f", 1.0))
    assert bench.servo.force == 0.0  # idle
    bench.send(0x07, struct.pack("<I", CLOSED_LOOP))
    assert bench.servo.force == 0.0  # position control, as it comes
    bench.send(0x0B, struct.pack("<II", 1, 1))
    assert bench.servo.force == 1.0
    bench.send(0x0E, struct.pack("<f", -50.0))
    assert bench.servo.force == -2.0  # what the motor has
    bench.send(0x0B, struct.pack("<II", 2, 1))
    assert bench.servo.force == 0.0  # velocity control
    assert bench.heartbeat() == (0, CLOSED_LOOP, 0)
    bench.send(0x07, struct.pack("<I", IDLE))
    assert bench.heartbeat() == (0, IDLE, 0)


@pytest.mark.parametrize(("error", "provoke"), [(WATCHDOG, "silence"), (ESTOP, "estop")])
def test_odrive_latches_errors_until_they_are_cleared(error: int, provoke: str) -> None:
    bench = OdriveBench()
    bench.torque_control()
    if provoke == "estop":
        bench.send(0x02)
    else:
        bench.now += 10 * MS
        bench.servo.trip(bench.now)  # as the stage does, at the deadline
    assert bench.heartbeat() == (error, IDLE, 3)
    assert bench.servo.force == 0.0
    bench.send(0x07, struct.pack("<I", CLOSED_LOOP))
    assert bench.heartbeat()[1] == IDLE  # refused
    bench.send(0x18)
    assert bench.heartbeat()[0] == 0
    bench.torque_control()
    assert bench.servo.force == 1.0


def test_an_estop_is_told_beside_an_expired_watchdog() -> None:
    bench = OdriveBench()
    bench.torque_control()
    bench.now += 10 * MS
    bench.servo.trip(bench.now)
    bench.send(0x02)
    assert bench.heartbeat() == (WATCHDOG | ESTOP, IDLE, 3)


def test_odrive_restarts_in_position_control() -> None:
    bench = OdriveBench()
    bench.torque_control()
    bench.send(0x07, struct.pack("<I", CLOSED_LOOP))
    bench.send(0x0E, struct.pack("<f", 1.0))
    assert bench.servo.force != 0.0
    bench.send(0x16)
    bench.send(0x07, struct.pack("<I", CLOSED_LOOP))
    bench.send(0x0E, struct.pack("<f", 1.0))
    assert bench.servo.force == 0.0


def test_odrive_sends_in_its_own_time_and_answers_remote_frames() -> None:
    bench = OdriveBench()
    sent = [frame for at in range(41 * 10) for frame in bench.drive.advance(at * MS // 10)]
    assert {frame.can_id for frame in sent} == {NODE << 5 | 0x01, NODE << 5 | 0x09}
    estimates = [frame for frame in sent if frame.can_id & 0x1F == 0x09]
    assert len(estimates) == 41
    assert len(sent) - len(estimates) == 3
    assert struct.unpack("<ff", estimates[-1].data) == (1.5, 0.0)
    bench.now = 50 * MS
    (answer,) = bench.send(0x09, remote=True)
    assert answer.data == estimates[-1].data
    assert bench.send(0x14, remote=True) == []  # Get_Iq: not emulated


def test_odrive_hears_no_other_node_and_takes_its_time_to_enable() -> None:
    bench = OdriveBench(enable_delay_ns=5 * MS)
    bench.torque_control()
    assert bench.servo.force == 0.0
    bench.drive.advance(bench.now + 5 * MS)
    assert bench.servo.force == 1.0
    bench.drive.on_frame(Frame(4 << 5 | 0x07, struct.pack("<I", IDLE), 0, bench.now + 6 * MS))
    assert bench.servo.force == 1.0


def vesc(**instead: float) -> tuple[Vesc, ServoDrive]:
    servo = ServoDrive(0, 2.0, 1e-7, 10 * MS, False, 0)
    times = {"feedback_ns": MS, "status_ns": 20 * MS}
    return Vesc(7, servo, lambda: -0.25, 0, motor=Motor(0.05, 7), instead=instead, **times), servo


def test_vesc_makes_torque_of_current_and_of_nothing_else() -> None:
    drive, servo = vesc()

    def send(can_id: int, milliamperes: int) -> float:
        drive.on_frame(Frame(can_id, struct.pack(">i", milliamperes), 0, MS))
        return servo.force

    assert send(EXTENDED | 0x107, 20_000) == pytest.approx(1.0)
    assert send(EXTENDED | 0x108, 0) == pytest.approx(1.0)  # another VESC
    assert send(0x107, 0) == pytest.approx(1.0)  # 11 bits
    assert send(EXTENDED | 0x107, -100_000) == -2.0  # its limit
    assert send(EXTENDED | 0x307, 20_000) == 0.0  # SET_RPM: a loop of its own


def test_vesc_begins_again_after_its_timeout_and_tells_one_turn() -> None:
    drive, servo = vesc()
    drive.on_frame(Frame(EXTENDED | 0x107, struct.pack(">i", 20_000), 0, MS))
    servo.trip(11 * MS)
    drive.on_frame(Frame(EXTENDED | 0x107, struct.pack(">i", 20_000), 0, 12 * MS))
    assert servo.force == pytest.approx(1.0)
    sent = {frame.can_id & 0xFFFF: frame.data for frame in drive.advance(40 * MS)}
    assert set(sent) == {0x0907, 0x1007, 0x1B07}
    assert struct.unpack(">hhhh", sent[0x1007])[3] == 13_500  # 270 degrees times 50
    assert struct.unpack(">ihh", sent[0x0907])[1] == 200  # 20 A
    assert struct.unpack(">ihxx", sent[0x1B07])[0] == round(-0.25 * 7 * 6)


@pytest.mark.parametrize(("instead", "least", "most"), [
    ({}, -2.0, 2.0),
    ({"l_current_max": 10.0}, -2.0, 0.5),
    ({"l_current_min": -4.0}, -0.2, 2.0),
    ({"l_current_max": 10.0, "l_current_min": -10.0, "l_current_max_scale": 5000}, -0.25, 0.25),
])  # fmt: skip
def test_vesc_clips_current_to_its_configuration(instead: dict[str, float], least: float, most: float) -> None:
    drive, servo = vesc(**instead)
    for milliamperes, force in ((100_000, most), (-100_000, least)):
        drive.on_frame(Frame(EXTENDED | 0x107, struct.pack(">i", milliamperes), 0, MS))
        assert servo.force == pytest.approx(force)


@pytest.mark.parametrize(("timeout_ms", "deadline_ns"), [(10, 11 * MS), (500, 501 * MS)])
def test_vesc_lets_go_after_the_timeout_of_its_configuration(timeout_ms: int, deadline_ns: int) -> None:
    drive, servo = vesc(timeout_msec=timeout_ms)
    drive.on_frame(Frame(EXTENDED | 0x107, struct.pack(">i", 20_000), 0, MS))
    assert servo.deadline_ns == deadline_ns


def test_a_vesc_without_a_timeout_never_lets_go() -> None:
    drive, servo = vesc(timeout_msec=0)
    drive.on_frame(Frame(EXTENDED | 0x107, struct.pack(">i", 20_000), 0, MS))
    assert servo.force > 0.0
    assert servo.deadline_ns >= NEVER_NS


def answer_of(drive: Vesc, question: bytes) -> list[Frame]:
    assert drive.on_frame(Frame(EXTENDED | 0x807, question, 0, drive.now_ns)) == []
    sent = [frame for at in range(400) for frame in drive.advance(drive.now_ns + MS // 10 * (at > 0))]
    return [frame for frame in sent if frame.can_id & 0xFF == 99]


def test_vesc_tells_its_configuration_in_pieces_to_who_asked() -> None:
    drive, _ = vesc(l_current_max=12.5)
    frames = answer_of(drive, bytes((99, 0, 14)))
    assert [frame.can_id >> 8 & 0xFF for frame in frames] == [5] * 37 + [6] * 38 + [7]
    packet = b"".join(f.data[1 if f.can_id >> 8 & 0xFF == 5 else 2 :] for f in frames[:-1])
    assert packet[:5] == bytes((14,)) + (788332866).to_bytes(4, "big")
    assert struct.unpack_from(">f", packet, 9) == (12.5,)
    assert frames[-1].data[:4] == bytes((7, 1)) + len(packet).to_bytes(2, "big")
    assert len(packet) == 484


def test_vesc_tells_its_timeout_and_its_firmware_and_answers_nothing_else() -> None:
    drive, _ = vesc()
    packet = b"".join(frame.data[1:] for frame in answer_of(drive, bytes((99, 0, 17)))[:-1])
    assert struct.unpack_from(">IBI", packet, 1) == (2099347128, 7, 10)
    assert answer_of(drive, bytes((99, 0, 0)))[0].data[:4] == bytes((0, 0, 6, 6))
    for question in (b"", bytes((99, 0)), bytes((99, 1, 14)), bytes((99, 2, 14)), bytes((99, 0, 13))):
        assert answer_of(drive, question) == []


def test_an_unknown_value_of_a_vesc_is_refused() -> None:
    with pytest.raises(ValueError, match="'l_currant' is no value of an emulated VESC; there are mcconf_signature, "):
        vesc(l_currant=1.0)
