"""The emulated nodes of a rig's outputs, by their kind, and what all of them switch together."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from drivers.frame import Frame, segment_of
from drivers.outputs.config import OutputConfig, by_frame
from sim_plant.nodes.output import NEVER_NS, OutputNode


def output_nodes(outputs: Mapping[str, OutputConfig], base_dir: Path) -> list[OutputNode]:
    """The node of each frame. base_dir: of the files that they name."""
    return [_node(group, base_dir) for group in by_frame(outputs)]


def _node(group: dict[str, OutputConfig], base_dir: Path) -> OutputNode:
    config = next(iter(group.values()))
    if config.kind == "hil":
        return OutputNode(config.can_id)
    from sim_plant.nodes.other_outputs import CanopenOutputNode, SignalOutputNode  # few rigs have one

    return SignalOutputNode(group, base_dir) if config.kind == "dbc" else CanopenOutputNode(group, base_dir)


class OutputNodes:
    """All of a rig; they are on the first segment. senders: name of the node that answers, by identifier."""

    def __init__(self, nodes: Sequence[OutputNode]) -> None:
        self.nodes = list(nodes)
        self._told = {node.output_id: node for node in nodes}
        self._answering = [node for node in nodes if node.can_ids]
        self.senders = {can_id: f"outputs {node.output_id:#x}" for node in self._answering for can_id in node.can_ids}

    @property
    def names(self) -> list[str]:
        """Of those that answer."""
        return list(dict.fromkeys(self.senders.values()))

    def tells(self, frame: Frame) -> bool:
        """Whether it says to one of them what is set; to nobody else it says anything."""
        return frame.can_id in self._told and not segment_of(frame)

    def hear(self, frame: Frame, now_ns: int) -> list[Frame]:
        """A frame came; what they answer."""
        node = self._told.get(frame.can_id)
        if node is None:
            return [answer for other in self._answering for answer in other.heed(frame, now_ns)]
        node.hear(frame, now_ns)
        return []

    def expire(self, now_ns: int) -> None:
        """Time has come to now_ns."""
        for node in self.nodes:
            node.expire(now_ns)

    def switched(self) -> tuple[int, int]:
        """The bits of all, and when the first of them goes off by itself; NEVER_NS: none does."""
        bits = 0
        for node in self.nodes:
            bits |= node.bits
        return bits, min((node.deadline_ns for node in self.nodes), default=NEVER_NS)
