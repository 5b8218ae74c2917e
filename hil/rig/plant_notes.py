"""What to know of a rig's emulated stage before a simulation, in lines of text."""

from hil.rig.plant import MODEL_KEYS
from hil.rig.schema import RigConfig
from sim_plant.config import REAL_STAGES, STAGES
from sim_plant.native import library
from sim_plant.physics.truth import Truth


def plant_notes(rig: RigConfig) -> list[str]:
    """What to know of the emulated stage before a simulation, a line each. Told are keys that come from the nominal
    model, encoders emulated with another resolution than the control service uses, and what computes it.
    """
    absent = [name for name in MODEL_KEYS if name not in rig.plant.model_fields_set and any(getattr(rig.plant, name))]
    scaled = {"mass": rig.plant.mass_scale} | dict.fromkeys(
        ("coulomb", "viscous", "quadratic"), rig.plant.friction_scale
    )
    said: dict[str, list[str]] = {}
    for name in absent:
        factor = scaled.get(name, 1.0)
        said.setdefault("as" if factor == 1.0 else f"{factor:g} times what", []).append(name)
    parts = [f"{', '.join(names)} {how} the nominal model says" for how, names in said.items()]
    notes = [f"emulated stage of {rig.name}: {'; '.join(parts)}"] if parts else []
    return notes + encoder_notes(rig) + law_notes(rig) + kernel_notes(rig)


def law_notes(rig: RigConfig) -> list[str]:
    """A line where the law is made for presliding and guides of the emulated stage have dry friction alone."""
    if rig.law.name != "presliding-kalman" or rig.plant.stage not in STAGES:
        return []
    truth = Truth.from_config(rig.plant, len(rig.axes), rig.axis_names)
    dry = ((truth.coulomb > 0.0) & (truth.presliding == 0.0)).tolist()
    axes = ", ".join(name for name, is_dry in zip(rig.axis_names, dry, strict=True) if is_dry)
    if not axes:
        return []
    return [
        f"presliding-kalman is made for guides with presliding; plant.stage = {rig.plant.stage!r} has none on {axes}: "
        "there the law will hunt at rest. Use --set law.name=structured-kalman, or --set plant.stage=crossed-roller"
    ]


def kernel_notes(rig: RigConfig) -> list[str]:
    """A line where the emulated stage is computed in Python though it has what the native kernel is for."""
    kernel, lacking = library.found()
    if kernel or rig.plant.stage not in REAL_STAGES:
        return []
    return [f"emulated stage computed in Python, several times slower ({lacking}): python -m sim_plant.native"]


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
