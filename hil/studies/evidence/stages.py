"""Drawn stages: what differs from a rig's nominal model, and by how much.

A stage's parameters follow from the seed and its number alone. It differs from the nominal model as real stages do:
presliding (LuGre), a lag and a mode that are not quite what the model says. Mass and friction are off, and there are
friction that varies along the travel, cogging, a cable, an unknown constant force, noise of half a count. How far an
axis is off is its tolerance: what was measured of it (axes.NAME.measured), else the usual. Hard stages have more of
what real ones have.

mode_hz: Hz of the free axis, 0: rigid; None: lag, mode and presliding are those of the rig file.
"""

from collections.abc import Sequence
from dataclasses import fields
from random import Random

import numpy as np

from drivers.base.toml_file import toml_value
from hil.rig.measured_table import Tolerances
from hil.rig.schema import RigConfig
from hil.rig.tables import ModelConfig
from hil.studies.population import Range, between, drawn, truth_of
from sim_plant.axis_config import MOST_LOAD, MOST_MODES, ModeConfig, SlipConfig
from sim_plant.config import CoggingConfig, PlantConfig
from sim_plant.physics.truth import Truth

PRESLIDING = (0.3e-6, 30e-6)  # m (rad), log-uniform
DAMPING = (0.15, 0.5)  # ratio of the stuck axis
VARIATION, VARIATION_PERIOD = 0.1, (5e-3, 20e-3)  # of friction along the travel, random phase
COGGING, COGGING_PERIOD = 1 / 30, 24e-3  # of Coulomb friction, random phase; m
CABLE, HYSTERESIS, REACH = 1 / 6, 0.01, 5e-4  # of Coulomb friction: a metre, half the loop; m
BIAS = 0.1  # of Coulomb friction: at most, either sign
# Of hard stages: rolling elements that pass, Stribeck friction, a signal period of the encoder, age of its samples.
HARD_PERIOD, HARD_STRIBECK, HARD_VELOCITY = (0.6e-3, 2e-3), (0.05, 0.3), (1e-3, 1e-2)  # m; of Coulomb friction; m/s
# Resonances beside the tool's: from so many times that one's, or Hz where there is none, to a part of the rate.
HARD_ABOVE, HARD_FROM_HZ, HARD_TO = 1.5, 150.0, 0.45
HARD_LOAD, HARD_DAMPING, HARD_THIRD = (0.02, 0.08), (0.005, 0.02), 0.5  # of the mass; ratio; share of axes with two
# Maxwell-slip elements: share of axes, how many, longest over shortest, limits in proportion.
HARD_SLIP, HARD_ELEMENTS, HARD_SPREAD, HARD_LIMIT = 0.5, 4, (5.0, 50.0), (0.5, 1.5)
HARD_ERROR, HARD_LATENCY = 2.0, 5e-6  # encoder counts; s that no stamp tells
NOMINAL_LAG, MODE_DAMPING, MODE_LOAD = 2e-4, 0.02, 0.3
TOLD = ("torque_lag", "mode_frequency_hz", "mode_damping", "mode_load")  # axes.NAME.model: what the law knows
OWN = {"encoder_resolution", "initial_position", "brake_force", "drive", "parameters", "source"}  # stay the rig's own
HEAD = (
    "presliding 0.3-30 um (LuGre, damping 0.15-0.5), mass +-20 %, friction +-30 % and varying by 10 % over 5-20 mm, "
    "lag 0.2 ms +-20 %, mode +-10 % (damping 0.02, 30 % load), each less where it was measured; cogging, cable, bias "
    "+-10 % of Coulomb friction, half-count noise. Not in it: "
)
LEFT_OUT = "membranes, force noise, floor vibration, drift"
FOOT = ". Errors are the tool's, against the setpoint at the sample's instant"


def head(*, hard: bool) -> str:
    """What the stages are drawn from, and what is not in them."""
    if not hard:
        return (
            f"{HEAD}{LEFT_OUT}, Stribeck friction, Maxwell-slip friction, a second resonance on an axis, encoder "
            f"errors, latency the stamps do not know{FOOT}"
        )
    more = (
        "friction varies over 0.6-2 mm instead, Stribeck friction 5-30 % within 1-10 mm/s, periodic error of 2 counts, "
        "samples 5 us older than their stamps, Maxwell-slip friction in place of LuGre on half of the axes, a second "
        "resonance from 1.5 times the first (rigid: from 150 Hz) to 0.45 of the rate, on half of the axes a third "
        "(each 2-8 % load, damping 0.005-0.02)"
    )
    return f"{HEAD}{LEFT_OUT}. Hard: {more}{FOOT}"


def _held(mode_hz: float) -> float:
    """Hz of the tool while the motor is held."""
    return mode_hz * float(np.sqrt(1.0 - MODE_LOAD))


def nominal(rig: RigConfig, mode_hz: float | None) -> RigConfig:
    """The rig whose model knows the drive's lag and the mode as they are on average."""
    if mode_hz is None:
        return rig
    known = dict(zip(TOLD, (NOMINAL_LAG, _held(mode_hz), MODE_DAMPING, MODE_LOAD), strict=True))
    axes = {
        name: axis.model_copy(update={"model": axis.model.model_copy(update=known)}) for name, axis in rig.axes.items()
    }
    return rig.model_copy(update={"axes": axes})


def plant_of(rig: RigConfig, seed: int, number: int, mode_hz: float | None, *, hard: bool = False) -> PlantConfig:
    """[plant] of stage `number`: a function of the arguments alone."""
    random, names, axes = drawn(seed, number), list(rig.axes), list(rig.axes.values())
    models, n = [axis.model for axis in axes], len(axes)
    known = [each.model for each in nominal(rig, mode_hz).axes.values()]

    def uniform(limits: Range) -> list[float]:
        return [random.uniform(*limits) for _ in range(n)]

    def within(shares: Sequence[float]) -> list[float]:
        return [random.uniform(1.0 - share, 1.0 + share) for share in shares]

    shares = [axis.tolerances for axis in nominal(rig, mode_hz).axes.values()]
    mass, friction = within([each.mass for each in shares]), within([each.friction for each in shares])
    lag, mode = within([each.lag for each in shares]), within([each.mode for each in shares])
    lengths = [PRESLIDING if mode_hz is not None or not each.presliding else each.presliding for each in models]
    dry = [m.coulomb for m in models]
    plant = PlantConfig(
        mass=[m.mass * k for m, k in zip(models, mass, strict=True)],
        coulomb=[m.coulomb * k for m, k in zip(models, friction, strict=True)],
        viscous=[m.viscous * k for m, k in zip(models, friction, strict=True)],
        quadratic=[m.quadratic for m in models],
        gravity=[m.gravity for m in models],
        presliding=[between((low, high), random.random()) for low, high in lengths],
        presliding_damping=uniform(DAMPING),
        torque_lag=[m.torque_lag * k for m, k in zip(known, lag, strict=True)],
        friction_variation=VARIATION,
        friction_period=uniform(VARIATION_PERIOD),
        friction_phase=uniform((0.0, 6.283)),
        cogging=[
            CoggingConfig(axis=name, amplitude=COGGING * c, period=COGGING_PERIOD, phase=random.uniform(0.0, 6.283))
            for name, c in zip(names, dry, strict=True)
        ],
        cable_stiffness=[CABLE * c for c in dry],
        cable_hysteresis=[HYSTERESIS * c for c in dry],
        cable_reach=REACH,
        bias=[random.uniform(-BIAS, BIAS) * c for c in dry],
        encoder_noise=[0.5 * axis.encoder_resolution for axis in axes],
        seed=random.randrange(2**31),
        modes=[
            ModeConfig(axis=name, frequency_hz=m.mode_frequency_hz * k, damping=m.mode_damping, load=m.mode_load)
            for name, m, k in zip(names, known, mode, strict=True)
            if m.mode_frequency_hz
        ] + _others(names, known, shares, Random(f"other modes/{seed}/{number}")),
    )  # fmt: skip
    return _harder(plant, rig, Random(f"hard/{seed}/{number}")) if hard else plant


def _others(
    names: Sequence[str], known: Sequence[ModelConfig], shares: Sequence[Tolerances], random: Random
) -> list[ModeConfig]:
    """The resonances that the models state beside the first, each off by itself."""
    return [
        ModeConfig(
            axis=name,
            frequency_hz=hertz * random.uniform(1.0 - share.mode, 1.0 + share.mode),
            damping=damping,
            load=load,
            tool=False,
        )
        for name, model, share in zip(names, known, shares, strict=True)
        for hertz, damping, load in model.other_modes
    ]


def _harder(plant: PlantConfig, rig: RigConfig, random: Random) -> PlantConfig:
    """The same stage with more of what real ones have."""

    def each(limits: tuple[float, float]) -> list[float]:
        return [random.uniform(*limits) for _ in rig.axes]

    more = {
        "friction_period": each(HARD_PERIOD),
        "stribeck_scale": each(HARD_STRIBECK),
        "stribeck_velocity": each(HARD_VELOCITY),
        "encoder_periodic_error": [HARD_ERROR * axis.encoder_resolution for axis in rig.axes.values()],
        "encoder_latency": HARD_LATENCY,
        "modes": [mode for name in rig.axes for mode in _modes(plant, name, rig.rate_hz, random)],
        "slip": [element for name in rig.axes for element in _elements(name, random)],
    }
    return plant.model_copy(update=more)


def _modes(plant: PlantConfig, axis: str, rate_hz: float, random: Random) -> list[ModeConfig]:
    """The axis' modes, and those that no model knows: as many as an emulated axis may have. No loop could damp what is
    above half the rate, and such a resonance is folded below it; so they end at HARD_TO of the rate. Where the first
    leaves no room, there are none.
    """
    modes = [mode for mode in plant.modes if mode.axis == axis]
    free = [mode.frequency_hz / (1.0 - mode.load) ** 0.5 for mode in modes if mode.tool]
    room_for = MOST_MODES - 1 - sum(not mode.tool for mode in modes)
    low, high = max([HARD_FROM_HZ, *(HARD_ABOVE * hertz for hertz in free)]), HARD_TO * rate_hz
    room = min(1.0, (MOST_LOAD - sum(mode.load for mode in modes)) / (2.0 * HARD_LOAD[1]))
    drawn_modes = [
        ModeConfig(
            axis=axis,
            frequency_hz=min(low + random.random() * (high - low), 5000.0),
            damping=random.uniform(*HARD_DAMPING),
            load=room * random.uniform(*HARD_LOAD),
            tool=False,
        )
        for _ in range(2)
    ]
    count = 1 + (random.random() < HARD_THIRD)
    return [*modes, *drawn_modes[: min(count, room_for) * (low < high)]]


def _elements(axis: str, random: Random) -> list[SlipConfig]:
    """Springs whose lengths are spread evenly in their logarithm; none on the other axes."""
    there, spread = random.random() < HARD_SLIP, between(HARD_SPREAD, random.random())
    limits = [random.uniform(*HARD_LIMIT) for _ in range(HARD_ELEMENTS)]
    lengths = [spread ** (i / (HARD_ELEMENTS - 1)) for i in range(HARD_ELEMENTS)]
    found = [SlipConfig(axis=axis, stiffness=f / s, limit=f) for f, s in zip(limits, lengths, strict=True)]
    return found if there else []


def stage_of(rig: RigConfig, seed: int, number: int, mode_hz: float | None, *, hard: bool = False) -> Truth:
    """What stage `number` is really like, (n_axes,)."""
    return truth_of(rig, plant_of(rig, seed, number, mode_hz, hard=hard))


def overrides(rig: RigConfig, seed: int, number: int, mode_hz: float | None, *, hard: bool = False) -> list[str]:
    """key=value, as for --set, that make the rig file that stage, with what its law is told of it."""
    plant = plant_of(rig, seed, number, mode_hz, hard=hard).model_dump(mode="json", exclude=OWN, exclude_none=True)
    known = nominal(rig, mode_hz).axes
    told = [f"axes.{name}.model.{key}={getattr(known[name].model, key)!r}" for name in known for key in TOLD]
    return [*told, *(f"plant.{key}={toml_value(value)}" for key, value in plant.items())]


def only(rig: RigConfig, names: Sequence[str]) -> RigConfig:
    """The rig with these of its axes, in its order. Its task and what else names axes is as it was. Streams
    of noise are numbered by axis: another number, other noise.
    """
    kept = [i for i, name in enumerate(rig.axes) if name in names]
    n = len(rig.axes)

    def picked(value: object) -> object:
        if isinstance(value, dict):
            return {key: picked(item) for key, item in value.items()}
        return [value[i] for i in kept] if isinstance(value, list) and len(value) == n else value

    law = rig.law.model_copy(update={key: picked(getattr(rig.law, key)) for key in ("gains", "tuned", "learnt_state")})
    estimator = rig.estimator.model_copy(update={key: picked(value) for key, value in rig.estimator})
    plant = rig.plant.model_copy(
        update={key: picked(getattr(rig.plant, key)) for key in ("encoder_resolution", "initial_position")}
    )
    axes = {name: axis for name, axis in rig.axes.items() if name in names}
    drives = rig.drives.model_copy(update={"brake": picked(rig.drives.brake)})
    parts = {"axes": axes, "law": law, "estimator": estimator, "plant": plant, "drives": drives}
    return rig.model_copy(update=parts)


def columns(truth: Truth, kept: Sequence[int]) -> Truth:
    """These axes of one stage."""
    return Truth(**{field.name: getattr(truth, field.name)[list(kept)] for field in fields(truth)})
