"""What is found of a rig of deploy/rigs and its layout."""

from drivers.bus_load.schedulability import Analysis
from hil.rig.bus_load import analyse_rig, rig_layout
from hil.rig.encoder_range import encoder_range_problems
from hil.rig.schema import RigConfig
from tests.support.paths import RIGS


def analysed(rig: RigConfig) -> Analysis:
    """Its traffic."""
    return analyse_rig(rig, rig_layout(rig, RIGS))


def range_problems(rig: RigConfig) -> list[str]:
    """Where its travel is more than its layout carries."""
    return encoder_range_problems(rig, rig_layout(rig, RIGS))
