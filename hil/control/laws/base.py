"""The one signature of all control laws.

Timing (docs/architecture.md): a sample taken at s_k is seen at tick k+1. The force computed there acts from a_{k+1}
(the expected reception of tick k+1's command, about one period after s_k) for one period. Laws see both instants.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.control.number import Number

Array = NDArray[np.float64]


@dataclass(slots=True)
class Reference:
    """Setpoints at an instant: m, m/s, m/s^2 (rad for rotary axes); a float each, or arrays (..., n_axes)."""

    position: Number
    velocity: Number
    acceleration: Number


@dataclass(slots=True)
class Model:
    """The nominal model of the plant, a float each or arrays (..., n_axes): kg, N, N s/m, N s^2/m^2, N.

    Friction force: coulomb*sgn(v) + viscous*v + quadratic*v*|v|; `gravity` is the constant force the actuator must
    supply to hold the axis. torque_lag: s, of the force behind its command. mode_frequency: Hz, at which the tool rings
    on its spring while the motor is held, 0: a rigid axis; mode_damping: its damping ratio; mode_load: its part of the
    mass. presliding_least, presliding_greatest: m (rad), Coulomb friction over its stiffness at rest; 0: not stated.
    known: how well mass, mode and lag are measured, 0 (not at all) to 1 (within hil.rig.measured_table.KNOWN).
    second_..., third_...: of two further masses on springs, as the tool's; a frequency of 0: none.
    friction_period: m (rad), with which friction varies along the travel; 0: not stated. travel: m (rad) from position
    0, as far as the axis may go; 0: not stated.
    """

    mass: Number
    coulomb: Number
    viscous: Number
    quadratic: Number
    gravity: Number
    torque_lag: Number = 0.0
    mode_frequency: Number = 0.0
    mode_damping: Number = 0.0
    mode_load: Number = 0.0
    presliding_least: Number = 0.0
    presliding_greatest: Number = 0.0
    known: Number = 0.0
    second_frequency: Number = 0.0
    second_damping: Number = 0.0
    second_load: Number = 0.0
    third_frequency: Number = 0.0
    third_damping: Number = 0.0
    third_load: Number = 0.0
    friction_period: Number = 0.0
    travel: Number = 0.0


def axis_model(whole: Any, index: int) -> Model:
    """One axis of a Model of arrays (n_axes,), as floats: in the compiled build not the same class.

    See hil/control/number.py.
    """
    values = (
        whole.mass, whole.coulomb, whole.viscous, whole.quadratic, whole.gravity,
        whole.torque_lag, whole.mode_frequency, whole.mode_damping, whole.mode_load,
        whole.presliding_least, whole.presliding_greatest, whole.known,
        whole.second_frequency, whole.second_damping, whole.second_load,
        whole.third_frequency, whole.third_damping, whole.third_load, whole.friction_period,
        whole.travel,
    )  # fmt: skip
    return Model(*(value if isinstance(value, float) else float(value[index]) for value in values))


@dataclass(slots=True)
class LawInputs:
    """All a law may look at in one tick: of one axis, floats; or of all, arrays (..., n_axes). The objects are reused
    from tick to tick, their arrays as well: copy what you keep.

    position: newest sample (as measured, m). fresh: 1.0 where a trusted sample came this tick, else 0.0; where none
    came, `position` is the rig filter's prediction for the instant the sample should have had, and nothing must be
    learnt from it. answered: 1.0 where any axis of the rig answered this tick, else 0.0.
    sample: reference at the samples' own time stamps (or that instant).
    sample_interval: s from the previous sample instant to this one, by their stamps (one period where none came).
    ahead: s from the sample instant to the start of the interval in which the force asked for now will act.
    position_estimate, velocity_estimate, disturbance_estimate: the rig's Kalman filter, predicted to that start (m,
    m/s, N); the first two are the user's estimator's where the rig names one.
    start: reference at that start. end: reference at that interval's end.
    mean_velocity, mean_acceleration, mean_sign: reference averaged over that interval (mean_sign: of sgn(velocity)).
    force_last: force the gate applied in the previous tick; acts between the sample and `start` (N).
    force_before: force applied the tick before that; it acted in the interval ending at the sample (N).
    preview: of a law that looks ahead (Law.preview): references at `start` and at the ends of the next periods,
    preview[k] being that of k periods after `start`; else None. task_ns: task time at which the interval starts (ns
    since the trajectory's origin, first axis; below 0: no task runs); laws that learn over repeats need it.
    readings: the newest of every sensor of [sensors] (hil.Reading), in the order of the rig file; batches have none.
    """

    position: Number
    fresh: Number
    sample: Reference
    sample_interval: Number
    ahead: Number
    position_estimate: Number
    velocity_estimate: Number
    disturbance_estimate: Number
    start: Reference
    end: Reference
    mean_velocity: Number
    mean_acceleration: Number
    mean_sign: Number
    force_last: Number
    force_before: Number
    answered: Number = 1.0
    task_ns: int = 0
    preview: Any = None  # list[Reference]
    readings: Any = ()  # Sequence[Reading]


def axis_inputs() -> LawInputs:
    """LawInputs of one axis, floats, all 0."""
    o = 0.0
    sample, start, end = Reference(o, o, o), Reference(o, o, o), Reference(o, o, o)
    return LawInputs(o, o, sample, o, o, o, o, o, start, end, o, o, o, o, o)


class Law(ABC):
    """A control law: asks for force, decides nothing about safety (the gate does).

    Written once for floats and arrays (hil/control/number.py). All that it is given is of one kind: floats, one law
    object an axis, as the control cycle does (hil/control/laws/per_axis.py), or arrays (..., n_axes), one object for
    all, as batches do. Gains arrive as keyword arguments of the same kind; the class attribute `GAINS` declares them
    (hil/control/gain.py), or names them with plain defaults. Both ways give bit-identical results: only element-wise
    IEEE operations (+ - * / sqrt, minimum, maximum, where, abs), no BLAS, no transcendental function, no reduction
    whose order depends on memory layout.

    elementwise: `force` works on arrays of any number of axes and plants as on floats, element by element; where it
    is False, there is one object for every axis of every plant. Our own laws all are. preview: how many periods ahead
    `inputs.preview` is to reach. coupled: it looks at all axes at once, and its `force` takes arrays alone.
    own_estimate: it has an observer of its own, and looks at no estimate.
    told_of_learning: a force learnt beside it (hil/control/laws/iterative_learning.py) counts in the forces that acted;
    its feedback is then that of `stiffness` (N/m) and `damping` (N s/m). learns_repeats: it learns a task that repeats
    by itself (ours alone), and law.iterative_learning turns that on by `learn_repeats`. denominator_floors: how often a
    denominator was held at its floor.
    """

    GAINS: ClassVar[dict[str, Any]] = {}
    elementwise: ClassVar[bool] = False
    coupled: bool = False
    preview: int = 0
    own_estimate: ClassVar[bool] = False
    told_of_learning: ClassVar[bool] = False
    learns_repeats: ClassVar[bool] = False
    stiffness: Number = 0.0
    damping: Number = 0.0
    denominator_floors: int = 0

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:  # noqa: B027
        """Every law is made like this. period: s. force_limit: N."""

    @classmethod
    def own_gains(cls, model: Model, period: float) -> dict[str, Number]:
        """Of a law whose gains follow from the model: those of GAINS whose default is None. period: s."""
        return {}

    def learn_repeats(self, repeat_ns: int, from_ns: int) -> None:
        """Learn from repeat to repeat, of that length from that task time on (ns). Raises ValueError naming the key."""
        raise ValueError("law.iterative_learning: this law has no learning of its own")

    def learnt_state(self) -> list[Number]:
        """Of a law that keeps what it learns: all that `begin_learnt` needs to go on from there."""
        return []

    def keep(self) -> None:  # noqa: B027
        """Of the same, on floats: the next reset begins with what was learnt since the last, if the axis has moved."""

    def kept(self) -> list[Number]:
        """State that the next reset begins with; empty: none."""
        return []

    def begin_learnt(self, state: list[Number]) -> None:
        """Begin with that from the next reset on. Raises ValueError naming law.learnt."""
        raise ValueError("law.learnt: this law keeps nothing that it learns")

    def designed(self) -> list[Number]:
        """Of a law that takes long to make: what took long, which makes the same law at once as its argument
        `designed`.
        """
        return []

    def found_of_pulse(self, ticks: int) -> list[Number]:
        """Of a law that learns repeats by itself: what it finds, N, at the end of each period, of a force of 1 N in the
        first that it is not told of.
        """
        return []

    @abstractmethod
    def reset(self, position: Number, force: Number) -> None:
        """Bumpless start at rest at `position` (m) with `force` (N) now applied: integrators and estimates restart."""

    @abstractmethod
    def force(self, inputs: LawInputs) -> Number:
        """Force asked for, N."""


class AxisLaws(Protocol):
    """A rig's law on plain floats, for all its axes. denominator_floors: of all laws together. failure: why a law that
    a user brought no longer counts, with file and line; empty where all is well.
    """

    @property
    def failure(self) -> str:
        """Why the law asks for NaN."""

    @property
    def denominator_floors(self) -> int:
        """How often a denominator was held at its floor."""

    def reset(self, position: Sequence[float], force: Sequence[float]) -> None:
        """Bumpless start at rest at `position` (m) with `force` (N) now applied; one value an axis."""

    def force(self, axes: Sequence[Any]) -> list[float]:
        """Force asked for, N; one value an axis. axes: LawInputs of floats, one an axis."""
