"""What to know of a rig's emulated stage before a simulation, in lines of text."""

from hil.rig.plant import MODEL_KEYS
from hil.rig.schema import RigConfig


def plant_notes(rig: RigConfig) -> list[str]:
    """What to know of the emulated stage before a simulation, a line each: which of its keys come from the nominal
    model, and which encoders are emulated with another resolution than the control service uses.
    """
    absent = [name for name in MODEL_KEYS if name not in rig.plant.model_fields_set and any(getattr(rig.plant, name))]
    notes = [f"emulated stage of {rig.name}: {', '.join(absent)} as the nominal model says"] if absent else []
    return notes + encoder_notes(rig)


def encoder_notes(rig: RigConfig) -> list[str]:
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
