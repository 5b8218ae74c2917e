"""Signals that stand on several pages of a multiplexed message are named by page, as the file writes them."""

from pathlib import Path
from typing import Any

import pytest

from drivers.config import BusConfig
from drivers.frame import Frame
from drivers.protocols import LayoutError, device_protocol, host_protocol
from drivers.protocols.base import Command, DriveStatus, Sample

MS = 1_000_000
HEAD = """VERSION ""
NS_ :
BS_:
BU_: H D
BO_ 770 Fb: 8 D
 SG_ Kind M : 0|8@1+ (1,0) [0|0] "" H
 SG_ Pos m1 : 8|32@1- (1,0) [0|0] "" H
 SG_ State m1 : 40|8@1+ (1,0) [0|0] "" H
"""
COMMAND = """BO_ 771 Cmd: 8 H
 SG_ Sort M : 0|8@1+ (1,0) [0|0] "" D
 SG_ Tq m1 : 8|16@1- (1,0) [0|0] "" D
 SG_ On m1 : 24|8@1+ (1,0) [0|0] "" D
"""
# Several signals of one name, and one signal with several values: State and On are on pages 1 and 3.
DOUBLES = (
    HEAD
    + ' SG_ State m3 : 8|8@1+ (1,0) [0|0] "" H\n'
    + COMMAND
    + ' SG_ On m3 : 8|8@1+ (1,0) [0|0] "" D\n SG_ Limit m4 : 8|8@1+ (1,0) [0|0] "" D\n'
    + ' SG_ Limit m5 : 16|8@1+ (1,0) [0|0] "" D\n'
)
RANGES = (
    HEAD
    + COMMAND
    + ' SG_ Limit m4 : 8|8@1+ (1,0) [0|0] "" D\n'
    + "SG_MUL_VAL_ 770 State Kind 1-1, 3-3;\nSG_MUL_VAL_ 771 On Sort 1-1, 3-3;\nSG_MUL_VAL_ 771 Limit Sort 4-5;\n"
)
BOTH = pytest.mark.parametrize("text", [DOUBLES, RANGES], ids=["doubles", "ranges"])
ALIKE: dict[str, Any] = {
    "position": [{"message": "Fb", "signal": "Pos m1"}],  # the page may be said where there is only one, too
    "torque": [{"message": "Cmd", "signal": "Tq", "scale": 0.01}],
    "enable": [{"message": "Cmd", "signal": "On m1"}],
    "status": [{"message": "Fb", "signal": "State m1", "enabled": [7]}],
}


def ends(folder: Path, text: str, **changes: Any) -> tuple[Any, Any]:
    (folder / "made.dbc").write_text(text)
    bus = BusConfig.model_validate({"protocol": "dbc:made.dbc", "dbc": ALIKE | changes})
    return host_protocol(bus, 1, [20.0], folder, MS), device_protocol(bus, 1, [20.0], folder)


@BOTH
def test_a_signal_is_read_on_its_page_alone(text: str, tmp_path: Path) -> None:
    host, device = ends(tmp_path, text)
    (frame,) = device.frames_of(Sample(0, 1234, int(DriveStatus.ENABLED), -1, 0))
    assert frame.data == bytes((1, 0xD2, 4, 0, 0, 7, 0, 0))
    assert host.decode(frame).status == DriveStatus.ENABLED
    host.decode(Frame(770, bytes((3, 0, 0, 0, 0, 0, 0, 0))))  # another page: its state is bound by nobody
    assert host.decode(frame).status == DriveStatus.ENABLED
    assert host.decode(frame._replace(data=frame.data[:5] + bytes(3))).status == 0


@BOTH
def test_a_command_has_its_signals_in_one_frame(text: str, tmp_path: Path) -> None:
    host, device = ends(tmp_path, text)
    (frame,) = host.encode(Command(0, [-0.02], 1, False))
    assert frame.data == bytes((1, 0xFE, 0xFF, 1, 0, 0, 0, 0))
    assert device.decode_command(frame).enable == 1


@BOTH
def test_pages_with_such_a_signal_may_be_sent_on_change(text: str, tmp_path: Path) -> None:
    constant = [{"message": "Cmd", "signal": "Limit m5", "value": 9}]
    host, _ = ends(tmp_path, text, constant=constant, on_change=["Cmd.Limit m5"])
    first, second = (host.encode(Command(tick, [0.0], 0, False)) for tick in (0, 1))
    assert [frame.data[0] for frame in first] == [5, 1]
    assert 9 in first[0].data[1:]
    assert [frame.data[0] for frame in second] == [1]


@pytest.mark.parametrize(
    ("text", "changes", "says"),
    [
        (DOUBLES, {"status": "State"}, r"status\[0\]: Fb.State stands on 2 pages; name one: 'State m1' or 'State m3'"),
        (DOUBLES, {"enable": "On"}, r"enable\[0\]: Cmd.On stands on 2 pages; name one: 'On m1' or 'On m3'"),
        (DOUBLES, {"status": "State m2"}, r"message Fb has no signal 'State m2'; did you mean Fb.State m\d or"),
        (RANGES, {"status": "State m2"}, "message Fb has no signal 'State m2'; did you mean Fb.State"),
        (RANGES, {"status": "State m1", "error": "State"}, "Fb: State is bound on page 'State m1' and on all"),
        (RANGES, {"enable": "On"}, "message Cmd: two of its bound pages are one by their multiplexers"),
        (RANGES, {"status": "State"}, "message Fb: two of its bound pages are one by their .* 'SIGNAL m1'"),
        (RANGES, {"status": "Kind"}, r"bus.dbc.status\[0\]: Fb.Kind is a multiplexer and says which page is bound"),
        (RANGES, {"enable": "Sort"}, r"bus.dbc.enable\[0\]: Cmd.Sort is a multiplexer and says which page is bound"),
        (RANGES, {"checksum": "Kind"}, r"bus.dbc.checksum\[0\]: Fb.Kind is a multiplexer and says which page"),
        (DOUBLES.replace(" m3 :", " m1 :"), {}, r"message Fb has 2 signals 'State m1'"),
    ],
)
def test_what_is_not_one_page_is_refused_in_one_line(
    text: str, changes: dict[str, str], says: str, tmp_path: Path
) -> None:
    bound = {key: [{"message": "Cmd" if key == "enable" else "Fb", "signal": name}] for key, name in changes.items()}
    with pytest.raises(LayoutError, match=says) as refusal:
        ends(tmp_path, text, **bound)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("page", "sums"), [(" m1", ("04", "00")), ("", ("04", "0d"))])
def test_a_checksum_protects_the_pages_that_have_it(page: str, sums: tuple[str, str], tmp_path: Path) -> None:
    text = DOUBLES + f' SG_ Sum{page} : 56|8@1+ (1,0) [0|0] "" D\n'
    host, _ = ends(
        tmp_path,
        text,
        checksum=[{"message": "Cmd", "signal": "Sum"}],
        checksum_algorithm="sum8",
        constant=[{"message": "Cmd", "signal": "Limit m4", "value": 9}],
    )
    first, second = sorted(frame.data for frame in host.encode(Command(0, [0.02], 1, False)))
    assert (first.hex(), second.hex()) == ("01020001000000" + sums[0], "04090000000000" + sums[1])


def test_pages_that_nothing_selects_are_told(tmp_path: Path) -> None:
    text = HEAD.replace("Kind M", "Kind") + COMMAND
    host, _ = ends(tmp_path, text, position=[{"message": "Fb", "signal": "Pos"}], status=[])
    assert host.warnings == ["made.dbc: message Fb has no multiplexer (M), so it is read as one page: Pos m1, State m1"]
    assert host.decode(Frame(770, bytes((9, 0xD2, 4, 0, 0, 0, 0, 0)))).position == 1234
    assert not ends(tmp_path, HEAD + COMMAND)[0].warnings
