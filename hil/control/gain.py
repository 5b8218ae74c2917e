"""How a law declares its gains: each once, in `Law.GAINS`.

The constructor's defaults, the check of a rig file's [law.gains], the page docs/laws.md and the tuner's search ranges
all read that declaration.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

LARGEST = 1.7976931348623157e308
TINIEST = 1e-300  # a least value below this means "above 0"


class Knob(NamedTuple):
    """The range `hil tune` searches a gain in, logarithmic. scale: what the numbers are multiplied by to give the gain,
    from nominal mass m, nominal Coulomb friction C, force limit F, period T and encoder count (see
    hil.studies.tune.search_space.knob_scale). of: another gain that this one is a multiple of. density: per sqrt(s),
    and therefore the same at every rate.
    """

    low: float
    high: float
    scale: str = "1"
    of: str = ""
    density: bool = False


class Gain(NamedTuple):
    """One gain. default: a number, a word, or None where the law works it out from mass, rate and force limit. unit:
    SI, of a linear axis. least, most: allowed range. words: allowed values of a gain that is a word. tune: its range in
    `hil tune`; plan: the same for an injection plan, where a law has ranges of its own there.
    """

    default: float | str | None
    unit: str = ""
    meaning: str = ""
    least: float = 0.0
    most: float = LARGEST
    words: tuple[str, ...] = ()
    tune: Knob | None = None
    plan: Knob | None = None

    def allowed(self) -> str:
        """The range of a number, for messages."""
        if self.most < LARGEST:
            return f"a number from {self.least:g} to {self.most:g}"
        return "a finite number > 0" if 0.0 < self.least < TINIEST else f"a finite number >= {self.least:g}"


def declared(gains: Mapping[str, Any]) -> dict[str, Gain]:
    """A law's GAINS with every plain default (a number, a word, None) as a Gain without further particulars."""
    return {name: gain if isinstance(gain, Gain) else Gain(gain) for name, gain in gains.items()}


def with_defaults(gains: Mapping[str, Gain], given: Mapping[str, Any]) -> dict[str, Any]:
    """The values a law's constructor works with: those given, and the defaults of the others. Raises ValueError for
    a gain the law does not have.
    """
    for name in given:
        if name not in gains:
            raise ValueError(f"law.gains.{name}: the law has {', '.join(gains)}")
    return {name: given.get(name, gain.default) for name, gain in gains.items()}


def knobs(gains: Mapping[str, Any], *, plan: bool) -> dict[str, Knob]:
    """The gains that `hil tune` searches, in their order; plan: on an injection plan."""
    found = declared(gains)
    special = {name: gain.plan for name, gain in found.items() if gain.plan is not None} if plan else {}
    return special or {name: gain.tune for name, gain in found.items() if gain.tune is not None}
