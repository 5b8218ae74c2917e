"""Admission: whether a rig's traffic fits its bus. `hil run` refuses a rig on it; `hil check` prints its tables."""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from drivers.bus_load.schedulability import Analysis, analyse, frame_ns
from drivers.config import LAYOUT_KIND
from drivers.families import family_of
from drivers.protocols.base import HostProtocol, Message
from drivers.protocols.mounting import MountedHost
from hil.rig.layout import fitted, host_layout
from hil.rig.outputs import output_messages
from hil.rig.schema import LEAST_RATE_HZ, RigConfig, RigError
from hil.rig.sensors import sensor_messages


def rig_layout(rig: RigConfig, base_dir: Path, built: HostProtocol | None = None) -> HostProtocol:
    """The host's side of the rig's frame layout; built: that of a rig with the same drives and bus. Raises RigError for
    one the rig cannot have.
    """
    try:
        return host_layout(rig, base_dir) if built is None else fitted(rig, built)
    except (ValueError, OSError) as error:
        raise RigError([layout_problem(rig, error)]) from None


def layout_problem(rig: RigConfig, error: Exception) -> str:
    """Why the rig cannot have its layout, with the key."""
    text = str(error)
    return (
        text
        if text.startswith(("bus.protocol = ", "sensors.", "outputs."))
        else f"bus.protocol = {rig.bus.protocol!r}: {text}"
    )


def feedback_notes(rig: RigConfig, layout: HostProtocol) -> list[str]:
    """What drives that sample in their own time cost the loop, for people; nothing for drives that are triggered."""
    acts_ns = layout.acts_ns
    if not acts_ns or family_of(rig.bus.protocol) is None:
        return []
    least_ms = max(acts_ns) * 1e-6
    most_ms = least_ms + (feedback_ns(layout) or rig.period_ns) * 1e-6
    more_ms = max(0.0, most_ms - rig.period_ns * 1e-6)
    return [
        f"drives sample in their own time: a position is {least_ms:.1f} to {most_ms:.1f} ms old when the force made of "
        f"it acts; the stability below counts {rig.period_ns * 1e-6:g} ms. The rest, {more_ms:.1f} ms, costs "
        f"{0.36 * more_ms:.2f} degrees of phase per Hz of the loop's crossover"
    ]


def answer_at_rest(rig: RigConfig, layout: HostProtocol) -> tuple[int, int]:
    """The longest answer that is asked for at rest alone: frames, and ns for which it takes the bus; zeros: none is."""
    frames: Counter[str] = Counter()
    taken_ns: Counter[str] = Counter()
    for number, part in enumerate(messages_by_segment(rig, layout)):
        for message in part:
            if message.at_rest and message.sender != "host":
                drive = f"{number} {message.sender}"
                frames[drive] += message.at_rest
                taken_ns[drive] += message.at_rest * frame_ns(message, rig.bus.bitrate, rig.bus.data_bitrate)
    return max(frames.values(), default=0), max(taken_ns.values(), default=0)


def rest_notes(rig: RigConfig, layout: HostProtocol) -> list[str]:
    """How long an answer takes the bus that is asked for at rest alone, for people; nothing where there is none."""
    frames, taken_ns = answer_at_rest(rig, layout)
    if not frames:
        return []
    return [
        f"read back before READY and after a reset: an answer has up to {frames} frames and takes the bus for up to "
        f"{taken_ns * 1e-6:.1f} ms, one drive at a time. While a drive is enabled nothing is asked, so the table "
        "leaves these frames out"
    ]


def emulation_notes(rig: RigConfig) -> list[str]:
    """What runs against the emulated drives of a layout cannot show, for people; nothing where those drives are made
    from another document than the layout.
    """
    if LAYOUT_KIND.own(rig.bus.protocol) or rig.plant.drive is not None:
        return []
    return [
        f"emulated drives: the drives' side of {rig.bus.protocol} itself. A run with them shows that its two "
        "sides agree, not that a drive you bought does; plant.drive has drives made from their makers' documents"
    ]


def _unmounted(layout: HostProtocol) -> HostProtocol:
    """The layout in the terms of the drives."""
    return layout.layout if isinstance(layout, MountedHost) else layout


def _parts(layout: HostProtocol) -> Sequence[HostProtocol]:
    """Of every segment."""
    inner = _unmounted(layout)
    return getattr(inner, "segments", (inner,))


def feedback_ns(layout: HostProtocol) -> int:
    """Stated period of drives that send their position in their own time; 0: every tick."""
    return max(int(getattr(part, "feedback_ns", 0)) for part in _parts(layout))


def layout_warnings(layout: HostProtocol) -> list[str]:
    """What is wrong with the layout's file beside what is used of it, and what its drives are not asked, for people."""
    parts = _parts(layout)  # all of them read the same file
    said = (text for part in parts for name in ("warnings", "unasked") for text in getattr(part, name, ()))
    return list(dict.fromkeys(said))


def messages_by_segment(rig: RigConfig, layout: HostProtocol) -> list[list[Message]]:
    """All traffic that layout, outputs and sensors put on each of the rig's segments."""
    several = getattr(_unmounted(layout), "messages_by_segment", None)
    found: list[list[Message]] = several(rig.period_ns) if several else [layout.messages(rig.period_ns)]
    found[0] = [*found[0], *output_messages(rig), *sensor_messages(rig, layout)]
    return found


def analyse_rig(rig: RigConfig, layout: HostProtocol) -> Analysis:
    """Worst-case response times on the rig's bus: on all its segments, with the load of the busiest."""
    analyses = [analyse(part, rig.bus.bitrate, rig.bus.data_bitrate) for part in messages_by_segment(rig, layout)]
    if len(analyses) == 1:
        return analyses[0]
    return Analysis(
        tuple(response for analysis in analyses for response in analysis.responses),
        max(analysis.bus_load for analysis in analyses),
        max(analysis.tick_ns for analysis in analyses),
    )


def refuse_unschedulable(rig: RigConfig, base_dir: Path, built: HostProtocol | None = None) -> HostProtocol:
    """The layout of a rig whose traffic fits. built: that of a rig with the same drives and bus. Raises RigError (exit
    status 78) naming each frame that is too late, and for a layout that the rig cannot have.
    """
    layout = rig_layout(rig, base_dir, built)
    analysis = analyse_rig(rig, layout)
    if not analysis.schedulable:
        raise RigError(problems(rig, base_dir, analysis))
    return layout


def highest_rate(rig: RigConfig, base_dir: Path) -> int | None:
    """The most whole Hz, below its own rate, at which the rig's traffic fits; None where it does not at the least."""
    fits, too_much = LEAST_RATE_HZ - 1, math.ceil(rig.rate_hz)
    while too_much - fits > 1:
        middle = (fits + too_much) // 2
        slower = rig.model_copy(update={"rate_hz": middle})
        if analyse_rig(slower, rig_layout(slower, base_dir)).schedulable:
            fits = middle
        else:
            too_much = middle
    return fits if fits >= LEAST_RATE_HZ else None


def problems(rig: RigConfig, base_dir: Path, analysis: Analysis) -> list[str]:
    """One line for the bus, one for the frame that is worst off."""
    if analysis.schedulable:
        return []
    response = analysis.tightest
    if response.margin_ns is None:
        verdict = "has no bound: the bus is overloaded"
    else:
        verdict = (
            f"ends up to {microseconds(response.message.deadline_ns - response.margin_ns)} after the tick's start, "
        )
        verdict += (
            f"{microseconds(-response.margin_ns)} past its deadline of {microseconds(response.message.deadline_ns)}"
        )
    highest = highest_rate(rig, base_dir)
    slower = f"rate_hz = {highest} or less, " if highest else ""
    return [
        f"bus.protocol = {rig.bus.protocol!r} at {rig.bus.bitrate} bit/s does not fit rate_hz = {rig.rate_hz:g} "
        f"with {len(rig.axes)} axes: worst-case load {analysis.bus_load:.1%}, cyclic part "
        f"{microseconds(analysis.tick_ns)} of {microseconds(rig.period_ns)} per tick",
        f"frame '{response.frame}' {verdict}; {slower}a higher bit rate or a leaner layout would do",
    ]


def microseconds(time_ns: int) -> str:
    """A time as tables and refusals show it."""
    return f"{time_ns / 1000:.1f} us"
