"""The drives that a rig's emulated stage has: made from their own documentation or EDS, not from the rig's binding."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Protocol

from drivers.config import LAYOUT_KIND, BusConfig, DrivesConfig
from drivers.frame import Frame
from drivers.protocols.mounting import Mounting
from sim_plant.config import EmulatedDriveConfig, PlantConfig
from sim_plant.drives.servo import Counter, ServoDrive, Switches
from sim_plant.physics.stage import per_axis_array

Position = Callable[[], float]
MIT = ("damiao", "cubemars", "robstride")
# the layout of drives that speak none that a DBC file describes
SPOKEN = {"cia402": "cia402", "moteus": "moteus"} | dict.fromkeys((*MIT, "mit"), "mit")


class DriveNode(Protocol):
    """A drive that is a node of its own on the bus. next_ns: when it has something to send in its own time. fd: it
    speaks CAN FD.
    """

    fd: bool
    node_id: int
    servo: ServoDrive
    sampled_ns: int
    next_ns: int

    def on_frame(self, frame: Frame) -> list[Frame]:
        """What it sends at the reception of a frame."""

    def advance(self, now_ns: int) -> list[Frame]:
        """What it sends by itself until now_ns."""


def installed_mountings(config: EmulatedDriveConfig | None, n_axes: int) -> list[Mounting]:
    """How the motors of drives that count in turns sit on their axes; none where the rig's own mountings are true.

    Raises ValueError where [plant.drive] has not one entry for each axis.
    """
    if config is None or config.kind == "cia402":
        return []
    for name in ("turn", "nodes"):
        count = len(getattr(config, name))
        if count != n_axes and not (name == "nodes" and not count):
            raise ValueError(f"plant.drive.{name} has {count} values for {n_axes} axes")
    return [Mounting(1 if turn > 0 else -1, 2.0 * math.pi / abs(turn), 0) for turn in config.turn]


def installed_servos(
    plant: PlantConfig, config: DrivesConfig, axis_names: Sequence[str], rated_force: Sequence[float], modulus: int
) -> list[ServoDrive]:
    """What every drive is inside, in bus order, with its limit switches.

    rated_force: N per axis. modulus: of the layout's sequence number; 0: it has none. Raises ValueError where a list
    does not fit the axes.
    """
    n_axes = len(axis_names)
    resolution = per_axis_array("plant.encoder_resolution", plant.encoder_resolution, n_axes).tolist()
    brake = per_axis_array("drives.brake", config.brake, n_axes).astype(bool).tolist()
    watchdog_ns = round(config.watchdog_s * 1e9)
    opening_ns = round(config.brake_opening_s * 1e9)
    servos = [
        ServoDrive(axis, rated_force[axis], resolution[axis], watchdog_ns, brake[axis], modulus, opening_ns=opening_ns)
        for axis in range(n_axes)
    ]
    for entry in plant.switches:
        servo = servos[list(axis_names).index(entry.axis)]
        servo.switches = Switches(**entry.model_dump(exclude={"axis", "zero", "index"}, exclude_none=True))
        if entry.zero is not None or entry.index is not None:
            servo.counter = Counter(entry.zero or 0.0, None if entry.contact in ("dead", "stuck") else entry.index)
    return servos


def installed_drives(
    bus: BusConfig,
    config: EmulatedDriveConfig | None,
    base_dir: Path,
    servos: Sequence[ServoDrive],
    positions: Sequence[Position],
    start_ns: int,
) -> Sequence[DriveNode]:
    """One node an axis. positions: of the axes as their drives see them, m. Raises ValueError for an EDS that cannot be
    read, or drives that do not speak the rig's layout.
    """
    layout = "dbc" if bus.protocol.startswith("dbc:") else bus.protocol
    kind = config.kind if config else layout
    if LAYOUT_KIND.own(bus.protocol) and layout != SPOKEN.get(kind, "dbc"):  # of a user's, it is to be seen
        raise ValueError(f"plant.drive.kind = {kind!r}: such drives do not speak bus.protocol = {bus.protocol!r}")
    if kind == "cia402":
        return _cia402(bus, config, base_dir, servos, positions, start_ns)
    if kind == "moteus":
        return _moteus(bus, config, servos, positions, start_ns)
    if SPOKEN.get(kind) == "mit":
        return _mit(bus, config, servos, positions, start_ns)
    assert config is not None
    nodes = config.nodes or list(range(len(servos)))
    return [
        _in_turns(bus, config, node, servo, position, abs(turn), start_ns)
        for node, servo, position, turn in zip(nodes, servos, positions, config.turn, strict=True)
    ]


def _turns(servo: ServoDrive, position: Position, turn: float) -> float:
    """What an encoder of so much resolution says, in turns."""
    return servo.sample(position(), servo.last_command_ns).position * servo.resolution / turn


def _status(servo: ServoDrive, position: Position) -> int:
    """DriveStatus of a servo, with the switches at its axis."""
    return servo.sample(position(), servo.last_command_ns).status


def _in_turns(
    bus: BusConfig, config: EmulatedDriveConfig, node: int, servo: ServoDrive, position: Position, turn: float,
    start_ns: int,
) -> DriveNode:  # fmt: skip
    turns = partial(_turns, servo, position, turn)
    feedback_ns, state_ns = round(config.feedback_s * 1e9), round(config.heartbeat_s * 1e9)
    if config.kind == "odrive":
        from sim_plant.drives.odrive_homing import HomingOdrive

        delay_ns = round(config.enable_delay_s * 1e9)
        periods = {"feedback_ns": feedback_ns, "heartbeat_ns": state_ns, "enable_delay_ns": delay_ns}
        inputs = partial(_status, servo, position)
        return HomingOdrive(node, servo, turns, start_ns, turn=turn, inputs=inputs, instead=config.instead, **periods)
    from sim_plant.drives.vesc import Motor, Vesc

    motor = Motor(config.torque_constant, config.pole_pairs)
    pace = {"feedback_ns": feedback_ns, "status_ns": state_ns, "bitrate": bus.bitrate}
    return Vesc(node, servo, turns, start_ns, motor=motor, instead=config.instead, **pace)


def _moteus(
    bus: BusConfig,
    config: EmulatedDriveConfig | None,
    servos: Sequence[ServoDrive],
    positions: Sequence[Position],
    start_ns: int,
) -> Sequence[DriveNode]:
    from drivers.families.moteus.layout import COUNTS_PER_TURN, moteus_nodes
    from sim_plant.drives.moteus import Moteus

    if config is None:  # as the rig has them
        nodes = moteus_nodes(bus, len(servos))
        turn = [servo.resolution * COUNTS_PER_TURN for servo in servos]
    else:
        nodes = config.nodes or list(range(1, len(servos) + 1))
        turn = [abs(travel) for travel in config.turn]
    delay_ns, instead = (round(config.enable_delay_s * 1e9), config.instead) if config else (0, {})
    made = []
    for node, servo, position, travel in zip(nodes, servos, positions, turn, strict=True):
        turns, inputs = partial(_turns, servo, position, travel), partial(_status, servo, position)
        made.append(
            Moteus(node, servo, turns, start_ns, enable_delay_ns=delay_ns, instead=instead, inputs=inputs),
        )
    return made


def _mit(
    bus: BusConfig,
    config: EmulatedDriveConfig | None,
    servos: Sequence[ServoDrive],
    positions: Sequence[Position],
    start_ns: int,
) -> Sequence[DriveNode]:
    from drivers.families.mit.layout import CODES, mit_drives
    from sim_plant.drives.mit import CubeMars, Damiao, Ranges, RobStride

    count = len(servos)
    if config is None:  # as the rig has them
        stated = mit_drives(bus, count)
        kind: str = stated.kind
        nodes, position, torque = stated.nodes, stated.position, stated.torque
        hosts = [stated.host] * count if kind == "robstride" else stated.answers
        turn = [servo.resolution * CODES * math.pi / most for servo, most in zip(servos, position, strict=True)]
    else:
        kind, nodes = config.kind, config.nodes or list(range(1, count + 1))
        position, torque = [config.position_range] * count, [config.torque_range] * count
        hosts = config.told_to or [{"robstride": 0xFD, "damiao": 0x10 + node}.get(kind, node) for node in nodes]
        turn = [abs(travel) for travel in config.turn]
    made = {"damiao": Damiao, "cubemars": CubeMars, "robstride": RobStride}[kind]
    ranges = map(Ranges, position, torque, hosts)
    return [
        made(node, servo, partial(_turns, servo, at, travel), start_ns, reach)
        for node, servo, at, travel, reach in zip(nodes, servos, positions, turn, ranges, strict=True)
    ]


def _cia402(
    bus: BusConfig,
    config: EmulatedDriveConfig | None,
    base_dir: Path,
    servos: Sequence[ServoDrive],
    positions: Sequence[Position],
    start_ns: int,
) -> Sequence[DriveNode]:
    from drivers.families.cia402.cia301 import EDS
    from drivers.families.cia402.config import cia402_keys
    from drivers.families.cia402.host import node_ids
    from sim_plant.drives.homing_drive import HomingDrive  # only CANopen rigs pay for it
    from sim_plant.drives.quirks import stated_quirks

    quirks, stated = stated_quirks(config), cia402_keys(bus).cia402
    files = [base_dir / name for name in stated.eds] if stated else [EDS]
    files = files * len(servos) if len(files) == 1 else files
    nodes = node_ids(bus, len(servos))
    return [
        HomingDrive(node, servo, position, start_ns, eds=eds, quirks=quirks)
        for node, eds, servo, position in zip(nodes, files, servos, positions, strict=True)
    ]
