"""What a rig file can say that only shows once the rig's parts are made: before anything runs, they all are."""

from pathlib import Path

from hil.rig.schema import RigConfig, RigError
from hil.virtual.lockstep import LockstepRun


def usable(rig: RigConfig, rig_file: Path) -> RigConfig:
    """The rig, if a run of it in lockstep can begin. Raises RigError where its task, law, filter, layout or plant do
    not fit.
    """
    try:
        LockstepRun(rig, rig_file.parent)
    except (ValueError, OSError) as error:
        raise RigError([f"{rig_file}: {error}"]) from None
    return rig
