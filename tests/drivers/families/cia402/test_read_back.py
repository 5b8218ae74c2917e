"""What was written is read back: a drive that acknowledges and does otherwise is never enabled, and is told by name."""

import struct
from pathlib import Path
from typing import Any

import pytest

from drivers.config import BusConfig, Wiring
from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import DriveState
from drivers.families.cia402.config import Cia402Config
from drivers.families.cia402.host import Cia402Host
from drivers.families.cia402.node import APPLICATION, Phase
from drivers.frame import Frame
from drivers.protocols.base import Command
from tests.support.foreign_drive import CST_DRIVE, I8, I16, U8, U16, Fact, ForeignDrive, eds_text

MS = 1_000_000
NODE = 3
FACTS = CST_DRIVE | {
    (0x6061, 0): Fact(I8, "ro", "0"), (0x6072, 0): Fact(U16, "rw", "3000"), (0x605C, 0): Fact(I16, "rw", "1"),
    (0x605E, 0): Fact(I16, "rw", "2"), (0x60C2, 0): Fact(U8, "ro", "2"), (0x60C2, 1): Fact(U8, "rw", "10"),
    (0x60C2, 2): Fact(I8, "rw", "-3"),
}  # fmt: skip
Place = tuple[int, int]


class Drive(ForeignDrive):
    """lies: what it says of an object, whatever was written. mute: objects it answers nothing about. unread: those it
    takes and does not tell, "mute" or "aborts". nameless: objects it aborts without naming one. forgets: with a fault,
    its mode.
    """

    def __init__(self) -> None:
        super().__init__(FACTS, NODE)
        self.lies: dict[Place, int] = {}
        self.mute: set[Place] = set()
        self.unread: dict[Place, str] = {}
        self.nameless: set[Place] = set()
        self.forgets = False
        self.writes: list[Place] = []

    def on_frame(self, frame: Frame) -> list[Frame]:
        """See ForeignDrive."""
        if frame.can_id != cia301.SDO_REQUEST_ID + NODE:
            return super().on_frame(frame)
        command, *place = struct.unpack("<BHB4x", frame.data)
        at = (place[0], place[1])
        if at in self.mute:
            return []
        if at in self.nameless:
            return [Frame(cia301.SDO_RESPONSE_ID + NODE, struct.pack("<BHBI", 0x80, 0, 0, 0x06020000))]
        if command >> 5 == 1:
            self.writes.append(at)
        elif at in self.unread:
            aborted = Frame(cia301.SDO_RESPONSE_ID + NODE, struct.pack("<BHBI", 0x80, *at, 0x06020000))
            return [aborted] if self.unread[at] == "aborts" else []
        answers = super().on_frame(frame)
        if command >> 5 == 2 and at in self.lies:
            said = self.lies[at].to_bytes(4, "little")
            answers = [answer._replace(data=answer.data[:4] + said) for answer in answers]
        return answers

    def _on_sync(self) -> list[Frame]:
        if self.state is not DriveState.FAULT:
            return super()._on_sync()
        if self._pending.get(cia301.CONTROLWORD, 0) & 0x80:
            self.state = DriveState.SWITCH_ON_DISABLED
            if self.forgets:
                for index in (cia301.MODE, cia301.MODE_DISPLAY):
                    self.node.data_store[index] = {0: bytes(1)}
        word = DriveState.FAULT.value[1]
        return [Frame(self._get(0x1800, 1) & 0x7FF, struct.pack("<iH", self.position, word))]


class Bench:
    """Host and drive, tick by tick; enabled for as long as the host may."""

    def __init__(self, folder: Path) -> None:
        (folder / "made.eds").write_text(eds_text(FACTS))
        settings = Cia402Config.model_validate({"eds": ["made.eds"], "nodes": [NODE]})
        self.host = Cia402Host(Wiring(BusConfig(protocol="cia402", cia402=settings), 1, [0.05], MS, folder))
        self.drive = Drive()
        self.was_enabled = False

    def tick(self, count: int, *, enable: bool = True, reset: bool = False) -> None:
        for _ in range(count):
            for frame in self.host.encode(Command(0, [0.02], int(enable), reset)):
                for answer in self.drive.on_frame(frame):
                    self.host.decode(answer)
            self.was_enabled |= self.drive.state is DriveState.OPERATION_ENABLED

    def settle(self) -> None:
        """As an operator does: first ready, then enabled."""
        self.tick(900, enable=False)
        self.tick(100)

    @property
    def problem(self) -> str:
        return self.host.nodes[0].problem


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_a_drive_that_does_as_it_is_told_is_enabled(bench: Bench) -> None:
    bench.settle()
    assert bench.was_enabled
    assert bench.problem == ""


@pytest.mark.parametrize("mode", [0, 1, 8, 9, 0xFF])
def test_a_drive_that_shows_another_mode_is_never_enabled(bench: Bench, mode: int) -> None:
    bench.drive.lies[0x6061, 0] = mode
    for _ in range(4):
        bench.settle()
        assert f"6061h = {mode:#x}; expected 0xa" in bench.problem
    assert not bench.was_enabled


def kept(step: Any) -> Place:
    return step.object_index, step.subindex


PROVED = [
    (0x1006, 0), (0x1017, 0), (0x1400, 1), (0x1400, 2), (0x1600, 0), (0x1600, 1), (0x1600, 2), (0x1800, 1),
    (0x1A00, 1), (0x1A00, 2), (0x605C, 0), (0x605E, 0), (0x6060, 0), (0x60C2, 1), (0x60C2, 2),
]  # fmt: skip


def test_all_that_is_written_is_read_back_the_application_last(bench: Bench) -> None:
    steps = bench.host.plans[0].steps
    written = {kept(step) for step in steps if step.size}
    proofs = [kept(step) for step in steps if step.proof]
    assert set(proofs) == written | {(0x6061, 0)}
    assert set(PROVED) <= set(proofs) | {(0x1006, 0), (0x1017, 0)}
    assert proofs == sorted(proofs)
    assert [step.proof for step in steps] == sorted(step.proof for step in steps)


@pytest.mark.requirement(id="SR-5.6")
@pytest.mark.parametrize("place", [place for place in PROVED if place[0] >= 0x1400])
def test_a_drive_that_acknowledges_and_keeps_another_value_is_named(bench: Bench, place: Place) -> None:
    bench.drive.lies[place] = 0x77
    bench.settle()
    assert f"{place[0]:04X}h" in bench.problem
    assert "it does not keep what is written" in bench.problem
    assert not bench.was_enabled


def test_a_mode_that_is_lost_with_a_fault_is_written_again_before_the_drive_is_enabled(bench: Bench) -> None:
    bench.settle()
    bench.drive.forgets, bench.drive.state = True, DriveState.FAULT
    bench.tick(20, enable=False)
    bench.drive.writes.clear()
    bench.tick(2, enable=False, reset=True)
    bench.was_enabled = False
    bench.tick(60, enable=True)
    assert not bench.was_enabled, "not before it is read back"
    bench.settle()
    assert (cia301.MODE, 0) in bench.drive.writes
    assert bench.was_enabled
    assert bench.drive.torque != 0


def test_after_a_fault_that_changes_nothing_the_application_is_read_back_and_nothing_written(bench: Bench) -> None:
    bench.settle()
    bench.drive.state = DriveState.FAULT
    bench.tick(20, enable=False)
    bench.drive.writes.clear()
    bench.tick(5, enable=False, reset=True)
    assert bench.host.nodes[0].phase is Phase.CONFIGURE
    bench.tick(100, enable=False)
    assert bench.host.nodes[0].phase is Phase.RUNNING
    bench.was_enabled = False
    bench.tick(50)
    assert bench.was_enabled
    assert bench.drive.writes == []
    told = [answer for answer in bench.host.nodes[0].answers if answer.step.object_index >= APPLICATION]
    assert told


def test_an_optional_object_without_an_answer_is_left_out_after_a_while(bench: Bench) -> None:
    bench.drive.mute = {(0x60C2, 1), (0x60C2, 2)}
    bench.tick(390, enable=False)
    assert bench.host.nodes[0].phase is Phase.RUNNING, "0.2 s for the object, not for each of its values"
    bench.settle()
    assert bench.was_enabled
    told = [a for a in bench.host.nodes[0].answers if a.step.object_index == 0x60C2]
    assert [(a.step.subindex, a.text) for a in told] == [(1, "no answer")]


def test_a_required_one_is_named_for_as_long_as_there_is_no_answer(bench: Bench) -> None:
    bench.drive.mute = {(0x6060, 0)}
    bench.settle()
    assert not bench.was_enabled
    assert bench.problem == "node 3: no answer to 6060h:00"
    bench.drive.mute.clear()
    bench.settle()
    assert bench.was_enabled


@pytest.mark.parametrize("place", [(0x60C2, 1), (0x605C, 0)])
def test_an_abort_that_names_no_object_is_the_answer_to_what_was_asked(bench: Bench, place: Place) -> None:
    bench.drive.nameless = {place}
    bench.settle()
    assert bench.was_enabled
    assert "aborted with 0x06020000" in next(a.text for a in bench.host.nodes[0].answers if kept(a.step) == place)


def test_what_was_left_out_is_not_read_back(bench: Bench) -> None:
    del bench.drive.node.object_dictionary.indices[0x605C]
    bench.settle()
    assert bench.was_enabled
    assert sum(kept(answer.step) == (0x605C, 0) for answer in bench.host.nodes[0].answers) == 1


UNTOLD = {"mute": "gave no answer when it was read back", "aborts": "aborted with 0x06020000"}


@pytest.mark.parametrize("how", UNTOLD)
@pytest.mark.parametrize("place", [(0x6061, 0), (0x605C, 0), (0x60C2, 2), (0x1A00, 1), (0x1400, 2)])
def test_a_value_that_cannot_be_read_back_refuses_the_drive_by_name(bench: Bench, place: Place, how: str) -> None:
    bench.drive.unread[place] = how
    bench.settle()
    assert bench.problem.startswith(f"node 3: {place[0]:04X}h:{place[1]:02X} {UNTOLD[how]}")
    assert not bench.was_enabled


@pytest.mark.parametrize("how", UNTOLD)
def test_nor_is_it_enabled_where_it_tells_its_mode_no_more_after_a_fault_reset(bench: Bench, how: str) -> None:
    bench.settle()
    bench.drive.unread[0x6061, 0] = how
    bench.drive.state = DriveState.FAULT
    bench.tick(20, enable=False)
    bench.tick(5, enable=False, reset=True)
    bench.was_enabled = False
    bench.settle()
    assert bench.problem.startswith(f"node 3: 6061h:00 {UNTOLD[how]}")
    assert not bench.was_enabled


def test_what_was_left_out_is_not_read_back_after_a_fault_either(bench: Bench) -> None:
    first = min(kept(step) for step in bench.host.plans[0].steps if step.proof and step.object_index >= APPLICATION)
    bench.drive.nameless = {first}
    bench.settle()
    bench.drive.state = DriveState.FAULT
    bench.tick(20, enable=False)
    bench.tick(5, enable=False, reset=True)
    bench.was_enabled = False
    bench.settle()
    assert bench.problem == ""
    assert bench.was_enabled


def test_of_an_object_that_went_mute_what_was_written_before_is_read_back(bench: Bench) -> None:
    bench.drive.mute = {(0x60C2, 2)}
    bench.drive.lies[0x60C2, 1] = 0x77
    bench.settle()
    assert "60C2h:01 = 0x77" in bench.problem
    assert not bench.was_enabled
