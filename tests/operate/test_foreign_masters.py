"""canopen's RemoteNode and BaseNode402 on our drives: every transition, mode, transfer, error and mapping."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import canopen
import pytest

from tests.support.foreign_drive import I16, MOTION_DRIVE, U16, U32, Fact, eds_text
from tests.support.foreign_master import NODE, PATIENCE_S, Bench, eventually, foreign_master

pytestmark = pytest.mark.live

NAME = "A servo drive with a name of more than seven bytes"
OPTIONS = {0x605A: 2, 0x605B: 1, 0x605C: 1, 0x605D: 1, 0x605E: 2, 0x6007: 1}
FACTS = (
    MOTION_DRIVE
    | {(index, 0): Fact(I16, "rw", str(value)) for index, value in OPTIONS.items()}
    | {
        (0x6065, 0): Fact(U32, "rw", "100"),
        (0x6066, 0): Fact(U16, "rw", "1"),
        (0x6084, 0): Fact(U32, "rw", "1000000"),
        (0x6085, 0): Fact(U32, "rw", "2000000"),
    }
)
STATES = {  # of the statusword, CiA 402-2: mask, value
    "SOD": (0x4F, 0x40), "RTSO": (0x6F, 0x21), "SO": (0x6F, 0x23), "OE": (0x6F, 0x27), "QSA": (0x6F, 0x07),
    "FAULT": (0x4F, 0x08),
}  # fmt: skip


@pytest.fixture
def eds(tmp_path: Path) -> Path:
    path = tmp_path / "made.eds"
    path.write_text(eds_text(FACTS))
    return path


@pytest.fixture
def bench(eds: Path) -> Iterator[Bench]:
    with foreign_master(eds) as made:
        yield made


def reaches(node: Any, state: str) -> None:
    mask, value = STATES[state]
    eventually(lambda: node.sdo[0x6041].raw & mask == value)


def refused(node: Any, index: int, value: int, subindex: int | None = None) -> int:
    """The abort code of a write."""
    entry = node.sdo[index] if subindex is None else node.sdo[index][subindex]
    with pytest.raises(canopen.SdoAbortedError) as refusal:
        entry.raw = value
    return int(refusal.value.code)


def enabled(bench: Bench, mode: int) -> Any:
    """A node in operation in a mode, with SYNC."""
    node = bench.node(profile=False)
    node.nmt.state = "OPERATIONAL"
    node.sdo[0x6060].raw = mode
    bench.network.sync.start(bench.sync_s)
    for word, state in ((0x06, "RTSO"), (0x07, "SO"), (0x0F, "OE")):
        node.sdo[0x6040].raw = word
        reaches(node, state)
    return node


# CiA 402-2, figure 8: controlword, and the state that it leads to; transitions 2 to 12 and 16, each at least once.
WALK = [
    (0x06, "RTSO"), (0x00, "SOD"), (0x06, "RTSO"), (0x02, "SOD"), (0x06, "RTSO"), (0x07, "SO"), (0x06, "RTSO"),
    (0x07, "SO"), (0x00, "SOD"), (0x06, "RTSO"), (0x07, "SO"), (0x02, "SOD"), (0x06, "RTSO"), (0x0F, "OE"),
    (0x07, "SO"), (0x0F, "OE"), (0x06, "RTSO"), (0x0F, "OE"), (0x00, "SOD"), (0x07, "SOD"), (0x06, "RTSO"),
    (0x0F, "OE"), (0x02, "QSA"), (0x0F, "OE"), (0x02, "QSA"), (0x00, "SOD"), (0x0F, "SOD"),
]  # fmt: skip


@pytest.mark.parametrize("mode", [1, 3, 4, 6, 8, 9, 10])
def test_every_transition_in_every_mode(mode: int, bench: Bench) -> None:
    node = bench.node(profile=False)
    node.nmt.state = "OPERATIONAL"
    node.sdo[0x605A].raw = 6
    node.sdo[0x6060].raw = mode
    assert node.sdo[0x6061].raw == mode
    for word, state in WALK:
        node.sdo[0x6040].raw = word
        reaches(node, state)


def test_a_402_master_goes_from_any_state_to_any_other(bench: Bench) -> None:
    node = bench.operational()
    node.sdo[0x605A].raw = 6
    bench.network.sync.start(bench.sync_s)
    states = ("SWITCH ON DISABLED", "READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED")
    for start in states:
        for target in states:
            node.state = start
            node.state = target
            assert node.state == target
    node.state = "OPERATION ENABLED"
    node.state = "QUICK STOP ACTIVE"
    node.state = "OPERATION ENABLED"
    bench.double.order("fault")
    eventually(lambda: node.check_statusword(PATIENCE_S) is not None and node.is_faulted())
    node.reset_from_fault()
    assert node.state == "OPERATION ENABLED"


def test_positions_speeds_and_torques_are_reached(bench: Bench) -> None:
    node = enabled(bench, 3)
    node.sdo[0x6083].raw = 1_000_000
    node.sdo[0x60FF].raw = 20_000
    eventually(lambda: node.sdo[0x606C].raw == 20_000 and node.sdo[0x6041].raw & 0x400)
    node.sdo[0x6040].raw = 0x10F  # halt: by its ramp, and still enabled
    eventually(lambda: node.sdo[0x606C].raw == 0)
    reaches(node, "OE")
    node.sdo[0x6060].raw = 8
    node.sdo[0x6040].raw = 0x0F
    here = node.sdo[0x6064].raw
    for step in range(1, 6):  # within the window of the following error
        node.sdo[0x607A].raw = here + 20 * step
        eventually(lambda step=step: node.sdo[0x6064].raw == here + 20 * step)  # type: ignore[misc]
    node.sdo[0x6060].raw = 9
    node.sdo[0x60FF].raw = -3000
    eventually(lambda: node.sdo[0x606C].raw == -3000)
    for mode in (4, 10):
        node.sdo[0x6060].raw = mode
        node.sdo[0x6071].raw = 10 * mode
        eventually(lambda mode=mode: node.sdo[0x6077].raw == 10 * mode)  # type: ignore[misc]
        assert node.sdo[0x6061].raw == mode


def test_it_homes(bench: Bench) -> None:
    node = bench.operational()
    node.sdo[0x607C].raw = 1234
    bench.network.sync.start(bench.sync_s)
    assert node.homing()
    assert node.sdo[0x6064].raw == 1234


@pytest.mark.parametrize("length", [1, 4, 5, 7, 8, 14, 21, 100, 256])
def test_values_of_any_length_go_both_ways_in_segments(length: int, bench: Bench) -> None:
    node = bench.node(profile=False)
    content = bytes(65 + at % 26 for at in range(length))
    node.sdo.download(0x2000, 0, content, force_segment=True)
    assert node.sdo.upload(0x2000, 0) == content
    with node.sdo.open(0x2000, mode="rb", block_transfer=True) as file:
        assert file.read() == content


def test_numbers_go_expedited_and_what_does_not_fit_is_refused(bench: Bench) -> None:
    node = bench.node(profile=False)
    for index, value in ((0x6060, -0), (0x6060, 9), (0x605A, 5), (0x6081, 0xFEDCBA98), (0x607A, -2_000_000_000)):
        node.sdo[index].raw = value
        assert node.sdo[index].raw == value
    for index, data, code in (
        (0x605A, b"\1", 0x06070013),  # too short
        (0x605A, b"\1\0\0\0", 0x06070012),  # too long
        (0x6041, b"\0\0", 0x06010002),
        (0x5FFF, b"\0", 0x06020000),
    ):
        with pytest.raises(canopen.SdoAbortedError) as refusal:
            node.sdo.download(index, 0, data)
        assert refusal.value.code == code
    for index in (0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6060):
        assert refused(node, index, -7) == 0x06090030


@pytest.mark.parametrize("answers", ["expedited", "unsized", "segmented", "block"])
def test_a_master_reads_whatever_way_the_drive_answers(answers: str, eds: Path) -> None:
    with foreign_master(eds, answers=answers) as bench:
        node = bench.node(profile=False)
        assert node.sdo[0x1000].raw == 0x20192
        if answers == "block":
            with pytest.raises(canopen.SdoAbortedError) as refusal:
                node.sdo.upload(0x1008, 0)
            assert refusal.value.code == 0x05040001
        else:
            assert node.sdo[0x1008].raw == NAME
        with node.sdo.open(0x1008, mode="rb", block_transfer=True) as file:
            assert file.read().decode() == NAME


def test_heartbeats_are_told_and_the_masters_are_heard(bench: Bench) -> None:
    node = bench.node(profile=False)
    node.sdo[0x1017].raw = round(1000 * bench.sync_s)  # ms
    for command, state in (("OPERATIONAL", "OPERATIONAL"), ("STOPPED", "STOPPED"), ("PRE-OPERATIONAL",) * 2):
        node.nmt.state = command
        eventually(lambda state=state: node.nmt.wait_for_heartbeat(PATIENCE_S) == state)  # type: ignore[misc]
    node.sdo[0x1016][1].raw = 0x7F << 16 | 20_000  # ms: longer than a loaded computer is late
    node.nmt.state = "OPERATIONAL"
    heartbeat = bench.network.send_periodic(0x77F, b"\5", 0.02)
    bench.network.sync.start(bench.sync_s)
    for word, state in ((0x06, "RTSO"), (0x0F, "OE")):
        node.sdo[0x6040].raw = word
        reaches(node, state)
    assert node.emcy.log == []
    heartbeat.stop()
    node.sdo[0x1016][1].raw = 0x7F << 16 | 50
    bench.network.send_message(0x77F, b"\5")  # arms it anew, and is the last
    eventually(lambda: any(error.code == 0x8130 for error in node.emcy.log))
    reaches(node, "FAULT")  # 6007h = 1
    eventually(lambda: node.nmt.wait_for_heartbeat(PATIENCE_S) == "PRE-OPERATIONAL")  # without 1029h


def test_a_held_shaft_is_an_emergency_with_history_register_and_reset(bench: Bench) -> None:
    node = enabled(bench, 8)
    bench.double.order("block")
    node.sdo[0x607A].raw = node.sdo[0x6064].raw + 5000
    eventually(lambda: any(error.code == 0x8611 for error in node.emcy.log))
    reaches(node, "FAULT")
    assert node.sdo[0x6041].raw & 0x2000
    assert (node.sdo[0x603F].raw, node.sdo[0x1001].raw) == (0x8611, 0x01)
    assert (node.sdo[0x1003][0].raw, node.sdo[0x1003][1].raw) == (1, 0x8611)
    bench.double.order("unblock")
    node.sdo[0x6040].raw = 0x80
    reaches(node, "SOD")
    eventually(lambda: node.emcy.active == [])
    node.sdo[0x1003][0].raw = 0
    assert node.sdo[0x1003][1].raw == 0


def remap(pdo: Any, objects: tuple[int, ...], kind: int, can_id: int | None = None) -> None:
    pdo.clear()
    for index in objects:
        pdo.add_variable(index)
    pdo.cob_id = can_id or pdo.cob_id
    pdo.trans_type, pdo.enabled = kind, True
    pdo.save()


def test_pdos_are_mapped_anew_cyclic_event_driven_and_at_once(bench: Bench) -> None:
    node = bench.node(profile=False)
    node.tpdo.read()
    node.rpdo.read()
    node.nmt.state = "PRE-OPERATIONAL"
    remap(node.tpdo[1], (0x6064, 0x6061), 3, 0x1A3)
    remap(node.tpdo[2], (0x6041,), 255)
    remap(node.rpdo[1], (0x6040, 0x6060, 0x60FF), 255)
    counts = {1: 0, 2: 0}
    node.tpdo[1].add_callback(lambda pdo: counts.update({1: counts[1] + 1}))
    node.tpdo[2].add_callback(lambda pdo: counts.update({2: counts[2] + 1}))
    node.nmt.state = "OPERATIONAL"
    eventually(lambda: counts[2] == 1)  # what it says first
    for _ in range(9):
        bench.network.sync.transmit()
    assert node.sdo[0x1001].raw == 0  # frames keep their order
    assert counts == {1: 3, 2: 1}
    for word in (0x06, 0x07, 0x0F):
        told = counts[2]
        node.rpdo[1][0x6040].raw, node.rpdo[1][0x6060].raw, node.rpdo[1][0x60FF].raw = word, 9, 700
        node.rpdo[1].transmit()
        eventually(lambda told=told: counts[2] == told + 1)  # type: ignore[misc]
    assert node.sdo[0x6061].raw == 9
    assert node.sdo[0x60FF].raw == 700
    assert node.sdo[0x606C].raw == 0  # a synchronous target waits for SYNC
    bench.network.sync.transmit()
    eventually(lambda: node.sdo[0x606C].raw == 700)


def test_a_mapping_that_cannot_be_is_refused_with_the_code_for_it(bench: Bench) -> None:
    node = bench.node(profile=False)
    assert refused(node, 0x1A00, 1, 0) == 0x08000022  # while it is valid
    node.sdo[0x1800][1].raw = 0xC0000180 + NODE
    node.sdo[0x1A00][0].raw = 0
    assert refused(node, 0x1A00, 0x10010008, 1) == 0x06040041  # not mappable
    assert refused(node, 0x1A00, 0x60640010, 1) == 0x06040041  # not that long
    assert refused(node, 0x1A00, 0x5FFF0008, 1) == 0x06020000
    for place, entry in enumerate((0x60640020, 0x606C0020, 0x60410010), 1):
        node.sdo[0x1A00][place].raw = entry
    assert refused(node, 0x1A00, 3, 0) == 0x06040042  # ten bytes
    node.sdo[0x1A00][0].raw = 2
    for kind in (0, 241, 252, 253):
        assert refused(node, 0x1800, kind, 2) == 0x06090030
    assert refused(node, 0x1800, 0x40000600 + NODE, 1) == 0x06090030  # an identifier of SDO
    node.sdo[0x1800][1].raw = 0x40000180 + NODE


def test_a_reset_brings_the_file_back(bench: Bench) -> None:
    node = enabled(bench, 9)
    node.sdo[0x605A].raw, node.sdo[0x1017].raw = 5, 50
    node.nmt.state = "RESET"
    assert (node.sdo[0x605A].raw, node.sdo[0x1017].raw, node.sdo[0x6061].raw) == (2, 0, 0)
    assert node.sdo[0x6041].raw & 0x4F == 0x40
