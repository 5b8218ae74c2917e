"""When ticks begin."""

from typing import Final

from hil.cycle.faults.row import ALWAYS, MOVING, RESET, Reaction, Row, Trial

_LOAD: Final = "another process or the hypervisor held the control process up"

ROWS: Final = (
    Row(
        27,
        "OVERRUN",
        requirement="SR-7.1",
        seen_by="a slot was skipped",
        after="1 slot",
        reaction=Reaction.COUNT,
        states=ALWAYS,
        measured="slots skipped",
        unit="ticks",
        cause=_LOAD,
        action="none, if it is rare; else hil doctor",
        trials=(Trial("one overrun"),),
    ),
    Row(
        28,
        "OVERRUN_BURST",
        requirement="SR-7.1",
        seen_by="the same",
        after="safety.overrun_streak (5) ticks in a row",
        reaction=Reaction.STOP,
        states=MOVING,
        measured="ticks in a row that skipped slots",
        unit="ticks",
        cause=_LOAD,
        action=f"hil doctor, {RESET}",
        trials=(Trial("every other slot missed"),),
    ),
    Row(
        29,
        "OVERRUN_LONG",
        requirement="SR-7.1",
        seen_by="time between two ticks",
        after="safety.overrun_zero_s (20 ms)",
        reaction=Reaction.ZERO,
        states=MOVING,
        measured="time between two ticks",
        unit="s",
        cause=_LOAD,
        action=f"hil doctor, {RESET}",
        trials=(Trial("held up for 25 ms"),),
    ),
)
