"""The microscope with reference equipment and cells under its tip."""

from hil.rig.bus_load import rig_layout
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.studies.inject.equipment import grid, middle, words
from tests.support.paths import RIGS

RIG = RIGS / "microscope.toml"


def equipped(
    cells: int, *changes: str, seed: int = 3, anomalies: tuple[str, ...] = (), share: float = 0.0
) -> RigConfig:
    """A row of cells, 1 mm apart. changes: overrides beside it."""
    rig = load_rig(RIG)
    places = grid(1, cells, 1e-3, middle(rig))
    return load_rig(RIG, (*words(rig, places, seed, share, anomalies, fd=rig_layout(rig, RIGS).fd), *changes))
