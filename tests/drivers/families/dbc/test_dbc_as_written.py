"""What a DBC file says beside its signals: the bit rate switch, pages of different length, identifiers used twice."""

from pathlib import Path
from typing import Any

import pytest

from drivers.bus_load.schedulability import frame_bits
from drivers.config import BusConfig
from drivers.frame import BRS, FD, Frame
from drivers.protocols import host_protocol
from drivers.protocols.base import Command, HostProtocol, LayoutError, Reject, Sample

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: A\n'
FD_FILE = (
    HEAD
    + 'BO_ 100 Fb: 8 A\n SG_ Pos : 0|32@1- (1,0) [0|0] "" A\nBO_ 101 Cmd: 8 A\n SG_ Tq : 0|16@1- (1,0) [0|0] "" A\n'
    'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","r2","r3","r4","r5","r6","r7","r8","r9","r10","r11",'
    '"r12","r13","StandardCAN_FD","ExtendedCAN_FD";\nBA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'
    'BA_ "VFrameFormat" BO_ 100 14;\nBA_ "VFrameFormat" BO_ 101 14;\n'
)
SWITCH = 'BA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";\nBA_DEF_DEF_ "CANFD_BRS" "{default}";\n'
PAGES = (
    HEAD + 'BO_ 770 Fb: 7 A\n SG_ mux M : 0|7@1+ (1,0) [0|0] "" A\n SG_ Pos m1 : 8|32@1- (1,0) [0|0] "" A\n'
    ' SG_ Temp m2 : 8|8@1+ (1,0) [0|255] "" A\nBO_ 771 Cmd: 8 A\n SG_ Tq : 0|16@1- (1,0) [0|0] "" A\n'
)


def host(folder: Path, text: str, **more: Any) -> HostProtocol:
    (folder / "made.dbc").write_text(text)
    dbc = {"position": [{"message": "Fb", "signal": "Pos"}], "torque": [{"message": "Cmd", "signal": "Tq"}], **more}
    bus = BusConfig.model_validate({"protocol": "dbc:made.dbc", "dbc": dbc})
    return host_protocol(bus, 1, [20.0], folder, 1_000_000)


@pytest.mark.parametrize(
    ("said", "flags"),
    [
        ("", FD | BRS),
        (SWITCH.format(default="1"), FD | BRS),
        (SWITCH.format(default="0"), FD),
        (SWITCH.format(default="1") + 'BA_ "CANFD_BRS" BO_ 101 0;\n', FD),
        (SWITCH.format(default="0") + 'BA_ "CANFD_BRS" BO_ 101 1;\n', FD | BRS),
    ],
)
def test_a_frame_changes_its_bit_rate_as_the_file_says(said: str, flags: int, tmp_path: Path) -> None:
    made = host(tmp_path, FD_FILE + said)
    (frame,) = made.encode(Command(0, [1.0], 1, False))
    assert frame.flags == flags
    command = next(message for message in made.messages(1_000_000) if message.can_id == 101)
    assert bool(frame_bits(command)[1]) is bool(flags & BRS)  # without it all bits cost what nominal ones do


@pytest.mark.parametrize(
    ("data", "outcome"),
    [
        ("01e803000000 00".replace(" ", ""), 1000),  # whole
        ("01e8030000", 1000),  # cut behind its own signals
        ("01e80300", Reject.WRONG_LENGTH),  # cut in its own signals
        ("0219", Reject.SERVICE),  # a page that nobody binds, as short as it is
        ("02190000000000", Reject.SERVICE),
        ("", Reject.WRONG_LENGTH),
        ("01e80300000000ff", Reject.WRONG_LENGTH),
    ],
)
def test_a_page_may_be_shorter_than_its_message(data: str, outcome: int | Reject, tmp_path: Path) -> None:
    found = host(tmp_path, PAGES).decode(Frame(770, bytes.fromhex(data)))
    assert (found.position if isinstance(found, Sample) else found) == outcome


@pytest.mark.parametrize("key", ["error", "constant"])
def test_a_position_or_a_torque_has_a_signal_to_itself(key: str, tmp_path: Path) -> None:
    message, signal = {"error": ("Fb", "Pos"), "constant": ("Cmd", "Tq")}[key]
    entry = {"message": message, "signal": signal} | ({"value": 1} if key == "constant" else {})
    with pytest.raises(LayoutError, match=rf"bus.dbc.{key}\[0\]: {message}.{signal} is bus.dbc.\w+\[0\] already"):
        host(tmp_path, PAGES.replace("8|32@1-", "8|32@1+"), **{key: [entry]})


@pytest.mark.parametrize(
    ("key", "entry"),
    [("constant", {"value": 2}), ("constant", {"value": -1}), ("enable", {"on": 4}), ("reset", {"on": 1, "off": 9})],
)
def test_what_does_not_fit_its_signal_is_refused(key: str, entry: dict[str, int], tmp_path: Path) -> None:
    text = PAGES + ' SG_ Bit : 16|1@1+ (1,0) [0|1] "" A\n'
    with pytest.raises(LayoutError, match=rf"bus.dbc.{key}\[0\]: raw value -?\d: allowed 0 to 1"):
        host(tmp_path, text, **{key: [{"message": "Cmd", "signal": "Bit"} | entry]})


def test_two_axes_cannot_have_one_torque(tmp_path: Path) -> None:
    (tmp_path / "made.dbc").write_text(PAGES.replace("m2", "m1").replace("8|8@1+", "40|8@1+"))
    torque = [{"message": "Cmd", "signal": "Tq"}] * 2
    position = [{"message": "Fb", "signal": "Pos"}, {"message": "Fb", "signal": "Temp"}]
    bus = BusConfig.model_validate({"protocol": "dbc:made.dbc", "dbc": {"position": position, "torque": torque}})
    with pytest.raises(LayoutError, match=r"bus.dbc.torque\[1\]: Cmd.Tq is bus.dbc.torque\[0\] already"):
        host_protocol(bus, 2, [20.0, 20.0], tmp_path, 1_000_000)


def test_two_bound_messages_on_one_identifier_are_refused_in_one_line(tmp_path: Path) -> None:
    text = PAGES + 'BO_ 771 Order: 8 A\n SG_ Code : 0|64@1+ (1,0) [0|0] "" A\n'
    frames = {
        key: [{"message": "Order", "signal": "Code", "value": value}] for key, value in (("start", 1), ("stop", 2))
    }
    with pytest.raises(LayoutError, match="messages Cmd and Order are both bound, on one identifier, 0x303") as refusal:
        host(tmp_path, text, **frames)
    assert "\n" not in str(refusal.value)
    host(tmp_path, text)  # whom nobody binds may have any
