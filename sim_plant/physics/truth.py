"""What a stage is really like: [plant] as arrays, one value per axis, for one stage or for a batch."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_plant.axis_config import MOST_LOAD, ModeConfig, SlipConfig, slip_fits
from sim_plant.config import PlantConfig
from sim_plant.physics.exact_trigonometry import TURN
from sim_plant.physics.structure import HUNG, LINES, SLIPS
from sim_plant.stages import staged

Array = NDArray[np.float64]
_Entry = TypeVar("_Entry", ModeConfig, SlipConfig)

SINUSOIDS = np.dtype([("amplitude", "f8", (LINES,)), ("wavenumber", "f8", (LINES,)), ("phase", "f8", (LINES,))])
OTHER_MODES = np.dtype([("frequency", "f8", (HUNG,)), ("damping", "f8", (HUNG,)), ("load", "f8", (HUNG,))])
SLIP = np.dtype([("stiffness", "f8", (SLIPS,)), ("limit", "f8", (SLIPS,))])

# What may be changed of an axis' first line: its array, its field, what the field holds of the value, and back.
FIRST_LINE: dict[str, tuple[str, str, Callable[[Array], Array], Callable[[Array], Array]]] = {
    "cogging": ("cogging", "amplitude", np.positive, np.positive),
    "cogging_period": ("cogging", "wavenumber", np.reciprocal, np.reciprocal),
    "cogging_phase": ("cogging", "phase", lambda phase: phase / TURN, lambda turns: turns * TURN),
    "vibration": ("vibration", "amplitude", np.positive, np.positive),
    "vibration_frequency": ("vibration", "wavenumber", np.positive, np.positive),
}


@dataclass(frozen=True)
class Truth:
    """What the stage is really like; every array has shape (..., n_axes), scales already applied, SI.

    mass: kg. coulomb, gravity, modelling_error, ripple_amplitude: N. viscous: N s/m. quadratic: N s^2/m^2. stribeck: N,
    extra friction at rest. stribeck_velocity: m/s. ripple_period, cell_surface, puncture_depth: m. cell_direction: +-1.
    cell_stiffness: N/m^3 (0: no cell). cell_drag: N s/m.

    The others as in PlantConfig; mode_frequency in Hz (0: no mode): of the tool. other_modes: structured array of
    OTHER_MODES, those beside the tool's: Hz, damping ratio, part of the mass. slip: structured array of SLIP, of an
    axis' Maxwell-slip elements: parts of the stiffness at rest and of the dry friction. Cogging and vibration are
    structured arrays of SINUSOIDS: amplitude in N and m/s^2, wavenumber in turns per m and per s, phase in turns.
    """

    mass: Array
    coulomb: Array
    viscous: Array
    quadratic: Array
    gravity: Array
    modelling_error: Array
    stribeck: Array
    stribeck_velocity: Array
    ripple_amplitude: Array
    ripple_period: Array
    cell_surface: Array
    cell_direction: Array
    cell_stiffness: Array
    puncture_depth: Array
    cell_drag: Array
    presliding: Array
    presliding_damping: Array
    torque_lag: Array
    torque_noise: Array
    mode_frequency: Array
    mode_damping: Array
    mode_load: Array
    other_modes: NDArray[np.void]
    slip: NDArray[np.void]
    friction_variation: Array
    friction_period: Array
    friction_phase: Array
    cogging: NDArray[np.void]
    cable_stiffness: Array
    cable_hysteresis: Array
    cable_reach: Array
    bias: Array
    bias_walk: Array
    vibration: NDArray[np.void]
    backlash: Array
    drift: Array
    encoder_noise: Array
    encoder_periodic_error: Array
    encoder_period: Array
    encoder_latency: Array
    seed: Array

    @classmethod
    def from_config(cls, plant: PlantConfig, n_axes: int, axis_names: Sequence[str] = ()) -> "Truth":
        """Truth of one rig, arrays (n_axes,). axis_names are needed where [plant] names axes. Raises ValueError."""
        plant = staged(plant)
        per_axis: dict[str, ArrayLike] = {
            "mass": np.multiply(plant.mass, plant.mass_scale),
            "coulomb": np.multiply(plant.coulomb, plant.friction_scale),
            "viscous": np.multiply(plant.viscous, plant.friction_scale),
            "quadratic": np.multiply(plant.quadratic, plant.friction_scale),
            "gravity": plant.gravity or 0.0,
            "stribeck": np.multiply(np.multiply(plant.coulomb, plant.friction_scale), plant.stribeck_scale),
            "cell_surface": 0.0,
            "cell_direction": 1.0,
            "cell_stiffness": 0.0,
            "puncture_depth": 1e100,
            "cell_drag": 0.0,
            "mode_frequency": 0.0,
            "mode_damping": 0.0,
            "mode_load": 0.0,
        }
        lists = {"cogging": SINUSOIDS, "vibration": SINUSOIDS, "other_modes": OTHER_MODES, "slip": SLIP}
        straight = [field.name for field in fields(cls) if field.name not in (*per_axis, *lists)]
        per_axis |= {key: getattr(plant, key) for key in straight}
        arrays: dict[str, NDArray[Any]] = {
            key: per_axis_array(f"plant.{key}", value, n_axes) for key, value in per_axis.items()
        }
        arrays |= {key: np.zeros(n_axes, kind) for key, kind in lists.items()}
        _Entries(arrays, n_axes, axis_names).take(plant)
        return cls(**arrays)

    @classmethod
    def stack(cls, truths: Sequence["Truth"]) -> "Truth":
        """Batch of plants, arrays of shape (len(truths), ..., n_axes)."""
        return cls(**{field.name: np.stack([getattr(truth, field.name) for truth in truths]) for field in fields(cls)})

    def changed(self, axis: int, key: str, value: float) -> tuple["Truth", Array]:
        """The truth with another value of a key on an axis, of one stage or of every one of a batch; and the values
        before, (...).

        key: a field, or one of FIRST_LINE. What the axis has none of yet gets what the rest of [plant] has by default:
        a mode 30 % of the mass and damping 0.02, a cogging line the ripple's period, the floor 25 Hz.
        """
        arrays = {field.name: getattr(self, field.name).copy() for field in fields(self)}
        if key not in FIRST_LINE:
            if key == "mode_frequency":
                new = self.mode_load[..., axis] == 0.0
                arrays["mode_load"][..., axis][new], arrays["mode_damping"][..., axis][new] = 0.3, 0.02
            target = arrays[key][..., axis]
            before: Array = target.copy()
            if key == "mode_load":  # what the other modes leave of it
                value = np.minimum(value, MOST_LOAD - self.other_modes["load"][..., axis, :].sum(axis=-1))
            target[...] = value
            return Truth(**arrays), before
        name, field, stored, stated = FIRST_LINE[key]
        first = {each: arrays[name][each][..., axis, 0] for each in SINUSOIDS.names or ()}
        default = 1.0 / self.ripple_period[..., axis] if name == "cogging" else np.asarray(25.0)
        first["wavenumber"][...] = np.where(first["wavenumber"] == 0.0, default, first["wavenumber"])
        before = stated(first[field])
        first[field][...] = stored(np.asarray(value))
        return Truth(**arrays), before

    @property
    def shape(self) -> tuple[int, ...]:
        """(..., n_axes)."""
        return self.mass.shape


class _Entries:
    """Writes the entries of [plant]'s lists, which name their axes, into the arrays."""

    def __init__(self, arrays: dict[str, NDArray[Any]], n_axes: int, axis_names: Sequence[str]) -> None:
        self._arrays = arrays
        self._n_axes = n_axes
        self._names = list(axis_names)

    def take(self, plant: PlantConfig) -> None:
        """All of them. Raises ValueError for an axis there is not, too many entries, or slip without presliding."""
        for cell in plant.cells:
            for axis in self._axes("cells", cell.axis):
                for key in ("surface", "direction", "stiffness", "drag"):
                    self._arrays[f"cell_{key}"][axis] = getattr(cell, key)
                self._arrays["puncture_depth"][axis] = cell.puncture_depth
        for axis, modes in self._own("modes", plant.modes):
            self._hang(axis, modes)
        slip_fits(plant.slip, self._arrays["presliding"].tolist(), self._names)
        for axis, elements in self._own("slip", plant.slip):
            self._slip(axis, elements)
        for cogging in plant.cogging:
            for axis in self._axes("cogging", cogging.axis):
                self._add("cogging", axis, cogging.amplitude, 1.0 / cogging.period, cogging.phase)
        for line in plant.vibration:
            for axis in self._axes("vibration", line.axis):
                self._add("vibration", axis, line.acceleration, line.frequency_hz, line.phase)

    def _own(self, key: str, entries: Sequence[_Entry]) -> list[tuple[int, list[_Entry]]]:
        """Of each axis its entries in their order: those that name it, else those that name none."""
        stated = [(self._axes(key, entry.axis), entry) for entry in entries]
        every = [entry for entry in entries if entry.axis is None]
        own = [[entry for axes, entry in stated if entry.axis and axis in axes] for axis in range(self._n_axes)]
        return [(axis, found or every) for axis, found in enumerate(own)]

    def _slip(self, axis: int, elements: Sequence[SlipConfig]) -> None:
        """Their parts of all there is."""
        for key in ("stiffness", "limit"):
            values = [getattr(element, key) for element in elements]
            self._arrays["slip"][key][axis, : len(values)] = np.divide(values, sum(values))

    def _hang(self, axis: int, modes: Sequence[ModeConfig]) -> None:
        """The first one that does carries the tool."""
        tool = next((mode for mode in modes if mode.tool), None)
        if tool:
            self._arrays["mode_frequency"][axis] = tool.frequency_hz
            self._arrays["mode_damping"][axis] = tool.damping
            self._arrays["mode_load"][axis] = tool.load
        others = self._arrays["other_modes"]
        for place, mode in enumerate(mode for mode in modes if mode is not tool):
            for name, value in (("frequency", mode.frequency_hz), ("damping", mode.damping), ("load", mode.load)):
                others[name][axis, place] = value

    def _axes(self, key: str, axis: str | None) -> Sequence[int]:
        if axis is None:
            return range(self._n_axes)
        if axis not in self._names:
            raise ValueError(f"plant.{key}: no axis '{axis}'; the axes are {', '.join(self._names) or 'not named'}")
        return (self._names.index(axis),)

    def _add(self, key: str, axis: int, amplitude: float, wavenumber: float, phase: float) -> None:
        lines = self._arrays[key]
        most = LINES - (key == "cogging")  # the ripple of the ideal stage is one of them
        used = int(np.count_nonzero(lines["wavenumber"][axis]))
        if used == most:
            raise ValueError(f"plant.{key}: more than {most} on one axis")
        for name, value in (("amplitude", amplitude), ("wavenumber", wavenumber), ("phase", phase / TURN)):
            lines[name][axis, used] = value


def per_axis_array(name: str, value: ArrayLike, n_axes: int) -> Array:
    """One number for all axes, or one per axis, as an array (n_axes,). Raises ValueError naming the key."""
    array = np.asarray(value, dtype=np.float64)
    if array.ndim and array.shape != (n_axes,):
        raise ValueError(f"{name} has {array.size} values for {n_axes} axes")
    return np.array(np.broadcast_to(array, (n_axes,)))
