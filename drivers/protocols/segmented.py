"""A frame layout over several segments: each has one of its own, for the axes on it.

So every segment has its whole traffic: its command frame or SYNC, its master and NMT, its sampling clock. What is told
to all drives is told on each segment to those that are there. `Frame.flags` say which segment a frame is on; an answer
of an axis that comes on another segment than its own is nobody's there.
"""

import functools
from collections.abc import Callable, Sequence
from operator import and_
from typing import TypeVar

from drivers.config import BusConfig
from drivers.frame import Frame, on_segment, segment_of
from drivers.protocols.base import Command, DeviceProtocol, HostProtocol, LayoutError, Message, Reject, Sample
from drivers.protocols.segments import Segment, segments_of

Side = TypeVar("Side")


def on_each(bus: BusConfig, n_axes: int, make: Callable[[Segment], Side]) -> list[tuple[Segment, Side]]:
    """What `make` makes for each segment of a rig. Raises LayoutError naming the segment."""
    found = []
    for number, segment in enumerate(segments_of(bus, n_axes)):
        try:
            found.append((segment, make(segment)))
        except LayoutError as error:
            raise LayoutError(f"bus.segments[{number}] ({segment.bus.channel}): {error}") from None
    return found


class SegmentedHost:
    """HostProtocol of all axes on one of each segment (`segments`). echo_ids: echo_id of each."""

    echo_id: int | None = None  # of the bus as a whole there is none

    def __init__(self, parts: Sequence[tuple[Segment, HostProtocol]]) -> None:
        """parts: in the order of the rig's segments. Raises LayoutError where they number commands differently."""
        self.segments = [layout for _, layout in parts]
        self.channels = [segment.bus.channel for segment, _ in parts]
        self._axes = [segment.axes for segment, _ in parts]
        one = self.segments[0]
        self.name, self.sequence_modulus = one.name, one.sequence_modulus
        self.checksum = all(layout.checksum for layout in self.segments)
        self.states = all(layout.states for layout in self.segments)
        self.causes = all(layout.causes for layout in self.segments)
        self.resets = all(layout.resets for layout in self.segments)
        self.tells = functools.reduce(and_, (layout.tells for layout in self.segments))
        self.stamp_wraps_ns: Sequence[int] = [wrap for layout in self.segments for wrap in layout.stamp_wraps_ns]
        self.n_axes = sum(layout.n_axes for layout in self.segments)
        self.fd = any(layout.fd for layout in self.segments)
        self.positions: Sequence[tuple[float, float]] = [ends for layout in self.segments for ends in layout.positions]
        self.echo_ids = [layout.echo_id for layout in self.segments]
        self.acts_ns: Sequence[int] = [acts for layout in self.segments for acts in layout.acts_ns]
        self.state_ns = max(layout.state_ns for layout in self.segments)
        self._decoders = [(layout.decode, axes[0]) for layout, axes in zip(self.segments, self._axes, strict=True)]
        if any(layout.sequence_modulus != self.sequence_modulus for layout in self.segments):
            raise LayoutError("bus.segments: commands have a sequence number on some and none, or another, on others")

    @property
    def problems(self) -> list[str]:
        """Why drives were refused, with their segment."""
        named = zip(self.channels, self.segments, strict=True)
        return [f"{channel}: {text}" for channel, layout in named for text in layout.problems]

    def decode(self, frame: Frame) -> Sample | Reject | tuple[Sample, ...]:
        """As the layout of the segment that the frame came on, with the axis' number in the rig."""
        segment = segment_of(frame)
        if segment >= len(self._decoders):
            return Reject.UNKNOWN_ID
        decode, first = self._decoders[segment]
        outcome = decode(frame)
        if isinstance(outcome, Reject):
            return outcome
        for sample in (outcome,) if isinstance(outcome, Sample) else outcome:
            sample.axis += first
        return outcome

    def encode(self, command: Command) -> list[Frame]:
        """The frames of every segment's layout, those of the first segment first. Raises ValueError as theirs does."""
        if len(command.force) != self.n_axes:
            raise ValueError(f"{len(command.force)} forces for {self.n_axes} axes")
        frames = []
        for number, (layout, axes) in enumerate(zip(self.segments, self._axes, strict=True)):
            enable = command.enable >> axes.start & (1 << len(axes)) - 1
            force = command.force[axes.start : axes.stop]
            part = layout.encode(Command(command.sequence, force, enable, command.reset))
            frames += [on_segment(frame, number) for frame in part]
        return frames

    def messages(self, period_ns: int) -> list[Message]:
        """Of all segments, with their channel in the names."""
        return [message for part in self.messages_by_segment(period_ns) for message in part]

    def messages_by_segment(self, period_ns: int) -> list[list[Message]]:
        """The same, by segment; senders are the axes of the rig."""
        return [
            [_renamed(message, channel, axes.start) for message in layout.messages(period_ns)]
            for channel, layout, axes in zip(self.channels, self.segments, self._axes, strict=True)
        ]


def _renamed(message: Message, channel: str, first: int) -> Message:
    sender = message.sender
    if sender.startswith("axis "):
        sender = f"axis {int(sender.removeprefix('axis ')) + first}"
    after = message.after and f"{channel} {message.after}"
    return message._replace(name=f"{channel} {message.name}", sender=sender, after=after)


class SegmentedDevice:
    """DeviceProtocol of all axes. force_resolution, enable_lag: the layouts', where they have them."""

    def __init__(self, parts: Sequence[tuple[Segment, DeviceProtocol]]) -> None:
        self._layouts = [layout for _, layout in parts]
        self._axes = [segment.axes for segment, _ in parts]
        one = self._layouts[0]
        self.name, self.n_axes = one.name, sum(layout.n_axes for layout in self._layouts)
        self.fd = any(getattr(layout, "fd", False) for layout in self._layouts)
        self.sequence_modulus = int(getattr(one, "sequence_modulus", 0))
        self.force_resolution = max(float(getattr(layout, "force_resolution", 0.0)) for layout in self._layouts)
        self.enable_lag = max(int(getattr(layout, "enable_lag", 0)) for layout in self._layouts)
        self._told = Command(0, [0.0] * self.n_axes, 0, False)

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command that the last segment's frame completes; SERVICE for that of another."""
        command = self.decode_part(frame)
        last = segment_of(frame) == len(self._layouts) - 1
        return command if last or isinstance(command, Reject) else Reject.SERVICE

    def decode_part(self, frame: Frame) -> Command | Reject:
        """The command as it is told on the frame's segment; of the axes on others what they were told before."""
        number = segment_of(frame)
        if number >= len(self._layouts):
            return Reject.UNKNOWN_ID
        part = self._layouts[number].decode_command(frame)
        if not isinstance(part, Command):
            return part
        axes, force = self._axes[number], list(self._told.force)
        force[axes.start : axes.stop] = part.force
        others = self._told.enable & ~((1 << len(axes)) - 1 << axes.start)
        self._told = Command(part.sequence, force, others | part.enable << axes.start, part.reset)
        return self._told

    def frames_of(self, sample: Sample) -> list[Frame]:
        """What an axis sends with a sample."""
        number = next(n for n, axes in enumerate(self._axes) if sample.axis in axes)
        layout = self._layouts[number]
        local = Sample(
            sample.axis - self._axes[number].start, sample.position, sample.status, sample.sequence, sample.stamp_ns
        )
        several = getattr(layout, "frames_of", None)
        frames = several(local) if several else [layout.encode_feedback(local)]
        return [on_segment(frame, number) for frame in frames]

    def encode_feedback(self, sample: Sample) -> Frame:
        """See DeviceProtocol: of several frames that with the position."""
        return self.frames_of(sample)[-1]
