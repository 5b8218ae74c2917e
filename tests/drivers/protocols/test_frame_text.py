"""CANopen's own traffic in words, for whoever watches a bus."""

import struct
from pathlib import Path

import pytest

from drivers.config import BusConfig
from drivers.families.cia402.emergency import emergency_words
from drivers.families.cia402.services import service_text
from drivers.frame import BRS, ERROR, EXTENDED, FD, REMOTE, Frame
from drivers.protocols import device_protocol, host_protocol
from drivers.protocols.base import Command, DriveStatus, LayoutError, Sample
from drivers.protocols.frame_text import command_text, layout_reader
from tests.support.foreign_drive import CST_DRIVE, eds_text

RATED = [5.0, 2.0]


@pytest.mark.parametrize(
    ("can_id", "data", "says"),
    [
        (0x000, "01 00", "NMT start, all nodes"),
        (0x000, "81 05", "NMT reset node, node 5"),
        (0x000, "33 05", "NMT command 0x33, node 5"),
        (0x080, "", "SYNC"),
        (0x080, "f0", "SYNC 240"),
        (0x705, "05", "node 5: operational"),
        (0x705, "85", "node 5: operational"),
        (0x705, "33", "node 5: state 0x33"),
        (0x085, "30 81 11 00 00 00 00 00", "node 5: emergency 8130h: heartbeat or life guarding"),
        (0x685, "00 00 00 00 00 00 00 00", "node 5: emergency 0000h: no error any more"),
        (0x605, "40 41 60 00 00 00 00 00", "to node 5: SDO read 6041h:00"),
        (0x605, "2f 60 60 00 0a ff ff ff", "to node 5: SDO write 6060h:00 = 0xa"),
        (0x605, "2b 40 60 00 0f 01 ff ff", "to node 5: SDO write 6040h:00 = 0x10f"),
        (0x605, "22 40 60 00 0f 01 02 03", "to node 5: SDO write 6040h:00 = 0x302010f"),
        (0x585, "4b 41 60 00 37 02 ff ff", "node 5: SDO 6041h:00 is 0x237"),
        (0x585, "42 41 60 00 37 02 01 00", "node 5: SDO 6041h:00 is 0x10237"),
    ],
)
def test_canopens_own_frames_are_told_and_no_other_is(can_id: int, data: str, says: str) -> None:
    frame = Frame(can_id, bytes.fromhex(data), 0, 0)
    assert service_text(frame).lower().startswith(says.lower())
    for bit in (EXTENDED, REMOTE, ERROR):
        assert service_text(frame._replace(can_id=can_id | bit)) == ""
    assert service_text(frame._replace(flags=FD | BRS)) == ""


@pytest.mark.parametrize(
    ("can_id", "length"), [(0x000, 1), (0x185, 8), (0x205, 8), (0x585, 7), (0x605, 4), (0x680, 8), (0x705, 2)]
)
def test_process_data_and_what_has_another_length_are_no_service(can_id: int, length: int) -> None:
    assert service_text(Frame(can_id, bytes(length), 0, 0)) == ""


CLASSES = {
    0x54: "power section", 0x61: "internal software", 0x62: "user software", 0x63: "data set", 0x71: "power unit",
    0x73: "sensor", 0x81: "communication", 0x82: "protocol", 0x90: "external error", 0xFF: "device specific",
    0x10: "generic error", 0x21: "current", 0x33: "voltage", 0x44: "temperature", 0x51: "hardware of the device",
    0x6F: "software of the device", 0x70: "additional modules", 0x80: "monitoring", 0xF0: "additional functions",
    0xA0: "unknown code",
}  # fmt: skip


@pytest.mark.parametrize(("high", "words"), CLASSES.items())
def test_a_code_that_has_no_words_of_its_own_has_those_of_its_class(high: int, words: str) -> None:
    for low in (0x01, 0x02, 0xFE):
        data = struct.pack("<HB5s", high << 8 | low, 0, bytes(5))
        assert emergency_words(data) == f"emergency {high << 8 | low:04X}h: {words}; error register none"


def test_an_emergency_names_the_bits_of_the_register_and_shows_the_makers_bytes() -> None:
    said = emergency_words(struct.pack("<HB5s", 0x7320, 0x21, b"\0\0\x12\0\xab"))
    assert said == "emergency 7320h: position sensor; error register generic, profile; maker's bytes 00 00 12 00 ab"


def test_a_command_says_each_axis_force_and_what_is_disabled() -> None:
    said = command_text(Command(7, [0.5, -1.25], 0b01, True), ["x", "y"])
    assert said == "force x +0.5, y -1.25 (disabled), reset"
    assert command_text(Command(7, [0.0, 0.0], 0b11, False), ["x", "y"]) == "force x +0, y +0"


@pytest.mark.parametrize(("protocol", "answers"), [("stage_fd", ", answers 3"), ("cia402", "")])
def test_a_sample_says_its_state_and_what_it_answers_where_its_layout_counts(protocol: str, answers: str) -> None:
    bus = BusConfig(protocol=protocol)
    read, device = layout_reader(bus, ["x", "y"], RATED, Path()), device_protocol(bus, 2, RATED, Path())
    for status, words in ((0, "not enabled"), (DriveStatus.ENABLED, "ENABLED"), (DriveStatus.FAULT, "FAULT")):
        assert read(device.encode_feedback(Sample(1, -70, int(status), 3, 0))) == f"y: position -70, {words}{answers}"


def test_a_command_is_told_with_its_last_frame_and_what_is_wrong_with_one_by_its_reason() -> None:
    bus = BusConfig(protocol="stage_fd")
    read, host = layout_reader(bus, ["x", "y"], RATED, Path()), host_protocol(bus, 2, RATED, Path())
    (command,) = host.encode(Command(7, [0.5, -1.25], 0b11, False))
    force = read(command).removeprefix("force ")
    assert [f"{float(part[2:]):.3f}" for part in force.split(", ")] == ["0.500", "-1.250"]
    feedback = device_protocol(bus, 2, RATED, Path()).encode_feedback(Sample(0, 5, 0, 0, 0))
    assert read(feedback) == "x: position 5, not enabled, answers 0"
    for frame in (command, feedback):
        turned = frame.data[:-1] + bytes((frame.data[-1] ^ 1,))
        assert read(frame._replace(data=turned)) == "bad checksum"
        assert read(frame._replace(data=frame.data[:4])) == "wrong length"
        assert read(frame._replace(flags=0)) == "wrong format"
    assert read(command._replace(can_id=0x7F0)) == ""


def test_own_traffic_of_canopen_is_told_on_a_bus_of_canopen_alone() -> None:
    beat = Frame(0x705, b"\x05")
    assert layout_reader(BusConfig(protocol="cia402"), ["x"], [5.0], Path())(beat) == "node 5: operational"
    assert layout_reader(BusConfig(protocol="stage_fd"), ["x"], [5.0], Path())(beat) == ""


DBC = """VERSION ""

BU_: Host Drive

BO_ 256 Told: 6 Drive
 SG_ Mode : 0|8@1+ (1,0) [0|0] "" Host
 SG_ Speed : 8|8@1- (0.123456789,0) [0|0] "rpm" Host
 SG_ Position : 16|32@1- (1,0) [0|0] "counts" Host

BO_ 2147483904 Asked: 2 Host
 SG_ Torque : 0|16@1- (1,0) [0|0] "" Drive

BO_ 512 Paged: 2 Drive
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" Host
 SG_ One m1 : 8|8@1+ (1,0) [0|0] "" Host

VAL_ 256 Mode 3 "Cyclic" ;
"""


def test_a_dbc_file_gives_messages_and_signals_their_names_units_and_words(tmp_path: Path) -> None:
    (tmp_path / "any.dbc").write_text(DBC)
    torque, position = ({"message": of, "signal": s} for of, s in (("Asked", "Torque"), ("Told", "Position")))
    bus = BusConfig.model_validate({"protocol": "dbc:any.dbc", "dbc": {"torque": [torque], "position": [position]}})
    read = layout_reader(bus, ["x"], [5.0], tmp_path)
    told = Frame(0x100, struct.pack("<Bbi", 3, 100, -70))
    assert read(told) == "Told: Mode Cyclic, Speed 12.3457 rpm, Position -70 counts"
    assert read(told._replace(data=told.data[:2])) == "Told: Mode Cyclic, Speed 12.3457 rpm"
    assert read(Frame(EXTENDED | 0x100, b"\xfe\xff")) == "Asked: Torque -2"
    assert read(Frame(0x101, b"")) == ""
    assert read(Frame(0x200, b"\x01\x07")) == "Paged: Page 1, One 7"
    assert read(Frame(0x200, b"\x02\x07")).startswith("Paged: DecodeError ")


def test_a_dbc_file_without_a_binding_is_refused_as_a_layout_is(tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match=r"bus\.dbc"):
        layout_reader(BusConfig(protocol="dbc:any.dbc"), ["x"], [5.0], tmp_path)


def test_positions_are_told_where_torques_have_a_unit_that_only_the_drive_knows(tmp_path: Path) -> None:
    (tmp_path / "made.eds").write_text(eds_text(CST_DRIVE))
    bus = BusConfig.model_validate({"protocol": "cia402", "cia402": {"eds": ["made.eds"], "nodes": [1, 2]}})
    with pytest.raises(LayoutError, match="rated_torque"):
        device_protocol(bus, 2, RATED, tmp_path)
    read = layout_reader(bus, ["x", "y"], RATED, tmp_path)
    assert read(Frame(0x182, struct.pack("<iH", -70, 0x0027), 0, 0)) == "y: position -70, ENABLED"


def test_every_code_that_has_words_of_its_own_says_them() -> None:
    known = {
        0x2310: "continuous over-current at the output", 0x2320: "short circuit or earth leakage at the output",
        0x3210: "over-voltage of the DC link", 0x3220: "under-voltage of the DC link",
        0x4210: "excess temperature of the device", 0x4310: "excess temperature of the drive",
        0x6320: "parameter error", 0x7121: "motor blocked", 0x7305: "incremental encoder 1", 0x7320: "position sensor",
        0x8110: "CAN overrun", 0x8120: "CAN in error passive",
        0x8130: "heartbeat or life guarding: the host fell silent", 0x8140: "recovered from bus-off",
        0x8210: "PDO not processed: too short", 0x8220: "PDO too long", 0x8240: "unexpected length of SYNC",
        0x8250: "RPDO timed out", 0x8611: "following error", 0x8612: "reference limit",
    }  # fmt: skip
    for code, words in known.items():
        assert emergency_words(struct.pack("<HB5x", code, 0)) == f"emergency {code:04X}h: {words}; error register none"
    for high, words in CLASSES.items():
        for code in (high << 8, high << 8 | 0xFF):
            assert emergency_words(struct.pack("<HB5x", code, 0)).split(": ")[1] == f"{words}; error register none"
    assert emergency_words(bytes(8)) == "emergency 0000h: no error any more"
