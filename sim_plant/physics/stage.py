"""The stage's physics: independent axes with set-valued friction, advanced from one change of force to the next.

Between two changes the force is constant. Each axis is integrated with the classical Runge-Kutta step on pieces of at
most 1 ms on which sgn(v) does not change; the instants of stops, breakaways and punctures are found to rounding and the
integration restarts there, so that nothing chatters at zero speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_plant.config import PlantConfig
from sim_plant.physics.axis import (
    ACCURACY,
    MAX_SUBSTEPS,
    Axis,
    State,
    advance_piece,
    effort,
    make_axis,
    net_force,
    runge_kutta,
    take,
)
from sim_plant.physics.axis_floats import SingleAxis
from sim_plant.physics.exact_trigonometry import sin_turns
from sim_plant.physics.friction import Friction, breakaway
from sim_plant.physics.membrane import Membrane, transition

Array = NDArray[np.float64]

MAX_PIECE_NS = 1_000_000
FEW = 16  # axes that are faster one by one than as an array
CHUNK = 8192  # axes integrated together: their temporaries stay in a core's cache


@dataclass(frozen=True)
class Truth:
    """What the stage is really like; every array has shape (..., n_axes), scales already applied.

    mass: kg. coulomb, gravity, modelling_error, ripple_amplitude: N. viscous: N s/m. quadratic: N s^2/m^2. stribeck: N,
    extra friction at rest. stribeck_velocity: m/s. ripple_period, cell_surface, puncture_depth: m. cell_direction: +-1.
    cell_stiffness: N/m^3 (0: no cell). cell_drag: N s/m.
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

    @classmethod
    def from_config(cls, plant: PlantConfig, n_axes: int, axis_names: Sequence[str] = ()) -> "Truth":
        """Truth of one rig, arrays (n_axes,). axis_names are needed where [plant] has cells. Raises ValueError."""
        per_axis = {
            "mass": np.multiply(plant.mass, plant.mass_scale),
            "coulomb": np.multiply(plant.coulomb, plant.friction_scale),
            "viscous": np.multiply(plant.viscous, plant.friction_scale),
            "quadratic": np.multiply(plant.quadratic, plant.friction_scale),
            "gravity": plant.gravity or 0.0,
            "modelling_error": plant.modelling_error,
            "stribeck": np.multiply(np.multiply(plant.coulomb, plant.friction_scale), plant.stribeck_scale),
            "stribeck_velocity": plant.stribeck_velocity,
            "ripple_amplitude": plant.ripple_amplitude,
            "ripple_period": plant.ripple_period,
            "cell_surface": 0.0,
            "cell_direction": 1.0,
            "cell_stiffness": 0.0,
            "puncture_depth": 1e100,
            "cell_drag": 0.0,
        }
        arrays = {key: per_axis_array(f"plant.{key}", value, n_axes) for key, value in per_axis.items()}
        for cell in plant.cells:
            if cell.axis not in axis_names:
                raise ValueError(
                    f"plant.cells: no axis '{cell.axis}'; the axes are {', '.join(axis_names) or 'not named'}"
                )
            index = list(axis_names).index(cell.axis)
            for key, value in {
                "cell_surface": cell.surface,
                "cell_direction": cell.direction,
                "cell_stiffness": cell.stiffness,
                "puncture_depth": cell.puncture_depth,
                "cell_drag": cell.drag,
            }.items():
                arrays[key][index] = value
        return cls(**arrays)

    @classmethod
    def stack(cls, truths: Sequence["Truth"]) -> "Truth":
        """Batch of plants, arrays of shape (len(truths), ..., n_axes)."""
        return cls(**{field.name: np.stack([getattr(truth, field.name) for truth in truths]) for field in fields(cls)})

    @property
    def shape(self) -> tuple[int, ...]:
        """(..., n_axes)."""
        return self.mass.shape


def per_axis_array(name: str, value: ArrayLike, n_axes: int) -> Array:
    """One number for all axes, or one per axis, as an array (n_axes,). Raises ValueError naming the key."""
    array = np.asarray(value, dtype=np.float64)
    if array.ndim and array.shape != (n_axes,):
        raise ValueError(f"{name} has {array.size} values for {n_axes} axes")
    return np.array(np.broadcast_to(array, (n_axes,)))


def _filled(value: ArrayLike, shape: tuple[int, ...]) -> Array:
    # in C order, whatever the strides of the broadcast view: a batch is integrated through flat views of it
    return np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), shape), order="C")


def _axes_of(truth: Truth, clamp: Array) -> Axis:
    flat = {field.name: np.ascontiguousarray(getattr(truth, field.name)).reshape(-1) for field in fields(truth)}
    friction = Friction(
        coulomb=flat["coulomb"] + flat["modelling_error"] + clamp.reshape(-1),
        stribeck=flat["stribeck"],
        stribeck_slowness=1.0 / flat["stribeck_velocity"],
        viscous=flat["viscous"],
        quadratic=flat["quadratic"],
    )
    membrane = Membrane(
        surface=flat["cell_surface"],
        direction=flat["cell_direction"],
        stiffness=flat["cell_stiffness"],
        puncture_depth=flat["puncture_depth"],
        drag=flat["cell_drag"],
    )
    return make_axis(flat["mass"], friction, flat["ripple_amplitude"], flat["ripple_period"], membrane)


def _single(axis: Axis) -> Axis:
    """One axis, told which of the optional terms it has itself."""
    return axis._replace(
        sine=sin_turns,
        has_stribeck=axis.friction.stribeck != 0.0,
        has_ripple=axis.ripple_amplitude != 0.0,
        has_cell=axis.membrane.stiffness != 0.0 or axis.membrane.drag != 0.0,
    )


def _parts_of(axes: Axis) -> list[tuple[NDArray[np.int64], Axis]]:
    """Indices and parameters of the axes that go together: those with the same terms, at most CHUNK."""
    membrane = axes.membrane
    stribeck, ripple = axes.friction.stribeck != 0.0, axes.ripple_amplitude != 0.0
    cell = (membrane.stiffness != 0.0) | (membrane.drag != 0.0)
    kinds = 1 * stribeck + 2 * ripple + 4 * cell
    parts = []
    for kind in np.unique(kinds).tolist():
        members = np.flatnonzero(kinds == kind)
        for start in range(0, members.size, CHUNK):
            index = members[start : start + CHUNK]
            part = take(axes, index)
            has_stribeck, has_ripple, has_cell = (bool(kind & bit) for bit in (1, 2, 4))
            parts.append((index, part._replace(has_stribeck=has_stribeck, has_ripple=has_ripple, has_cell=has_cell)))
    return parts


class Stage:
    """One stage (n_axes,) or a batch of stages (..., n_axes) under forces that are constant during each `advance`.

    position, velocity: truth after the last `advance`, m and m/s, (..., n_axes); read only, those of a batch reused by
    the next one. pierced: 1.0 where an axis' cell is pierced.
    """

    def __init__(self, truth: Truth, position: ArrayLike = 0.0, velocity: ArrayLike = 0.0) -> None:
        self.truth = truth
        self._clamp = np.zeros(truth.shape)
        self._gravity: list[float] = truth.gravity.tolist() if truth.mass.ndim == 1 else []
        self._axes: list[SingleAxis] = []  # of one stage
        self._state = State(*(_filled(value, truth.shape) for value in (position, velocity, 0.0)))  # of a batch
        self._parts: list[tuple[NDArray[np.int64], Axis]] = []  # of a batch: what is integrated together
        self._configure(self._state)

    def _configure(self, state: State) -> None:
        """Take over the parameters, at this state (arrays)."""
        axes = _axes_of(self.truth, self._clamp)
        if len(self.truth.shape) == 1:
            states = zip(*(array.tolist() for array in state), strict=True)
            self._axes = [SingleAxis(_single(take(axes, i)), *values) for i, values in enumerate(states)]
        else:
            self._parts = _parts_of(axes)

    @property
    def position(self) -> Array:
        """m, (..., n_axes)."""
        return np.array(self.positions) if self._axes else self._state.position

    @property
    def velocity(self) -> Array:
        """m/s, (..., n_axes)."""
        return np.array([axis.velocity for axis in self._axes]) if self._axes else self._state.velocity

    @property
    def pierced(self) -> Array:
        """1.0 or 0.0, (..., n_axes)."""
        return np.array([axis.pierced for axis in self._axes]) if self._axes else self._state.pierced

    @property
    def positions(self) -> list[float]:
        """Positions of one stage (not a batch), m."""
        return [axis.position for axis in self._axes]

    @property
    def velocities(self) -> list[float]:
        """Velocities of one stage (not a batch), m/s."""
        return [axis.velocity for axis in self._axes]

    def clamp(self, force: ArrayLike) -> None:
        """Hold axes with `force` (N, (..., n_axes)) of additional dry friction from now on: a brake, a jam. 0: free."""
        wanted = np.broadcast_to(np.asarray(force, dtype=np.float64), self._clamp.shape)
        if not np.array_equal(wanted, self._clamp):
            self._clamp[...] = wanted
            self._configure(State(self.position, self.velocity, self.pierced))

    def advance(self, duration_ns: int, force: Sequence[float] | Array) -> None:
        """Advance by duration_ns >= 0 with `force` (N, (..., n_axes)) held; all values finite."""
        if duration_ns <= 0:
            return
        pieces = -(-duration_ns // MAX_PIECE_NS)
        h = duration_ns * 1e-9 / pieces
        if self._axes:
            single = force.tolist() if isinstance(force, np.ndarray) else force
            for axis, drive, gravity in zip(self._axes, single, self._gravity, strict=True):
                axis.advance(pieces, h, drive + gravity)
        else:
            self._advance_batch(pieces, h, np.asarray(force, dtype=np.float64))

    def peek(self, duration_ns: int, force: Sequence[float] | Array) -> tuple[Array, Array, Array]:
        """Position, velocity, pierced after `advance(duration_ns, force)`, as new arrays; the stage stays as it is."""
        batch, singles = self._state, [axis.state for axis in self._axes]
        self._state = State(*(array.copy() for array in batch))
        try:
            self.advance(duration_ns, force)
            return self.position, self.velocity, self.pierced
        finally:
            self._state = batch
            for axis, state in zip(self._axes, singles, strict=True):
                axis.position, axis.velocity, axis.pierced = state

    def _advance_batch(self, pieces: int, h: float, force: Array) -> None:
        drive = (force + self.truth.gravity).reshape(-1)
        flat = [array.reshape(-1) for array in self._state]
        for index, axis in self._parts:
            state, part = State(*(array[index] for array in flat)), drive[index]
            for _ in range(pieces):
                state = _advance_many(axis, state, part, h)
            for array, values in zip(flat, state, strict=True):
                array[index] = values


def _advance_many(axis: Axis, state: State, drive: Array, h: float) -> State:
    """As one piece of `SingleAxis.advance`, for an array: axes that need equally many substeps go together."""
    work = effort(axis, state.velocity, drive, h)
    count = np.ones(work.shape)
    while np.any(short := (count * ACCURACY < work) & (count < MAX_SUBSTEPS)):
        count[short] *= 2
    levels = np.unique(count)
    if levels.size == 1:
        return _repeat(axis, state, drive, h / float(levels[0]), int(levels[0]))
    result = State(*(array.copy() for array in state))
    for level in levels.tolist():
        index = np.flatnonzero(count == level)
        if index.size <= FEW:
            _advance_few(axis, result, drive, h, index.tolist())
            continue
        part = State(*(array[index] for array in state))
        moved = _repeat(take(axis, index), part, drive[index], h / level, int(level))
        for array, values in zip(result, moved, strict=True):
            array[index] = values
    return result


def _advance_few(axis: Axis, state: State, drive: Array, h: float, indices: list[int]) -> None:
    """Advance these of the axes, in place."""
    for index in indices:
        alone = SingleAxis(_single(take(axis, index)), *(float(array[index]) for array in state))
        alone.advance(1, h, float(drive[index]))
        state.position[index], state.velocity[index], state.pierced[index] = alone.state


def _repeat(axis: Axis, state: State, drive: Array, h: float, count: int) -> State:
    for _ in range(count):
        state = _piece_many(axis, state, drive, h)
    return state


def _piece_many(axis: Axis, state: State, drive: Array, h: float) -> State:
    """`advance_piece` for an array: smooth axes together, the few with an event one by one."""
    sign = np.sign(state.velocity)
    resting = sign == 0.0
    if resting.any():
        net = net_force(axis, *state, drive)
        sign = np.where(resting & (np.abs(net) > breakaway(axis.friction)), np.sign(net), sign)
    moving = sign != 0.0
    position, velocity = runge_kutta(axis, state, drive, sign, h)
    event = moving & (velocity * sign <= 0.0)
    if axis.has_cell:
        event |= moving & (transition(axis.membrane, position, state.pierced) >= 0.0)
    result = State(
        np.where(moving, position, state.position), np.where(moving, velocity, state.velocity), state.pierced.copy()
    )
    for index in np.flatnonzero(event).tolist():
        alone = State(*(float(array[index]) for array in state))
        outcome = advance_piece(_single(take(axis, index)), alone, float(drive[index]), h)
        for array, value in zip(result, outcome, strict=True):
            array[index] = value
    return result
