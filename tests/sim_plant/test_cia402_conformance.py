"""What CiA 301 and 402 ask of a drive and our master does not: mode 0, halt, 6071h by SDO, 1015h, 1029h, PDOs."""

from pathlib import Path

import pytest

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import Abort, DriveState, NmtCommand, NmtState
from drivers.frame import Frame
from sim_plant.drives.canopen_drive import Cia402Drive
from sim_plant.drives.object_dictionary import key_of
from sim_plant.drives.quirks import Quirks
from sim_plant.drives.servo import ServoDrive
from tests.support.foreign_drive import CST_DRIVE, I16, U8, Fact, eds_text

MS = 1_000_000
NODE = 5


class Line:
    """One drive and a client on a bus without delay."""

    def __init__(self, **more: object) -> None:
        self.servo = ServoDrive(0, 5.0, 1e-7, 1000 * MS, False, 0)
        self.drive = Cia402Drive(NODE, self.servo, lambda: 0.001, **more)  # type: ignore[arg-type]
        self.now = 0
        self.drive.advance(0)

    def send(self, can_id: int, data: bytes = b"") -> list[Frame]:
        self.now += MS
        return self.drive.on_frame(Frame(can_id, data, 0, self.now))

    def write(self, index: int, subindex: int, value: int, size: int) -> int:
        """SDO download: 0, or the abort code."""
        data = (value % (1 << 8 * size)).to_bytes(4, "little")
        answers = self.send(0x600 + NODE, cia301.SDO.pack(0x23 | (4 - size) << 2, index, subindex, data))
        (answer,) = (frame.data for frame in answers if frame.can_id == 0x580 + NODE)
        return int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0

    def nmt(self, command: NmtCommand) -> None:
        self.send(0x000, bytes((command, NODE)))

    def enable(self) -> None:
        self.nmt(NmtCommand.START)
        assert self.write(0x6060, 0, cia301.TORQUE_MODE, 1) == 0
        for word in (0x80, 0x06, 0x07, 0x0F):
            assert self.write(0x6040, 0, word, 2) == 0
        assert self.drive.state is DriveState.OPERATION_ENABLED

    def force(self, thousandths: int = 500) -> float:
        """What it applies once 6071h was written over SDO and SYNC has come."""
        assert self.write(0x6071, 0, thousandths, 2) == 0
        self.send(0x080)
        return self.servo.force


def made(tmp_path: Path, *removed: int, **facts: Fact) -> Path:
    """The EDS of a maker's drive."""
    path = tmp_path / "made.eds"
    stated = {key: fact for key, fact in CST_DRIVE.items() if key[0] not in removed}
    path.write_text(eds_text(stated | {(int(name[1:], 16), 0): fact for name, fact in facts.items()}))
    return path


def test_a_target_torque_by_sdo_acts_at_sync_and_is_refused_where_it_could_not() -> None:
    line = Line()
    assert line.write(0x6071, 0, 500, 2) == Abort.DEVICE_STATE  # pre-operational: no SYNC would apply it
    line.enable()
    assert line.write(0x6071, 0, 500, 2) == 0
    assert line.servo.force == 0.0
    line.send(0x080)
    assert line.servo.force == 0.5  # thousandths of 1 N, the default of 6076h


@pytest.mark.parametrize(("index", "value", "size"), [(0x6060, 0, 1), (0x6040, 0x010F, 2)], ids=["mode 0", "halt"])
def test_force_is_let_go_at_once_and_comes_back_by_a_new_target_alone(index: int, value: int, size: int) -> None:
    line = Line()
    line.enable()
    assert line.force() == 0.5
    assert line.write(index, 0, value, size) == 0
    assert line.servo.force == 0.0
    assert line.force() == 0.0
    assert line.write(0x6060, 0, cia301.TORQUE_MODE, 1) == line.write(0x6040, 0, 0x0F, 2) == 0
    assert line.servo.force == 0.0
    assert line.force() == 0.5


@pytest.mark.parametrize(
    ("index", "subindex", "value", "size", "code"),
    [
        (0x1800, 2, 0, 1, Abort.VALUE_RANGE),  # acyclic
        (0x1800, 2, 252, 1, Abort.VALUE_RANGE),  # on request
        (0x1400, 2, 241, 1, Abort.VALUE_RANGE),  # reserved
        (0x1400, 2, 254, 1, 0),
        (0x1800, 1, 0x20000185, 4, Abort.VALUE_RANGE),  # 29 bits
        (0x1800, 1, 0x601, 4, Abort.VALUE_RANGE),  # of SDO
        (0x1800, 1, 0x186, 4, Abort.DEVICE_STATE),  # while valid
        (0x1800, 1, 0x80000186, 4, 0),
        (0x1005, 0, 0x40000080, 4, Abort.VALUE_RANGE),  # it produces no SYNC
    ],
)
def test_what_is_not_supported_aborts(index: int, subindex: int, value: int, size: int, code: int) -> None:
    assert Line().write(index, subindex, value, size) == code


def test_emergencies_keep_their_inhibit_time() -> None:
    line = Line()
    line.enable()
    assert line.write(0x1015, 0, 1000, 2) == 0  # 100 ms

    def emergencies(frames: list[Frame]) -> int:
        return sum(frame.can_id == 0x080 + NODE for frame in frames)

    first = emergencies(line.send(0x080, b"\1\2"))  # SYNC of another length, twice
    assert (first, emergencies(line.send(0x080, b"\1\2"))) == (1, 0)
    assert emergencies(line.drive.advance(line.now + 98 * MS)) == 0
    assert emergencies(line.drive.advance(line.now + 99 * MS)) == 1
    assert line.drive.dictionary.number(key_of(0x1003)) == 2  # both are remembered


@pytest.mark.parametrize(
    ("behaviour", "state"), [(0, NmtState.PRE_OPERATIONAL), (1, NmtState.OPERATIONAL), (2, NmtState.STOPPED)]
)
def test_a_lost_master_does_to_the_network_state_what_1029h_says(behaviour: int, state: NmtState) -> None:
    line = Line()
    line.enable()
    assert line.write(0x1029, 1, behaviour, 1) == 0
    assert line.write(0x1016, 1, 127 << 16 | 50, 4) == 0
    line.send(0x700 + 127, b"\5")
    line.drive.advance(line.now + 60 * MS)
    assert line.drive.nmt is state
    assert line.drive.state is DriveState.FAULT


@pytest.mark.parametrize(
    ("option", "state"),
    [
        (0, DriveState.OPERATION_ENABLED),
        (1, DriveState.FAULT),
        (2, DriveState.SWITCH_ON_DISABLED),
        (3, DriveState.QUICK_STOP),
    ],
)
def test_a_lost_master_does_to_a_makers_drive_what_6007h_says(option: int, state: DriveState, tmp_path: Path) -> None:
    facts = {"x6007": Fact(I16, "rw", str(option)), "x605A": Fact(I16, "rw", "6")}
    line = Line(eds=made(tmp_path, **facts))
    line.enable()
    assert line.write(0x1016, 1, 127 << 16 | 50, 4) == 0
    line.send(0x700 + 127, b"\5")
    frames = line.drive.advance(line.now + 60 * MS)
    assert line.drive.state is state
    assert [frame.data[:2] for frame in frames if frame.can_id == 0x085] == [b"\x30\x81"]  # 8130h, heartbeat


@pytest.mark.parametrize(
    ("polarity", "position", "force"), [(0x00, 1, 1), (0x80, -1, 1), (0x20, 1, -1), (0xA0, -1, -1)]
)
def test_607eh_turns_position_and_torque_round(polarity: int, position: int, force: int, tmp_path: Path) -> None:
    line = Line(eds=made(tmp_path, x607E=Fact(U8, "rw", "0")))
    assert line.write(0x607E, 0, polarity, 1) == 0
    line.enable()
    assert line.force() == force * 2.5
    assert line.drive.dictionary.get(key_of(0x6064)) == position * 10_000


@pytest.mark.parametrize(("option", "state"), [(2, DriveState.SWITCH_ON_DISABLED), (6, DriveState.QUICK_STOP)])
def test_quick_stop_ends_as_605ah_says(option: int, state: DriveState, tmp_path: Path) -> None:
    line = Line(eds=made(tmp_path, x605A=Fact(I16, "rw", str(option))))
    line.enable()
    assert line.write(0x6040, 0, 0x02, 2) == 0
    assert line.drive.state is state


def test_a_makers_drive_has_what_its_eds_says_and_keeps_its_motors_rated_torque(tmp_path: Path) -> None:
    line = Line(eds=made(tmp_path))
    assert line.write(0x1019, 0, 240, 1) == Abort.NO_OBJECT
    line.nmt(NmtCommand.RESET_NODE)
    assert line.drive.dictionary.number(key_of(0x6076)) == 5000  # mN m: 5 N m
    line.enable()
    assert line.force(100) == 0.5


def test_quirks_make_it_differ_from_its_eds(tmp_path: Path) -> None:
    quirks = Quirks(
        missing=frozenset({key_of(0x1017)}),
        aborts={key_of(0x6060): 0x08000000},
        answer_delay_ns=5 * MS,
        enable_delay_ns=20 * MS,
        status_bits=0x8000,
    )
    line = Line(eds=made(tmp_path), quirks=quirks)
    assert line.send(0x600 + NODE, cia301.SDO.pack(0x2B, 0x1017, 0, bytes(4))) == []
    line.now += 5 * MS
    (late,) = line.drive.advance(line.now)
    assert int.from_bytes(late.data[4:], "little") == Abort.NO_OBJECT
    line.nmt(NmtCommand.START)
    for word in (0x06, 0x07, 0x0F, 0x0F):
        line.send(0x600 + NODE, cia301.SDO.pack(0x2B, 0x6040, 0, word.to_bytes(4, "little")))
    assert line.drive.state is DriveState.SWITCHED_ON
    line.drive.advance(line.now + 19 * MS)  # from the first of both
    assert line.drive.state is DriveState.OPERATION_ENABLED
    assert line.drive.dictionary.get(key_of(0x6041)) & 0xC000 == 0x8000


def test_an_event_driven_tpdo_tells_every_change_of_state_and_nothing_else(tmp_path: Path) -> None:
    line = Line(eds=made(tmp_path))
    for index, value, size in ((0x1A00, 0, 1),):
        line.write(0x1800, 1, 0xC0000185, 4)
        assert line.write(index, 0, value, size) == 0
    assert line.write(0x1A00, 1, 0x60410010, 4) == line.write(0x1A00, 0, 1, 1) == 0
    assert line.write(0x1800, 2, 255, 1) == line.write(0x1800, 1, 0x40000185, 4) == 0
    line.nmt(NmtCommand.START)

    def told(word: int) -> list[int]:
        data = cia301.SDO.pack(0x2B, 0x6040, 0, word.to_bytes(4, "little"))
        frames = [frame for frame in line.send(0x600 + NODE, data) if frame.can_id == 0x185]
        return [int.from_bytes(frame.data, "little") & 0x6F for frame in frames]

    assert told(0x06) == [0x21]
    assert told(0x06) == []
    assert told(0x07) == [0x23]


def test_an_eds_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "made.eds").write_text("[6040]\nObjectType=nothing\n")
    with pytest.raises(ValueError, match=r"made\.eds: no object in it"):
        Line(eds=tmp_path / "made.eds")
