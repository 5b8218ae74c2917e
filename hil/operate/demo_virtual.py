"""The demo where this computer cannot keep real time: the same rig, stage and law in virtual time, shown as it runs."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from hil.rig.control_path import control_path
from hil.rig.schema import RigConfig
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.sim import simulate
from sim_plant.config import REAL_STAGES
from sim_plant.native import library

MOST_LATE = 1e-3  # of the ticks, missed or without a sample, that still leave figures of the stage


def too_slow(rig: RigConfig) -> str:
    """Why the stage cannot be emulated in real time here; empty where it can."""
    kernel, lacking = library.found()
    if kernel or rig.plant.stage not in REAL_STAGES or control_path() == "compiled":
        return ""
    return f"Python alone is too slow to emulate this stage in real time (no native kernel: {lacking}; see hil doctor)"


def was_too_busy(summary: dict[str, Any]) -> str:
    """Why a live run's figures are this computer's and not the stage's; empty where they are the stage's."""
    ticks, missed = summary["ticks"], summary["missed"]["own"] + summary["missed"]["host"]
    lost = summary["frames"]["lost"]
    if missed + lost <= MOST_LATE * ticks:
        return ""
    return f"this computer was too busy for the live run: {missed} of {ticks} ticks missed, {lost} samples late"


def run_virtual(
    rig: RigConfig, rig_file: Path, seconds: float, target: Path, console: Console, check: Callable[[], None]
) -> None:
    """Run the rig for so long in virtual time and record it at `target`, with a line a virtual second, at which `check`
    is called, which may end it.
    """
    began = time.monotonic()

    def say(done: int) -> None:
        check()
        passed = done * rig.period_ns * 1e-9
        pace = passed / max(time.monotonic() - began, 1e-9)
        speed = f", {pace:.1f} times as fast as real time" if passed >= 1.0 else ""
        console.print(f"{seconds - passed:5.1f} s to go in virtual time{speed}")

    recorder = LockstepRecorder(target, rig, rig_file)
    try:
        simulate(rig, rig_file.parent, seconds, progress=say, observer=recorder.observe, tell=recorder.tell)
    finally:
        recorder.close()
