"""The emulated ODrive's own homing: what its heartbeat says, and what it refuses."""

import struct

import pytest

from drivers.frame import Frame
from drivers.protocols.base import DriveStatus
from sim_plant.drives.odrive import REBOOT, RX_SDO, SET_AXIS_STATE, SET_CONTROLLER_MODE, SET_INPUT_TORQUE
from sim_plant.drives.odrive_homing import HOMING, HomingOdrive
from sim_plant.drives.servo import Counter, ServoDrive, Switches

COUNT, MASS, STEP_S, TURN, RATED = 1e-6, 0.05, 1e-4, 0.01, 5.0  # m, kg, s, m, of the servo
IDLE, CLOSED_LOOP = 1, 8
SUCCESS, BUSY, CANCELLED, DISARMED, WITHOUT_ENDSTOP = 0, 1, 2, 3, 12
SOFT_MAX, SOFT_MIN, SPEED, RAMP, ENABLED, OFFSET, PRESSED = 304, 305, 306, 307, 311, 312, 313
ENDSTOP = -0.02  # m


class Bench:
    """A drive that moves a mass without friction. most: the greatest force it has applied."""

    def __init__(self, place: float = 0.004, low: float | None = ENDSTOP) -> None:
        self.place, self.speed, self.most, self.held = place, 0.0, 0.0, False
        servo = ServoDrive(0, RATED, COUNT, 10**12, False, 0)
        servo.counter = Counter(0.0, None)
        if low is not None:
            servo.switches = Switches(low=low)
        self.servo = servo
        self.drive = HomingOdrive(
            0, servo, lambda: servo.sample(self.place, 0).position * COUNT / TURN, 0, turn=TURN,
            inputs=lambda: servo.switches.closed(self.place), feedback_ns=10**6, heartbeat_ns=20 * 10**6,
        )  # fmt: skip
        self.now_ns = 0

    def send(self, command: int, data: bytes) -> list[Frame]:
        return self.drive.on_frame(Frame(command, data, 0, self.now_ns))

    def write(self, number: int, kind: str, value: float) -> None:
        self.send(RX_SDO, struct.pack("<BHx", 1, number) + struct.pack("<" + kind, value))

    def read(self, number: int, kind: str) -> float:
        (answer,) = self.send(RX_SDO, struct.pack("<BHx", 0, number) + bytes(4))
        return float(struct.unpack_from("<" + kind, answer.data, 4)[0])

    def state(self, state: int) -> None:
        self.send(SET_AXIS_STATE, struct.pack("<I", state))

    def told(self) -> tuple[int, int]:
        """Axis_State, Procedure_Result."""
        frame = self.drive._heartbeat()
        return frame.data[4], frame.data[5]

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.speed = 0.0 if self.held else self.speed + self.servo.force / MASS * STEP_S
            self.place += self.speed * STEP_S
            self.now_ns += round(STEP_S * 1e9)
            self.drive.advance(self.now_ns)
            self.most = max(self.most, abs(self.servo.force))


def ready(**more: float) -> Bench:
    """In torque control, and configured to home at 5 turns/s."""
    bench = Bench(**more)
    bench.write(SPEED, "f", 5.0)
    bench.write(RAMP, "f", 100.0)
    bench.send(SET_CONTROLLER_MODE, struct.pack("<II", 1, 1))
    bench.state(CLOSED_LOOP)
    return bench


@pytest.mark.parametrize(("offset", "zero"), [(0.0, ENDSTOP), (-0.3, ENDSTOP + 0.3 * TURN)])
def test_it_goes_to_its_endstop_and_counts_from_its_zero(offset: float, zero: float) -> None:
    bench = ready()
    bench.write(OFFSET, "f", offset)
    bench.state(HOMING)
    assert bench.told() == (HOMING, BUSY)
    bench.run(0.2)
    assert bench.told() == (HOMING, BUSY)
    assert bench.speed == pytest.approx(-5.0 * TURN, rel=0.02)
    bench.send(SET_INPUT_TORQUE, struct.pack("<f", RATED))
    bench.run(0.1)
    assert bench.speed == pytest.approx(-5.0 * TURN, rel=0.02), "a torque does nothing while it homes"
    bench.run(2.0)
    assert bench.told() == (IDLE, SUCCESS)
    assert bench.servo.force == 0.0
    (estimate, _) = struct.unpack("<ff", bench.drive._estimates().data)
    assert estimate * TURN == pytest.approx(bench.place - zero, abs=2e-5)
    bench.state(CLOSED_LOOP)
    bench.send(SET_INPUT_TORQUE, struct.pack("<f", 1.0))
    assert bench.servo.force == 1.0, "in the mode of before"


def test_its_torque_stays_within_its_limits() -> None:
    bench = ready()
    bench.write(SOFT_MAX, "f", 0.5)
    bench.write(SOFT_MIN, "f", -0.4)
    bench.state(HOMING)
    bench.held = True
    bench.run(0.5)
    assert bench.servo.force == pytest.approx(-0.4)
    assert bench.most == pytest.approx(0.4)
    bench.state(CLOSED_LOOP)
    bench.send(SET_CONTROLLER_MODE, struct.pack("<II", 1, 1))
    for torque, force in ((2.0, 0.5), (-2.0, -0.4), (0.3, 0.3)):
        bench.send(SET_INPUT_TORQUE, struct.pack("<f", torque))
        assert bench.servo.force == pytest.approx(force)


def test_without_an_endstop_it_refuses_and_moves_nothing() -> None:
    bench = ready(low=None)
    assert bench.read(ENABLED, "?") == 0
    bench.state(HOMING)
    assert bench.told() == (IDLE, WITHOUT_ENDSTOP)
    bench.run(0.1)
    assert bench.place == 0.004
    bench.write(ENABLED, "?", True)
    bench.state(HOMING)
    bench.run(0.1)
    assert bench.told() == (HOMING, BUSY)


def test_another_state_or_an_error_ends_it_in_the_mode_of_homing() -> None:
    bench = ready()
    bench.state(HOMING)
    bench.run(0.1)
    bench.state(IDLE)
    assert bench.told() == (IDLE, CANCELLED)
    assert bench.drive._modes == (2, 2)
    bench.state(HOMING)
    bench.servo.fail()
    bench.run(0.1)
    assert bench.told() == (IDLE, DISARMED)
    assert bench.servo.force == 0.0
    bench.state(HOMING)
    assert bench.told() == (IDLE, DISARMED), "an error is latched"


def test_its_loop_feeds_no_watchdog_and_its_endstop_is_told() -> None:
    bench = ready()
    bench.state(HOMING)
    deadline_ns = bench.servo.deadline_ns
    bench.run(0.05)
    assert bench.servo.deadline_ns == deadline_ns
    assert bench.read(PRESSED, "?") == 0
    bench.place = ENDSTOP - 1e-4
    assert bench.read(PRESSED, "?") == 1
    assert bench.servo.switches.closed(bench.place) == DriveStatus.LIMIT_LOW


def test_what_is_written_is_there_until_it_restarts() -> None:
    bench = ready()
    assert bench.read(SPEED, "f") == 5.0
    bench.send(REBOOT, b"")
    assert bench.read(SPEED, "f") == 0.25
