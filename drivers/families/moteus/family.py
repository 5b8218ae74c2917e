"""moteus controllers."""

from drivers.families import Family, Sides
from drivers.families.moteus.config import MoteusKeys

_FOLDER = "drivers.families.moteus"
FAMILY = Family(
    layouts={"moteus": Sides(f"{_FOLDER}.layout:MoteusHost", f"{_FOLDER}.layout:MoteusListener")},
    keys=MoteusKeys,
    cut=f"{_FOLDER}.layout:cut",
    problems=f"{_FOLDER}.admission:problems",
    sketch=f"{_FOLDER}.sketch:sketch",
)
