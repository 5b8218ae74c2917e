"""What cells are like, by animal and stage: values for [plant.dish], each with its source, and what is assumed.

Sources:

- Kim 2006: Kim, Hwang, Sun, Lee, Kim, Nelson, "Mechanical analysis of chorion softening in prehatching stages of
  zebrafish embryos", IEEE Trans. NanoBioscience 5(2), 2006. Penetration force and elastic modulus of the chorion at the
  blastula stage are 1.3 and 1.66 times those at the prehatching stage.
- Sun 2005: Sun, Nelson, Greminger, "Investigating protein structure change in the zona pellucida with a microrobotic
  system", Int. J. Robotics Research 24, 2005. A point load on a membrane: force with the third power of the depth.
- Murayama 2006: Murayama et al., "Mouse zona pellucida dynamically changes its elasticity during oocyte maturation,
  fertilization and early embryo development", Human Cell 19, 2006. Young's modulus 8.26 kPa (SD 5.22; metaphase II),
  22.3 kPa (SD 10.5; pronuclear), at indentations of 5 um, so in the range of small strain: force with depth^1.5.
"""

from typing import Final, NamedTuple

from sim_plant.dish_config import LayerConfig

RATED_SPEED: Final = 2e-3  # m/s; faster punctures are outside what was measured


class Preset(NamedTuple):
    """Cells of one animal and stage.

    layers: from the outermost on. top_spread: m, standard deviation of the tops. lateral_stiffness: N/m, of the cell
    against a tip in it that moves sideways. slip_off: N, sideways, at which the tip slips off. source: where the values
    come from. assumed: those that come from nowhere.
    """

    layers: tuple[LayerConfig, ...]
    top_spread: float
    lateral_stiffness: float
    slip_off: float
    source: str
    assumed: str


_CHORION = {"force_spread": 0.2, "viscous_share": 0.4, "viscous_time": 0.15, "slip_time": 3e-3}
_SHAFT = {"friction": 20e-6, "adhesion": 20e-6}
_BLASTULA_FORCE = 0.75e-3
_BLASTULA_STIFFNESS = _BLASTULA_FORCE / (180e-6 * 180e-6 * 180e-6)


def _zona(modulus: float, spread: float, force: float) -> LayerConfig:
    """Zona pellucida by its Young's modulus (Pa): Hertz's sphere, 4/3 E / (1 - nu^2) sqrt(R), R = 5 um, nu = 0.5."""
    stiffness = 4.0 / 3.0 * modulus / 0.75 * 2.23606797749979e-3
    return LayerConfig(
        power=1.5, force=force, force_spread=0.2, stiffness=stiffness, spread=spread, viscous_share=0.3,
        viscous_time=0.3, rate_gain=0.05, friction=0.02 * force, adhesion=0.02 * force,
    )  # fmt: skip


PRESETS: Final[dict[str, Preset]] = {
    "zebrafish-assumed": Preset(
        (LayerConfig(power=2.0, force=0.75e-3, depth=180e-6, spread=0.15, **_CHORION, **_SHAFT),),
        15e-6, 5.0, 0.5e-3,
        "none",
        "everything; the cell that the bars of `hil inject --judge` are stated for",
    ),
    "zebrafish-blastula": Preset(
        (
            LayerConfig(
                power=3.0, force=_BLASTULA_FORCE, stiffness=_BLASTULA_STIFFNESS, spread=0.2, rate_gain=0.05,
                **_CHORION, **_SHAFT,
            ),
        ),
        15e-6, 5.0, 0.5e-3,
        "power: Sun 2005",
        "force, stiffness, viscous part, rate, shaft, spreads, sideways",
    ),
    "zebrafish-prehatching": Preset(
        (
            LayerConfig(
                power=3.0, force=_BLASTULA_FORCE / 1.3, stiffness=_BLASTULA_STIFFNESS / 1.66, spread=0.2,
                rate_gain=0.05, **_CHORION, **_SHAFT,
            ),
        ),
        15e-6, 5.0, 0.5e-3,
        "force and stiffness relative to the blastula: Kim 2006; power: Sun 2005",
        "viscous part, rate, shaft, spreads, sideways",
    ),
    "mouse-mii": Preset(
        (_zona(8.26e3, 0.63, 8e-6),),
        5e-6, 0.2, 6e-6,
        "modulus and its spread: Murayama 2006; power: its small strain",
        "contact radius 5 um, puncture force, viscous part, rate, shaft, sideways",
    ),
    "mouse-pn": Preset(
        (_zona(22.3e3, 0.47, 20e-6),),
        5e-6, 0.5, 15e-6,
        "modulus and its spread: Murayama 2006; power: its small strain",
        "contact radius 5 um, puncture force, viscous part, rate, shaft, sideways",
    ),
}  # fmt: skip
