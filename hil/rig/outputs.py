"""The outputs of a rig beside its frame layout: their traffic, and whether they have room there."""

from drivers.outputs.hil_frame import LENGTH
from drivers.protocols.base import MOST_SENT, HostProtocol, LayoutError, Message
from hil.rig.schema import RigConfig
from hil.rig.sensors import first_segment


def output_messages(rig: RigConfig) -> list[Message]:
    """The output frame, where there is one: behind the command, in every tick."""
    if not rig.outputs:
        return []
    can_id = next(iter(rig.outputs.values())).can_id
    return [Message("outputs", can_id, LENGTH, False, rig.period_ns, rig.period_ns, 0, "host")]


def check_outputs(rig: RigConfig, layout: HostProtocol) -> None:
    """Raise LayoutError, naming the key, for outputs that have no room beside the layout."""
    if not rig.outputs:
        return
    name, output = next(iter(rig.outputs.items()))
    cyclic = first_segment(layout).messages(rig.period_ns)
    users = {message.can_id: message.name for message in cyclic}
    users |= {sensor.can_id: f"sensors.{sensor_name}" for sensor_name, sensor in rig.sensors.items()}
    if output.can_id in users:
        raise LayoutError(
            f"outputs.{name}.can_id = {output.can_id:#x}: '{users[output.can_id]}' has this identifier; choose "
            "one that `hil check` does not list"
        )
    if sum(message.sender == "host" for message in cyclic) >= MOST_SENT:
        raise LayoutError(
            f"outputs.{name}: bus.protocol = {rig.bus.protocol!r} sends {MOST_SENT} frames in a tick, and no more are "
            "recorded"
        )
