"""What the campaign does to the sensors of a rig that has some: to all of them at once."""

from collections.abc import Callable
from dataclasses import replace

from hil.cycle.fault_table import Fault
from hil.rig.schema import RigConfig
from hil.studies.fault_campaign.trial import Limit, Step, Trial, once
from hil.virtual.lockstep import LockstepRun
from sim_plant.nodes.sensor import SensorNode, Tap, invalid, repeating, silent, stuck, tapped

_ON_ITS_WAY = 2  # ticks from an injection to the first reading that it changed


def falsified(tap_of: Callable[[SensorNode], Tap]) -> Step:
    """Every sensor sends what a tap of its own makes of its samples, from now on."""

    def act(run: LockstepRun, axis: int) -> None:
        tapped(run.stage.sensors, tap_of)

    return once(act)


def beyond(node: SensorNode) -> Tap:
    """It shows a reading twice as far from zero as its range goes."""
    most = 2.0 * max(node.config.range, key=abs)
    return lambda shown: replace(shown, counts=round(most / node.config.scale))


def skipping(node: SensorNode) -> Tap:
    """One of its sequence numbers does not follow; those behind it do."""
    return lambda shown: replace(shown, sequence=shown.sequence + 100)


def _after_silence(rig: RigConfig) -> int:
    return min(sensor.silent_ticks for sensor in rig.sensors.values()) + _ON_ITS_WAY


def _after_repeats(rig: RigConfig) -> int:
    watched = [sensor.stuck_ticks for sensor in rig.sensors.values() if sensor.stuck_ticks]
    return min(watched, default=0) + _ON_ITS_WAY


def _trial(name: str, tap_of: Callable[[SensorNode], Tap], fault: Fault, within: Limit) -> Trial:
    return Trial(name, falsified(tap_of), (fault,), within=within, per_axis=False, sensors=True)


SENSOR_TRIALS = (
    _trial("sensor silent", silent, Fault.SENSOR_SILENT, _after_silence),
    _trial("sensor invalid", invalid, Fault.SENSOR_SILENT, _after_silence),
    _trial("sensor repeats a sequence number", repeating, Fault.SENSOR_SILENT, _after_silence),
    _trial("sensor stuck", stuck, Fault.SENSOR_STUCK, _after_repeats),
    _trial("sensor out of range", beyond, Fault.SENSOR_RANGE, _ON_ITS_WAY),
    Trial("sensor skips sequence numbers", falsified(skipping), benign=True, per_axis=False, sensors=True),
)
