"""The emulated stage of a rig: what [plant] does not state is as the nominal model of [axes] says."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hil.rig.tables import AxisConfig
from sim_plant.config import PlantConfig

if TYPE_CHECKING:
    from hil.rig.schema import RigConfig

MODEL_KEYS = ("mass", "coulomb", "viscous", "quadratic", "gravity")  # of [axes.NAME.model] and of [plant]


def completed(plant: PlantConfig, axes: Mapping[str, AxisConfig]) -> PlantConfig:
    """The plant with every key that it does not state taken from the axes. `model_fields_set` still tells what was
    stated.
    """
    derived: dict[str, Any] = {name: [getattr(axis.model, name) for axis in axes.values()] for name in MODEL_KEYS}
    derived["encoder_resolution"] = [axis.encoder_resolution for axis in axes.values()]
    stated = plant.model_fields_set
    values = {name: derived[name] if name in derived and name not in stated else value for name, value in plant}
    return PlantConfig.model_construct(_fields_set=set(stated), **values)


def plant_notes(rig: "RigConfig") -> list[str]:
    """What to know of the emulated stage before a simulation, a line each: which of its keys come from the nominal
    model, and which encoders are emulated with another resolution than the control service uses.
    """
    absent = [name for name in MODEL_KEYS if name not in rig.plant.model_fields_set and any(getattr(rig.plant, name))]
    notes = [f"emulated stage of {rig.name}: {', '.join(absent)} as the nominal model says"] if absent else []
    return notes + encoder_notes(rig)


def encoder_notes(rig: "RigConfig") -> list[str]:
    """A line for every axis whose emulated encoder has another resolution than the axis: a stated modelling error."""
    stated = rig.plant.encoder_resolution
    true = stated if isinstance(stated, list) else [stated] * len(rig.axes)
    return [
        f"stated modelling error: plant.encoder_resolution = {resolution:g} on axis {name}, whose "
        f"axes.{name}.encoder_resolution = {axis.encoder_resolution:g}: measured positions are "
        f"{axis.encoder_resolution / resolution:g} times the true ones"
        for (name, axis), resolution in zip(rig.axes.items(), true, strict=True)
        if resolution != axis.encoder_resolution
    ]
