"""The numbers of an ODrive's endpoints stand once: in its firmware's flat_endpoints.json, or in the DBC file."""

import json
import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest

from drivers.protocols.base import Command, LayoutError
from hil.cycle.state_machine import State
from hil.rig.layout import host_layout
from hil.rig.provenance import describe_run, rig_of_run
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from sim_plant.drives import odrive
from tests.support.bought_drives import ODRIVE_DBC
from tests.support.paths import RIGS

FILE = "flat_endpoints.json"
PATHS = {
    "Control_Mode": "axis0.controller.config.control_mode",
    "Input_Mode": "axis0.controller.config.input_mode",
    "Enable_Watchdog": "axis0.config.enable_watchdog",
    "Watchdog_Timeout": "axis0.config.watchdog_timeout",
    "Torque_Soft_Max": "axis0.config.torque_soft_max",
}
TYPES = dict(zip(PATHS.values(), ("uint8", "uint8", "bool", "float", "float"), strict=True))
NUMBERS = dict(zip(PATHS.values(), (393, 304, 300, 65535, 0), strict=True))  # some of the DBC file's, for others


def firmware(folder: Path, **changed: Any) -> None:
    """The DBC file, with modes of a byte, and the firmware's file. changed: entries by signal."""
    text = (
        (RIGS / ODRIVE_DBC)
        .read_text()
        .replace("m300 : 32|32@1+", "m300 : 32|8@1+")
        .replace("m301 : 32|32", "m301 : 32|8")
    )
    (folder / ODRIVE_DBC).write_text(text)
    endpoints = {path: {"id": NUMBERS[path], "type": TYPES[path], "access": "rw"} for path in NUMBERS}
    endpoints |= {PATHS[signal]: entry for signal, entry in changed.items()}
    (folder / FILE).write_text(json.dumps({"fw_version": "0.6.10", "endpoints": endpoints}))


def rig_of(**binding: Any) -> RigConfig:
    document: Any = tomllib.loads((RIGS / "odrive.toml").read_text())
    for item in document["bus"]["dbc"]["read_back"]:
        item["endpoint"] = PATHS[item["signal"]]
    document["bus"]["dbc"] |= {"endpoints": FILE} | binding
    return RigConfig.model_validate(document)


def asked(folder: Path, rig: RigConfig) -> set[int]:
    """Numbers that the host asks drive 0 for first."""
    host = host_layout(rig, folder)
    frames = [frame for tick in range(3) for frame in host.encode(Command(tick, [0.0, 0.0], 0, False))]
    return {int.from_bytes(frame.data[1:3], "little") for frame in frames if frame.can_id == odrive.RX_SDO}


def test_the_shipped_rig_asks_by_the_numbers_of_its_dbc_file() -> None:
    rig = RigConfig.model_validate(tomllib.loads((RIGS / "odrive.toml").read_text()))
    assert asked(RIGS, rig) == {300}
    assert "value" not in (RIGS / "odrive.toml").read_text().partition("read_back")[2].partition("]")[0]


def test_drives_of_another_firmware_become_ready_by_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    firmware(tmp_path)
    codes = {"uint8": "B", "bool": "?", "float": "f"}
    theirs = {NUMBERS[path]: (path.removeprefix("axis0."), codes[TYPES[path]]) for path in NUMBERS}
    monkeypatch.setattr(odrive, "ENDPOINTS", theirs)
    assert asked(tmp_path, rig_of()) == {393}
    run = LockstepRun(rig_of(), tmp_path)
    while run.cycle.state is not State.READY:
        run.tick()
        assert run.index < 500, run.cycle.protocol.problems


def test_a_recording_carries_the_file(tmp_path: Path) -> None:
    (tmp_path / "rig").mkdir()
    firmware(tmp_path / "rig")
    described = describe_run(rig_of(), tmp_path / "rig")
    shutil.rmtree(tmp_path / "rig")
    with rig_of_run(described) as (rig, folder):
        assert asked(folder, rig) == {393}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        (
            {"Control_Mode": None},
            "read_back[0].endpoint: flat_endpoints.json has no 'axis0.controller.config.control",
        ),
        ({"Control_Mode": {"id": 65536, "type": "uint8"}}, "with a number and a type"),
        ({"Control_Mode": {"id": True, "type": "uint8"}}, "with a number and a type"),
        ({"Control_Mode": {"id": 5, "type": "function"}}, "with a number and a type"),
        ({"Control_Mode": {"id": 5, "type": "uint32"}}, "has 32 bits, unsigned; TxSdo0.Control_Mode has 8, unsigned"),
        ({"Control_Mode": {"id": 5, "type": "int8"}}, "has 8 bits, signed; TxSdo0.Control_Mode has 8, unsigned"),
        ({"Control_Mode": {"id": 304, "type": "uint8"}}, "TxSdo0.Control_Mode and Input_Mode both have number 304"),
    ],
)
def test_an_endpoint_that_does_not_fit_is_refused(changed: dict[str, Any], says: str, tmp_path: Path) -> None:
    firmware(tmp_path, **changed)
    with pytest.raises(LayoutError) as caught:
        host_layout(rig_of(), tmp_path)
    assert says in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"[]", b"{}", b'{"endpoints": []}', b"\xff\xfe", b"[" * 100_000])
def test_a_file_that_is_none_is_refused_in_one_line(content: bytes, tmp_path: Path) -> None:
    firmware(tmp_path)
    (tmp_path / FILE).write_bytes(content)
    with pytest.raises(LayoutError, match=r"flat_endpoints\.json is no flat_endpoints\.json"):
        host_layout(rig_of(), tmp_path)


def test_a_file_that_is_not_there_and_half_a_binding_are_refused(tmp_path: Path) -> None:
    firmware(tmp_path)
    (tmp_path / FILE).unlink()
    with pytest.raises(LayoutError, match=r"flat_endpoints\.json: No such file"):
        host_layout(rig_of(), tmp_path)
    with pytest.raises(LayoutError, match="state both"):
        host_layout(rig_of(endpoints=""), tmp_path)
