"""Is the loop stable on the stage that is really there? The loop around what the nominal model says and leaves open.

Sliding, the axis is a mass with lag and mode; mass, mode, lag and viscous friction are off by what was measured
(axes.NAME.measured), or by what nobody knows better without. At rest, where the axis hangs on its friction's stiffness
(Coulomb friction over the presliding distance), it is an oscillator: a law has to bear every stiffness that the stage
may have (axes.NAME.model.presliding). All corners are rows of one batch.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from hil.analysis.flexible_plant import AxisDynamics, FlexiblePlant
from hil.analysis.pulse_loop import CRUISE, Pulsed, loop_of, try_together
from hil.analysis.stability import REALISED, LoopMargins, check_stability, is_stable, margins, realise_poles
from hil.control.laws.base import Array
from hil.rig.measured_table import Tolerances
from hil.rig.schema import RigConfig
from hil.rig.tables import AxisConfig, ModelConfig

MASS_OFF, MODE_OFF, LAG_OFF, FRICTION_OFF = UNMEASURED = Tolerances()
STUCK_STIFFNESSES = 7  # tried between the ends of the presliding range
STUCK_DAMPING = 0.15  # least damping ratio of an axis stuck on its guide
ANSWER = 2000  # ticks
FADED = 1e-6  # of a pulse, after which a corner's answer ends: what follows is less than 0.01 dB of any margin


class Corner(NamedTuple):
    """Factors on the nominal model. stuck: at rest, at that share of the presliding range (log); None: sliding."""

    mass: float = 1.0
    mode: float = 1.0
    lag: float = 1.0
    friction: float = 1.0
    stuck: float | None = None

    def dynamics(self, model: ModelConfig) -> AxisDynamics | None:
        """The axis; None where the corner says nothing of it."""
        mass = self.mass * model.mass
        stiffness = damping = 0.0
        if self.stuck is not None:
            distance = presliding(model, self.stuck)
            if not distance or not model.coulomb:
                return None
            stiffness = self.friction * model.coulomb / distance
            damping = 2.0 * STUCK_DAMPING * math.sqrt(stiffness * mass)
        return AxisDynamics(
            mass,
            self.lag * model.torque_lag,
            self.mode * model.mode_frequency_hz,
            model.mode_damping,
            model.mode_load,
            0.0 if self.stuck is not None else self.friction * model.viscous,
            stiffness,
            damping,
            tuple((self.mode * hertz, ratio, load) for hertz, ratio, load in model.other_modes),
        )

    def within(self, off: Tolerances) -> "Corner":
        """The same corner of an axis whose model may be off by this much."""
        if off == UNMEASURED:
            return self
        pairs = zip(self[:4], UNMEASURED, off, strict=True)
        mass, mode, lag, friction = (1.0 + (factor - 1.0) * mine / usual for factor, usual, mine in pairs)
        return Corner(mass, mode, lag, friction, self.stuck)

    def text(self, model: ModelConfig) -> str:
        """For people: 'mass -20 %, mode +10 %', or 'at rest on 3 um'."""
        parts = [
            f"{name} {factor - 1.0:+.0%}"
            for name, factor in (
                ("mass", self.mass),
                ("mode", self.mode),
                ("lag", self.lag),
                ("viscous friction", self.friction),
            )
            if factor != 1.0
        ]
        if self.stuck is not None:
            parts.insert(0, f"at rest on {presliding(model, self.stuck) * 1e6:.3g} um of presliding")
        return ", ".join(parts) or "as the model says"


# Margins that are asked for, dB and degrees. The nominal one is there for what the model may be off by: of a measured
# axis that is less.
NOMINAL, MEASURED, OFF, AT_REST = (6.0, 30.0), (4.5, 30.0), (3.0, 15.0), (4.5, 0.0)


@dataclass(frozen=True)
class CornerFinding:
    """One axis in one corner. frequency_hz: where the margin is smallest, or where the unstable loop rings. measured:
    the axis is, so well that gains may follow from it (Tolerances.known).
    """

    axis: str
    corner: str
    at_rest: bool
    nominal: bool
    stable: bool
    gain_db: float
    phase_deg: float
    frequency_hz: float
    measured: bool = False

    @property
    def asked(self) -> tuple[float, float]:
        """Gain margin (dB) and phase margin (degrees) that `lacks` asks for."""
        nominal = MEASURED if self.measured else NOMINAL
        return AT_REST if self.at_rest else nominal if self.nominal else OFF

    def lacks(self, *, least: bool = False) -> str:
        """What is missing to the margins that are asked for, with axis and corner. With `least`: to a loop that is
        stable. Empty for nothing.
        """
        short = self.shortfall(least=least)
        return f"axis '{self.axis}', {self.corner}: {short}" if short else ""

    def shortfall(self, *, least: bool = False) -> str:
        """The same without axis and corner."""
        if not self.stable:
            return f"the loop is unstable; it rings at {self.frequency_hz:.0f} Hz"
        gain, phase = self.asked
        if least or (self.gain_db >= gain and self.phase_deg >= phase):
            return ""
        short = []  # rounded, but never up to what is asked
        if self.gain_db < gain:
            short.append(f"a gain margin of {min(self.gain_db, gain - 0.1):.1f} dB (at least {gain:g})")
        if self.phase_deg < phase:
            short.append(f"a phase margin of {min(self.phase_deg, phase - 1.0):.0f} deg (at least {phase:g})")
        return f"{' and '.join(short)} at {self.frequency_hz:.0f} Hz"

    def as_json(self) -> dict[str, Any]:
        """Keys: as the fields; margins are null where nothing is met."""
        finite = {
            key: value if math.isfinite(value) else None
            for key, value in (("gain_db", self.gain_db), ("phase_deg", self.phase_deg))
        }
        return {
            "axis": self.axis,
            "corner": self.corner,
            "at_rest": self.at_rest,
            "stable": self.stable,
            **finite,
            "frequency_hz": self.frequency_hz,
        }


def presliding(model: ModelConfig, share: float) -> float:
    """Distance (m) at that share of the range between its ends, 0 where the model states none."""
    if not model.presliding:
        return 0.0
    low, high = model.presliding
    return float(low * (high / low) ** share)


def sliding_corners() -> list[Corner]:
    """The nominal one first."""
    both = [Corner(mass, mode) for mass, mode in product(_around(MASS_OFF), _around(MODE_OFF))]
    lag = [Corner(lag=factor) for factor in (1.0 - LAG_OFF, 1.0 + LAG_OFF)]
    friction = [Corner(friction=factor) for factor in (1.0 - FRICTION_OFF, 1.0 + FRICTION_OFF)]
    return [*both, *lag, *friction]


def stuck_corners() -> list[Corner]:
    """At rest, over the presliding range."""
    off = [Corner(mass=mass) for mass in _around(MASS_OFF)[1:]] + [Corner(mode=mode) for mode in _around(MODE_OFF)[1:]]
    return [
        *(Corner(stuck=float(share)) for share in np.linspace(0.0, 1.0, STUCK_STIFFNESSES)),
        *(corner._replace(stuck=share) for corner in off for share in (0.0, 0.5, 1.0)),
    ]


def _around(off: float) -> tuple[float, float, float]:
    return 1.0, 1.0 - off, 1.0 + off


class CornerTrial(Pulsed):
    """Every corner that an axis' model speaks of, the nominal one first, as copies of the rig's loop. ticks: of the
    answers, at least REALISED.
    """

    def __init__(self, rig: RigConfig, ticks: int = ANSWER) -> None:
        self._rig = rig
        self._corners = corners = [*_distinct(rig, sliding_corners()), *_distinct(rig, stuck_corners())]
        speed = np.array([CRUISE if corner.stuck is None else 0.0 for corner in corners])
        super().__init__(self._flexible, len(corners), ticks, speed=speed, faded=FADED)

    def _flexible(self, rows: int) -> FlexiblePlant:
        axes = self._rig.axes.values()
        of_corners = [
            [_dynamics(corner, axis) or AxisDynamics(axis.model.mass) for axis in axes] for corner in self._corners
        ]
        each = rows // self.copies
        return FlexiblePlant([row for row in of_corners for _ in range(each)], self.period_s)

    @property
    def period_s(self) -> float:
        """Of the loop."""
        return self._rig.period_ns * 1e-9

    def plain(self) -> list[tuple[str, bool, AxisDynamics, Array]]:
        """(axis, at rest, what it is, answer (ticks,)) of stable loops on the nominal model and, where it speaks of it,
        at rest in the middle of the presliding; after the trial.
        """
        found = []
        for at, corner in enumerate(self._corners):
            if corner not in (Corner(), Corner(stuck=0.5)):
                continue
            for i, (name, axis) in enumerate(self._rig.axes.items()):
                dynamics, motion = _dynamics(corner, axis), self.motion[:, at, i]
                if dynamics is not None and is_stable(motion, realise_poles(motion[:REALISED])):
                    found.append((name, corner.stuck is not None, dynamics, self.answer[:, at, i]))
        return found

    def findings(self) -> list[CornerFinding]:
        """What became of every axis in every corner; after the trial."""
        places = [(at, i) for at in range(len(self._corners)) for i in range(len(self._rig.axes))]
        return [found for place in places if (found := self._found(*place)) is not None]

    def of_axis(self, i: int) -> Iterator[CornerFinding]:
        """The same of one axis, corner by corner: each is worked out when it is asked for."""
        return (found for at in range(len(self._corners)) if (found := self._found(at, i)) is not None)

    def _found(self, at: int, i: int) -> CornerFinding | None:
        """None where the corner says nothing of the axis."""
        corner, (name, axis) = self._corners[at], list(self._rig.axes.items())[i]
        if _dynamics(corner, axis) is None:
            return None
        return _finding(name, corner, axis, self.answer[:, at, i], self.motion[:, at, i], self._rig.rate_hz)


def check_corners(rig: RigConfig, ticks: int = ANSWER) -> list[CornerFinding]:
    """Every axis in every corner that its model speaks of, the nominal one first. ticks: of the answers, at least
    REALISED.

    Raises ValueError where the law cannot be made from its gains.
    """
    trial = CornerTrial(rig, ticks)
    try_together(loop_of(rig, [trial]), [trial])
    return trial.findings()


def corner_problems(found: Sequence[CornerFinding]) -> list[str]:
    """A line for each loop that is unstable: nobody should move that."""
    return [text for finding in found if (text := finding.lacks(least=True))]


def loop_problems(rig: RigConfig) -> list[str]:
    """Why nobody should close this rig's loop, a line each: it is unstable on the model, or off it. Raises ValueError
    as check_stability and check_corners.
    """
    corners = CornerTrial(rig)
    return check_stability(rig, beside=[corners]).problems() or corner_problems(corners.findings())


def _distinct(rig: RigConfig, corners: list[Corner]) -> list[Corner]:
    """Without those that are, on this rig, the same as an earlier one, or none."""
    axes = rig.axes.values()
    kept: dict[tuple[AxisDynamics | None, ...], Corner] = {}
    for corner in corners:
        dynamics = tuple(_dynamics(corner, axis) for axis in axes)
        if any(dynamics):
            kept.setdefault(dynamics, corner)
    return list(kept.values())


def _dynamics(corner: Corner, axis: AxisConfig) -> AxisDynamics | None:
    """The axis there, within its own tolerances."""
    return corner.within(axis.tolerances).dynamics(axis.model)


def _finding(
    name: str, corner: Corner, axis: AxisConfig, answer: Array, motion: Array, rate_hz: float
) -> CornerFinding:
    poles = realise_poles(motion[:REALISED])
    stable = is_stable(motion, poles)
    met = margins(answer) if stable else LoopMargins(None, None, None)
    at = met.tightest_at
    if not stable:
        at = abs(float(np.angle(poles[0]))) / (2.0 * math.pi) if poles else 0.5
    off, at_rest, nominal = axis.tolerances, corner.stuck is not None, corner == Corner()
    found = stable, met.gain_db, met.phase_margin, at * rate_hz
    return CornerFinding(name, corner.within(off).text(axis.model), at_rest, nominal, *found, off.known > 0.0)
