"""The emulated stage of a rig, and scenarios it can play by itself, live."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from hil.rig.layout import host_layout
from hil.rig.schema import RigConfig, RigError
from hil.rig.sensors import trigger, trigger_mask
from hil.virtual.scenario import load_scenario
from sim_plant.emulator import EmulatedStage
from sim_plant.nodes.output import OutputNode
from sim_plant.nodes.outputs import output_nodes
from sim_plant.nodes.sensor import SensorNode
from sim_plant.nodes.sensors import sensor_nodes
from sim_plant.scenario.language import Scenario
from sim_plant.scene_page import ScenePage


def emulated_stage(rig: RigConfig, base_dir: Path, start_ns: int) -> EmulatedStage:
    """The rig's emulated stage. Raises RigError for a plant or layout that does not fit."""
    rated = [axis.rated_force for axis in rig.axes.values()]
    try:
        return EmulatedStage(
            rig.plant, rig.bus, rig.axis_names, rated, base_dir, start_ns, drives=rig.drives, mountings=rig.mountings,
            sensors=emulated_sensors(rig, base_dir), outputs=emulated_outputs(rig, base_dir),
        )  # fmt: skip
    except (ValueError, OSError) as error:
        raise RigError([f"rig {rig.name}: {error}"]) from None


def emulated_sensors(rig: RigConfig, base_dir: Path) -> list[SensorNode]:
    """The nodes of the rig's [sensors]. Raises LayoutError as host_layout."""
    if not rig.sensors:
        return []
    layout = host_layout(rig, base_dir)
    heard, mask = trigger(rig, layout), trigger_mask(layout)
    return sensor_nodes(rig.sensors, rig.plant, None if heard is None else (mask, heard.can_id & mask), base_dir)


def emulated_outputs(rig: RigConfig, base_dir: Path) -> list[OutputNode]:
    """The nodes of the rig's [outputs], where it has any. Raises ValueError, OSError for their files."""
    return output_nodes(rig.outputs, base_dir)


def without_camera(rig: RigConfig) -> RigConfig:
    """The same rig, whose camera's sensors another process sends. Raises RigError where it has no camera or no dish."""
    if rig.camera is None or rig.plant.dish is None:
        lacking = "[camera]" if rig.camera is None else "[plant.dish]"
        raise RigError([f"rig {rig.name}: --camera needs {lacking}"])
    others = {name: sensor for name, sensor in rig.sensors.items() if name not in rig.camera.sends.values()}
    return rig.model_copy(update={"sensors": others})


@contextmanager
def scene_shown(rig: RigConfig, stage: EmulatedStage, path: Path) -> Iterator[Callable[[], None]]:
    """While open, what the emulated camera sees is in that file; what updates it."""
    assert rig.plant.dish is not None
    x, y, z = (rig.axis_names.index(name) for name in rig.plant.dish.axes)
    page = ScenePage(path)
    try:
        yield lambda: page.update(stage, (x, y, z))
    finally:
        page.close()
        path.unlink(missing_ok=True)


def live_scenario(path: Path, rig: RigConfig) -> Scenario:
    """A scenario that needs nobody to tell it what the control process is doing, nor a simulated wire."""
    scenario = load_scenario(path, rig)
    problems = [
        f"{path}: fault {number + 1}: a live emulator knows no wire, state or phase; use at_s or at_tick, or `hil sim`"
        for number, fault in enumerate(scenario.fault)
        if fault.on_wire or fault.at_state or fault.at_phase
    ]
    if problems:
        raise RigError(problems)
    return scenario
