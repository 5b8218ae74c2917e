"""The sensors of a rig beside its frame layout: their traffic, and whether they have room there."""

from collections.abc import Sequence
from pathlib import Path

from drivers.frame import FD_LENGTHS
from drivers.protocols.base import HostProtocol, LayoutError, Message
from drivers.sensors.base import SensorReader, trigger_of
from drivers.sensors.hil_frame import CLASSIC_LENGTH, FD_LENGTH
from drivers.sensors.readers import sensor_readers
from hil.rig.schema import RigConfig


def first_segment(layout: HostProtocol) -> HostProtocol:
    """The layout of the segment that sensors are on."""
    unmounted = getattr(layout, "layout", layout)
    part: HostProtocol = getattr(unmounted, "segments", (unmounted,))[0]
    return part


def trigger(rig: RigConfig, layout: HostProtocol) -> Message | None:
    """The host's frame at whose end the sensors sample."""
    part = first_segment(layout)
    return trigger_of(part.messages(rig.period_ns), part.echo_id, rig.period_ns)


def readers_of(rig: RigConfig, base_dir: Path, layout: HostProtocol) -> list[SensorReader]:
    """Who reads the frames of the rig's sensors, in their order. Raises LayoutError naming the key."""
    if not rig.sensors:
        return []
    return sensor_readers(rig.sensors, base_dir, counted=sync_counted(rig, layout))


def sync_counted(rig: RigConfig, layout: HostProtocol) -> bool:
    """Whether a SYNC is sent, and carries a counter."""
    heard = trigger(rig, layout)
    return rig.bus.protocol == "cia402" and heard is not None and heard.length > 0


def trigger_mask(layout: HostProtocol) -> int:
    """The bits of its identifier that are the same whatever the host says in that frame."""
    return int(getattr(first_segment(layout), "node_mask", -1))


def sensor_messages(rig: RigConfig, layout: HostProtocol) -> list[Message]:
    """One frame a sensor and tick, each due within the period. The few that configure a CiA 404 device before it gives
    readings, in ticks in which no drive is served, are not among them.
    """
    if not rig.sensors:
        return []
    heard, period_ns = trigger(rig, layout), rig.period_ns
    after = None if heard is None else heard.name
    found = []
    for name, sensor in rig.sensors.items():
        length = CLASSIC_LENGTH if not sensor.fd else FD_LENGTH if sensor.kind == "hil" else FD_LENGTHS[-1]
        found.append(Message(name, sensor.can_id, length, sensor.fd, period_ns, period_ns, 0, name, after))
    return found


def check_sensors(rig: RigConfig, layout: HostProtocol) -> None:
    """Raise LayoutError, naming the key, for a sensor that has no room beside the layout."""
    if not rig.sensors:
        return
    taken: Sequence[Message] = first_segment(layout).messages(rig.period_ns)
    users = {message.can_id: message.name for message in taken}
    for name, sensor in rig.sensors.items():
        if sensor.kind == "cia404":
            if rig.bus.protocol != "cia402":
                raise LayoutError(
                    f"sensors.{name}.kind = 'cia404': bus.protocol = {rig.bus.protocol!r} sends no SYNC; such a device "
                    "goes with protocol = 'cia402'"
                )
            from drivers.families.cia402.cia301 import HEARTBEAT_ID, SDO_RESPONSE_ID  # few rigs have such a node

            if SDO_RESPONSE_ID + sensor.node in users or HEARTBEAT_ID + sensor.node in users:
                raise LayoutError(f"sensors.{name}.node = {sensor.node}: it is the node of a drive; choose another")
        if sensor.can_id in users:
            raise LayoutError(
                f"sensors.{name}.can_id = {sensor.can_id:#x}: '{users[sensor.can_id]}' of bus.protocol = "
                f"{rig.bus.protocol!r} has this identifier; choose one that `hil check` does not list"
            )
        if sensor.fd and not layout.fd:
            raise LayoutError(
                f"sensors.{name}.fd = true: bus.protocol = {rig.bus.protocol!r} is one of classic CAN; expected false"
            )
    if trigger(rig, layout) is None:
        raise LayoutError(
            f"sensors.{next(iter(rig.sensors))}: bus.protocol = {rig.bus.protocol!r} sends no frame in every tick at "
            "which a sensor could sample"
        )
