"""How a law declares its gains: each once, in `Law.GAINS`.

The constructor's defaults, the check of a rig file's [law.gains], the page docs/laws.md and the tuner's search ranges
all read that declaration.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

LARGEST = 1.7976931348623157e308
SCALES = (  # of a Knob; what each multiplies by is in hil.studies.tune.search_space.knob_scale
    "1", "1/T", "m", "m/T", "T/m", "m/T2", "m/T3", "m2/FT", "m2/FT2", "F", "C", "count", "count/T1.5", "own",
)  # fmt: skip
TINIEST = 1e-300  # a least value below this means "above 0"


class Knob(NamedTuple):
    """The range `hil tune` searches a gain in, logarithmic. scale: what the numbers are multiplied by to give the gain,
    from nominal mass m, nominal Coulomb friction C, force limit F, period T and encoder count (see
    hil.studies.tune.search_space.knob_scale). A scale of "own" is the gain that the law has where the rig file states
    none: its default, or Law.own_gains. of: another gain that this one is a multiple of. density: per sqrt(s), and
    therefore the same at every rate.
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
    """A law's GAINS with every plain default (a number, a word, None) as a Gain without further particulars.

    Raises ValueError for a declaration that says something impossible, naming the gain and what is allowed.
    """
    found = {name: gain if isinstance(gain, Gain) else Gain(gain) for name, gain in gains.items()}
    for name, gain in found.items():
        if problem := _problem(gain, [other for other in found if other != name]):
            raise ValueError(f"GAINS[{name!r}]: {problem}")
    return found


_GIVEN_BY_PLACE = 3  # model, period, force_limit


def not_taken(made: Callable[..., Any], gains: Iterable[str]) -> list[str]:
    """The gains among `gains` that a law's class does not take by name behind model, period and force limit. A rig file
    or the tuner could not set them, or the force limit would be taken for one.
    """
    import inspect  # of users' laws alone

    parameters = inspect.signature(made).parameters.values()
    by_place = [p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)][:_GIVEN_BY_PLACE]
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return [name for name in gains if name in by_place]
    by_name = {p.name for p in parameters if p.kind in (p.KEYWORD_ONLY, p.POSITIONAL_OR_KEYWORD)}
    return [name for name in gains if name not in by_name or name in by_place]


def _problem(gain: Gain, others: list[str]) -> str:
    """What is impossible in a declaration; empty where nothing is."""
    if not _is_number(gain.least) or not _is_number(gain.most) or gain.least > gain.most:
        return f"least = {gain.least!r}, most = {gain.most!r}: expected two numbers, the first not above the second"
    if isinstance(gain.default, str):
        if gain.default not in gain.words:
            return f"default = {gain.default!r}: expected one of words, {', '.join(map(repr, gain.words)) or 'none'}"
    elif gain.default is not None and not (_is_number(gain.default) and gain.least <= gain.default <= gain.most):
        return f"default = {gain.default!r}: expected None, or {gain.allowed()}"
    for key, knob in (("tune", gain.tune), ("plan", gain.plan)):
        if knob is not None and (problem := _knob_problem(knob, others)):
            return f"{key}: {problem}"
        if knob is not None and knob.scale == "own" and not (gain.default is None or _is_number(gain.default)):
            return f"{key}: scale 'own' needs a default that is a number, or None; it is {gain.default!r}"
    return ""


def _knob_problem(knob: Any, others: list[str]) -> str:
    if not isinstance(knob, Knob):
        return f"{knob!r}: expected a hil.Knob"
    if not (_is_number(knob.low) and _is_number(knob.high) and 0.0 < knob.low <= knob.high):
        return f"Knob({knob.low!r}, {knob.high!r}): expected 0 < low <= high, as the search is logarithmic"
    if knob.scale not in SCALES:
        return f"Knob scale {knob.scale!r}: expected one of {', '.join(SCALES)}"
    if knob.of and knob.of not in others:
        return f"Knob of {knob.of!r}: expected another gain of this law: {', '.join(others) or 'there is none'}"
    return ""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


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
