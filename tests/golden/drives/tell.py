"""What emulated drives say and do in long conversations.

A conversation is drawn from its name: commands in any order, reads of everything there is, frames that are too short,
for others or of the wrong kind, times of silence, and what fault injection does to a servo. The hash of each piece says
where two of them part; `--full` shows every frame.
"""

import struct
from binascii import crc_hqx
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any, Protocol

from drivers.families.cia402 import cia301
from drivers.frame import BRS, EXTENDED, FD, FD_LENGTHS, REMOTE, Frame
from drivers.protocols.base import DriveStatus
from sim_plant.drives.canopen_drive import Cia402Drive
from sim_plant.drives.moteus import Moteus
from sim_plant.drives.motion_drive import MotionDrive
from sim_plant.drives.motor import Motor
from sim_plant.drives.object_dictionary import described
from sim_plant.drives.odrive import Odrive
from sim_plant.drives.quirks import NO_QUIRKS, Quirks
from sim_plant.drives.servo import NEVER_NS, ServoDrive
from sim_plant.drives.vesc import Motor as VescMotor
from sim_plant.drives.vesc import Vesc
from tests.golden.golden import sha256
from tests.support.foreign_drive import FULL_DRIVE, I16, MOTION_DRIVE, STRING, U8, U32, Fact, eds_text

MS = 1_000_000
PIECES, TURNS = 12, 250  # of a conversation; what is asked in a piece
PAUSES = (0, 0, MS // 10, MS // 10, MS // 2, MS // 2, MS // 2, MS, MS, MS, MS, 3 * MS) * 3 + (12 * MS,)
DEFECTS = (0, 0, 0, 0, 0, 0, 0, int(DriveStatus.FAULT), int(DriveStatus.ENCODER_FAULT), int(DriveStatus.TORQUE_LIMITED))


class Node(Protocol):
    """A drive on a bus."""

    servo: ServoDrive

    def on_frame(self, frame: Frame) -> list[Frame]:
        """What it answers."""

    def advance(self, now_ns: int) -> list[Frame]:
        """What it sends by itself."""


Ask = Callable[[Random], list[Frame]]  # one frame, or what leads a drive into operation


def _servo(*, brake: bool = False, watchdog_ns: int = 10 * MS) -> ServoDrive:
    return ServoDrive(0, 2.0, 1e-7, watchdog_ns, brake, 0)


def _word(text: str, *values: Any) -> bytes:
    return struct.pack(text, *values)


def _mostly_whole(data: bytes, draw: Random) -> bytes:
    return data if draw.randrange(12) else data[: draw.randrange(len(data) + 1)]


def _torque(draw: Random) -> float:
    return draw.choice((0.0, 0.5, -1.25, 1.999, 2.0, -2.5, 40.0, float("nan"), float("inf"), -1e-3))


# drives ---------------------------------------------------------------------------------------------------------------


def _odrive(delay_ns: int) -> tuple[Node, Ask]:
    def position() -> float:
        return 1.5 + drive.now_ns * 1e-9 * 0.25

    def ask(draw: Random) -> list[Frame]:
        if draw.randrange(6) == 0:
            steps = (0x18, b""), (0x0B, _word("<II", 1, 1)), (0x07, _word("<I", 8)), (0x0E, _word("<f", _torque(draw)))
            return [Frame(3 << 5 | command, data) for command, data in steps]
        bodies = {
            0x02: b"",
            0x07: _word("<I", draw.choice((8, 8, 8, 1, 3, 0))),
            0x0B: _word("<II", draw.choice((1, 1, 1, 2, 3)), draw.choice((1, 1, 1, 2))),
            0x0E: _word("<f", _torque(draw)),
            0x16: b"",
            0x18: b"\0" * draw.randrange(3),
            0x1F: b"x",
        }
        command = draw.choice((0x02, 0x07, 0x07, 0x0B, 0x0E, 0x0E, 0x0E, 0x0E, 0x0E, 0x0E, 0x0E, 0x16, 0x18, 0x1F))
        node, flags = (4 if draw.randrange(30) == 0 else 3), FD if draw.randrange(40) == 0 else 0
        if draw.randrange(4) == 0:
            return [Frame(REMOTE | node << 5 | draw.choice((0x01, 0x03, 0x09, 0x14)), b"", flags)]
        return [Frame(node << 5 | command, _mostly_whole(bodies[command], draw), flags)]

    drive = Odrive(3, _servo(), position, 0, feedback_ns=MS, heartbeat_ns=20 * MS, enable_delay_ns=delay_ns)
    return drive, ask


def _vesc(*questions: int) -> tuple[Node, Ask]:
    """questions: numbers of the packets that it is asked for now and then, in place of a current."""

    def position() -> float:
        return -0.25 + drive.now_ns * 1e-9 * 3.0

    def ask(draw: Random) -> list[Frame]:
        if questions and draw.randrange(6) == 0:
            packet = bytes((draw.choice((200, 99)), draw.choice((0, 0, 0, 1)), draw.choice(questions)))
            return [Frame(EXTENDED | 8 << 8 | draw.choice((7, 7, 7, 8)), _mostly_whole(packet, draw))]
        value = draw.choice((0, 1, -1, 20_000, -39_999, 40_001, -(2**31), 2**31 - 1, 7))
        can_id = draw.choice((1, 1, 1, 1, 1, 0, 2, 3, 4, 5, 9)) << 8 | draw.choice((7, 7, 7, 7, 7, 8))
        flags = FD if draw.randrange(40) == 0 else 0
        return [Frame((EXTENDED if draw.randrange(20) else 0) | can_id, _mostly_whole(_word(">i", value), draw), flags)]

    drive = Vesc(7, _servo(), position, 0, motor=VescMotor(0.05, 7), feedback_ns=MS, status_ns=20 * MS)
    return drive, ask


def _moteus(delay_ns: int) -> tuple[Node, Ask]:
    registers = (*range(0x10), *range(0x20, 0x2E), 0x7F, 0x3F0)

    def position() -> float:
        return -0.5 + drive.now_ns * 1e-9 * 0.125

    def varuint(value: int) -> bytes:
        return bytes((value,)) if value < 0x80 else bytes((value & 0x7F | 0x80, value >> 7))

    def subframe(draw: Random) -> bytes:
        kind, register, count = draw.randrange(4), draw.choice(registers), draw.choice((0, 1, 2, 3))
        head = draw.choice((0x10, 0x10, 0x10, 0x00, 0x20)) if draw.randrange(3) == 0 else 0x10
        few = draw.choice((0, 1, 4, 5)) if count == 0 else count
        told = varuint(few) if count == 0 else b""
        values = b"" if head == 0x10 else b"".join(_number(kind, draw) for _ in range(few))
        return bytes((head | kind << 2 | count,)) + told + varuint(register) + values

    def command(draw: Random, modes: Sequence[int]) -> bytes:
        mode = draw.choice(modes)
        scale, torque = draw.choice((0.0, 0.0, 0.0, 1.0)), _torque(draw)
        most, timeout = draw.choice((float("nan"), 0.25, 1.0, -1.5, 9.0)), draw.choice((0.0, 0.02, 0.5, float("nan")))
        data = bytes((0x01, 0x00, mode, 0x0C, 4, 0x22)) + _word("<4f", torque, scale, 0.0, most)
        return data + bytes((0x0D, 0x27)) + _word("<f", timeout) if draw.randrange(2) else data

    def ask(draw: Random) -> list[Frame]:
        if draw.randrange(6) == 0:
            return [_padded(0x8003, bytes((0x01, 0x00, 0))), _padded(0x8003, command(draw, (10,)) + b"\x14\x04\x00")]
        any_mode = (0, 10, 10, 10, 10, 10, 15, 5, 1, 12, 3)
        parts = [subframe(draw) for _ in range(draw.randrange(1, 4))]
        data = command(draw, any_mode) if draw.randrange(3) else b"".join(parts)
        if draw.randrange(4) == 0:
            data += subframe(draw)
        data = _mostly_whole(data, draw)[:64]
        can_id = draw.choice((0x8003, 0x8003, 0x8003, 0x8003, 0x0003, 0x8004, 0xA503))
        flags = FD | BRS if draw.randrange(30) else 0
        return [_padded(can_id, data, flags=flags, extended=can_id > 0x7FF or draw.randrange(2) == 0)]

    drive = Moteus(3, _servo(watchdog_ns=100 * MS), position, 0, enable_delay_ns=delay_ns)
    return drive, ask


def _padded(can_id: int, data: bytes, *, flags: int = FD | BRS, extended: bool = True) -> Frame:
    length = next(n for n in FD_LENGTHS if n >= len(data))
    return Frame((EXTENDED if extended else 0) | can_id, data + b"\x50" * (length - len(data)), flags)


def _number(kind: int, draw: Random) -> bytes:
    if kind == 3:
        return _word("<f", draw.choice((0.0, 10.0, -1.5, 0.25, float("nan"), 3e9)))
    most = (1 << (8 * (1, 2, 4)[kind] - 1)) - 1
    return _word("<" + "bhi"[kind], draw.choice((0, 1, 10, -7, most, -most, -most - 1)))


class Master:
    """Asks a CANopen drive. size_of: bytes of each object to write and read, by index and sub-index as one number."""

    WORDS = (0x06, 0x07, 0x0F, 0x0F, 0x0F, 0x0F, 0x1F, 0x5F, 0x02, 0x00, 0x80, 0x80, 0x10F, 0x0B)
    NUMBERS = (0, 1, 2, 3, 8, 10, 100, 0xFF, 500, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0x60710010, 0x60640020, 0x60410010)
    COMMANDS = (0x40, 0x40, 0x40, 0x60, 0x70, 0xA0, 0xA4, 0xA3, 0xA2, 0xA1, 0x80, 0xC0)
    TORQUES = (0, 100, -100, 500, 1200, -32768, 32767)
    TARGETS = ((0x6071, 300), (0x6071, -900), (0x607A, 500), (0x60FF, -4000), (0x60FF, 20_000))

    def __init__(self, node_id: int, size_of: Mapping[int, int]) -> None:
        self._node, self._size_of = node_id, size_of
        self._places = sorted(size_of)
        self._of_drive = [place for place in self._places if place >> 8 in range(0x6040, 0x60FF)]
        self._modes = (10, 10, 1, 3, 4, 6, 8, 9) if 0x607A00 in size_of else (10,)
        self._targets = [target for target in self.TARGETS if target[0] << 8 in size_of]

    def __call__(self, draw: Random) -> list[Frame]:
        """What it asks next."""
        often = self._into_operation, self._network, self._word, self._rpdo, self._long
        return draw.choice((*often, self._sdo, self._sdo, self._sync, self._sync))(draw)

    def _write(self, index: int, subindex: int, value: int, size: int = 0) -> Frame:
        size = size or self._size_of.get(index << 8 | subindex, 4)
        body = _word("<BHBI", 0x23 | (4 - size) << 2, index, subindex, value % (1 << 8 * size))
        return Frame(cia301.SDO_REQUEST_ID + self._node, body)

    def _sdo(self, draw: Random) -> list[Frame]:
        place = draw.choice(self._of_drive if draw.randrange(2) else self._places)
        if draw.randrange(20) == 0:
            place = draw.choice((0x1FFF00, 0x604005, 0x101802))
        if draw.randrange(3) == 0:
            body = _word("<BHB4x", draw.choice(self.COMMANDS), place >> 8, place & 0xFF)
            return [Frame(cia301.SDO_REQUEST_ID + self._node, body)]
        value = draw.choice(self.WORDS if place == 0x604000 else self.NUMBERS)
        asked = self._write(place >> 8, place & 0xFF, value, 0 if draw.randrange(10) else draw.choice((1, 2, 3, 4)))
        return [asked._replace(data=_mostly_whole(asked.data, draw))]

    def _long(self, draw: Random) -> list[Frame]:
        """A value in segments or in a block, down or up; now and then not as announced, or in the wrong order."""
        place = draw.choice((*self._places, 0x200000, 0x200000, 0x100800))
        where, length = _word("<HB", place >> 8, place & 0xFF), draw.choice((1, 2, 4, 7, 8, 14, 20, 256, 300))
        value = bytes(at & 0xFF for at in range(length))
        announced = _word("<I", len(value) + (draw.randrange(8) == 0))
        parts = [value[at : at + 7] for at in range(0, len(value), 7)]
        unused = 7 - len(parts[-1])
        last = len(parts) - 1
        match draw.randrange(4):
            case 0:  # segments down, with their toggle bit
                heads = [(at & 1) << 4 | (7 - len(part)) << 1 | (at == last) for at, part in enumerate(parts)]
                steps = [bytes((draw.choice((0x21, 0x21, 0x20)),)) + where + announced]
                steps += [bytes((head,)) + part.ljust(7, b"\0") for head, part in zip(heads, parts, strict=True)]
            case 1:  # a block down
                crc = crc_hqx(value, 0) ^ (draw.randrange(6) == 0)
                steps = [bytes((draw.choice((0xC6, 0xC6, 0xC2, 0xC4, 0xC0)),)) + where + announced]
                numbers = [(at + 1) & 0x7F | (0x80 if at == last else 0) for at in range(len(parts))]
                steps += [bytes((number,)) + part.ljust(7, b"\0") for number, part in zip(numbers, parts, strict=True)]
                steps.append(_word("<BH5x", 0xC1 | unused << 2, crc))
            case 2:  # segments up
                steps = [b"\x40" + where + bytes(4), *(bytes((0x60 | (at & 1) << 4, *bytes(7))) for at in range(9))]
            case _:  # a block up
                size = draw.choice((1, 2, 127, 0, 128))
                steps = [bytes((draw.choice((0xA4, 0xA0)),)) + where + bytes((size, 0, 0, 0)), b"\xa3" + bytes(7)]
                told = [draw.choice((size, size, 1, 0, 9)) for _ in range(3)]
                steps += [bytes((0xA2, number, size, *bytes(5))) for number in told]
                steps.append(b"\xa1" + bytes(7))
        if draw.randrange(8) == 0:
            steps.insert(draw.randrange(len(steps) + 1), draw.choice(steps))
        return [Frame(cia301.SDO_REQUEST_ID + self._node, step) for step in steps]

    def _pdo(self, communication: int, can_id: int, kind: int, *mapped: int) -> list[Frame]:
        write, mapping = self._write, communication + 0x200
        steps = [write(communication, 1, 1 << 31 | can_id), write(communication, 2, kind), write(mapping, 0, 0)]
        steps += [write(mapping, at, entry) for at, entry in enumerate(mapped, 1)]
        return [*steps, write(mapping, 0, len(mapped)), write(communication, 1, can_id)]

    def _into_operation(self, draw: Random) -> list[Frame]:
        """PDOs, start, mode and the four controlwords; a target and two SYNCs."""
        write, steps = self._write, []
        if draw.randrange(2):
            steps += self._pdo(0x1400, 0x200 + self._node, draw.choice((1, 255)), 0x60400010, 0x60710010)
        if draw.randrange(2):
            steps += self._pdo(0x1800, 0x180 + self._node, draw.choice((0, 1, 2, 254, 255)), 0x60640020, 0x60410010)
        steps += [Frame(0x000, bytes((1, self._node))), write(0x6060, 0, draw.choice(self._modes))]
        steps += [write(0x6040, 0, word) for word in (0x00, 0x80, 0x06, 0x07, 0x0F)]
        index, value = draw.choice(self._targets)
        steps += [write(index, 0, value)] + ([write(0x6040, 0, 0x1F)] if index == 0x607A else [])
        return [*steps, Frame(0x080, b""), Frame(0x080, b"")]

    def _network(self, draw: Random) -> list[Frame]:
        if draw.randrange(2):
            return [Frame(0x77F, draw.choice((b"\5", b"\5", b"", b"\0\0")))]
        told = draw.choice((1, 1, 1, 1, 2, 0x80, 0x81, 0x82, 5)), draw.choice((0, self._node, self._node + 1))
        return [Frame(0x000, bytes(told))]

    def _sync(self, draw: Random) -> list[Frame]:
        return [Frame(0x080, draw.choice((b"", b"", b"", b"", bytes((draw.randrange(1, 241),)))))]

    def _word(self, draw: Random) -> list[Frame]:
        return [self._write(0x6040, 0, draw.choice(self.WORDS))]

    def _rpdo(self, draw: Random) -> list[Frame]:
        body = _word("<Hh", draw.choice((0x0F, 0x0F, 0x0F, *self.WORDS)), draw.choice(self.TORQUES))
        return [Frame(0x200 + self._node, _mostly_whole(body, draw))]


def _by_eds(folder: Path, name: str, facts: dict[tuple[int, int], Fact]) -> tuple[Path, dict[int, int]]:
    sizes = {U8: 1, 0x2: 1, 0x6: 2, I16: 2}
    (folder / name).write_text(eds_text(facts))
    return folder / name, {index << 8 | sub: sizes.get(fact.data_type, 4) for (index, sub), fact in facts.items()}


OPTIONS = {(0x605A + at, 0): Fact(I16, "rw", value) for at, value in enumerate(("2", "1", "1", "1", "2"))}
OPTIONS |= {(0x6084, 0): Fact(U32, "rw", "50000"), (0x6085, 0): Fact(U32, "rw", "90000")}
OPTIONS |= {(0x2000, 0): Fact(STRING, "rw", "as it was made")}
OPTIONS |= {(0x6087, 0): Fact(U32, "rw", "4000"), (0x1029, 1): Fact(U8, "rw", "0"), (0x6007, 0): Fact(I16, "rw", "3")}


def drives(folder: Path) -> dict[str, tuple[Node, Ask]]:
    """Every kind of drive, fresh, with who asks it. folder: for EDS files."""
    made: dict[str, tuple[Node, Ask]] = {
        "an odrive": _odrive(0),
        "an odrive that takes its time": _odrive(2 * MS),
        "a vesc": _vesc(),
        "a vesc that is asked": _vesc(0, 13, 14, 14, 17),
        "a moteus": _moteus(0),
        "a moteus that takes its time": _moteus(2 * MS),
    }
    quirky = Quirks(enable_delay_ns=3 * MS, answer_delay_ns=MS // 2, status_bits=0x4000, answers="segmented")
    blocks = NO_QUIRKS._replace(answers="block", missing=frozenset({0x601700}), aborts={0x100100: 0x08000000})
    for name, quirks in (("canopen", NO_QUIRKS), ("canopen, quirky", quirky), ("canopen, by blocks", blocks)):
        eds, sizes = _by_eds(folder, "full.eds", FULL_DRIVE | OPTIONS)
        drive = Cia402Drive(5, _servo(brake=True), lambda: 0.00125, eds=eds, quirks=quirks)
        made[name] = drive, Master(5, sizes)
    sizes = {key: entry.size or 4 for key, entry in described(cia301.EDS, 5).entries.items()}
    made["canopen, our own"] = Cia402Drive(5, _servo(brake=True), lambda: -0.00025), Master(5, sizes)
    for name, more in (("motion", {}), ("motion, with ramps", OPTIONS)):
        eds, sizes = _by_eds(folder, f"{len(more)}.eds", MOTION_DRIVE | more)
        motion = MotionDrive(9, _servo(watchdog_ns=NEVER_NS), Motor(1e-3, 1e-3, 1e-3, 0), eds=eds)
        made[name] = motion, Master(9, sizes)
    return made


# conversations --------------------------------------------------------------------------------------------------------


def talk(node: Node, ask: Ask, draw: Random) -> Iterator[list[str]]:
    """Piece by piece what was asked, what it sent, and what its servo then did."""
    now = 0
    for _ in range(PIECES):
        lines = []
        for _ in range(TURNS):
            now += draw.choice(PAUSES)
            sent = node.advance(now)
            if now >= node.servo.deadline_ns:  # as the stage does
                node.servo.trip(node.servo.deadline_ns)
            servo = node.servo
            if draw.randrange(25) == 0:
                servo.extra_status = draw.choice(DEFECTS)
            if draw.randrange(100) == 0 and not isinstance(node, Vesc):  # which tells and clears no fault
                servo.fail()
            for asked in ask(draw):
                answers = node.on_frame(asked._replace(timestamp_ns=now))
                did = f"{servo.force!r} {servo.status} {servo.deadline_ns - now}"
                lines.append(f"{now} < {_text([asked])} > {_text(sent)} | {_text(answers)} : {did}")
        yield lines


def _text(frames: Sequence[Frame]) -> str:
    return " ".join(f"{frame.can_id:X}#{frame.flags}{frame.data.hex()}" for frame in frames)


@cache
def stories() -> list[str]:
    """Their names."""
    with TemporaryDirectory() as folder:
        return list(drives(Path(folder)))


def tell(story: str) -> list[str]:
    """Of each piece, how much was said and done."""
    return lines(pieces(story))


def full(story: str) -> list[str]:
    """Every frame."""
    return [line for piece in pieces(story) for line in piece]


def pieces(story: str) -> list[list[str]]:
    """The whole conversation."""
    with TemporaryDirectory() as folder:
        return list(talk(*drives(Path(folder))[story], Random(story)))


def statuses(piece: Sequence[str]) -> list[DriveStatus]:
    """What the drive was after each turn."""
    return [DriveStatus(int(line.split()[-2])) for line in piece]


def lines(told: Sequence[Sequence[str]]) -> list[str]:
    """A line a piece."""
    found = []
    for number, piece in enumerate(told):
        answers = sum("|  :" not in line for line in piece)
        turns = Counter(bit.name for status in statuses(piece) for bit in status)
        states = ", ".join(f"{name} {count}" for name, count in sorted(turns.items(), key=str))
        until_s = int(piece[-1].split()[0]) * 1e-9
        found.append(
            f"piece {number}, until {until_s:.3f} s: {len(piece)} asked, {answers} answered; turns with {states}; "
            f"sha256 {sha256(chr(10).join(piece))}"
        )
    return found
