"""[motion.parameters] of name = "cells": where the cells are, and how they are injected."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """What may be asked; checked.py holds it against the rig. Lengths in m, forces in N, times in s, speeds in m/s.

    cells: rows of place across (two axes), of the cell's top along the axis of injection, and, where `turn` names a
    rotary axis, of its angle, rad. turn_speed: rad/s. first: number of the one
    that it begins with, from 1 on; those before it are over. safe: height of the way from cell to cell. start_above:
    above the expected top, where the search begins. deposit, deepest: behind the first touch; deposit counts from the
    expected top where z_law is impedance or position. z_law: a key of z_laws.py. force_rate: N/s, and admittance:
    N s/m, of ramp and hold. stiffness: N/m, of impedance. hold_force, hold_s: of hold. force_limit: most force on the
    cell. puncture_force: that is expected, for `hil check` alone; 0: not known. pull_limit: of withdrawal.
    camera_latency_s: from exposure to the first bit of its frame. camera_age_s: of a frame that still counts. The names
    of sensors and of the valve: empty where there is none; what they would show is then unknown.
    """

    cells: Sequence[Sequence[float]]
    safe: float
    first: int = 1
    along: str = "z"
    across: Sequence[str] = ("x", "y")
    turn: str = ""
    direction: int = -1
    start_above: float = 60e-6
    transfer_speed: float = 0.02
    turn_speed: float = 0.5
    seek_speed: float = 4e-3
    press_speed: float = 4e-3
    withdraw_speed: float = 8e-3
    deposit: float = 230e-6
    deepest: float = 320e-6
    force_limit: float = 1.4e-3
    puncture_force: float = 0.0
    pull_limit: float = 3e-4
    z_law: str = "press"
    force_rate: float = 0.02
    admittance: float = 0.15
    stiffness: float = 10.0
    hold_force: float = 4e-4
    hold_s: float = 1.0
    freeze_s: float = 0.012
    pulse_s: float = 0.05
    dwell_s: float = 0.25
    settle_s: float = 0.05
    camera_latency_s: float = 0.05
    camera_age_s: float = 0.11
    roll_limit: float = 12e-6
    tip_limit: float = 15e-6
    bolus_least: float = 0.5
    force: str = "force"
    shift: str = ""
    tip: str = ""
    bolus: str = ""
    dimple: str = ""
    valve: str = ""
