"""The paper's claims by id: setting, reading, what the paper prints, and what is found (docs/paper.md)."""

from dataclasses import dataclass, field
from typing import Any

from hil.studies.paper.problem import DELTA, ROBUST

HOLDS = "holds"
FAILS = "fails as printed"
ARTEFACT = "solver artefact"
INFEASIBLE = "infeasible when sampled"

HOLDS_WITHIN = 0.2  # of the printed value, which the paper gives as "about"


@dataclass(frozen=True)
class Variant:
    """One run of a claim. law, gains: as in a rig file. delta: N. duration, steady_from: s. adaptive: by the ode45-like
    solver at rtol 1e-3, atol 1e-6 instead of by Moreau's time stepping.
    """

    name: str
    law: str
    gains: dict[str, Any] = field(default_factory=dict)
    delta: float = 0.0
    duration: float = 4.0
    steady_from: float = 2.0
    adaptive: bool = False


@dataclass(frozen=True)
class Claim:
    """A claim. paper_um: printed (x, y), None where the paper prints nothing. bars_um: ((low, high) of x, of y) that an
    independent study and the issue allow for the first variant's maximum. figures: of the paper.
    """

    id: str
    text: str
    reading: str
    paper_um: tuple[float, float] | None
    bars_um: tuple[tuple[float, float], tuple[float, float]] | None
    variants: tuple[Variant, ...]
    figures: str = ""


def _around(x: float, y: float, share: float) -> tuple[tuple[float, float], tuple[float, float]]:
    return (x * (1 - share), x * (1 + share)), (y * (1 - share), y * (1 + share))


def _robust(reading: str, norm: str, *, duration: float = 4.0, steady_from: float = 2.0) -> Variant:
    gains = {**ROBUST, "reading": reading, "norm": norm}
    return Variant(f"{reading}, {norm} norm", "robust-pd", gains, DELTA, duration, steady_from)


_PDFF = "(15), feedforward from q̇d, no Delta"

CLAIMS: dict[str, Claim] = {
    claim.id: claim
    for claim in (
        Claim(
            "pdff-exact",
            "PD + feedforward without modelling error tracks to +-0.8 / +-1.8 um",
            f"{_PDFF}, solved accurately",
            (0.8, 1.8),
            ((0.0, 0.01), (0.0, 0.01)),
            (Variant("exact", "pd-feedforward"),),
            "3, 4",
        ),
        Claim(
            "pdff-solver-noise",
            "the same figures, as an adaptive solver at a common default tolerance gives them",
            f"{_PDFF}, sgn(q̇) evaluated explicitly",
            (0.8, 1.8),
            ((0.05, 0.9), (1.2, 2.0)),
            (Variant("ode45", "pd-feedforward", duration=10.0, adaptive=True),),
            "5, 6",
        ),
        Claim(
            "pdff-modelling-error",
            "with Delta = 0.3 sgn(q̇) PD + feedforward errs by about 100 um",
            "(15), Delta in the plant alone",
            (100.0, 100.0),
            _around(100.0, 300.0 / 3.5, 0.01),
            (Variant("Delta", "pd-feedforward", {}, DELTA),),
            "9, 10",
        ),
        Claim(
            "robust-as-printed",
            "with Delta the robust law errs by about 1.5 um",
            "(27)-(28) as printed; alpha N e cancels",
            (1.5, 1.5),
            _around(100.0, 300.0 / 3.5, 0.01),
            (_robust("printed", "vector", duration=6.0, steady_from=4.0),),
            "7, 8, 11, 12",
        ),
        Claim(
            "robust-filtered-error",
            "the same, if nu acts on s = ė + alpha e",
            "(27)-(28) with s for ė in nu",
            (1.5, 1.5),
            _around(60.8, 55.7, 0.02),
            (_robust("filtered-error", "vector"), _robust("filtered-error", "per-axis")),
            "11, 12",
        ),
        Claim(
            "robust-alpha-brackets",
            "the same, if alpha multiplies both brackets",
            "-alpha [M + Kd] ė - alpha Kp e in (27)",
            (1.5, 1.5),
            _around(5.0 / 3.0, 10.0 / 7.0, 0.02),
            (_robust("alpha-brackets", "vector"),),
            "7, 8, 11, 12",
        ),
        Claim(
            "paper-gains-sampled",
            "the paper's gains in a real sampled loop",
            "force one period after the sample, velocity by finite difference",
            None,
            None,
            (),
        ),
    )
}


def judge(claim: Claim, max_um: tuple[float, float]) -> str:
    """The verdict that a claim's own figures (first variant) give."""
    assert claim.paper_um is not None
    if claim.id == "pdff-exact":
        return HOLDS if all(ours > 0.1 * said for ours, said in zip(max_um, claim.paper_um, strict=True)) else ARTEFACT
    if claim.id == "pdff-solver-noise":
        same_size = all(0.05 * said < ours < 2 * said for ours, said in zip(max_um, claim.paper_um, strict=True))
        return ARTEFACT if same_size else FAILS
    close = all(abs(ours - said) <= HOLDS_WITHIN * said for ours, said in zip(max_um, claim.paper_um, strict=True))
    return HOLDS if close else FAILS


def agrees(claim: Claim, max_um: tuple[float, float]) -> bool:
    """Whether our figures lie where the independent study's did."""
    assert claim.bars_um is not None
    return all(low <= ours <= high for ours, (low, high) in zip(max_um, claim.bars_um, strict=True))
