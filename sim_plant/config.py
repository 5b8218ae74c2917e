"""The part of a rig file that describes the emulated stage: [plant]. The plant's truth, not the controller's belief."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

# Of any quantity, in SI units. Beyond, the quotient of two can be zero or infinite.
Positive = Annotated[float, Field(ge=1e-15, le=1e15)]
NonNegative = Annotated[float, Field(ge=0, le=1e15)]
Position = Annotated[float, Field(ge=-1e3, le=1e3)]
Resolution = Annotated[float, Field(ge=1e-15, le=1e3)]
PerAxis = float | list[float]  # one number for all axes, or one per axis


class PlantError(ArithmeticError):
    """Numbers in [plant] that are valid one by one but whose motion cannot be integrated."""


class CellConfig(BaseModel):
    """A membrane in front of the pipette: F = stiffness * depth^3 until it is pierced (physics/membrane.py)."""

    model_config = STRICT
    axis: str
    surface: float  # m, axis position at which the tip touches
    direction: Literal[-1, 1] = -1  # sign of the motion into the cell
    stiffness: Positive = 1.54e8  # N/m^3
    puncture_depth: Positive = 164e-6  # m
    drag: NonNegative = 0.0  # N s/m while inside, after piercing


class PlantConfig(BaseModel):
    """[plant]: masses (kg), friction, encoders and drives of the stage. Per-axis values in the order of [axes]."""

    model_config = STRICT
    mass: list[Positive]
    coulomb: list[NonNegative]  # N
    viscous: list[float]  # N s/m; the paper's are negative on X
    quadratic: list[float]  # N s^2/m^2, times v |v|
    gravity: list[float] = []  # N, constant force on the axis (negative pulls towards negative positions); empty: none
    mass_scale: Annotated[float, Field(ge=0.1, le=10)] = 1.0
    friction_scale: Annotated[float, Field(ge=0, le=10)] = 1.0  # of coulomb, viscous and quadratic
    modelling_error: Annotated[float, Field(ge=0)] | list[NonNegative] = 0.0  # N, Delta sgn(v)
    encoder_resolution: Resolution | list[Resolution] = 1e-7  # m or rad per count
    ripple_amplitude: NonNegative | list[NonNegative] = 0.0  # N
    ripple_period: Positive | list[Positive] = 0.05  # m
    stribeck_scale: NonNegative | list[NonNegative] = 0.0  # extra Coulomb friction at rest, as a fraction
    stribeck_velocity: Positive | list[Positive] = 0.01  # m/s
    initial_position: Position | list[Position] = 0.0  # m
    cells: list[CellConfig] = []  # at most one per axis
    brake: bool | list[bool] = False  # the axis has a brake, engaged by its drive whenever it applies no torque
    brake_force: Positive | list[Positive] = 100.0  # N (N m) the brake holds
    watchdog_s: Annotated[float, Field(gt=0, le=1)] = 0.01  # no valid command for this long: zero torque, latched
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 1  # of nothing yet: noise is a scenario's, loss and jitter the wire's

    @model_validator(mode="after")
    def _one_cell_per_axis(self) -> "PlantConfig":
        axes = [cell.axis for cell in self.cells]
        twice = sorted({axis for axis in axes if axes.count(axis) > 1})
        if twice:
            raise ValueError(f"cells: more than one on axis {', '.join(twice)}; at most one is allowed per axis")
        return self
