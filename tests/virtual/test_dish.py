"""A dish of cells in lockstep: the host's readings beside the truth, and a run that is the same again."""

from collections.abc import Sequence

import numpy as np
import pytest

from drivers.frame import Frame
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CycleResult, Tick
from hil.rig.file import load_rig, rig_hash
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS

FORCE = 'sensors.force={can_id=0x3F1, unit="N", scale=1e-8, noise=5e-6, range=[-0.01, 0.01]}'
SHIFT = (
    'sensors.shift={can_id=0x3F2, unit="m", scale=1e-9, noise=7e-7, range=[-0.5, 0.5], silent_ticks=150, stuck_ticks=0}'
)
MEASURED = (
    "plant.sensors=[{sensor='force', measures='tip_force', axis='z'}, {sensor='shift', measures='cell_shift', axis='z',"
    " frame_s=0.0333, delay=0.05}]"
)
DISH = "plant.dish={positions=[[0.004, 0.002]], top=-0.0038, anomalies=['rolled']}"
OVERRIDES = ("plant.cells=[]", DISH, FORCE, SHIFT, MEASURED)


class Kept:
    """A run of the injection plan's first press, with what the host read and what was true."""

    def __init__(self, rig: RigConfig, ticks: int) -> None:
        self.readings: list[np.void] = []
        self.true: list[float] = []
        self.run = LockstepRun(rig, RIGS, observer=self._observe)
        assert self.run.stage.dish is not None
        self.dish = self.run.stage.dish
        for _ in range(ticks):
            self.run.tick()

    def _observe(self, tick: Tick, frames: Sequence[Frame], result: CycleResult) -> None:
        self.readings.append(result.record["readings"][:2].copy())
        self.true.append(self.dish.force)


@pytest.mark.long
def test_the_host_reads_force_and_shift_of_a_cell_that_rolls_and_the_same_again() -> None:
    rig = load_rig(RIGS / "microscope-ideal.toml", OVERRIDES)
    kept = Kept(rig, 4100)
    assert (kept.run.cycle.state, kept.run.cycle.fault) == (State.ACTIVE, Fault.NONE)
    (cell,) = kept.dish.cells
    assert cell.contact == pytest.approx(-0.0038, abs=60e-6)
    assert cell.pierced_ns is None
    assert cell.moved > 12e-6
    forces, shifts = np.array(kept.readings).T
    true = np.array(kept.true)
    assert true.max() > 0.1e-3
    assert np.std(forces[100:] - true[100:]) == pytest.approx(5e-6, rel=0.1)
    assert shifts[-1] == pytest.approx(cell.moved, abs=3e-6)
    again = Kept(rig, 4100)
    assert np.array(again.readings)[100:].tobytes() == np.array(kept.readings)[100:].tobytes()
    assert again.true == kept.true


def test_a_rig_without_a_dish_is_what_it_was() -> None:
    rig = load_rig(RIGS / "microscope.toml", (FORCE, MEASURED.replace("tip_force", "cell_force").split(", {")[0] + "]"))
    plant = rig.model_dump(mode="json")["plant"]
    assert "dish" not in plant
    assert not {"frame_s", "tool_mass", "decay"} & plant["sensors"][0].keys()
    assert rig_hash(rig) != rig_hash(load_rig(RIGS / "microscope.toml"))
    assert LockstepRun(rig, RIGS).stage.dish is None
