"""Rigs of bought drives, each with an emulated drive that was not made from the rig's binding."""

import tomllib
from pathlib import Path
from typing import Any

from tests.support.foreign_drive import CST_DRIVE, eds_text
from tests.support.paths import RIGS

VESC_DBC = "vesc.dbc"
ODRIVE_DBC = "odrive_cansimple.dbc"
EDS = "made.eds"


def shipped(name: str) -> dict[str, Any]:
    """A rig that we ship."""
    return tomllib.loads((RIGS / f"{name}.toml").read_text())


def odrive() -> dict[str, Any]:
    """The rig of ODrives."""
    return shipped("odrive")


def vesc() -> dict[str, Any]:
    """The rig of VESCs, beginning at zero."""
    rig = shipped("vesc")
    del rig["plant"]["initial_position"]
    return rig


def moteus() -> dict[str, Any]:
    """The rig of moteus controllers."""
    return shipped("moteus")


def cia402() -> dict[str, Any]:
    """The stage of paper.toml on a maker's CST drives with node numbers of their own."""
    rig = tomllib.loads((RIGS / "paper.toml").read_text())
    rig["bus"] = {"protocol": "cia402", "cia402": {"eds": [EDS], "nodes": [3, 9], "rated_torque": [5.0, 5.0]}}
    rig["plant"]["drive"] = {"kind": "cia402", "status_bits": 0xC000, "enable_delay_s": 0.02, "answer_delay_s": 0.002}
    for name, force in (("x", 1.6), ("y", 0.4)):
        rig["axes"][name]["push"] = {"force": force, "distance": 4e-3}
    return rig


def write_files(folder: Path) -> None:
    """The files that these rigs name, into a folder."""
    (folder / EDS).write_text(eds_text(CST_DRIVE))
    for name in (VESC_DBC, ODRIVE_DBC):
        (folder / name).write_text((RIGS / name).read_text())


RIGS_OF = {"odrive": odrive, "vesc": vesc, "moteus": moteus, "cia402": cia402}
