"""The part of a rig file that describes the emulated stage: [plant]. The true plant, not the nominal model."""

from typing import Annotated, Literal

from pydantic import BaseModel, Field, model_validator

from drivers.config import REQUIRED, STRICT, key

# Of any quantity, in SI units. Beyond, the quotient of two can be zero or infinite.
Positive = Annotated[float, Field(ge=1e-15, le=1e15)]
NonNegative = Annotated[float, Field(ge=0, le=1e15)]
Position = Annotated[float, Field(ge=-1e3, le=1e3)]
Resolution = Annotated[float, Field(ge=1e-15, le=1e3)]
PerAxis = float | list[float]  # one number for all axes, or one per axis


class PlantError(ArithmeticError):
    """Numbers in [plant] that are valid one by one but whose motion cannot be integrated."""


class CellConfig(BaseModel):
    """[[plant.cells]]: a membrane in front of the pipette, F = stiffness * depth^3 until it is pierced."""

    model_config = STRICT
    axis: str = key(REQUIRED, "axis whose tip touches the cell; at most one cell per axis")
    surface: float = key(REQUIRED, "axis position at which the tip touches", "m")
    direction: Literal[-1, 1] = key(-1, "sign of the motion into the cell", "1")
    stiffness: Positive = key(1.54e8, "force over the cube of the depth", "N/m^3")
    puncture_depth: Positive = key(164e-6, "depth at which the membrane is pierced", "m")
    drag: NonNegative = key(0.0, "viscous drag inside the cell, after piercing", "N s/m")


class PlantConfig(BaseModel):
    """[plant]: what the emulated stage is really like; only emulation and simulation read it.

    One number for all axes, or a list in the order of [axes]. What a rig file does not state is as its nominal model
    says.
    """

    model_config = STRICT
    mass: list[Positive] = key([], "moving mass", "kg (kg m^2)", derived="axes.NAME.model.mass")
    coulomb: list[NonNegative] = key([], "Coulomb friction", "N (N m)", derived="axes.NAME.model.coulomb")
    viscous: list[float] = key(
        [], "viscous friction; the paper's is negative on X", "N s/m (N m s/rad)", derived="axes.NAME.model.viscous"
    )
    quadratic: list[float] = key(
        [], "friction times v |v|", "N s^2/m^2 (N m s^2/rad^2)", derived="axes.NAME.model.quadratic"
    )
    gravity: list[float] = key(
        [],
        "constant force on the axis; negative pulls towards negative positions; an empty list: none",
        "N (N m)",
        derived="axes.NAME.model.gravity",
    )
    mass_scale: float = key(1.0, "factor on mass", "1", ge=0.1, le=10)
    friction_scale: float = key(1.0, "factor on coulomb, viscous and quadratic", "1", ge=0, le=10)
    modelling_error: NonNegative | list[NonNegative] = key(
        0.0, "additional dry friction that no model knows: the paper's Delta sgn(v)", "N (N m)"
    )
    encoder_resolution: Resolution | list[Resolution] = key(
        1e-7,
        "length per encoder count; another value than the axis' makes every measured position wrong by that factor",
        "m (rad)",
        derived="axes.NAME.encoder_resolution",
    )
    ripple_amplitude: NonNegative | list[NonNegative] = key(0.0, "amplitude of the force ripple", "N (N m)")
    ripple_period: Positive | list[Positive] = key(0.05, "period of the force ripple along the travel", "m (rad)")
    stribeck_scale: NonNegative | list[NonNegative] = key(
        0.0, "extra Coulomb friction at rest, as a fraction of it", "1"
    )
    stribeck_velocity: Positive | list[Positive] = key(0.01, "velocity at which half of it is gone", "m/s (rad/s)")
    initial_position: Position | list[Position] = key(0.0, "true position at the start", "m (rad)")
    cells: list[CellConfig] = key([], "cells in front of the pipette")
    brake_force: Positive | list[Positive] = key(100.0, "force the brakes of [drives] hold", "N (N m)")
    seed: int = key(1, "reserved: noise is seeded by a scenario, losses and jitter by [wire]", "1", ge=0, lt=2**32)

    @model_validator(mode="after")
    def _one_cell_per_axis(self) -> "PlantConfig":
        axes = [cell.axis for cell in self.cells]
        twice = sorted({axis for axis in axes if axes.count(axis) > 1})
        if twice:
            raise ValueError(f"cells: more than one on axis {', '.join(twice)}; at most one is allowed per axis")
        return self
