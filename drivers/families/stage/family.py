"""The project's own drives: one command frame for all of them, an answer of each."""

from drivers.families import Family, Sides
from drivers.families.stage.config import StageKeys

_FOLDER = "drivers.families.stage"
_FD, _CLASSIC = f"{_FOLDER}.stage_fd:StageFd", f"{_FOLDER}.stage_classic:StageClassic"
FAMILY = Family(
    layouts={
        "stage_fd": Sides(f"{_FD}Host", f"{_FD}Device", plain=True),
        "stage_classic": Sides(f"{_CLASSIC}Host", f"{_CLASSIC}Device"),
    },
    keys=StageKeys,
    cut=f"{_FOLDER}.common:cut",
    order=0,
)
