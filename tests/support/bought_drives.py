"""Rigs of bought drives, each with an emulated drive that was not made from the rig's binding."""

import tomllib
from pathlib import Path
from typing import Any

from tests.support.foreign_drive import CST_DRIVE, eds_text
from tests.support.paths import RIGS

VESC_COUNTS = 18_000  # a turn: degrees times 50
VESC_DBC = "vesc.dbc"
EDS = "made.eds"

# VESC IDs 0 and 1; identifiers as the DBC format writes those of 29 bits.
_VESC_MESSAGES = """
BO_ {current} Set_Current{axis}: 4 Host
 SG_ Current : 7|32@0- (0.001,0) [0|0] "A" Axis{axis}

BO_ {status} Status_4_{axis}: 8 Axis{axis}
 SG_ Temp_FET : 7|16@0- (0.1,0) [0|0] "C" Host
 SG_ Temp_Motor : 23|16@0- (0.1,0) [0|0] "C" Host
 SG_ Current_In : 39|16@0- (0.1,0) [0|0] "A" Host
 SG_ PID_Pos : 55|16@0- (0.02,0) [0|0] "deg" Host
"""


def vesc_dbc() -> str:
    """A DBC file for two VESCs, from the firmware's documentation of its CAN protocol."""
    extended = 1 << 31
    text = 'VERSION ""\n\nBU_: Host Axis0 Axis1\n'
    for axis in (0, 1):
        text += _VESC_MESSAGES.format(axis=axis, current=extended | 0x100 | axis, status=extended | 0x1000 | axis)
    return text


def odrive() -> dict[str, Any]:
    """The shipped rig of ODrives."""
    return tomllib.loads((RIGS / "odrive.toml").read_text())


def vesc() -> dict[str, Any]:
    """The stage of paper.toml, slower, on VESCs: 10 mm a turn, 0.05 N m per A."""
    rig = odrive()
    for name in ("x", "y"):
        rig["axes"][name]["encoder_resolution"] = 0.01 / VESC_COUNTS
        rig["axes"][name]["limits"] |= {"speed": 0.5, "force_rate": 1e4}
    rig["task"] |= {"radius": 0.05, "frequency_hz": 0.1, "settle_s": 0.0}
    rig["bus"] = {"protocol": f"dbc:{VESC_DBC}", "dbc": vesc_binding()}
    rig["plant"]["drive"] = {"kind": "vesc", "turn": [0.01, 0.01], "feedback_s": 0.002, "torque_constant": 0.05}
    return rig


def vesc_binding() -> dict[str, Any]:
    """Position of one turn; current for torque; no enable, no state."""
    position = {"signal": "PID_Pos", "scale": 50.0, "wrap": float(VESC_COUNTS)}
    torque = {"signal": "Current", "scale": 0.05}
    return {
        "feedback": "cyclic",
        "feedback_period_s": 0.002,
        "position": [{"message": f"Status_4_{axis}", **position} for axis in (0, 1)],
        "torque": [{"message": f"Set_Current{axis}", **torque} for axis in (0, 1)],
    }


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
    (folder / VESC_DBC).write_text(vesc_dbc())
    (folder / "odrive_cansimple.dbc").write_text((RIGS / "odrive_cansimple.dbc").read_text())


RIGS_OF = {"odrive": odrive, "vesc": vesc, "cia402": cia402}
