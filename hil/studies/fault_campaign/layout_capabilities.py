"""What a frame layout gives the detectors to work with, and so what nobody can ask of a rig that uses it.

The one place where the campaign tells layouts apart: a trial names the capabilities its fault takes to be told from the
truth (`Trial.needs`), or to be played at all (`Trial.only`).
"""

from enum import Flag, auto
from typing import NamedTuple

from drivers.families import family_of
from drivers.frame import Frame
from drivers.frame_length import INTERMISSION, frame_bits
from drivers.protocols.base import HostProtocol
from hil.virtual.lockstep import LockstepRun

BABBLE = Frame(0x7FF, b"")  # what a babbling node sends that disturbs least: the shortest frame, less urgent than ours
TRAFFIC_TICKS = 20  # over which the bus' load is taken


class Capability(Flag):
    """Properties of a layout on a rig."""

    SEQUENCE = auto()
    CHECKSUM = auto()
    STATE = auto()
    CAUSE = auto()
    RESET = auto()
    ROOM = auto()
    NODES = auto()
    STAMPS = auto()


NONE = Capability(0)


class Text(NamedTuple):
    """For people: what it is, what is missing without it, and what follows."""

    capability: str
    lacking: str
    follows: str


TEXTS: dict[Capability, Text] = {
    Capability.SEQUENCE: Text(
        "an answer says which command it answers",
        "no sequence number",
        "an answer that is late by whole periods passes for a prompt one, once the gap it left is over: the loop then "
        "runs on old positions, and only a following error, a speed or a diverging filter may tell. A frame that comes "
        "twice is taken twice, which changes nothing",
    ),
    Capability.CHECKSUM: Text(
        "frames carry a checksum besides CAN's own",
        "no checksum",
        "damage that CAN's own checksum lets through (in a drive's or a gateway's memory) is accepted for the tick it "
        "lasts: a position within the speed bound, a torque within the drive's own limit, a drive state as it reads. "
        "Where every command is damaged, no order to stop arrives, and the drives are not asked to let go",
    ),
    Capability.STATE: Text(
        "drives have states, which they tell and are told",
        "no drive states",
        "a drive is known by its positions alone: that it failed, let go or tripped shows where its axis does not do "
        "as it is told, and at rest nowhere. There is no enable: a drive obeys whatever torque it hears, so commands "
        "that are damaged without notice go on moving it",
    ),
    Capability.CAUSE: Text(
        "every answer says what is wrong with its drive",
        "no cause in the status",
        "a drive's fault is seen as soon as elsewhere, and answered the same; that its watchdog or its encoder was the "
        "cause comes in a message of its own, later or never, so the fault that latches is drive_fault",
    ),
    Capability.RESET: Text(
        "a drive clears what it latched when it is told to",
        "no reset",
        "a drive that tripped stays so until it is cleared by other means, such as its supply: after a restart the rig "
        "stays CONNECTED, and a reset does not change that",
    ),
    Capability.STAMPS: Text(
        "answers carry the drive's own time",
        "no time stamp",
        "an instant is estimated from this host's frames: a drive's clock cannot be wrong, as it is not asked",
    ),
    Capability.ROOM: Text(
        "beside our own traffic the bus has room for safety.flood_frames frames a tick",
        "no room for a flood",
        "a node that babbles with frames less urgent than all of ours is not seen: it delays ours by one short frame "
        "and displaces none. One more urgent than ours stops the rig under every layout",
    ),
}


def has_nodes(layout: str) -> bool:
    """Whether the drives are CANopen nodes."""
    family = family_of(layout)
    return family is not None and family.canopen


def fixed_capabilities(protocol: HostProtocol) -> Capability:
    """Those that follow from the layout alone."""
    capabilities = Capability.NODES if has_nodes(protocol.name) else NONE
    capabilities |= Capability.STAMPS if any(protocol.stamp_wraps_ns) else NONE
    capabilities |= Capability.STATE if protocol.states else NONE
    capabilities |= Capability.CAUSE if protocol.causes else NONE
    capabilities |= Capability.RESET if protocol.resets else NONE
    capabilities |= Capability.SEQUENCE if protocol.sequence_modulus else NONE
    return capabilities | (Capability.CHECKSUM if protocol.checksum else NONE)


def idle_bits_ns(run: LockstepRun) -> int:
    """Time per tick in which the bus is free, ns, from the traffic of the next ticks. The run is used up."""
    start, busy = run.index, run.wire.busy_ns
    while run.index < start + TRAFFIC_TICKS:
        run.tick()
    return run.rig.period_ns - (run.wire.busy_ns - busy) // TRAFFIC_TICKS


def has_room(run: LockstepRun) -> bool:
    """Whether a babbling node can get so many frames through that they count as a flood. The run is used up."""
    bits, _ = frame_bits(BABBLE)
    duration_ns = run.wire.nominal_ns[bits + INTERMISSION]
    return idle_bits_ns(run) // duration_ns >= run.rig.safety.flood_frames


def lacking_text(capabilities: Capability) -> str:
    """'no checksum, no sequence number', in the order of TEXTS; empty for none."""
    return ", ".join(text.lacking for one, text in TEXTS.items() if one & capabilities)
