"""Frames of start and stop with values beside the one that says it."""

from pathlib import Path
from typing import Any

import pytest

from drivers.config import BusConfig
from drivers.protocols import LayoutError, device_protocol, host_protocol
from drivers.protocols.base import Command, Reject

MS = 1_000_000
TEXT = """VERSION ""
NS_ :
BS_:
BU_: H D
BO_ 770 Fb: 8 D
 SG_ Pos : 0|32@1- (1,0) [0|0] "" H
 SG_ State : 32|8@1+ (1,0) [0|0] "" H
BO_ 771 Cmd: 8 H
 SG_ Tq : 0|16@1- (1,0) [0|0] "" D
BO_ 772 Order: 8 H
 SG_ Kind M : 0|8@1+ (1,0) [0|0] "" D
 SG_ Code : 8|8@1+ (1,0) [0|0] "" D
 SG_ Key m3 : 23|16@0- (1,0) [0|0] "" D
 SG_ Node m5 : 16|8@1+ (1,0) [0|0] "" D
SG_MUL_VAL_ 772 Key Kind 3-4;
"""
KEY = [{"signal": "Key", "value": -2}]


def table(start: dict[str, Any], stop: dict[str, Any]) -> dict[str, Any]:
    return {
        "position": [{"message": "Fb", "signal": "Pos"}],
        "torque": [{"message": "Cmd", "signal": "Tq", "scale": 0.01}],
        "status": [{"message": "Fb", "signal": "State", "enabled": [5]}],
        "start": [{"message": "Order", **start}],
        "stop": [{"message": "Order", **stop}],
    }


def ends(folder: Path, start: dict[str, Any], stop: dict[str, Any]) -> tuple[Any, Any]:
    (folder / "made.dbc").write_text(TEXT)
    bus = BusConfig.model_validate({"protocol": "dbc:made.dbc", "dbc": table(start, stop)})
    return host_protocol(bus, 1, [20.0], folder, MS), device_protocol(bus, 1, [20.0], folder)


@pytest.mark.parametrize(
    ("constant", "data"),
    [
        (KEY, "03fcfffe"),
        ([*KEY, {"signal": "Kind", "value": 4}], "04fcfffe"),  # the page, where there are several
        ([{"signal": "Kind", "value": 5}, {"signal": "Node", "value": 9}], "05fc0900"),
        ([{"signal": "Kind", "value": 7}], "07fc0000"),
        ([], "00fc0000"),
    ],
)
def test_a_constant_stands_beside_the_order_in_its_frame(
    constant: list[dict[str, Any]], data: str, tmp_path: Path
) -> None:
    start, stop = ({"signal": "Code", "value": value, "constant": constant} for value in (0xFC, 0xFD))
    host, device = ends(tmp_path, start, stop)
    stopped, _ = host.encode(Command(0, [0.0], 0, False))
    started, torque = host.encode(Command(1, [1.0], 1, False))
    assert (started.data.hex(), stopped.data.hex()) == (data + "00000000", data.replace("fc", "fd") + "00000000")
    assert device.decode_command(started) is Reject.SERVICE
    assert device.decode_command(torque).enable == 1
    half = started._replace(data=started.data[:2] + b"\x55\x55" + started.data[4:])
    assert device.decode_command(stopped) is device.decode_command(half) is Reject.SERVICE
    assert device.decode_command(torque).enable == 0  # the order without its constant starts nothing


def test_start_and_stop_may_differ_in_their_constants_alone(tmp_path: Path) -> None:
    on, off = ({"signal": "Code", "value": 1, "constant": [{"signal": "Key", "value": key}]} for key in (7, 8))
    host, _ = ends(tmp_path, on, off)
    assert host.encode(Command(0, [0.0], 0, False))[0].data.hex() == "0301000800000000"
    with pytest.raises(LayoutError, match="start and stop are the same frame of Order"):
        ends(tmp_path, on, on)


@pytest.mark.parametrize(("on", "off", "fits"), [(1, 2, True), (1, 0, False), (0, 2, False)])
def test_an_order_in_the_message_of_the_torque_is_never_a_torque(on: int, off: int, fits: bool, tmp_path: Path) -> None:
    """A command has zero in the order's signal, as nothing else is bound there."""
    text = TEXT.replace("BO_ 772", ' SG_ Mode : 16|8@1+ (1,0) [0|0] "" D\nBO_ 772')
    (tmp_path / "made.dbc").write_text(text)
    frames = {
        key: [{"message": "Cmd", "signal": "Mode", "value": value}] for key, value in (("start", on), ("stop", off))
    }
    bus = BusConfig.model_validate({"protocol": "dbc:made.dbc", "dbc": table({}, {}) | frames})
    if fits:
        assert host_protocol(bus, 1, [20.0], tmp_path, MS).encode(Command(0, [0.0], 0, False))[0].data[2] == off
        return
    with pytest.raises(LayoutError, match=r"made\.dbc: message Cmd is bound as command, and a frame of it stands"):
        host_protocol(bus, 1, [20.0], tmp_path, MS)


@pytest.mark.parametrize(
    ("constant", "says"),
    [
        ([{"signal": "Kay", "value": 1}], r"start\[0\].constant\[0\]: message Order has no signal 'Kay'; did you mean"),
        ([*KEY, {"signal": "Key", "value": 3}], r"start\[0\].constant\[1\]: Order.Key = 3: its value is stated as -2"),
        ([{"signal": "Code", "value": 3}], r"start\[0\].constant\[0\]: Order.Code = 3: its value is stated as 0 alr"),
        ([{"signal": "Key", "value": 40000}], r"start\[0\]: Order.Key = 40000: allowed -32768 to 32767"),
        ([{"signal": "Node", "value": 256}], r"start\[0\]: Order.Node = 256: allowed 0 to 255"),
        ([*KEY, {"signal": "Kind", "value": 5}], r"no value of the multiplexer Order.Kind has a page with all of Code"),
        ([*KEY, {"signal": "Node", "value": 1}], "has a page with all of Code, Key, Node"),
    ],
)
def test_a_constant_that_cannot_be_is_refused_in_one_line(
    constant: list[dict[str, Any]], says: str, tmp_path: Path
) -> None:
    with pytest.raises(LayoutError, match=says) as refusal:
        ends(tmp_path, {"signal": "Code", "constant": constant}, {"signal": "Code", "value": 1})
    assert "\n" not in str(refusal.value)
