"""The emulated stage of a rig: what [plant] does not state is as the nominal model of [axes] says."""

from collections.abc import Mapping
from typing import Any

from hil.rig.tables import AxisConfig
from sim_plant.axis_config import slip_fits
from sim_plant.config import PlantConfig
from sim_plant.stages import staged

MODEL_KEYS = ("mass", "coulomb", "viscous", "quadratic", "gravity")  # of [axes.NAME.model] and of [plant]


def completed(plant: PlantConfig, axes: Mapping[str, AxisConfig]) -> PlantConfig:
    """The plant with every key that it does not state taken from the axes, or from its kind of stage. Raises ValueError
    where [[plant.slip]] has no presliding.

    `model_fields_set` still tells what was stated, or has come from the kind of stage.
    """
    derived: dict[str, Any] = {name: [getattr(axis.model, name) for axis in axes.values()] for name in MODEL_KEYS}
    derived["encoder_resolution"] = [axis.encoder_resolution for axis in axes.values()]
    stated = plant.model_fields_set
    values = {name: derived[name] if name in derived and name not in stated else value for name, value in plant}
    whole = staged(PlantConfig.model_construct(_fields_set=set(stated), **values))
    lengths = whole.presliding if isinstance(whole.presliding, list) else [whole.presliding] * len(axes)
    slip_fits(whole.slip, lengths, list(axes))
    return whole
