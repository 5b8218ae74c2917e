"""A rig of ODrives whose X homes by its drive, with flat_endpoints.json of the emulated firmware."""

import json
from pathlib import Path
from typing import Any

from drivers.families.dbc.odrive_homing import HOMING
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from sim_plant.drives import odrive
from sim_plant.drives.odrive_homing import HomingOdrive
from tests.support.bought_drives import odrive as odrive_rig
from tests.support.bought_drives import write_files
from tests.support.homing import ABOVE, PLACE, ZERO, homed_by_drive

GEAR = 628.3185307179587  # N per N m
FILE = "flat_endpoints.json"
TYPES = {"I": "uint32", "?": "bool", "f": "float"}
PATHS = {
    "Control_Mode": "controller.config.control_mode",
    "Input_Mode": "controller.config.input_mode",
    "Enable_Watchdog": "config.enable_watchdog",
    "Watchdog_Timeout": "config.watchdog_timeout",
    "Torque_Soft_Max": "config.torque_soft_max",
}


def write_endpoints(folder: Path, without: str = "") -> None:
    """The DBC file, and flat_endpoints.json of the emulated firmware."""
    write_files(folder)
    known = {f"axis0.{path}": {"id": number, "type": TYPES[kind]} for number, (path, kind) in odrive.ENDPOINTS.items()}
    known.pop(without, None)
    (folder / FILE).write_text(json.dumps({"endpoints": known}))


def rig_of(
    folder: Path, *, start: float = ABOVE, zero: float = ZERO, low: float | None = PLACE,
    home: dict[str, Any] | None = None, contact: str = "sound", weight: float = 0.0, brake: bool = False,
    mirrored: bool = False, binding: dict[str, Any] | None = None, **drive: Any,
) -> RigConfig:  # fmt: skip
    """The shipped rig of ODrives, whose X homes by its drive; its min_endstop closes at `low` of the drive."""
    write_endpoints(folder)
    document = odrive_rig()
    for item in document["bus"]["dbc"]["read_back"]:
        item["endpoint"] = f"axis0.{PATHS[item['signal']]}"
    document["bus"]["dbc"] |= {"endpoints": FILE} | (binding or {})
    if mirrored:
        document["axes"]["x"]["direction"] = -1
        document["plant"]["drive"]["turn"] = [-0.01, 0.01]
    told = {"method": HOMING, "acceleration": 2.0}
    there = {"zero": zero, "contact": contact} | ({} if low is None else {"low": low})
    return homed_by_drive(document, told | (home or {}), there, start=start, weight=weight, braked=brake, **drive)


def node_of(run: LockstepRun) -> HomingOdrive:
    node = run.stage.nodes[0]
    assert isinstance(node, HomingOdrive)
    return node
