"""The emulated nodes of a rig's sensors, by their kind."""

from pathlib import Path

from drivers.sensors.config import SensorConfig
from sim_plant.config import PlantConfig
from sim_plant.nodes.sensor import SensorNode
from sim_plant.nodes.sensor_frames import Carrier, OwnFrame


def sensor_nodes(
    sensors: dict[str, SensorConfig], plant: PlantConfig, trigger: tuple[int, int] | None, base_dir: Path
) -> list[SensorNode]:
    """The nodes of a rig's sensors. base_dir: of the files that they name. trigger: as SensorNode's; None: no frame
    comes in every tick, and none samples.
    """
    if trigger is None:
        return []
    entries = {entry.sensor: entry for entry in plant.sensors}
    found: list[SensorNode] = []
    for place, (name, config) in enumerate(sensors.items()):
        if config.kind == "cia404":
            from sim_plant.nodes.cia404 import Cia404Node  # few rigs have one

            found.append(Cia404Node(name, config, place, entries.get(name), plant.seed, base_dir))
        else:
            carrier = carrier_of(name, config, base_dir)
            found.append(SensorNode(name, config, place, entries.get(name), carrier, trigger, plant.seed))
    return found


def carrier_of(name: str, config: SensorConfig, base_dir: Path) -> Carrier:
    """That of a sensor's kind; of a CiA 404 device, see sim_plant/nodes/cia404.py. Raises LayoutError, OSError."""
    if config.kind == "hil":
        return OwnFrame(config)
    from sim_plant.nodes.other_frames import SignalFrame, UserFrame  # few rigs have one

    return SignalFrame(config, base_dir) if config.kind == "dbc" else UserFrame(name, config)
