"""Which of the resonances found is the tool's, and what the others are called."""

from collections.abc import Sequence
from typing import NamedTuple

from hil.identify.estimate import WIDEST, Estimate
from hil.rig.measured_table import MOST_OTHERS

LEAST_TOOL = 0.1  # of the mass: nothing lighter is taken for the tool


class Mode(NamedTuple):
    """As it rings while the motor is held. load: part of the mass."""

    frequency_hz: Estimate
    damping: Estimate
    load: Estimate

    @property
    def hertz(self) -> float:
        """Its frequency, Hz."""
        return self.frequency_hz.value

    @property
    def sure(self) -> bool:
        """Whether its interval says that there is one."""
        return all(one.half_width < WIDEST * one.value for one in (self.frequency_hz, self.load))


def modes_told(modes: Sequence[Mode], low: float, high: float) -> tuple[dict[str, Estimate], dict[str, str]]:
    """Quantities by name, and refusals. The heaviest is the tool's, unless it is lighter than LEAST_TOOL; the others
    are numbered by frequency. low, high: between which frequencies the axis was excited, Hz.
    """
    found: dict[str, Estimate] = {}
    refused: dict[str, str] = {}
    excited = f"{low:.0f} to {high:.0f} Hz"
    if unsure := [mode for mode in modes if not mode.sure]:
        each = [f"{mode.hertz:.3g} Hz with {mode.load.value:.2g} +- {mode.load.half_width:.2g}" for mode in unsure]
        refused["mode_unsure"] = f"{', '.join(each)} of the mass (at most {100 * WIDEST:.0f} %): it may be none"
        modes = [mode for mode in modes if mode.sure]
    heaviest = max(modes, key=lambda mode: mode.load.value, default=None)
    tool = heaviest if heaviest and heaviest.load.value >= LEAST_TOOL else None
    if heaviest is None:
        refused["mode"] = f"no resonance in {excited}"
    elif tool is None:
        refused["mode"] = f"the heaviest is {heaviest.load.value:.2g} of the mass (a tool: at least {LEAST_TOOL})"
    elif low < tool.hertz < high:
        found = _named("mode", tool)
    others = sorted((mode for mode in modes if mode is not tool), key=lambda mode: mode.hertz)
    inside = [mode for mode in others if low < mode.hertz < high]
    if beyond := [f"{mode.hertz:.0f} Hz" for mode in modes if not low < mode.hertz < high]:
        refused["mode_beyond"] = f"{', '.join(beyond)}: outside the excited {excited}"
    if len(inside) > MOST_OTHERS:
        where = ", ".join(f"{mode.hertz:.0f}" for mode in inside)
        refused["other_modes"] = f"{len(inside)} resonances beside the tool's, at {where} Hz (at most {MOST_OTHERS})"
        inside = []
    for number, mode in enumerate(inside, 1):
        found |= _named(f"other_mode_{number}", mode)
    return found, refused


def _named(name: str, mode: Mode) -> dict[str, Estimate]:
    return {f"{name}_{key}": value for key, value in mode._asdict().items()}
