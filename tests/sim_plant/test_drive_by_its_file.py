"""The emulated drive knows its file alone: objects of every type, domains of two blocks, no request that ends it."""

import tracemalloc
from binascii import crc_hqx
from pathlib import Path
from random import Random

import pytest

from drivers.eds.data_types import DATA_TYPES, LARGEST_DATA, Kind
from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import SDO, Abort
from drivers.frame import Frame
from sim_plant.config import EmulatedDriveConfig
from sim_plant.drive_double import DoubleSettings, make_drive
from sim_plant.drives.motion_drive import MotionDrive
from sim_plant.drives.object_dictionary import SdoAbort
from tests.support.foreign_drive import MOTION_DRIVE, eds_text

NODE = 5
MS = 1_000_000
SETTINGS = DoubleSettings(None, 4096, 1e-4, 1e-3, 0.0, 0.0, EmulatedDriveConfig(kind="cia402"))
TYPE = "[1000]\nParameterName=Device type\nDataType=0x0007\nAccessType=ro\nDefaultValue=0x20192\n"


class SdoClient:
    """The SDO client of the drive of one file. now_ns: its time."""

    def __init__(self, eds: Path) -> None:
        self.now_ns = 0
        self.drive: MotionDrive = make_drive(eds, NODE, SETTINGS, 0)
        self.drive.advance(0)

    def send(self, can_id: int, data: bytes, wait_ns: int = 0) -> list[Frame]:
        self.now_ns += wait_ns
        return self.drive.on_frame(Frame(can_id, data, 0, self.now_ns))

    def ask(self, request: bytes, wait_ns: int = 0) -> list[bytes]:
        frames = self.send(cia301.SDO_REQUEST_ID + NODE, request.ljust(8, b"\0"), wait_ns)
        return [frame.data for frame in frames if frame.can_id == cia301.SDO_RESPONSE_ID + NODE]

    def read(self, index: int, subindex: int = 0) -> bytes:
        (answer,) = self.ask(SDO.pack(0x40, index, subindex, bytes(4)))
        assert answer[0] != 0x80, answer.hex()
        if answer[0] & 2:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        data, toggle = b"", 0
        while True:
            (segment,) = self.ask(bytes((0x60 | toggle,)))
            data += segment[1 : 8 - (segment[0] >> 1 & 7)]
            toggle ^= 0x10
            if segment[0] & 1:
                return data

    def write(self, index: int, subindex: int, data: bytes) -> int:
        """Abort code; 0 where it was taken."""
        if 1 <= len(data) <= 4:
            (answer,) = self.ask(SDO.pack(0x23 | (4 - len(data)) << 2, index, subindex, data.ljust(4, b"\0")))
        else:
            (answer,) = self.ask(SDO.pack(0x21, index, subindex, len(data).to_bytes(4, "little")))
            for at in range(0, max(1, len(data)), 7):
                part, last = data[at : at + 7], at + 7 >= len(data)
                head = (at // 7 & 1) << 4 | (7 - len(part)) << 1 | last
                if answer[0] != 0x80:
                    (answer,) = self.ask(bytes((head,)) + part)
        return int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0

    def write_block(self, index: int, data: bytes) -> int:
        """How many blocks it took."""
        self.ask(SDO.pack(0xC6, index, 0, len(data).to_bytes(4, "little")))
        segments = [data[at : at + 7] for at in range(0, len(data), 7)]
        blocks = 0
        for first in range(0, len(segments), 127):
            block = segments[first : first + 127]
            for number, segment in enumerate(block, 1):
                last = first + number == len(segments)
                answers = self.ask(bytes((number | (0x80 if last else 0),)) + segment)
            assert answers == [bytes((0xA2, len(block), 127, 0, 0, 0, 0, 0))]
            blocks += 1
        crc = crc_hqx(data, 0)
        assert self.ask(bytes((0xC1 | -len(data) % 7 << 2, crc & 0xFF, crc >> 8)))[0][0] == 0xA1
        return blocks

    def read_block(self, index: int) -> tuple[bytes, int]:
        """Data, and how many blocks it came in."""
        (answer,) = self.ask(SDO.pack(0xA4, index, 0, bytes((127, 0, 0, 0))))
        length, data, blocks = int.from_bytes(answer[4:], "little"), b"", 0
        answers = self.ask(b"\xa3")
        while answers[0][0] & 0xE3 != 0xC1:
            data += b"".join(segment[1:] for segment in answers)
            blocks += 1
            answers = self.ask(bytes((0xA2, len(answers), 127)))
        assert int.from_bytes(answers[0][1:3], "little") == crc_hqx(data[:length], 0)
        self.ask(b"\xa1")
        return data[:length], blocks


class Client(SdoClient):
    """Of a drive whose file has this text."""

    def __init__(self, folder: Path, text: str) -> None:
        (folder / "made.eds").write_text(text, encoding="utf-8")
        super().__init__(folder / "made.eds")


def section(index: int, data_type: int, default: str, access: str = "rw") -> str:
    keys = f"ParameterName=p\nObjectType=0x7\nDataType={data_type:#06x}\nAccessType={access}\nDefaultValue={default}\n"
    return f"[{index:04X}]\n{keys}PDOMapping=1\n"


def stated(number: int) -> tuple[str, bytes]:
    """A default as a file writes it, and its bytes."""
    data_type = DATA_TYPES[number]
    if data_type.kind is Kind.INTEGER:
        low, high = data_type.range
        value = low + 1 if data_type.signed else high
        return str(value), value.to_bytes(data_type.size, "little", signed=data_type.signed)
    texts = {0x08: "-1.5", 0x11: "1e300", 0x09: "a drive", 0x0A: "00 ff 10", 0x0B: "Ωm", 0x0F: "0102030405060708"}
    value = data_type.parse(texts[number])
    return texts[number], data_type.pack(value)


def test_every_object_is_served_as_the_file_types_it(tmp_path: Path) -> None:
    wanted = {0x2000 + number: stated(number) for number in DATA_TYPES}
    client = Client(tmp_path, TYPE + "".join(section(at, at & 0xFF, text) for at, (text, _) in wanted.items()))
    for index, (_, data) in wanted.items():
        assert client.read(index) == data
        assert client.write(index, 0, data) == 0
        if DATA_TYPES[index & 0xFF].size:
            assert client.write(index, 0, data + b"\0") == Abort.TOO_LONG
            other = b"\0" * len(data)
            assert (client.write(index, 0, other), client.read(index)) == (0, other)


@pytest.mark.parametrize(
    "index", [0x2010, 0x6041, 0x6064, 0x6077, 0x6061, 0x60FD, 0x606C, 0x6060, 0x6040, 0x6071, 0x6502]
)
@pytest.mark.parametrize("data_type", [0x02, 0x16, 0x08, 0x09, 0x1B])
def test_an_object_of_another_type_than_the_standards_is_the_files(index: int, data_type: int, tmp_path: Path) -> None:
    text, data = stated(data_type)
    client = Client(tmp_path, TYPE + section(index, data_type, text))
    assert len(client.read(index)) == len(data)
    client.write(index, 0, data)
    for word in (0x06, 0x07, 0x0F, 0x00):
        client.send(0x205, word.to_bytes(2, "little"), MS)
        client.send(0x080, b"", MS)
    assert len(client.read(index)) == len(data)


def test_a_makers_objects_are_the_makers(tmp_path: Path) -> None:
    compact = "[2014]\nParameterName=a\nObjectType=0x8\nDataType=7\nAccessType=rw\nDefaultValue=7\nCompactSubObj=3\n"
    client = Client(tmp_path, TYPE + section(0x2010, 6, "5") + section(0x2011, 0x16, "24") + compact)
    assert client.ask(SDO.pack(0x40, 0x2010, 0, bytes(4))) == [bytes.fromhex("4b10200005000000")]
    assert client.read(0x2011) == b"\x18\0\0"
    assert [client.read(0x2014, sub)[0] for sub in range(4)] == [3, 7, 7, 7]
    assert client.read(0x1000) == (0x20192).to_bytes(4, "little")


def test_the_projects_own_objects_go_with_its_file(tmp_path: Path) -> None:
    own = Client(tmp_path, cia301.EDS.read_text() + "\n; a copy\n")
    assert own.drive.dictionary.own
    assert int.from_bytes(own.read(0x2010), "little") > 10**9  # the double's watchdog is off
    assert not Client(tmp_path, TYPE).drive.dictionary.own


def test_what_is_longer_than_a_block_comes_in_two(tmp_path: Path) -> None:
    client = Client(tmp_path, TYPE + section(0x2000, 0x0F, "") + section(0x2001, 0x09, ""))
    data = Random(1).randbytes(LARGEST_DATA)
    for index in (0x2000, 0x2001):
        assert client.write_block(index, data) == 74
        assert client.read_block(index) == (data, 74)
        assert client.read(index) == data
    short = data[: 128 * 7]
    assert (client.write_block(0x2000, short), client.read_block(0x2000)) == (2, (short, 2))
    assert client.write(0x2000, 0, data + b"x") == Abort.OUT_OF_MEMORY


@pytest.mark.parametrize(
    ("index", "value"), [(0x1014, 0), (0x1014, 0x605), (0x1014, 0x20000085), (0x1005, 0), (0x1005, 0x605), (0x1003, 1)]
)
def test_no_identifier_of_others_is_taken(index: int, value: int, tmp_path: Path) -> None:
    text = section(0x1014, 7, "$NODEID+0x80") + section(0x1005, 7, "0x80") + section(0x1003, 7, "0")
    client = Client(tmp_path, TYPE + text)
    before = client.read(index)
    assert client.write(index, 0, value.to_bytes(4, "little")) == Abort.VALUE_RANGE
    assert client.read(index) == before
    assert client.write(index, 0, before) == 0


def test_a_client_that_falls_silent_in_a_block_is_given_up(tmp_path: Path) -> None:
    client = Client(tmp_path, TYPE + section(0x2000, 0x0F, ""))
    client.ask(SDO.pack(0xC2, 0x2000, 0, (100).to_bytes(4, "little")))
    assert client.ask(b"\x01abcdefg") == []
    frames = client.drive.advance(client.now_ns + 1500 * MS)
    assert [frame.data[:4].hex() for frame in frames if frame.can_id == 0x585] == ["80002000"]
    client.ask(SDO.pack(0xC2, 0x2000, 0, (100).to_bytes(4, "little")))
    assert client.read(0x1000)  # another client, at once


@pytest.mark.parametrize("begun", [False, True])
def test_another_transfer_ends_a_block_that_is_being_read(begun: bool, tmp_path: Path) -> None:
    client = Client(tmp_path, TYPE + section(0x2000, 0x0F, "") + section(0x2001, 0x06, "7"))
    client.write_block(0x2000, bytes(1000))
    for transfer in (lambda: client.write(0x2001, 0, b"\x08\0"), lambda: client.read(0x2001) != b"\x08\0"):
        client.ask(SDO.pack(0xA4, 0x2000, 0, bytes((127, 0, 0, 0))))
        assert len(client.ask(b"\xa3") if begun else [b""] * 127) == 127
        assert not transfer()
    client.ask(SDO.pack(0xA4, 0x2000, 0, bytes((127, 0, 0, 0))))
    assert client.read_block(0x2000) == (bytes(1000), 2)


WHOLE = (
    eds_text(MOTION_DRIVE)
    + "".join(section(0x2000 + number, number, stated(number)[0]) for number in DATA_TYPES)
    + "".join(section(0x3000 + number, 0x0F, "") for number in range(200))
)


def drawn(random: Random, objects: list[int]) -> bytes:
    """One request: of any bytes, or of a kind that leads somewhere."""
    key = random.choice(objects)
    data = random.choice((bytes(4), random.randbytes(4), b"\xff\xff\xff\xff", random.randbytes(1) + bytes(3)))
    command = random.choice((0x40, 0x21, 0x20, 0x22, 0x23, 0x27, 0x2B, 0x2F, 0xA0, 0xA4, 0xC0, 0xC2, 0xC4, 0xC6, 0x80))
    kind = random.random()
    if kind < 0.6:
        return SDO.pack(command, key >> 8, key & 0xFF, data)
    if kind < 0.8:
        return bytes((random.choice((0x00, 0x10, 0x01, 0x60, 0x70, 0xA2, 0xA3, 0xC1, 0xA1)),)) + random.randbytes(7)
    return random.randbytes(8)


def converse(client: Client, random: Random, requests: int) -> None:
    objects = list(client.drive.dictionary.entries)
    others = (0x000, 0x080, 0x205, 0x305, 0x77F)
    for number in range(requests):
        if random.random() < 0.05:  # a client that sends block after block
            for sequence in range(1, random.randrange(1, 128)):
                client.ask(bytes((sequence,)) + bytes(7))
        if random.random() < 0.2:
            client.send(random.choice(others), random.choice((b"", b"\1\0", b"\x81\0", random.randbytes(8))), MS)
        client.ask(drawn(random, objects), random.choice((0, 0, MS, 5 * MS)))
        if number % 50 == 0:  # whoever asks now is answered, at the latest when asked again
            request = SDO.pack(0x40, 0x1000, 0, bytes(4))
            client.send(0x000, b"\x80\0", MS)
            answers = [*client.ask(request), *client.ask(request)]
            assert SDO.pack(0x43, 0x1000, 0, (0x20192).to_bytes(4, "little")) in answers


@pytest.mark.parametrize("seed", range(4))
def test_no_sequence_of_requests_ends_it_or_makes_it_silent(seed: int, tmp_path: Path) -> None:
    converse(Client(tmp_path, WHOLE), Random(seed), 2500)


@pytest.mark.slow
def test_a_hundred_thousand_requests(tmp_path: Path) -> None:
    converse(Client(tmp_path, WHOLE), Random(99), 100_000)


def test_whatever_is_written_it_stays_small(tmp_path: Path) -> None:
    client = Client(tmp_path, WHOLE)
    tracemalloc.start()
    try:
        for index in range(0x3000, 0x3000 + 127):  # 8 MiB, all together, beside what the file itself states
            client.drive.dictionary.write(index, 0, bytes(LARGEST_DATA))
        for index in range(0x3000 + 127, 0x3000 + 200):
            with pytest.raises(SdoAbort, match="0x05040005"):
                client.drive.dictionary.write(index, 0, bytes(LARGEST_DATA))
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()
    assert client.read(0x1000)
