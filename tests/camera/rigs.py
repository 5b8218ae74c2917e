"""A stage with a camera above its dish."""

from pathlib import Path

from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from tests.support.paths import RIGS

SLOW = "silent_ticks=2000, stuck_ticks=0, range=[-0.5, 0.5]"
CAMERA = (
    "task.kind=hold",
    "plant.cells=[]",
    "plant.dish={positions=[[0.1e-3, 0.05e-3]], top=-0.0038}",
    f"sensors.tip={{can_id=0x3F3, unit='m', scale=1e-9, noise=7e-7, {SLOW}}}",
    f"sensors.shift={{can_id=0x3F2, unit='m', scale=1e-9, noise=7e-7, fd=true, {SLOW}}}",
    f"sensors.bolus={{can_id=0x3F4, unit='1', scale=1e-6, noise=0.02, {SLOW.replace('0.5', '9.0')}}}",
    "camera={pixel=2.5e-6, sends={tip_error='tip', cell_shift='shift', bolus='bolus'}}",
)
RIG: Path = RIGS / "microscope-ideal.toml"


def camera_rig(*overrides: str) -> RigConfig:
    return load_rig(RIG, [*CAMERA, *overrides])
