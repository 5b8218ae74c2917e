"""What law and filter compute."""

from typing import Final

from hil.cycle.faults.row import MOVING, RESET, Reaction, Row, Trial

ROWS: Final = (
    Row(
        13,
        "NOT_FINITE",
        requirement="SR-1.4",
        seen_by="NaN or infinity in the law's request or the filter",
        after="1 tick",
        reaction=Reaction.ZERO,
        states=MOVING,
        measured="what was no finite number: the law's request, or the filter's innovation",
        cause="the law divides by zero or overflows, or it failed, or an estimator of users did",
        action=f"the journal has the failure; mend the law, its gains or the estimator, {RESET}",
        trials=(Trial("law asks for NaN"),),
    ),
    Row(
        14,
        "FILTER_DIVERGED",
        requirement="SR-4.3",
        seen_by="normalised innovation squared",
        after="safety.nis_ticks (20) in a row",
        reaction=Reaction.ZERO,
        states=MOVING,
        measured="|innovation|",
        unit="m",
        cause="the nominal model is far from the axis: mass, friction or force constant",
        action=f"compare [axes.AXIS.model] with the stage, {RESET}",
        trials=(Trial("filter beside its samples"),),
    ),
)
