"""The outputs of a rig beside its frame layout: their traffic, and whether they have room there."""

from pathlib import Path

from drivers.frame import FD_LENGTHS
from drivers.outputs.base import OutputWriter
from drivers.outputs.config import CANOPEN, OutputConfig, by_frame
from drivers.outputs.hil_frame import LENGTH
from drivers.protocols.base import MOST_SENT, HostProtocol, LayoutError, Message
from hil.rig.schema import RigConfig
from hil.rig.sensors import first_segment, sync_counted

_LONGEST = 8  # bytes of a classic frame


def writers_of(rig: RigConfig, base_dir: Path, layout: HostProtocol) -> list[OutputWriter]:
    """Who tells the rig's output nodes what is set. Raises LayoutError naming the key."""
    if not rig.outputs:
        return []
    from drivers.outputs.writers import output_writers  # few rigs have one

    return output_writers(rig.outputs, base_dir, rig.period_ns, counted=sync_counted(rig, layout))


def output_messages(rig: RigConfig) -> list[Message]:
    """The output frames, where there are any: behind the command, in every tick. The few that configure a CANopen
    device, in ticks in which no drive is served, and its heartbeats are not among them.
    """
    found = []
    for number, group in enumerate(by_frame(rig.outputs)):
        name, output = next(iter(group.items()))
        length = LENGTH if output.kind == "hil" else FD_LENGTHS[-1] if output.fd else _LONGEST
        shown = f"outputs {name}" if number else "outputs"
        found.append(Message(shown, output.can_id, length, output.fd, rig.period_ns, rig.period_ns, 0, "host"))
    return found


def check_outputs(rig: RigConfig, layout: HostProtocol) -> None:
    """Raise LayoutError, naming the key, for outputs that have no room beside the layout."""
    if not rig.outputs:
        return
    cyclic = first_segment(layout).messages(rig.period_ns)
    users = {message.can_id: message.name for message in cyclic}
    users |= {sensor.can_id: f"sensors.{sensor_name}" for sensor_name, sensor in rig.sensors.items()}
    groups = by_frame(rig.outputs)
    for group in groups:
        name, output = next(iter(group.items()))
        if output.can_id in users:
            raise LayoutError(
                f"outputs.{name}.can_id = {output.can_id:#x}: '{users[output.can_id]}' has this identifier; choose "
                "one that `hil check` does not list"
            )
        if output.fd and not layout.fd:
            raise LayoutError(
                f"outputs.{name}.fd = true: bus.protocol = {rig.bus.protocol!r} is one of classic CAN; expected false"
            )
        if output.kind in CANOPEN:
            _check_node(rig, name, output, users)
    if sum(message.sender == "host" for message in cyclic) + len(groups) > MOST_SENT:
        name = next(iter(rig.outputs))
        raise LayoutError(
            f"outputs.{name}: bus.protocol = {rig.bus.protocol!r} sends {MOST_SENT} frames in a tick, and no more are "
            "recorded"
        )


def _check_node(rig: RigConfig, name: str, output: OutputConfig, users: dict[int, str]) -> None:
    """One that is beside CANopen drives, and that nobody else configures."""
    if rig.bus.protocol != "cia402":
        raise LayoutError(
            f"outputs.{name}.kind = '{output.kind}': bus.protocol = {rig.bus.protocol!r} has no CANopen master; such a "
            "device goes with protocol = 'cia402'"
        )
    from drivers.families.cia402.cia301 import HEARTBEAT_ID, SDO_RESPONSE_ID  # few rigs have such a node

    others = {sensor.node: f"sensors.{sensor_name}" for sensor_name, sensor in rig.sensors.items() if sensor.node}
    if SDO_RESPONSE_ID + output.node in users or HEARTBEAT_ID + output.node in users:
        raise LayoutError(f"outputs.{name}.node = {output.node}: it is the node of a drive; choose another")
    if output.node in others:
        raise LayoutError(f"outputs.{name}.node = {output.node}: it is the node of {others[output.node]}, too")
