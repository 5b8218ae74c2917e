"""Whether a rig goes with its moteus controllers."""

from drivers.families import Circumstances
from drivers.families.moteus.config import MoteusConfig, moteus_keys


def problems(rig: Circumstances) -> list[str]:
    """Drives that are told another watchdog than the rig relies on."""
    told = moteus_keys(rig.bus).moteus or MoteusConfig()
    if told.watchdog_s == rig.watchdog_s:
        return []
    return [f"bus.moteus.watchdog_s = {told.watchdog_s:g}: the drives are told another than drives.watchdog_s says"]
