"""What stages of the usual kinds deviate by: values for the keys of [plant] that a rig file does not state.

Orders of magnitude for a class of stage, not a data sheet. Forces scale with the axis' own friction and mass, so that
they hold for a rotary axis too (rad for m). Where the values come from:

- Rolling guides: a spring within about 100 nm, rolling beyond 100 um (Futami, Furutani, Yoshida, "Nanometer positioning
  and its micro-dynamics", Nanotechnology 1, 1990). Coulomb friction over stiffness lies between; 10 um for ball and
  crossed-roller guides, more for a ball screw with its nut and guides together. Such friction limits nanopositioning on
  mechanical bearings (Dong, Okwudire, Precision Engineering 54, 2018).
- Friction along the travel of rolling elements varies by some ten per cent within the pitch of the recirculation
  (Al-Bender, Swevers, IEEE Control Systems 28(6), 2008: friction of machine elements).
- Ball screw: first axial mode of tens to a few hundred Hz, backlash of micrometres unless preloaded (Altintas, Verl,
  Brecher, Uriarte, Pritschow, "Machine tool feed drives", CIRP Annals 60(2), 2011).
- Flexure: a restoring spring, no friction; 10 mm range with a first natural frequency of 25 Hz (Hiemstra, Parmar,
  Awtar, IEEE/ASME Trans. Mechatronics 19(4), 2014).
- Air bearing: no dry friction (Slocum, Precision Machine Design, 1992); cables and the floor are what is left.
- Encoder: error within the signal period about 0.2 % of it (Heydemann, Applied Optics 20(19), 1981, for its form).
- Floor: velocity 12.5 um/s RMS in a third of an octave, the generic criterion VC-C (Gordon, Proc. SPIE 1619, 1991), as
  one line at 25 Hz.
- Current loop: a bandwidth of 1 kHz or so is a lag of 0.1 to 0.2 ms.
"""

from collections.abc import Callable, Sequence
from typing import Any

from drivers.base import plugins
from sim_plant.axis_config import ModeConfig
from sim_plant.config import REAL_STAGES, STAGES, PlantConfig, VibrationConfig

VC_C = VibrationConfig(acceleration=2.8e-3, frequency_hz=25.0)  # sqrt(2) 2 pi 25 Hz 12.5 um/s
Scaled = Callable[[float], list[float]]


def _common(of_mass: Scaled) -> dict[str, Any]:
    """What every stage with a current loop, an optical encoder and a floor has."""
    return {
        "torque_lag": 1.5e-4,
        "torque_noise": of_mass(1e-4),  # 0.1 mm/s^2/sqrt(Hz)
        "encoder_noise": 1e-9,
        "encoder_periodic_error": 40e-9,
        "encoder_period": 20e-6,
        "encoder_latency": 2e-6,
        "vibration": [VC_C],
        "drift": 2e-10,
    }


def air_bearing(of_mass: Scaled, of_friction: Scaled) -> dict[str, Any]:
    """An air bearing."""
    return _common(of_mass) | {
        "friction_scale": 0.0,
        "modes": [ModeConfig(frequency_hz=300.0, damping=0.02, load=0.2)],
        "cable_stiffness": of_mass(2.0),
        "cable_hysteresis": of_mass(0.01),
        "bias_walk": of_mass(1e-3),
    }


def crossed_roller(of_mass: Scaled, of_friction: Scaled) -> dict[str, Any]:
    """Crossed-roller guides."""
    return _common(of_mass) | {
        "presliding": 10e-6,
        "presliding_damping": 0.2,
        "friction_variation": 0.1,
        "friction_period": 10e-3,
        "modes": [ModeConfig(frequency_hz=200.0, damping=0.02, load=0.3)],
        "cable_stiffness": of_friction(0.5),
        "cable_hysteresis": of_friction(0.02),
        "bias": of_friction(0.05),
        "bias_walk": of_friction(2e-3),
    }


def ball_screw(of_mass: Scaled, of_friction: Scaled) -> dict[str, Any]:
    """A ball screw on crossed-roller guides."""
    return crossed_roller(of_mass, of_friction) | {
        "presliding": 30e-6,
        "friction_variation": 0.2,
        "friction_period": 5e-3,
        "modes": [ModeConfig(frequency_hz=120.0, damping=0.03, load=0.5)],
        "backlash": 2e-6,
        "torque_lag": 3e-4,
        "drift": 2e-9,
    }


def flexure(of_mass: Scaled, of_friction: Scaled) -> dict[str, Any]:
    """A flexure."""
    return _common(of_mass) | {
        "friction_scale": 0.0,
        "cable_stiffness": of_mass(24.7e3),  # (2 pi 25 Hz)^2
        "modes": [ModeConfig(frequency_hz=400.0, damping=0.01, load=0.2)],
        "bias_walk": of_mass(1e-3),
    }


def ideal(of_mass: Scaled, of_friction: Scaled) -> dict[str, Any]:
    """Nothing but what is stated."""
    return {}


def staged(plant: PlantConfig) -> PlantConfig:
    """The plant with the values of its kind of stage wherever it states none."""
    if plant.stage not in REAL_STAGES:
        return plant

    def scaled(values: Sequence[float]) -> Scaled:
        return lambda factor: [factor * value for value in values]

    values = plugins.load(STAGES[plant.stage])(scaled(plant.mass), scaled(plant.coulomb))
    return plant.model_copy(
        update={name: value for name, value in values.items() if name not in plant.model_fields_set}
    )
