"""The stage's physics: independent axes, advanced from one change of force to the next.

Between two changes the drives' force is constant. An ideal axis, a mass under set-valued friction, is integrated with
the classical Runge-Kutta step on pieces of at most 1 ms on which sgn(v) does not change. The instants of stops,
breakaways and punctures are found to rounding and the integration restarts there. So nothing chatters at zero speed.
An axis with more to it (presliding, a mode, a lag, noise) is integrated by dynamics.py, and in pieces of 0.5 ms.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_plant.native import library
from sim_plant.physics.axis import Axis, AxisValues, State
from sim_plant.physics.disturbance import Disturbance
from sim_plant.physics.dynamic_batch import take as take_structure
from sim_plant.physics.dynamic_batch import take_many as take_structures
from sim_plant.physics.dynamics import Dynamics
from sim_plant.physics.encoder import Encoder, Point
from sim_plant.physics.events import dynamics_of
from sim_plant.physics.ideal_batch import advance_ideal, take, take_many
from sim_plant.physics.native_axis import NativeAxes, NativeAxis, takes
from sim_plant.physics.real_axes import (
    NOISY,
    RealPart,
    axis_values_of,
    is_dynamic,
    is_ideal,
    kinds_of,
    structure_of,
)
from sim_plant.physics.real_axis import RealAxis, disturbance_of, piece_times
from sim_plant.physics.single_axis import SingleAxis, axis_of
from sim_plant.physics.single_stage import IDEAL_PIECE_NS, SingleStage, encoder_of, real_pieces
from sim_plant.physics.structure import SLIPS, Motion, Structure, rigid
from sim_plant.physics.truth import Truth, per_axis_array

__all__ = ["Stage", "Truth", "per_axis_array"]

Array = NDArray[np.float64]
AnyAxis = SingleAxis | RealAxis | NativeAxis

CHUNK = 8192


def _filled(value: ArrayLike, shape: tuple[int, ...]) -> Array:
    # in C order, whatever the strides of the broadcast view: a batch is integrated through flat views of it
    return np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), shape), order="C")


def _grouped(kinds: NDArray[np.int64]) -> list[tuple[int, NDArray[np.int64]]]:
    """Kinds, and the indices of at most CHUNK axes of each: what is integrated together."""
    groups = []
    for kind in np.unique(kinds).tolist():
        members = np.flatnonzero(kinds == kind)
        groups += [(kind, members[start : start + CHUNK]) for start in range(0, members.size, CHUNK)]
    return groups


def _take_over(axes: list[AnyAxis], encoders: list[Encoder]) -> NativeAxes | None:
    """Puts axes of the native kernel in the place of those it can compute; None where it is not there, or for none."""
    kernel = library.kernel()
    found = [(i, axis, encoders[i]) for i, axis in enumerate(axes) if isinstance(axis, RealAxis) and takes(axis)]
    if kernel is None or not found:
        return None
    native = NativeAxes(kernel.advance, kernel.show, found)
    for index, axis in native.axes:
        axes[index] = axis
    return native


class Stage:
    """One stage (n_axes,) or a batch of stages (..., n_axes) under forces that are constant during each `advance`.

    position, velocity: of the tool, truth after the last `advance`, m and m/s, (..., n_axes); read only, those of a
    batch reused by the next one. pierced: 1.0 where an axis' cell is pierced.
    """

    def __init__(self, truth: Truth, position: ArrayLike = 0.0, velocity: ArrayLike = 0.0) -> None:
        self.truth = truth
        self._is_single = len(truth.shape) == 1
        self._clamp = np.zeros(truth.shape)
        self._single: SingleStage | None = None  # of one stage
        self._parts: list[tuple[NDArray[np.int64], Axis]] = []  # of a batch: what is integrated together
        self._real_parts: list[RealPart] = []
        self._elapsed_ns = 0
        self._count = 0  # pieces of REAL_PIECE_NS begun
        self._encoder: Encoder | None = None  # of a batch
        self._last_force: Sequence[float] | Array = [0.0] * truth.shape[-1]
        self._stiffness = np.zeros(truth.mass.size)
        self._slipping = np.zeros(truth.mass.size, dtype=bool)  # axes whose elements are bent already
        q, v = _filled(position, truth.shape), _filled(velocity, truth.shape)
        pierced, bristle, cable, force, walked = (np.zeros(truth.shape) for _ in range(5))
        still = Motion(q, v, pierced, q, v, bristle, cable, force, q, walked, q, v, q, v, *[bristle] * SLIPS)
        self._motion = Motion(*(array.copy() for array in still))
        self._configure(self._motion)

    # what it is made of ----------------------------------------------------------------------------------------------

    def _configure(self, motion: Motion) -> None:
        """Take over the parameters, at this state (arrays)."""
        truth = self.truth
        constant = truth.gravity + truth.bias
        self._constant = constant
        ideal, structure = axis_values_of(truth, self._clamp), structure_of(truth, self._clamp)
        kinds = kinds_of(truth, structure)
        streams = truth.seed.reshape(-1).astype(np.uint64), _axis_numbers(truth.shape)
        noise = (truth.torque_noise.reshape(-1), truth.bias_walk.reshape(-1), *streams)
        make = _Maker(ideal, structure, constant.reshape(-1), noise)
        motion = self._carried(motion, structure)
        self._deviates = not all(map(is_ideal, np.unique(kinds).tolist()))
        self._drift = truth.drift if truth.drift.any() else None
        encoders = (truth.encoder_noise, truth.encoder_periodic_error, truth.encoder_period, truth.encoder_latency)
        flat = [array.reshape(-1) for array in encoders]
        if self._is_single:
            rows = list(zip(*(array.tolist() for array in flat), strict=True))
            keys = list(zip(*(stream.tolist() for stream in streams), strict=True))
            reads = [encoder.read for encoder in self._single.encoders] if self._single else [0] * len(rows)
            axes: list[AnyAxis] = [make.one(i, kind, motion) for i, kind in enumerate(kinds.tolist())]
            encoded = [encoder_of(row, key, read) for row, key, read in zip(rows, keys, reads, strict=True)]
            drifts = [] if self._drift is None else truth.drift.tolist()
            native = _take_over(axes, encoded)
            self._single = SingleStage(axes, encoded, constant.tolist(), drifts, native)
        else:
            read = self._encoder.read if self._encoder else 0
            self._encoder = Encoder((flat[0], flat[1], flat[2], flat[3]), streams)
            self._encoder.read = read
            self._motion = motion
            groups = _grouped(kinds)
            self._parts = [(index, make.ideal(index)) for kind, index in groups if is_ideal(kind)]
            self._real_parts = [make.many(index, kind) for kind, index in groups if not is_ideal(kind)]

    def _carried(self, motion: Motion, structure: Structure) -> Motion:
        """This state under other parameters: bristles keep their force as far as they can hold it, at most that of the
        peak at rest; new ones slide with the motion."""
        presliding = structure.presliding
        has = presliding > 0.0
        most = presliding * (1.0 + structure.stribeck / np.where(has, structure.coulomb, 1.0))
        stiffness = np.where(has, structure.coulomb / np.where(has, presliding, 1.0), 0.0)
        kept = motion.bristle.reshape(-1) * (self._stiffness / np.where(has, stiffness, 1.0))
        begun = presliding * np.sign(motion.velocity.reshape(-1))
        bristle = np.where(self._stiffness > 0.0, np.clip(kept, -most, most), begun) * has
        shape, slipping = motion.bristle.shape, structure.slip_weight[0] > 0.0
        if slipping.any():
            kept = np.stack([array.reshape(-1) for array in motion[-SLIPS:]]) * (
                self._stiffness / np.where(has, stiffness, 1.0)
            )
            reach = structure.slip_reach
            bent = np.where(self._slipping, np.clip(kept, -most * reach, most * reach), bristle * reach)
            bristle = np.where(slipping, (structure.slip_weight * bent).sum(axis=0), bristle)
            motion = Motion(*motion[:-SLIPS], *(array.reshape(shape).copy() for array in bent))
        self._stiffness, self._slipping = stiffness, slipping
        return motion._replace(bristle=bristle.reshape(shape))

    def _motions(self) -> Motion:
        """State of every axis as arrays."""
        if not self._single:
            return self._motion
        each = [
            _rigid_motion(axis, force) if isinstance(axis, SingleAxis) else axis.motion
            for axis, force in zip(self._single.axes, self._last_force, strict=True)
        ]
        return Motion(*(np.array(values) for values in zip(*each, strict=True)))

    def clamp(self, force: ArrayLike) -> None:
        """Hold axes with `force` (N, (..., n_axes)) of additional dry friction from now on: a brake, a jam. 0: free."""
        wanted = np.broadcast_to(np.asarray(force, dtype=np.float64), self._clamp.shape)
        if not np.array_equal(wanted, self._clamp):
            self._clamp[...] = wanted
            self._configure(self._motions())

    def stand(self, force: ArrayLike) -> None:
        """The drives' forces have come up to `force` (N, (..., n_axes)), and nothing has moved."""
        motion = self._motions()
        self._configure(motion._replace(force=_filled(force, motion.force.shape)))

    def change(self, truth: Truth) -> None:
        """From now on the stage is this one, at the state it is in."""
        self.truth = truth
        self._configure(self._motions())

    # what is true, and what the encoders show ------------------------------------------------------------------------

    @property
    def position(self) -> Array:
        """m, (..., n_axes)."""
        if self._single:
            return np.array(self.positions)
        tool: Array = self._motion.played if self._deviates else self._motion.position
        return tool if self._drift is None else tool + self._drift * (self._elapsed_ns * 1e-9)

    @property
    def velocity(self) -> Array:
        """m/s, (..., n_axes)."""
        if self._single:
            return np.array(self.velocities)
        tool: Array = self._motion.load_velocity if self._deviates else self._motion.velocity
        return tool if self._drift is None else tool + self._drift

    @property
    def pierced(self) -> Array:
        """1.0 or 0.0, (..., n_axes)."""
        return np.array([axis.pierced for axis in self._single.axes]) if self._single else self._motion.pierced

    @property
    def positions(self) -> list[float]:
        """Positions of the tools of one stage (not a batch), m."""
        return self._alone.positions(self._elapsed_ns * 1e-9)

    @property
    def velocities(self) -> list[float]:
        """Velocities of one stage's tools, m/s."""
        return self._alone.velocities()

    def readings(self) -> list[float]:
        """What the encoders of one stage show, m; each call is a sample of its own."""
        return self._alone.readings(self._elapsed_ns * 1e-9)

    def reading(self, index: int) -> float:
        """What the encoder of this axis of one stage shows, m; each call is a sample of its own."""
        return self._alone.reading(index, self._elapsed_ns * 1e-9)

    @property
    def _alone(self) -> SingleStage:
        assert self._single, "a batch"
        return self._single

    def read(self) -> Array:
        """What the encoders show, m, (..., n_axes); each call is a sample of its own."""
        if self._single:
            return np.array(self.readings())
        assert self._encoder
        motor: Array = self._motion.position
        encoder, now = self._encoder, self._elapsed_ns * 1e-9
        if encoder.is_ideal:
            return motor
        flat = motor.reshape(-1), self._motion.velocity.reshape(-1)
        shown: Array = encoder.show(self._past(flat) if encoder.is_late else (), (now, *flat))
        there: Array = shown.reshape(self.truth.shape)
        return there

    def _past(self, now: tuple[Array, Array]) -> list[Point]:
        """Points of all axes of a batch; those without latency stand still there."""
        depth = max((len(part.past) for part in self._real_parts), default=0)
        points = []
        for k in range(depth):
            q, v = now[0].copy(), now[1].copy()
            for part in self._real_parts:
                time, q[part.index], v[part.index] = part.past[k]
            points.append((time, q, v))
        return points

    # how time passes -------------------------------------------------------------------------------------------------

    def advance(self, duration_ns: int, force: Sequence[float] | Array) -> None:
        """Advance by duration_ns >= 0 with `force` (N, (..., n_axes)) held; all values finite."""
        if duration_ns <= 0:
            return
        if self._single:
            commands = force.tolist() if isinstance(force, np.ndarray) else force
            self._last_force = commands
            self._count = self._single.advance(duration_ns, self._elapsed_ns, commands, self._count)
        else:
            commanded = np.asarray(force, dtype=np.float64)
            self._advance_ideal(duration_ns, commanded)
            if self._deviates:
                self._advance_parts(duration_ns, commanded.reshape(-1))
        self._elapsed_ns += duration_ns

    def _advance_ideal(self, duration_ns: int, force: Array) -> None:
        """Those axes of a batch that are ideal."""
        if not self._parts:
            return
        pieces = -(-duration_ns // IDEAL_PIECE_NS)
        h = duration_ns * 1e-9 / pieces
        drive = (force + self._constant).reshape(-1)
        flat = [array.reshape(-1) for array in self._motion]
        for index, axis in self._parts:
            state, part = State(*(array[index] for array in flat[:3])), drive[index]
            for _ in range(pieces):
                state = advance_ideal(axis, state, part, h)
            for array, values in zip(flat, state, strict=False):
                array[index] = values
            if self._deviates:
                at_motor = rigid(Motion(*(array[index] for array in flat)), *state)
                for array, values in zip(flat, at_motor, strict=True):
                    array[index] = values

    def _advance_parts(self, duration_ns: int, command: Array) -> None:
        """Those axes of a batch that deviate."""
        number = real_pieces(duration_ns)
        h = duration_ns * 1e-9 / number
        times = piece_times(self._elapsed_ns * 1e-9, h, number)
        flat = [array.reshape(-1) for array in self._motion]
        for part in self._real_parts:
            motion = Motion(*(array[part.index] for array in flat))
            moved = part.advance(motion, times, h, command[part.index], self._count)
            for array, values in zip(flat, moved, strict=True):
                array[part.index] = values
        self._count += len(times)

    def peek(self, duration_ns: int, force: Sequence[float] | Array) -> tuple[Array, Array, Array]:
        """Position, velocity, pierced after `advance(duration_ns, force)`, as new arrays; the stage stays as it is."""
        with self._unchanged():
            self.advance(duration_ns, force)
            return self.position, self.velocity, self.pierced

    def peek_reading(self, duration_ns: int, force: Sequence[float], index: int) -> float:
        """What the encoder of this axis of one stage shows after `advance(duration_ns, force)`."""
        with self._unchanged():
            self.advance(duration_ns, force)
            return self.reading(index)

    @contextmanager
    def _unchanged(self) -> Iterator[None]:
        """Puts the state back as it is now."""
        motion, elapsed, last = self._motion, (self._elapsed_ns, self._count), self._last_force
        states = [(axis, axis.state) for axis in self._single.axes] if self._single else []
        pasts = [part.past for part in self._real_parts]
        if not self._single:
            self._motion = Motion(*(array.copy() for array in motion))
        try:
            yield
        finally:
            self._motion, self._last_force = motion, last
            self._elapsed_ns, self._count = elapsed
            for axis, state in states:
                axis.restore(state)  # type: ignore[arg-type]
            for part, past in zip(self._real_parts, pasts, strict=True):
                part.past = past


class _Maker:
    """Makes what integrates the axes at given places of the flat arrays."""

    def __init__(
        self, ideal: AxisValues, structure: Structure, constant: Array, noise: tuple[Any, Any, Any, Any]
    ) -> None:
        self._ideal = ideal
        self._structure = structure
        self._constant = constant
        self._noise = noise  # density, walk, seed, axis

    def one(self, i: int, kind: int, motion: Motion) -> SingleAxis | RealAxis:
        """The axis of floats at `i`, of this kind, at its state in these arrays."""
        state = Motion(*(float(array[i]) for array in motion))
        if is_ideal(kind):
            return SingleAxis(axis_of(take(self._ideal, i)), state.position, state.velocity, state.pierced)
        density, walk, seed, number = self._noise
        noise = (
            disturbance_of(float(density[i]), float(walk[i]), int(seed[i]), int(number[i])) if kind & NOISY else None
        )
        if is_dynamic(kind):
            return RealAxis(
                dynamics_of(take_structure(self._structure, i), kind), state, float(self._constant[i]), noise
            )
        return RealAxis(axis_of(take(self._ideal, i)), state, float(self._constant[i]), noise)

    def ideal(self, index: NDArray[np.int64]) -> Axis:
        """The ideal axes at these places, which have the same terms."""
        return Axis(take_many(self._ideal, index))

    def many(self, index: NDArray[np.int64], kind: int) -> RealPart:
        """The axes of this kind at these places."""
        engine = Dynamics(take_structures(self._structure, index), kind) if is_dynamic(kind) else self.ideal(index)
        noise = Disturbance(*(values[index] for values in self._noise)) if kind & NOISY else None
        return RealPart(index, engine, self._constant[index], noise)


def _axis_numbers(shape: tuple[int, ...]) -> NDArray[np.uint64]:
    return np.broadcast_to(np.arange(shape[-1], dtype=np.uint64), shape).reshape(-1)


def _rigid_motion(axis: SingleAxis, force: float) -> Motion:
    """The motion of an ideal axis under this command (N)."""
    q, v = axis.position, axis.velocity
    return Motion(q, v, axis.pierced, q, v, 0.0, 0.0, force, q, 0.0, q, v, q, v, *[0.0] * SLIPS)
