"""Which faults of an emulated stage this computer caused, by holding a process up."""

from collections.abc import Iterable

from hil.events.motion_causes import RINGS
from hil.telemetry import events_pb2 as pb_events

STALL_FAULTS = (
    "ENCODER_LOST",
    "ENCODER_DEAD",
    "DRIVE_WATCHDOG",
    "DRIVE_DISABLED",
    "OVERRUN",
    "OVERRUN_BURST",
    "OVERRUN_LONG",
    "RECEIVE_FLOOD",
    "BAD_FRAMES",
    "TRANSMIT_REFUSED",
    "TRANSMIT_BLOCKED",
    "ENABLE_TIMEOUT",
)  # faults that a host stalling the emulator or the loop for milliseconds causes
UNSAMPLED = ("OSCILLATION", "SPEED", "FOLLOWING_ERROR", "FILTER_DIVERGED")  # what a loop without samples comes to
AFTER_NS = 1_000_000_000  # within this time


def by_this_computer(fault: str, cause: str, run_ns: int, events: Iterable[pb_events.Event]) -> bool:
    """Whether a fault, at this time of the run, is a stall's: by its name, or because the loop was held up, or all
    axes were silent in one tick, within AFTER_NS before it. The emulated drives are one process of this computer, too.
    cause: of its event; a loop that rings does so at every try.
    """
    if cause.startswith(RINGS):
        return False
    if fault not in UNSAMPLED:
        return fault in STALL_FAULTS
    return any(0 <= run_ns - event.run_ns <= AFTER_NS and _held_up(event) for event in events)


def _held_up(event: pb_events.Event) -> bool:
    name = event.name.upper()
    silent = name in STALL_FAULTS or (name == "ENCODER_GAP" and not event.axis)
    return silent or event.kind in (pb_events.Event.TICKS_LOST, pb_events.Event.TICK_LATE)
