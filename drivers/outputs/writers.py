"""Who tells a rig's output nodes what is set, by their kind."""

from collections.abc import Mapping
from pathlib import Path

from drivers.outputs.base import OutputWriter
from drivers.outputs.config import OutputConfig, by_frame
from drivers.outputs.hil_frame import HilOutputFrame


def output_writers(
    outputs: Mapping[str, OutputConfig], base_dir: Path, period_ns: int, *, counted: bool = False
) -> list[OutputWriter]:
    """One for each frame. base_dir: the rig file's folder. period_ns: of the control loop. counted: SYNC carries a
    counter. Raises LayoutError naming the key.
    """
    return [_writer(group, base_dir, period_ns, counted=counted) for group in by_frame(outputs)]


def _writer(group: dict[str, OutputConfig], base_dir: Path, period_ns: int, *, counted: bool) -> OutputWriter:
    config = next(iter(group.values()))
    if config.kind == "hil":
        return HilOutputFrame(config.can_id, sum(1 << output.bit for output in group.values()))
    if config.kind == "dbc":
        from drivers.outputs.dbc_frame import DbcOutputFrame  # few rigs have one

        return DbcOutputFrame(group, base_dir)
    from drivers.outputs.canopen import CanopenOutputs

    return CanopenOutputs(group, base_dir, period_ns, counted=counted)
