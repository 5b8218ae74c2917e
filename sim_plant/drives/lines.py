"""How frames reach the drives of a rig and leave them: by segment, by sender, and through what faults make of them."""

from collections.abc import Callable, Container, Iterable, Sequence

from drivers.frame import Frame, on_segment, segment_of

FrameTap = Callable[[int, Frame], Iterable[Frame]]  # (axis, its frame) -> what it sends instead


class AllBut:
    """An acceptance filter that lets all identifiers through but those in `ids` at the time, of which `shared` pass."""

    def __init__(self, ids: Container[int], shared: Container[int]) -> None:
        self._ids, self._shared = ids, shared

    def __contains__(self, can_id: object) -> bool:
        return can_id not in self._ids or can_id in self._shared


class Lines:
    """The drives' side of the bus. segments: the axes of each.

    taps: what every frame of a drive goes through. senders: the name of what sent frames of an identifier.
    """

    def __init__(self, axis_names: Sequence[str], segments: Sequence[range]) -> None:
        self._names, self._segments = list(axis_names), list(segments)
        self._numbers = [number for number, axes in enumerate(segments) for _ in axes]
        self.taps: list[FrameTap] = []
        self.senders: dict[int, str] = {}

    def reached_by(self, frame: Frame) -> range:
        """The axes whose drives a frame comes to."""
        if len(self._segments) == 1:
            return self._segments[0]
        segment = segment_of(frame)
        return self._segments[segment] if segment < len(self._segments) else range(0)

    def leaving(self, axis: int, frames: Iterable[Frame]) -> Iterable[Frame]:
        """What leaves the axis' drive in place of these frames."""
        for tap in self.taps:
            frames = [changed for frame in frames for changed in tap(axis, frame)]
        if len(self._segments) > 1:
            frames = [on_segment(frame, self._numbers[axis]) for frame in frames]
        for frame in frames:
            self.senders[frame.can_id] = self._names[axis]
        return frames
