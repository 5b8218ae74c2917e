"""Servo drives of a maker that does not exist, by their manual: each side of the bus as it reads there.

    id          who         bytes
    201h + n    host        torque (int16, big-endian, in torque_unit), control, counter, checksum
    180h        host        counter: all drives take their torque, sample, and answer
    281h + n    drive n     position (int32, big-endian, counts), state, counter, checksum

control: bit 0 power, bit 1 clear faults. state: bit 7 power, 6 fault, 5 no command in time, 4 torque limited, 3 encoder
lost, 2 referenced, 1 brake; bit 0 is always clear. counter: of the tick, modulo 256. checksum: FFh less the sum of all
bytes before it and of the identifier's low byte, modulo 256.
"""

import struct

from hil import Command, DriveSide, DriveStatus, Frame, FrameLayout, HostSide, Message, Reject, Sample, Wiring

GO_ID, TORQUE_ID, ANSWER_ID = 0x180, 0x201, 0x281


class Maker(FrameLayout):
    """torque_unit: N (N m) per step of the torque, as the drives are set."""

    def __init__(self, wiring: Wiring, torque_unit: float = 1e-3) -> None:
        super().__init__(wiring)
        for axis, rated in enumerate(wiring.rated_force):
            if not rated <= 32767 * torque_unit:
                raise ValueError(
                    f"torque_unit = {torque_unit:g} reaches {32767 * torque_unit:g}; axis {axis}: {rated:g}"
                )
        self.torque_unit = torque_unit

    def host(self) -> "MakerHost":
        return MakerHost(self.wiring.n_axes, self.torque_unit)

    def drives(self) -> "MakerDrives":
        return MakerDrives(self.wiring, self.torque_unit)


class MakerHost(HostSide):
    """What the manual asks of a host."""

    sequence_modulus, checksum, states, causes = 256, True, True, True
    echo_id = GO_ID
    STATUS = {
        0x80: DriveStatus.ENABLED,
        0x40: DriveStatus.FAULT,
        0x20: DriveStatus.WATCHDOG,
        0x10: DriveStatus.TORQUE_LIMITED,
        0x08: DriveStatus.ENCODER_FAULT,
        0x04: DriveStatus.HOMED,
        0x02: DriveStatus.BRAKE,
    }

    def __init__(self, n_axes: int, torque_unit: float) -> None:
        self.n_axes, self.torque_unit = n_axes, torque_unit

    def encode(self, command: Command) -> list[Frame]:
        counter, frames = command.sequence % 256, list[Frame]()
        for axis in range(self.n_axes):
            torque = round(command.force[axis] / self.torque_unit)
            control = (command.enable >> axis & 1) | 2 * command.reset
            data = struct.pack(">hBB", torque, control, counter)
            frames.append(Frame(TORQUE_ID + axis, data + bytes([self.check(TORQUE_ID + axis, data)])))
        return [*frames, Frame(GO_ID, bytes([counter]))]

    def decode(self, frame: Frame) -> Sample | Reject:
        axis = frame.can_id - ANSWER_ID
        if not 0 <= axis < self.n_axes:
            return Reject.UNKNOWN_ID
        if frame.flags:
            return Reject.WRONG_FORMAT
        if len(frame.data) != 7:
            return Reject.WRONG_LENGTH
        if self.check(frame.can_id, frame.data[:6]) != frame.data[6]:
            return Reject.BAD_CHECKSUM
        position, state, counter = struct.unpack(">iBB", frame.data[:6])
        if state & 0x01:
            return Reject.INVALID_VALUE
        status = sum(int(meaning) for bit, meaning in self.STATUS.items() if state & bit)
        return Sample(axis, position, status, counter, -1)

    def messages(self, period_ns: int) -> list[Message]:
        host, due = list[Message](), period_ns
        for axis in range(self.n_axes):
            host.append(Message(f"torque {axis}", TORQUE_ID + axis, 5, False, period_ns, due, 0, "host"))
        host.append(Message("go", GO_ID, 1, False, period_ns, due, 0, "host"))
        answers = [
            Message(f"answer {axis}", ANSWER_ID + axis, 7, False, period_ns, due, 0, f"axis {axis}", "go")
            for axis in range(self.n_axes)
        ]
        return host + answers

    @staticmethod
    def check(can_id: int, data: bytes) -> int:
        return (0xFF - sum(data) - can_id % 256) % 256


class MakerDrives(DriveSide):
    """What the manual says that the drives do."""

    sequence_modulus = 256

    def __init__(self, wiring: Wiring, torque_unit: float) -> None:
        self.rated, self.unit = list(wiring.rated_force), torque_unit
        self.force_resolution = max(0.5 * torque_unit / rated for rated in self.rated)
        # (force, power, clear, counter) of the drives that have heard their torque since the last GO
        self.told: dict[int, tuple[float, int, int, int]] = {}

    def decode_command(self, frame: Frame) -> Command | Reject:
        if frame.can_id == GO_ID and not frame.flags:
            return self.go(frame.data)
        drive = frame.can_id - TORQUE_ID
        if drive not in range(len(self.rated)):
            return Reject.UNKNOWN_ID
        if frame.flags or len(frame.data) != 5:
            return Reject.WRONG_LENGTH
        total = (sum(frame.data) + (frame.can_id & 0xFF)) & 0xFF
        if total != 0xFF:
            return Reject.BAD_CHECKSUM
        steps = int.from_bytes(frame.data[:2], "big", signed=True)
        force = steps * self.unit
        if abs(force) > self.rated[drive] + 0.5 * self.unit:
            return Reject.INVALID_VALUE
        self.told[drive] = force, frame.data[2] & 1, frame.data[2] & 2, frame.data[3]
        return Reject.SERVICE

    def go(self, data: bytes) -> Command | Reject:
        told, self.told = self.told, {}
        if len(data) != 1:
            return Reject.WRONG_LENGTH
        if len(told) != len(self.rated) or {counter for *_, counter in told.values()} != {data[0]}:
            return Reject.STALE  # a drive that has not heard its torque does nothing
        force = [told[drive][0] for drive in range(len(self.rated))]
        power = sum(1 << drive for drive, (_, on, _, _) in told.items() if on)
        return Command(data[0], force, power, any(clear for _, _, clear, _ in told.values()))

    def encode_feedback(self, sample: Sample) -> Frame:
        power, fault, late, limited, homed, brake, encoder = (sample.status >> bit & 1 for bit in range(7))
        state = power << 7 | fault << 6 | late << 5 | limited << 4 | encoder << 3 | homed << 2 | brake << 1
        can_id = ANSWER_ID + sample.axis
        data = sample.position.to_bytes(4, "big", signed=True) + bytes([state, sample.sequence % 256])
        return Frame(can_id, data + bytes([~(sum(data) + (can_id & 0xFF)) & 0xFF]))
