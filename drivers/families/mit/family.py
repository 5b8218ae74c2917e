"""Drives of the MIT kind."""

from drivers.families import Family, Sides
from drivers.families.mit.config import MitKeys

_FOLDER = "drivers.families.mit"
FAMILY = Family(
    layouts={"mit": Sides(f"{_FOLDER}.layout:MitHost", f"{_FOLDER}.listener:MitListener")},
    keys=MitKeys,
    cut=f"{_FOLDER}.layout:cut",
    sketch=f"{_FOLDER}.sketch:sketch",
)
