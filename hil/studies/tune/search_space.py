"""What `hil tune` searches: the gains that a law declares with a range (hil/control/gain.py), in units of the rig.

Ranges are in units of mass, rate, force limit and encoder counts, so that their middle is a sensible law on any axis.
On an injection plan a stage whose nominal model is a few per cent off is at rest again and again and has to be right at
once. A law may declare ranges of its own for it, sized by the nominal mass and friction. A law whose gains follow from
the model is searched around those.
"""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from hil.control.estimator.gains import per_axis
from hil.control.gain import Knob, declared, knobs
from hil.control.law_registry import law_class
from hil.control.laws.base import Array, Model
from hil.control.nominal_model import rig_model
from hil.rig.schema import LawConfig, RigConfig, RigError


def law_of(rig: RigConfig, law: str) -> LawConfig:
    """The rig's [law] with that name; [law.gains] belongs to the law the file names."""
    if law == rig.law.name:
        return rig.law
    return rig.law.model_copy(update={"name": law, "gains": {}, "source": ""})


def space_of(rig: RigConfig, law: str) -> dict[str, Knob]:
    """A law's knobs on the rig's task, in the order it declares them."""
    return knobs(law_class(law_of(rig, law)).GAINS, plan=rig.task.kind == "injection")


def law_gains(rig: RigConfig, law: str) -> dict[str, Any]:
    """The rig file's gains for a law."""
    return law_of(rig, law).effective_gains()


def own_gains(rig: RigConfig, law: str, period: float = 0.0) -> dict[str, Array]:
    """What a law has by itself of every gain that is searched in units of that, (n_axes,) each. period: s; 0: the
    rig's. Raises RigError where it says nothing of one, or 0.
    """
    made, shape = law_class(law_of(rig, law)), len(rig.axes)
    gains = declared(made.GAINS)
    follow = made.own_gains(rig_model(rig), period or rig.period_ns * 1e-9)
    own = {name: follow.get(name, gains[name].default) for name, knob in space_of(rig, law).items() if _is_own(knob)}
    if lacking := [name for name, value in own.items() if value is None or not np.all(np.asarray(value) > 0.0)]:
        raise RigError(
            [f"--law {law}: scale 'own' of {', '.join(lacking)}: a default or own_gains() above 0 is needed"]
        )
    return {name: np.zeros(shape) + value for name, value in own.items()}


def _is_own(knob: Knob) -> bool:
    return knob.scale == "own"


def knob_scale(knob: Knob, model: Model, period: float, force_limit: Array, resolution: float) -> Array:
    """What a knob's number is multiplied by, (n_axes,), for each of hil.control.gain.SCALES but "own"; resolution: m
    per encoder count.
    """
    one = np.ones_like(model.mass)
    scale: Array = {
        "1": one,
        "1/T": one / period,
        "m": model.mass * one,
        "m/T": model.mass / period,
        "T/m": period / model.mass,
        "m/T2": model.mass / period**2,
        "m/T3": model.mass / period**3,
        "m2/FT": model.mass**2 / (force_limit * period),
        "m2/FT2": model.mass**2 / (force_limit * period**2),
        "F": force_limit * one,
        "C": model.coulomb * one,
        "count": resolution * one,
        "count/T1.5": resolution * one / period**1.5,
    }[knob.scale]
    return scale


def at_rate(rig: RigConfig, law: str, gains: Mapping[str, Any], rate_hz: float) -> dict[str, Any]:
    """Gains found at the rig's rate as they are at another: by how their unit scales with the period."""
    n, old, new = len(rig.axes), rig.period_ns * 1e-9, 1.0 / rate_hz
    one = Model(*(np.ones(n) for _ in fields(Model)))
    own_old, own_new = own_gains(rig, law, old), own_gains(rig, law, new)
    scaled = dict(gains)
    for name, knob in space_of(rig, law).items():
        if name in gains and name in own_old:
            scaled[name] = (per_axis(gains[name], n) * own_new[name] / own_old[name]).tolist()
        elif name in gains and not knob.density:
            factor = knob_scale(knob, one, new, np.ones(n), 1.0) / knob_scale(knob, one, old, np.ones(n), 1.0)
            scaled[name] = (per_axis(gains[name], n) * factor).tolist()
    return scaled
