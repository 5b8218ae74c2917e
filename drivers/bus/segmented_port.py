"""One Port for the control loop of a rig whose axes are on several segments, each with a Port of its own.

A frame says which segment it is on (drivers/frame.py): on those received this is said here, on those to be sent it is
heeded. Counters are those of all segments, the state is the worst among them: a rig with a segment lost has lost its
bus. What brings a bus back (purge, rebind) is for the one that needs it: `members`.
"""

from collections.abc import Sequence

from drivers.bus.counters import PortCounters, of_all
from drivers.bus.port import Port, PortError, Role, open_port
from drivers.config import BusConfig
from drivers.frame import Frame, on_segment, segment_of, sort_by_time


class SegmentedPort(Port):
    """Several ports, in the order of the rig's segments."""

    def __init__(self, members: Sequence[Port], receive_limit: int) -> None:
        """members: open ones, closed with this one. receive_limit: frames that one drain of all returns at most."""
        self._members = list(members)
        self._most = receive_limit
        self._beyond = 0  # frames discarded here
        self._drained = False

    @property
    def members(self) -> Sequence[Port]:
        """The ports by segment."""
        return self._members

    def fileno(self) -> int:
        """There is none of all: wait for those of `members`."""
        raise OSError("a port on several segments has a descriptor for each")

    def drain(self, now_ns: int) -> list[Frame]:
        """As Port.drain, of all segments, by time; each frame with its segment."""
        frames: list[Frame] = []
        for number, member in enumerate(self._members):
            frames += [on_segment(frame, number) for frame in member.drain(now_ns)]
        sort_by_time(frames)
        if len(frames) > self._most:
            if self._drained:
                self._beyond += len(frames) - self._most
            del frames[: -self._most]
        self._drained = True
        return frames

    def send(self, frame: Frame) -> bool:
        """As Port.send, on the frame's segment. Raises ValueError for one that there is not."""
        segment = segment_of(frame)
        if segment >= len(self._members):
            raise ValueError(f"a frame for segment {segment}: there are {len(self._members)}")
        return self._members[segment].send(on_segment(frame, 0))

    def counters(self) -> PortCounters:
        """The sums of all segments' counters, and the worst state."""
        counters = of_all([member.counters() for member in self._members])
        return counters._replace(discarded=counters.discarded + self._beyond) if self._beyond else counters

    def rebind(self) -> bool:
        """Port.rebind of every segment; True when all can be used again."""
        return False not in [member.rebind() for member in self._members]

    def purge(self) -> bool:
        """Port.purge of every segment; False: on one of them something may still wait."""
        return False not in [member.purge() for member in self._members]

    def close(self) -> None:
        """Leave all segments."""
        for member in self._members:
            member.close()


def open_segments(bus: BusConfig, *, role: Role, fd: bool, echo_ids: Sequence[int | None] = (None,)) -> Port:
    """As open_port, of all segments of a rig, one or more: all are open, or none. Raises PortError.

    echo_ids: one a segment, or one None for all.
    """
    if not bus.segments:
        return open_port(bus, role=role, fd=fd, echo_id=echo_ids[0])
    echoes = echo_ids if len(echo_ids) > 1 else [None] * len(bus.segments)
    members: list[Port] = []
    try:
        for channel, echo_id in zip(bus.channels, echoes, strict=True):
            alone = bus.model_copy(update={"segments": [], "channel": channel})
            members.append(open_port(alone, role=role, fd=fd, echo_id=echo_id))
    except PortError:
        for member in members:
            member.close()
        raise
    return SegmentedPort(members, bus.receive_limit)
