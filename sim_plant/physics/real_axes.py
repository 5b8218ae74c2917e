"""What the axes of a truth are made of, which of them deviate from the ideal one, and many that do at a time."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_plant.physics.axis import Axis, AxisValues, State
from sim_plant.physics.disturbance import Disturbance
from sim_plant.physics.dynamic_batch import advance_dynamic
from sim_plant.physics.dynamics import Dynamics
from sim_plant.physics.encoder import KEPT, Point
from sim_plant.physics.exact_trigonometry import TURN
from sim_plant.physics.ideal_batch import advance_ideal
from sim_plant.physics.structure import HUNG, LINES, Motion, Structure, rigid, with_walk
from sim_plant.physics.truth import Truth

Array = NDArray[np.float64]

CLAMP_RING = 2.0 * TURN * 150.0  # rad/s: a brake or a jam grips through a structure that rings at 300 Hz at most

BRISTLE, MODE, LAG, STRIBECK, VARIATION, CABLE, BACKLASH, CELL = (1 << bit for bit in range(8))
LINE_COUNT, FLOOR_COUNT = 1 << 8, 1 << 11  # times the number of sinusoids
NOISY, LATE = 1 << 14, 1 << 15
HUNG_COUNT = 1 << 16  # times the number of masses hung beside the tool's
SLIP_COUNT = 1 << 18  # times the number of Maxwell-slip elements
DYNAMIC = BRISTLE | MODE | LAG | VARIATION | CABLE | BACKLASH | 7 * FLOOR_COUNT | 3 * HUNG_COUNT


def _flat(truth: Truth) -> dict[str, Any]:
    return {field.name: np.ascontiguousarray(getattr(truth, field.name)).reshape(-1) for field in fields(truth)}


def axis_values_of(truth: Truth, clamp: Array) -> AxisValues:
    """The axes of a truth as ideal ones, flat, with `clamp` (N) of dry friction more."""
    flat = _flat(truth)
    return AxisValues(
        mass=flat["mass"],
        coulomb=flat["coulomb"] + flat["modelling_error"] + clamp.reshape(-1),
        stribeck=flat["stribeck"],
        slowness=1.0 / flat["stribeck_velocity"],
        viscous=flat["viscous"],
        quadratic=flat["quadratic"],
        ripple_amplitude=flat["ripple_amplitude"],
        ripple_wavenumber=1.0 / flat["ripple_period"],
        surface=flat["cell_surface"],
        direction=flat["cell_direction"],
        stiffness=flat["cell_stiffness"],
        puncture_depth=flat["puncture_depth"],
        drag=flat["cell_drag"],
    )


def structure_of(truth: Truth, clamp: Array) -> Structure:
    """The axes of a truth, flat, with `clamp` (N) of dry friction more."""
    flat = _flat(truth)
    held = clamp.reshape(-1)
    mass = flat["mass"]
    free = flat["coulomb"] + flat["modelling_error"]
    coulomb = free + held
    presliding = flat["presliding"] * (free > 0.0)
    bristle = presliding > 0.0
    reach = np.where(bristle, presliding, 1.0)
    stiffness = free / reach
    grip = np.maximum(stiffness, np.minimum(coulomb / reach, mass * CLAMP_RING**2))
    stiffness = np.where(held > 0.0, grip, stiffness)
    load = flat["mode_load"] * mass * (flat["mode_frequency"] > 0.0)
    ring = TURN * flat["mode_frequency"]
    others = flat["other_modes"]
    hung_ring = TURN * others["frequency"].T
    hung_mass = np.where(hung_ring > 0.0, others["load"].T * mass, 0.0)  # also of a mass that is not a number
    cogging, floor = flat["cogging"], flat["vibration"]
    weight, share = flat["slip"]["stiffness"].T * bristle, flat["slip"]["limit"].T * bristle

    def lines(key: str, ripple: Array) -> Array:
        return np.concatenate([ripple[None], cogging[key].T[: LINES - 1]])

    return Structure(
        mass=mass,
        coulomb=coulomb,
        stribeck=flat["stribeck"] * (held == 0.0),  # a grip has no peak that steps would have to resolve
        slowness=1.0 / flat["stribeck_velocity"],
        viscous=flat["viscous"],
        quadratic=flat["quadratic"],
        presliding=np.where(bristle & (held > 0.0), coulomb / np.where(bristle, stiffness, 1.0), presliding),
        bristle_damping=2.0 * flat["presliding_damping"] * np.sqrt(stiffness * mass) * bristle,
        lag=flat["torque_lag"],
        load=load,
        mode_stiffness=load * ring * ring,
        mode_damping=2.0 * flat["mode_damping"] * ring * load,
        variation=flat["friction_variation"],
        variation_wavenumber=1.0 / flat["friction_period"],
        variation_phase=flat["friction_phase"] * (1.0 / TURN),
        cable_stiffness=flat["cable_stiffness"],
        cable_hysteresis=flat["cable_hysteresis"],
        cable_reach=flat["cable_reach"],
        backlash=flat["backlash"],
        hung_mass=hung_mass,
        hung_stiffness=hung_mass * hung_ring * hung_ring,
        hung_damping=2.0 * others["damping"].T * hung_ring * hung_mass,
        slip_weight=weight,
        slip_reach=share / np.where(weight > 0.0, weight, 1.0),
        line_amplitude=lines("amplitude", flat["ripple_amplitude"]),
        line_wavenumber=lines("wavenumber", 1.0 / flat["ripple_period"]),
        line_phase=lines("phase", 0.0 * mass),
        floor_amplitude=floor["amplitude"].T,
        floor_frequency=floor["wavenumber"].T,
        floor_phase=floor["phase"].T,
        surface=flat["cell_surface"],
        direction=flat["cell_direction"],
        membrane=flat["cell_stiffness"],
        puncture_depth=np.where(
            (flat["cell_stiffness"] != 0.0) | (flat["cell_drag"] != 0.0), flat["puncture_depth"], 0.0
        ),
        drag=flat["cell_drag"],
    )


def kinds_of(truth: Truth, s: Structure) -> NDArray[np.int64]:
    """Bits of what each axis has, flat; those that have DYNAMIC bits or cogging need `Dynamics`."""
    kinds = np.zeros(s.mass.shape, dtype=np.int64)
    for bit, present in (
        (BRISTLE, s.presliding > 0.0),
        (MODE, s.load > 0.0),
        (LAG, s.lag > 0.0),
        (STRIBECK, s.stribeck != 0.0),
        (VARIATION, s.variation != 0.0),
        (CABLE, (s.cable_stiffness != 0.0) | (s.cable_hysteresis != 0.0)),
        (BACKLASH, s.backlash != 0.0),
        (CELL, (s.membrane != 0.0) | (s.drag != 0.0)),
        (NOISY, ((truth.torque_noise != 0.0) | (truth.bias_walk != 0.0)).reshape(-1)),
        (LATE, (truth.encoder_latency != 0.0).reshape(-1)),
    ):
        kinds |= np.where(present, bit, 0)
    used = np.arange(1, LINES + 1)[:, None]
    kinds += LINE_COUNT * np.max(used * (s.line_amplitude != 0.0), axis=0)
    kinds += FLOOR_COUNT * np.max(used * (s.floor_amplitude != 0.0), axis=0)
    kinds += SLIP_COUNT * np.sum(s.slip_weight > 0.0, axis=0)
    kinds += HUNG_COUNT * np.max(used[:HUNG] * (s.hung_mass != 0.0), axis=0)
    return kinds


def is_ideal(kind: int) -> bool:
    """Whether these axes are a mass under set-valued friction, one ripple and a membrane, and nothing happens else."""
    return not (is_dynamic(kind) or kind & (NOISY | LATE))


def is_dynamic(kind: int) -> bool:
    """Whether these axes need `Dynamics`."""
    return bool(kind & DYNAMIC) or kind // LINE_COUNT % 8 > 1


class RealPart:
    """Those axes of a batch that deviate in the same terms. index: where they are in the flat batch."""

    def __init__(
        self, index: NDArray[np.int64], engine: Dynamics | Axis, constant: Array, disturbance: Disturbance | None
    ) -> None:
        self.index = index
        self.past: tuple[Point, ...] = ()
        self._engine = engine
        self._constant = constant
        self._disturbance = disturbance

    def advance(self, motion: Motion, times: Sequence[float], h: float, command: Array, count: int) -> Motion:
        """As RealAxis.advance, of this state."""
        for index, time in enumerate(times):
            external = self._constant
            self.past = (*self.past[1 - KEPT :], (time, motion.position, motion.velocity))
            if self._disturbance:
                force, walked = self._disturbance.draw(motion.walked, count + index, h)
                external, motion = external + force, with_walk(motion, walked)
            if isinstance(self._engine, Dynamics):
                motion = advance_dynamic(self._engine, motion, time, (external, command), h)
            else:
                state = State(motion.position, motion.velocity, motion.pierced)
                motion = rigid(motion, *advance_ideal(self._engine, state, command + external, h))
        return motion
