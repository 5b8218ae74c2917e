"""The part of a rig file that describes the emulated stage: [plant]. The true plant, not the nominal model."""

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from drivers.base.keys import REQUIRED, Table, key
from drivers.base.plugins import Kind, known, unknown
from sim_plant.axis_config import MOST_MODES, MOST_SLIPS, ModeConfig, SlipConfig, modes_fit
from sim_plant.dish_config import DishConfig

# Of any quantity, in SI units. Beyond, the quotient of two can be zero or infinite.
Positive = Annotated[float, Field(ge=1e-15, le=1e15)]
Angle = Annotated[float, Field(ge=-1e3, le=1e3)]
Distance = Annotated[float, Field(ge=0, le=1)]
Ratio = Annotated[float, Field(ge=0, le=10)]
Part = Annotated[float, Field(ge=0, le=0.95)]
Lag = Annotated[float, Field(ge=0, le=0.1)]
Speed = Annotated[float, Field(ge=-1, le=1)]
Latency = Annotated[float, Field(ge=0, le=1e-3)]
Force = Annotated[float, Field(ge=-1e6, le=1e6)]
NonNegative = Annotated[float, Field(ge=0, le=1e15)]
Position = Annotated[float, Field(ge=-1e3, le=1e3)]
Resolution = Annotated[float, Field(ge=1e-15, le=1e3)]
PerAxis = float | list[float]  # one number for all axes, or one per axis


# Kinds of stage, and where the values of ours are made. A user's is a class like sim_plant.user_stage.Plant.
STAGES: dict[str, str] = {
    "ideal": "sim_plant.stages:ideal",
    "air-bearing": "sim_plant.stages:air_bearing",
    "crossed-roller": "sim_plant.stages:crossed_roller",
    "ball-screw": "sim_plant.stages:ball_screw",
    "flexure": "sim_plant.stages:flexure",
}
REAL_STAGES = STAGES.keys() - {"ideal"}  # ours that add what real ones have
STAGE_KIND = Kind("stage", "stages", "plant", "stage", "hil.stages", STAGES, ("begin", "advance"))


class PlantError(ArithmeticError):
    """Numbers in [plant] that are valid one by one but whose motion cannot be integrated."""


def diverged(at_ns: int) -> PlantError:
    """Of a stage whose motion is no number any more."""
    return PlantError(
        f"[plant]: at {at_ns * 1e-9:.3f} s the emulated motion is no longer finite; its masses, friction, "
        "ripple or forces lie beyond what can be integrated in steps of a millisecond"
    )


class CellConfig(Table):
    """[[plant.cells]]: a membrane in front of the pipette, F = stiffness * depth^3 until it is pierced."""

    axis: str = key(REQUIRED, "axis whose tip touches the cell; at most one cell per axis")
    surface: float = key(REQUIRED, "axis position at which the tip touches", "m")
    direction: Literal[-1, 1] = key(-1, "sign of the motion into the cell", "1")
    stiffness: Positive = key(1.54e8, "force over the cube of the depth", "N/m^3")
    puncture_depth: Positive = key(164e-6, "depth at which the membrane is pierced", "m")
    drag: NonNegative = key(0.0, "viscous drag inside the cell, after piercing", "N s/m")


class SwitchConfig(Table):
    """[[plant.switches]]: the switches of one axis and its encoder's counter, as its drive reads them."""

    axis: str = key(REQUIRED, "axis that they are on")
    low: Position | None = key(None, "limit switch closed from here on towards negative positions", "m (rad)")
    high: Position | None = key(None, "limit switch closed from here on towards positive positions", "m (rad)")
    home: Position | None = key(None, "home switch closed from here on towards negative positions", "m (rad)")
    contact: Literal["sound", "dead", "stuck", "bouncing", "inverted"] = key(
        "sound",
        "dead: never closed; stuck: always; bouncing: within 5 um (5 urad) of its place; inverted",
        exclude_if=lambda contact: contact == "sound",
    )
    zero: Position | None = key(
        None,
        "place where the encoder counts from after power-up; none: it knows the axis' position",
        "m (rad)",
        exclude_if=lambda place: place is None,
    )
    index: Position | None = key(
        None,
        "the encoder's index: once it has been passed the drive counts from there and says homed, or its touch probe "
        "has latched where it counts there; dead and stuck contacts give no pulse",
        "m (rad)",
        exclude_if=lambda place: place is None,
    )


def _is_zero(value: float) -> bool:
    """Of a key that no hash of a rig without it knows."""
    return value == 0.0


Measured = Literal[
    "cell_force", "applied_force", "position", "tip_force", "cell_shift", "bolus", "tip_error", "dimple", "pressure"
]


OF_DISH: tuple[Measured, ...] = (
    "tip_force",
    "cell_shift",
    "bolus",
    "tip_error",
    "dimple",
    "pressure",
)  # these need [plant.dish]


class EmulatedSensorConfig(Table):
    """[[plant.sensors]]: what a sensor of [sensors] really measures, and how well."""

    sensor: str = key(REQUIRED, "name of the sensor in [sensors]; at most one entry each")
    measures: Measured = key(
        REQUIRED,
        "cell_force: of the membrane of [[plant.cells]] on the tip, pressing counts as positive; applied_force: of the "
        "axis' drive; position: of the axis' tip; the others need [plant.dish]: tip_force: of its cell on the tip, "
        "pressing positive; cell_shift: way of the cell under the tip from where it was planned; bolus: that of the "
        "last pulse in the cell under the tip, 1: a full one; tip_error: tip as a camera sees it less the encoder; "
        "dimple: how deep the tip has pressed in a cell that is not pierced; pressure: in the injector, of its valve",
    )
    axis: str = key(REQUIRED, "axis that it belongs to")
    gain: float = key(1.0, "reading per N (N m) or m (rad)", "1", ge=-1e9, le=1e9)
    offset: float = key(0.0, "reading at zero, in the sensor's unit", "unit", ge=-1e9, le=1e9)
    noise: float | None = key(
        None, "true RMS noise of a reading, in the sensor's unit", "unit", derived="sensors.NAME.noise", ge=0, le=1e6
    )
    lag: Lag = key(0.0, "time constant of the sensor and its amplifier", "s")
    delay: float = key(0.0, "from the sample to the first bit of its frame", "s", ge=0, le=0.2)
    frame_s: float = key(
        0.0, "it samples once in so long, as a camera does; 0: in every tick", "s", exclude_if=_is_zero, ge=0, le=1
    )
    tool_mass: float = key(
        0.0,
        "tip_force: mass between sensor and tip, which the sensor feels when it is accelerated",
        "kg",
        exclude_if=_is_zero,
        ge=0,
        le=1,
    )
    decay: float = key(
        0.0,
        "time constant with which a constant reading fades, as a piezo's does; 0: never",
        "s",
        exclude_if=_is_zero,
        ge=0,
        le=1e4,
    )

    @model_validator(mode="after")
    def _every_key_acts(self) -> "EmulatedSensorConfig":
        if self.tool_mass and self.measures != "tip_force":
            raise ValueError(f"tool_mass = {self.tool_mass}: of measures = 'tip_force' alone, not {self.measures!r}")
        return self


class CoggingConfig(Table):
    """[[plant.cogging]]: one harmonic of the motor's force, amplitude sin(2 pi position / period + phase)."""

    axis: str | None = key(None, "axis whose motor has it; without: every axis")
    amplitude: NonNegative = key(REQUIRED, "peak of the force", "N (N m)")
    period: Positive = key(REQUIRED, "travel after which it repeats", "m (rad)")
    phase: Angle = key(0.0, "phase at position 0", "rad")


class VibrationConfig(Table):
    """[[plant.vibration]]: one line of the floor's motion, acceleration sin(2 pi frequency t + phase)."""

    axis: str | None = key(None, "axis it shakes; without: every axis")
    acceleration: NonNegative = key(REQUIRED, "peak acceleration of the floor along the axis", "m/s^2 (rad/s^2)")
    frequency_hz: float = key(REQUIRED, "frequency", "Hz", gt=0, le=5000)
    phase: Angle = key(0.0, "phase at the emulated stage's start", "rad")


NodeNumber = Annotated[int, Field(ge=0, le=254)]
HostNumber = Annotated[int, Field(ge=0, le=0x7FF)]
ObjectPlace = Annotated[str, Field(pattern=r"^[0-9A-Fa-f]{4}h?(:[0-9A-Fa-f]{1,2})?$")]
Turn = Annotated[float, Field(ge=-1e3, le=1e3)]
Interval = Annotated[float, Field(ge=0, le=10)]  # s
_OF_KIND = {
    "cia402": {
        "missing",
        "aborts",
        "answer_delay_s",
        "enable_delay_s",
        "dummy_mapping",
        "status_bits",
        "answers",
        "instead",
    },
    "odrive": {"nodes", "turn", "feedback_s", "heartbeat_s", "enable_delay_s", "instead"},
    "moteus": {"nodes", "turn", "enable_delay_s", "instead"},
    "vesc": {"nodes", "turn", "feedback_s", "heartbeat_s", "torque_constant", "pole_pairs", "instead"},
    "damiao": {"nodes", "turn", "position_range", "torque_range", "told_to"},
    "cubemars": {"nodes", "turn", "position_range", "torque_range", "told_to"},
    "robstride": {"nodes", "turn", "position_range", "torque_range", "told_to"},
}


class EmulatedDriveConfig(Table):
    """[plant.drive]: the emulated drives as their maker documents them, not as the rig's binding has them.

    Lists are in the order of [axes].
    """

    kind: Literal["cia402", "moteus", "odrive", "vesc", "damiao", "cubemars", "robstride"] = key(
        REQUIRED, "what they are"
    )
    nodes: list[NodeNumber] = key(
        [], "all but cia402: their numbers", "1", derived="1, 2, ...; odrive, vesc: 0, 1, ..."
    )
    turn: list[Turn] = key(
        [],
        "all but cia402: travel of the axis per turn of the drive's shaft; negative: mounted the other way round",
        "m (rad)",
    )
    feedback_s: float = key(0.001, "odrive, vesc: period in which they send their position", "s", ge=1e-4, le=1)
    heartbeat_s: float = key(0.02, "odrive, vesc: period in which they send their state", "s", ge=1e-3, le=1)
    torque_constant: Positive = key(0.05, "vesc: torque of the motor per ampere", "N m/A")
    pole_pairs: int = key(7, "vesc: electrical per mechanical revolutions", "1", ge=1, le=100)
    position_range: Positive = key(12.5, "damiao, cubemars, robstride: greatest position that they tell", "rad")
    torque_range: Positive = key(10.0, "damiao, cubemars, robstride: greatest torque that they take", "N m")
    told_to: list[HostNumber] = key(
        [],
        "damiao, cubemars: identifier in which each answers; robstride: number of the host",
        "1",
        derived="damiao: its number + 0x10; cubemars: its number; robstride: 0xFD",
    )
    enable_delay_s: Interval = key(0.0, "cia402, moteus, odrive: from the command to torque", "s")
    missing: list[ObjectPlace] = key([], 'cia402: objects of the EDS that the drive has not, as "1029h:01"')
    aborts: list[ObjectPlace] = key([], "cia402: objects whose every access it aborts")
    answer_delay_s: Interval = key(0.0, "cia402: delay of its SDO answers", "s")
    dummy_mapping: bool = key(True, "cia402: RPDOs may map dummy objects, where the EDS says so")
    answers: Literal["expedited", "unsized", "segmented", "block"] = key(
        "expedited",
        "cia402: how it answers SDO reads; unsized: expedited, without telling the size; block: what is longer than "
        "four bytes by block transfer alone",
    )
    instead: dict[str, float] = key(
        {},
        "cia402, moteus, odrive: values that it acknowledges and then has otherwise, by object (6061h), register "
        "(kp_scale) or endpoint (controller.config.control_mode); vesc: values that were set otherwise (l_current_max)",
        exclude_if=lambda values: not values,
    )
    status_bits: int = key(0, "cia402: its own bits of the statusword: 8, 14, 15", "1", ge=0, le=0xFFFF)

    @model_validator(mode="after")
    def _every_key_acts(self) -> "EmulatedDriveConfig":
        fields = type(self).model_fields
        stated = {name for name, value in self if value != fields[name].default}
        ignored = sorted(stated - {"kind"} - _OF_KIND[self.kind])
        if ignored:
            raise ValueError(f"{', '.join(ignored)}: no key of kind = {self.kind!r}")
        if self.status_bits & ~0xC100:
            raise ValueError(f"status_bits = {self.status_bits:#x}: only bits 8, 14 and 15 are the maker's")
        if self.kind != "cia402" and (not self.turn or 0.0 in self.turn):
            raise ValueError(f"kind = {self.kind!r} needs `turn`, other than 0, for every axis")
        return self


class PlantConfig(Table):
    """[plant]: what the emulated stage is really like; only emulation and simulation read it.

    One number for all axes, or a list in the order of [axes]. What a rig file does not state is as its nominal model
    says.
    """

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
    dish: DishConfig | None = key(
        None, "a dish of cells with positions, in place of [[plant.cells]]", exclude_if=lambda value: value is None
    )
    drive: EmulatedDriveConfig | None = key(
        None, "the emulated drives as their maker has them; without: as the frame layout says"
    )
    brake_force: Positive | list[Positive] = key(100.0, "force the brakes of [drives] hold", "N (N m)")
    seed: int = key(1, "of the noise in force and encoders", "1", ge=0, lt=2**32)

    stage: str = key(
        "ideal",
        f"kind of stage: {', '.join(STAGES)}: values for the keys below that are not stated (sim_plant/stages.py), "
        "ideal: none; or a stage of your own in place of our physics: its registered name, package.module:Class, or "
        "./file.py:Class beside the rig file",
    )
    parameters: dict[str, Any] = key({}, "of a stage of your own: what its class takes")
    source: str = key("", "of such a stage: its file's text, or its package's digest; filled in when the rig is loaded")
    presliding: Distance | list[Distance] = key(
        0.0, "Coulomb friction over its stiffness at rest (LuGre); 0: friction flips at v = 0", "m (rad)"
    )
    presliding_damping: Ratio | list[Ratio] = key(0.2, "damping ratio of the axis stuck on that stiffness", "1")
    slip: list[SlipConfig] = key(
        [],
        f"[[plant.slip]]: Maxwell-slip elements, at most {MOST_SLIPS} per axis; an axis without: LuGre",
        exclude_if=lambda value: not value,
    )
    torque_lag: Lag | list[Lag] = key(0.0, "time constant of the force behind its command", "s")
    torque_noise: NonNegative | list[NonNegative] = key(
        0.0, "white noise of the force, one-sided density", "N/sqrt(Hz) (N m/sqrt(Hz))"
    )
    modes: list[ModeConfig] = key([], f"flexible modes, at most {MOST_MODES} per axis")
    friction_variation: Part | list[Part] = key(
        0.0, "fraction by which dry friction varies along the travel, a sinusoid", "1"
    )
    friction_period: Positive | list[Positive] = key(0.01, "period of that along the travel", "m (rad)")
    friction_phase: Angle | list[Angle] = key(0.0, "phase of that at position 0", "rad")
    cogging: list[CoggingConfig] = key([], "harmonics of the motors' forces, at most three per axis")
    switches: list[SwitchConfig] = key([], "[[plant.switches]]: limit and home switches, one entry an axis")
    sensors: list[EmulatedSensorConfig] = key(
        [],
        "what the sensors of [sensors] measure; without an entry: nothing but noise",
        exclude_if=lambda value: not value,
    )
    cable_stiffness: NonNegative | list[NonNegative] = key(
        0.0, "of the moving cables, about position 0", "N/m (N m/rad)"
    )
    cable_hysteresis: NonNegative | list[NonNegative] = key(0.0, "half the width of their loop of force", "N (N m)")
    cable_reach: Positive | list[Positive] = key(1e-3, "travel over which that force turns round", "m (rad)")
    bias: Force | list[Force] = key(0.0, "constant force that no model knows", "N (N m)")
    bias_walk: NonNegative | list[NonNegative] = key(
        0.0, "of a force that walks at random: RMS change in a second", "N/sqrt(s) (N m/sqrt(s))"
    )
    vibration: list[VibrationConfig] = key([], "lines of the floor's motion, at most four per axis")
    backlash: Distance | list[Distance] = key(0.0, "lost motion between the load and a tool without mass", "m (rad)")
    drift: Speed | list[Speed] = key(0.0, "thermal, of the tool; seen by no encoder", "m/s (rad/s)")
    encoder_noise: Distance | list[Distance] = key(0.0, "white noise of every sample, RMS", "m (rad)")
    encoder_periodic_error: Distance | list[Distance] = key(
        0.0, "amplitude of the error within a signal period", "m (rad)"
    )
    encoder_period: Positive | list[Positive] = key(20e-6, "signal period of the encoder", "m (rad)")
    encoder_latency: Latency | list[Latency] = key(0.0, "by which a sample is older than its time stamp says", "s")

    @field_validator("stage")
    @classmethod
    def _known_stage(cls, name: str) -> str:
        if not known(STAGE_KIND, name):
            raise ValueError(unknown(STAGE_KIND, name))
        return name

    @model_validator(mode="after")
    def _counted_per_axis(self) -> "PlantConfig":
        allowed = {"cells": 1, "modes": MOST_MODES, "slip": MOST_SLIPS, "switches": 1, "cogging": 3, "vibration": 4}
        for name, most in allowed.items():
            axes = [entry.axis for entry in getattr(self, name)]
            often = sorted({axis or "(every)" for axis in axes if axes.count(axis) > most})
            if often:
                raise ValueError(
                    f"{name}: more than {most} on axis {', '.join(often)}; allowed per axis: at most {most}"
                )
        modes_fit(self.modes)
        return self

    @model_validator(mode="after")
    def _dish_fits(self) -> "PlantConfig":
        lacking = [entry for entry in self.sensors if entry.measures in OF_DISH and self.dish is None]
        if lacking:
            raise ValueError(f"sensors: measures = {lacking[0].measures!r} of '{lacking[0].sensor}' needs [plant.dish]")
        if self.dish is not None and self.dish.axes[2] in [cell.axis for cell in self.cells]:
            raise ValueError(
                f"dish: axis {self.dish.axes[2]} has a membrane of [[plant.cells]], too; expected cells = [] beside it"
            )
        return self
