"""Each field of an answer wrong for one tick, for ten, drifting, and for ever: what must come of it.

A cell of the table is a trial made here, or one that the catalogue has anyway, or none, with the reason.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from enum import Enum

from drivers.frame import EXTENDED, Frame
from drivers.protocols.answer_fields import Field
from drivers.protocols.base import DriveStatus, Sample
from hil.cycle.fault_table import Fault, Reaction
from hil.rig.schema import RigConfig
from hil.studies.fault_campaign.checkpoints import CampaignRun
from hil.studies.fault_campaign.injections import answer_twice, is_answer
from hil.studies.fault_campaign.layout_capabilities import NONE, Capability, lacking_text
from hil.studies.fault_campaign.trial import (
    BY_MOTION,
    GONE,
    MOVING,
    PROMPT,
    WATCHING,
    Step,
    Trial,
    periods,
)

_FOREVER = 10**6
_FREE_ID = 0x7F1  # no layout's
_JUMP = 10**7  # counts, far beyond what an axis can go in a tick
_REPEATED = (Fault.BAD_FRAMES, *GONE)
_BOUNDS: Mapping[Fault, Callable[[RigConfig], int]] = {
    Fault.BAD_FRAMES: lambda rig: rig.safety.bad_frame_limit,
    Fault.ENCODER_LOST: lambda rig: rig.safety.silent_stop_ticks,
    Fault.ENCODER_DEAD: lambda rig: rig.safety.silent_zero_ticks,
    Fault.ANSWERS_DIFFER: lambda _: 2,  # the first one is none, the second answers what another did
}
_PPM = 1e-6


class Pattern(Enum):
    """For how long a field is wrong."""

    ONE = "one tick"
    TEN = "ten ticks"
    DRIFT = "drifting"
    EVER = "for ever"


TICKS = {Pattern.ONE: 1, Pattern.TEN: 10, Pattern.DRIFT: _FOREVER, Pattern.EVER: _FOREVER}


# Cells that the catalogue has anyway
_ELSEWHERE = {
    (Field.POSITION, Pattern.ONE): "encoder glitch",
    (Field.POSITION, Pattern.EVER): "encoder jump",
    (Field.STAMP, Pattern.EVER): "time stamp jumps by 1 ms",
    (Field.STATUS, Pattern.EVER): "drive fault bit",
    (Field.CAUSES, Pattern.EVER): "drive encoder fault bit",
    (Field.SENDER, Pattern.ONE): "another node sends our command",
    (Field.COUNT, Pattern.EVER): "two answers that differ",
}
# One frame latches: whatever comes after it is the same
_SAME = {(Field.SENDER, pattern): (Field.SENDER, Pattern.ONE) for pattern in Pattern} | {
    (Field.COUNT, pattern): (Field.COUNT, Pattern.EVER) for pattern in (Pattern.TEN, Pattern.DRIFT)
}
_OBEYED = "foreign_command at the first frame; a drive that has its own enabling message obeys it all the same"
_FOLLOWED = {(Field.STAMP, Pattern.DRIFT): "400 ppm are followed; beyond 500 ppm as for ever"}
_UNDETECTABLE = {(Field.POSITION, Pattern.DRIFT): "one encoder's slow drift looks like motion of the axis"}


def frames_wrong(make: Callable[[Frame], Frame], pattern: Pattern) -> Step:
    """The axis' answers are others."""

    def step(run: CampaignRun, axis: int, k: int) -> None:
        if k < TICKS[pattern]:
            ours = is_answer(run, axis)
            run.received[:] = [make(frame) if ours(frame) else frame for frame in run.received]

    return step


def samples_wrong(change: Callable[[Sample, int, int], Sample], pattern: Pattern) -> Step:
    """The axis' drive tells another sample: change(sample, ticks since, period in ns)."""
    since = 0

    def step(run: CampaignRun, axis: int, k: int) -> None:
        nonlocal since
        since = k

        def tap(sample: Sample) -> Sample:
            return change(sample, since, run.rig.period_ns) if since < TICKS[pattern] else sample

        if k == 0:
            run.stage.drives[axis].taps.append(tap)

    return step


def bit_wrong(bit: DriveStatus, pattern: Pattern) -> Step:
    """The axis' drive shows a bit of its status, in so many of its messages."""

    def step(run: CampaignRun, axis: int, k: int) -> None:
        drive = run.stage.drives[axis]
        apart = max(1, periods(run.cycle.protocol.state_ns * 1e-9, run.rig))
        if k == 0:
            drive.extra_status |= int(bit)
        elif k == TICKS[pattern] * apart:
            drive.extra_status &= ~int(bit)

    return step


def _renamed(frame: Frame) -> Frame:
    return frame._replace(can_id=frame.can_id & EXTENDED | _FREE_ID)


def _cut(frame: Frame) -> Frame:
    return frame._replace(data=frame.data[: len(frame.data) // 2])


def _flipped(frame: Frame) -> Frame:
    return frame._replace(data=frame.data[:-1] + bytes((frame.data[-1] ^ 0xFF,)))


def _name(field: Field, pattern: Pattern) -> str:
    return f"field: {field.value} wrong, {pattern.value}"


def _dropped(field: Field, make: Callable[[Frame], Frame], only: Capability = NONE) -> list[Trial]:
    """Answers that are rejected: one is a gap, three are silence."""
    patterns = (Pattern.ONE, Pattern.TEN, Pattern.EVER)
    return [
        Trial(
            _name(field, pattern),
            frames_wrong(make, pattern),
            () if pattern is Pattern.ONE else _REPEATED,
            within=11,
            bounds=_BOUNDS,
            armed=WATCHING if pattern is Pattern.EVER else MOVING,
            benign=pattern is Pattern.ONE,
            only=only,
            few=True,
        )
        for pattern in patterns
    ]


def _position(field: Field, pattern: Pattern, change: Callable[[Sample, int, int], Sample]) -> Trial:
    drifts = pattern is Pattern.DRIFT
    return Trial(
        _name(field, pattern),
        samples_wrong(change, pattern),
        (*BY_MOTION, Fault.STANDSTILL) if drifts else (Fault.ENCODER_JUMP,),
        within=2 if not drifts else 4,
        certain=not drifts,
        demand=Reaction.STOP if drifts else Reaction.ZERO,
        few=True,
    )


def _sequence(pattern: Pattern, late: Callable[[int], int]) -> Trial:
    return Trial(
        _name(Field.SEQUENCE, pattern),
        samples_wrong(lambda s, k, _: replace(s, sequence=s.sequence - late(k)), pattern),
        () if pattern is Pattern.ONE else (*_REPEATED, Fault.ANSWERS_DIFFER),
        within=11,
        bounds=_BOUNDS,
        benign=pattern is Pattern.ONE,
        only=Capability.SEQUENCE,
        few=True,
    )


def _stamp(pattern: Pattern, off: Callable[[int, int], int]) -> Trial:
    return Trial(
        _name(Field.STAMP, pattern),
        samples_wrong(lambda s, k, period_ns: replace(s, stamp_ns=s.stamp_ns + off(k, period_ns)), pattern),
        () if pattern is Pattern.DRIFT else (Fault.STAMP,),
        armed=WATCHING,
        benign=pattern is Pattern.DRIFT,
        demand=Reaction.ZERO,
        only=Capability.STAMPS,
        few=True,
    )


def _told(field: Field, pattern: Pattern) -> Trial:
    causes = field is Field.CAUSES
    return Trial(
        _name(field, pattern),
        bit_wrong(DriveStatus.ENCODER_FAULT if causes else DriveStatus.FAULT, pattern),
        (Fault.ENCODER_FAULT, Fault.DRIVE_FAULT) if causes else (Fault.DRIVE_FAULT,),
        armed=WATCHING,
        demand=Reaction.ZERO,
        needs=Capability.STATE | Capability.CAUSE if causes else Capability.STATE,
        instead=(Fault.DRIVE_DISABLED,),
        few=True,
    )


def _once(act: Step) -> Step:
    return lambda run, axis, k: act(run, axis, k) if k == 0 else None


FIELD_TRIALS = (
    *_dropped(Field.IDENTIFIER, _renamed),
    *_dropped(Field.LENGTH, _cut),
    *_dropped(Field.CHECKSUM, _flipped, Capability.CHECKSUM),
    _sequence(Pattern.ONE, lambda k: 2),
    _sequence(Pattern.TEN, lambda k: 2),
    _sequence(Pattern.DRIFT, lambda k: k + 1),
    _sequence(Pattern.EVER, lambda k: 2),
    _position(Field.POSITION, Pattern.TEN, lambda s, k, _: replace(s, position=s.position + _JUMP)),
    _position(Field.POSITION, Pattern.DRIFT, lambda s, k, _: replace(s, position=s.position + k)),
    _stamp(Pattern.ONE, lambda k, _: 1_000_000),
    _stamp(Pattern.TEN, lambda k, _: 1_000_000),
    _stamp(Pattern.DRIFT, lambda k, period_ns: round(400 * _PPM * k * period_ns)),
    *(_told(field, pattern) for field in (Field.STATUS, Field.CAUSES) for pattern in (Pattern.ONE, Pattern.TEN)),
    Trial(
        _name(Field.COUNT, Pattern.ONE),
        _once(answer_twice),
        (Fault.ANSWERS_DIFFER,),
        armed=WATCHING,
        demand=Reaction.ZERO,
        only=Capability.SEQUENCE,
        few=True,
    ),
)


def result_of(field: Field, pattern: Pattern, trials: Sequence[Trial], capabilities: Capability) -> str:
    """What comes of a field that is wrong so long, under a layout with these capabilities, in words. trials: those
    among which the cell's is found by its name.
    """
    at = _SAME.get((field, pattern), (field, pattern))
    name = _ELSEWHERE.get(at, _name(*at))
    found = next((trial for trial in trials if trial.name == name), None)
    if found is None:
        return "has no value that drifts"
    missing = found.only & ~capabilities
    if missing and field is Field.SENDER:
        return _OBEYED
    if missing:
        return f"not detectable: {lacking_text(missing)}"
    trial = found.over(capabilities)
    if at in _FOLLOWED:
        return _FOLLOWED[at]
    if trial.benign:
        return f"rejected, told as {'encoder_glitch' if field is Field.POSITION else 'encoder_gap'}"
    if not trial.certain:
        return f"not detectable: {_UNDETECTABLE.get(at) or lacking_text(trial.lacking)}"
    names = " or ".join(dict.fromkeys(fault.name.lower() for fault in trial.faults))
    return f"{names} within {PROMPT} ticks of its limit" if trial.bounds else f"{names} within {trial.within} ticks"


def field_trials(trials: Sequence[Trial]) -> dict[Field, list[Trial]]:
    """Those of the table, by field."""
    names = {field: {_ELSEWHERE.get((field, pattern), _name(field, pattern)) for pattern in Pattern} for field in Field}
    return {field: [trial for trial in trials if trial.name in names[field]] for field in Field}
