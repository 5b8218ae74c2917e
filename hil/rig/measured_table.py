"""[axes.NAME.measured]: what `hil identify` measured of an axis, and how well; `hil check` goes by it."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

from pydantic import Field

from drivers.base.keys import Table, key

Measured = Annotated[list[float], Field(min_length=2, max_length=2)]
BOTH = "value and half width of its 95 % interval"
MOST_OTHERS = 2  # resonances beside the tool's


def _of_other(number: int, what: str, unit: str) -> Measured | None:
    whole: Measured | None = key(
        None, f"{what} of model.other_modes[{number - 1}]: {BOTH}", unit, exclude_if=lambda value: value is None
    )
    return whole


class MeasuredConfig(Table):
    """[axes.NAME.measured]: identified values of [axes.NAME.model] with their half widths; written by `hil identify`.

    `hil check` tries the loop within these half widths where the model still has the measured value.
    """

    mass: Measured | None = key(None, f"moving mass (moment of inertia): {BOTH}", "kg (kg m^2)")
    coulomb: Measured | None = key(None, f"Coulomb friction: {BOTH}", "N (N m)")
    viscous: Measured | None = key(None, f"viscous friction: {BOTH}", "N s/m (N m s/rad)")
    quadratic: Measured | None = key(
        None, f"friction times v |v|: {BOTH}", "N s^2/m^2 (N m s^2/rad^2)", exclude_if=lambda one: one is None
    )
    friction_period: Measured | None = key(
        None,
        f"length along the travel with which friction varies: {BOTH}",
        "m (rad)",
        exclude_if=lambda one: one is None,
    )
    gravity: Measured | None = key(None, f"constant force on the axis: {BOTH}", "N (N m)")
    torque_lag: Measured | None = key(None, f"time constant of the force: {BOTH}", "s")
    mode_frequency_hz: Measured | None = key(None, f"resonance of the tool: {BOTH}", "Hz")
    mode_damping: Measured | None = key(None, f"damping ratio of that mode: {BOTH}", "1")
    mode_load: Measured | None = key(None, f"the tool's fraction of the moving mass: {BOTH}", "1")
    other_mode_1_frequency_hz: Measured | None = _of_other(1, "frequency", "Hz")
    other_mode_1_damping: Measured | None = _of_other(1, "damping ratio", "1")
    other_mode_1_load: Measured | None = _of_other(1, "fraction of the moving mass", "1")
    other_mode_2_frequency_hz: Measured | None = _of_other(2, "frequency", "Hz")
    other_mode_2_damping: Measured | None = _of_other(2, "damping ratio", "1")
    other_mode_2_load: Measured | None = _of_other(2, "fraction of the moving mass", "1")
    presliding: Measured | None = key(None, f"Coulomb friction over its stiffness at rest: {BOTH}", "m (rad)")
    validation: Measured | None = key(
        None, "force left unexplained, RMS, in a motion that no fit used, and in one that was fitted", "N (N m)"
    )
    date: str = key("", "day of the measurement")
    evidence: str = key("", "recording or runs that it comes from, with hashes")


def changed(before: MeasuredConfig, now: Mapping[str, Sequence[float]]) -> list[str]:
    """What left both intervals since the measurement before: wear, a screw, a cable. A line each. now: by quantity,
    value and half width.
    """
    told = []
    for quantity, (value, width) in now.items():
        then = getattr(before, quantity)
        if then is not None and abs(value - then[0]) > max(width, then[1]):
            told.append(f"{quantity} was {then[0]:.5g} +- {then[1]:.2g}, is {value:.5g} +- {width:.2g}")
    return told


class Tolerances(NamedTuple):
    """By how much the model of an axis may be off, fractions. mode: of that resonance which is known least."""

    mass: float = 0.2
    mode: float = 0.1
    lag: float = 0.2
    friction: float = 0.3

    @property
    def known(self) -> float:
        """How well mass, resonance and lag are known: 1 within KNOWN, 0 from twice that on; that of them which is known
        least.
        """
        return min(min(1.0, max(0.0, 2.0 - mine / least)) for mine, least in zip(self[:3], KNOWN, strict=False))

    def text(self, *, rigid: bool) -> str:
        """For people: 'mass 2 %, resonance 1 %, lag 5 %, viscous friction 10 %'. rigid: it has no resonance."""
        names = ("mass", "" if rigid else "resonance", "lag", "viscous friction")
        return ", ".join(f"{name} {100.0 * share:.2g} %" for name, share in zip(names, self, strict=True) if name)


KNOWN = Tolerances(0.02, 0.02, 0.05, 0.1)  # what the quicker gains of presliding-kalman are made for
LEAST = Tolerances(0.02, 0.01, 0.05, 0.1)  # whatever was measured: a stage changes with temperature and wear
SAME = 1e-5  # relative: the model has the measured value


def tolerances(model: Any, measured: MeasuredConfig | None) -> Tolerances:
    """Of an axis whose [model] and [measured] these are: the usual ones where nothing was measured. A resonance beside
    the tool's that was not measured counts as well known as the tool's. Where a frequency response, which also tells
    the lag, showed none of a tool, the others count, if there are any.
    """
    unknown = Tolerances()
    if measured is None:
        return unknown
    keys = ("mass", "mode_frequency_hz", "torque_lag", "viscous")
    of_tool = Tolerances(
        *(
            _tolerance(getattr(model, name), getattr(measured, name), least, default)
            for name, least, default in zip(keys, LEAST, unknown, strict=True)
        )
    )
    frequencies = (measured.other_mode_1_frequency_hz, measured.other_mode_2_frequency_hz)
    pairs = list(zip(model.other_modes, frequencies, strict=False))
    others = [_tolerance(mode[0], both, 0.0, 0.0) for mode, both in pairs]
    of_response = [both for _, both in pairs] or [measured.torque_lag]
    shown = not model.mode_frequency_hz and all(one is not None for one in of_response)
    return of_tool._replace(mode=max([LEAST.mode if shown else of_tool.mode, *others]))


def _tolerance(value: float, measured: list[float] | None, least: float, default: float) -> float:
    """Half width over value, at least `least`; `default` where the model's value is not the measured one."""
    if measured is None or not value or abs(value - measured[0]) > SAME * abs(value):
        return default
    return max(least, abs(measured[1] / value))
