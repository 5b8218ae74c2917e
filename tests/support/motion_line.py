"""A CiA 402 drive with a motor of its own and a master on a bus without delay, for tests."""

from pathlib import Path

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import DriveState, NmtCommand
from drivers.frame import Frame
from sim_plant.drives.motion_drive import MotionDrive
from sim_plant.drives.motor import Motor
from sim_plant.drives.object_dictionary import key_of
from sim_plant.drives.servo import NEVER_NS, ServoDrive
from tests.support.foreign_drive import MOTION_DRIVE, Fact, eds_text

MS = 1_000_000
NODE = 9
SPEED, ACCELERATION = 20_000, 200_000  # counts/s, counts/s^2

Facts = dict[tuple[int, int], Fact]


class Line:
    """One drive, its master, and time. told: what the drive sent but answers to SDOs."""

    def __init__(self, tmp_path: Path, modes: int = 0x3AD, more: Facts | None = None) -> None:
        """more: objects that it has besides."""
        facts = MOTION_DRIVE | {(0x6502, 0): MOTION_DRIVE[0x6502, 0]._replace(value=hex(modes))} | (more or {})
        tmp_path.mkdir(exist_ok=True)
        (tmp_path / "made.eds").write_text(eds_text(facts))
        self.servo = ServoDrive(0, 2.0, 1e-3, NEVER_NS, False, 0)
        self.motor = Motor(1e-3, 1e-3, 1e-3, 0)
        self.drive = MotionDrive(NODE, self.servo, self.motor, eds=tmp_path / "made.eds")
        self.now = 0
        self.told: list[Frame] = []
        self.pass_time(1)
        self.nmt(NmtCommand.START)

    def send(self, can_id: int, data: bytes = b"") -> list[Frame]:
        return self.drive.on_frame(Frame(can_id, data, 0, self.now))

    def pass_time(self, milliseconds: int) -> None:
        self.now += milliseconds * MS
        self.told += self.drive.advance(self.now)

    def nmt(self, command: NmtCommand) -> None:
        self.send(0x000, bytes((command, NODE)))

    def write(self, index: int, value: int, size: int, subindex: int = 0) -> int:
        data = (value % (1 << 8 * size)).to_bytes(4, "little")
        frames = self.send(0x600 + NODE, cia301.SDO.pack(0x23 | (4 - size) << 2, index, subindex, data))
        self.told += [frame for frame in frames if frame.can_id != 0x580 + NODE]
        (answer,) = (frame for frame in frames if frame.can_id == 0x580 + NODE)
        return int.from_bytes(answer.data[4:], "little") if answer.data[0] == 0x80 else 0

    def enable(self, mode: int) -> None:
        assert self.write(0x6060, mode, 1) == 0
        assert self.write(0x6081, SPEED, 4) == self.write(0x6083, ACCELERATION, 4) == 0
        for word in (0x06, 0x07, 0x0F):
            assert self.write(0x6040, word, 2) == 0
        assert self.drive.state is DriveState.OPERATION_ENABLED

    @property
    def emergencies(self) -> list[int]:
        """Error codes told."""
        return [int.from_bytes(frame.data[:2], "little") for frame in self.told if frame.can_id == 0x080 + NODE]

    @property
    def word(self) -> int:
        return int(self.drive.dictionary.get(key_of(0x6041)))

    @property
    def position(self) -> int:
        return int(self.drive.dictionary.get(key_of(0x6064)))

    @property
    def speed(self) -> int:
        return int(self.drive.dictionary.get(key_of(0x606C)))
