"""CANopen drives in cyclic synchronous torque mode (CiA 301, CiA 402). Contract: cia402.eds.

Theory of operation. Every tick the host sends one RPDO that all nodes share, with four target torques (6071h) of which
each node takes its own and maps the others to dummy objects, and then SYNC with a counter: drives apply, sample, and
answer with position and statusword. Behind them goes at most one service frame, so that it delays no SYNC; master.py
decides which. node.py follows one drive: it configures the drive over SDO, starts it and watches its states.

Rules. Controlwords: two RPDOs carry them. A frame that disables any drive acts at once (RPDO 2), all others at the next
SYNC (RPDO 3), so that an enabled drive has its torque from the first moment: until then a weight would fall. Where a
drive hears neither the SYNC that an enabling frame waits for nor the next one, a disabling frame finds nothing to
disable; the drive is then enabled, without torque, until the host has seen it and repeats the command (4 ticks).

Torque: the rated torque (6076h, whole mN m; mN on a linear axis) is set so that the rated force is just within the
32767 thousandths that 6071h can express. A step is then 6076h * 1e-6 N, about 1/32767 of the rated force.

Sampling time: CANopen carries none; sampling_clock.py takes it from the echo of SYNC, or estimates it from the first
TPDO behind SYNC.
"""

import math
from collections.abc import Sequence
from functools import cache
from struct import Struct
from typing import Any

import canopen

from drivers.config import BusConfig
from drivers.frame import ECHO, FD, Frame
from drivers.protocols.base import Command, DriveStatus, LayoutError, Message, Reject, Sample
from drivers.protocols.canopen import cia301
from drivers.protocols.canopen.cia301 import DriveState, mapping_entry
from drivers.protocols.canopen.master import HEARTBEAT_TICKS, MASTER_ID, SERVICE_TICKS, Master
from drivers.protocols.canopen.node import NodeMaster, Step
from drivers.protocols.sampling_clock import SamplingClock
from drivers.protocols.stage_common import MAX_AXES, check_force, reject_id

FULL_SCALE = 32767  # of 6071h
DRIVE_HEARTBEAT_MS = 100
EMCY_ID = 0x680  # below SDO: at 080h four emergencies delay every TPDO, at 480h the host's SDO, which blocks its FIFO
DUMMY_INT16, DUMMY_UINT16 = 0x0003, 0x0006
TPDO_OBJECTS = (cia301.POSITION, cia301.STATUSWORD)
_SIGNIFICANT = 0x6F | cia301.LIMIT_ACTIVE | cia301.HOMED | cia301.BRAKE  # bits of the statusword that are looked at


@cache
def _eds() -> Any:
    """The object dictionary of cia402.eds; types only, so any node will do."""
    return canopen.import_od(str(cia301.EDS), 1)


def _code(index: int) -> str:
    data_type = int(_eds()[index].data_type or 0)
    return cia301.BASIC_TYPES[data_type]


def _size(index: int, subindex: int) -> int:
    item = _eds()[index]
    variable: Any = item if isinstance(item, canopen.objectdictionary.ODVariable) else item[subindex]
    return Struct("<" + cia301.BASIC_TYPES[variable.data_type]).size


def _write(index: int, subindex: int, value: int) -> Step:
    return Step(index, subindex, value, _size(index, subindex))


def _pdo_steps(communication: int, mapping: int, can_id: int, kind: int, entries: Sequence[int]) -> list[Step]:
    """CiA 301, 7.5.2.38: invalidate the PDO, map it, make it valid."""
    return [
        _write(communication, 1, can_id | cia301.PDO_INVALID),
        _write(communication, 2, kind),
        _write(mapping, 0, 0),
        *(_write(mapping, place, entry) for place, entry in enumerate(entries, 1)),
        _write(mapping, 0, len(entries)),
        _write(communication, 1, can_id),
    ]


def _shared_entries(index: int, dummy: int, place: int, n_axes: int) -> list[int]:
    """Mapping of an RPDO that n_axes nodes share: the node's own object at its place, dummies elsewhere."""
    return [mapping_entry(index if at == place else dummy, 0, 16) for at in range(n_axes)]


def rated_torque(rated_force: float) -> tuple[int, int]:
    """Values of 6076h (mN or mN m) and 6072h (thousandths of it) for a rated force in N or N m."""
    unit = max(1, math.ceil(rated_force * 1e6 / FULL_SCALE))
    return unit, min(FULL_SCALE, math.floor(rated_force * 1e6 / unit))


def configuration(bus: BusConfig, axis: int, n_axes: int, rated_force: float, period_ns: int) -> list[Step]:
    """Everything the master asks of one node and tells it, before it starts it."""
    node = bus.node_id + axis
    unit, limit = rated_torque(rated_force)
    master_ms = max(DRIVE_HEARTBEAT_MS, 5 * HEARTBEAT_TICKS * period_ns // 1_000_000)
    torque = _shared_entries(cia301.TORQUE, DUMMY_INT16, axis, n_axes)
    controlword = _shared_entries(cia301.CONTROLWORD, DUMMY_UINT16, axis, n_axes)
    feedback = [mapping_entry(index, 0, 8 * Struct("<" + _code(index)).size) for index in TPDO_OBJECTS]
    return [
        Step(0x1000, 0, cia301.DEVICE_PROFILE, mask=0xFFFF),
        Step(0x6502, 0, cia301.TORQUE_MODE_BIT, mask=cia301.TORQUE_MODE_BIT),
        _write(0x1006, 0, 0),  # 1019h may only be written while it is zero
        _write(0x1019, 0, cia301.SYNC_COUNTER_MAX),
        _write(0x1014, 0, EMCY_ID + node),
        _write(0x1016, 1, MASTER_ID << 16 | min(master_ms, 0xFFFF)),
        _write(0x1017, 0, DRIVE_HEARTBEAT_MS),
        *_pdo_steps(0x1400, 0x1600, cia301.RPDO1_ID + bus.node_id, 1, torque),
        *_pdo_steps(0x1401, 0x1601, cia301.RPDO2_ID + bus.node_id, 255, controlword),
        *_pdo_steps(0x1402, 0x1602, cia301.RPDO3_ID + bus.node_id, 1, controlword),
        *_pdo_steps(0x1800, 0x1A00, cia301.TPDO1_ID + node, 1, feedback),
        _write(cia301.MODE, 0, cia301.TORQUE_MODE),
        _write(cia301.TORQUE_RATED, 0, unit),
        _write(cia301.TORQUE_MAX, 0, limit),
        _write(0x1006, 0, period_ns // 1000),
    ]


class Cia402Host:
    """HostProtocol of cia402. Starts by resetting communication on the whole bus; the nodes' states are in `nodes`."""

    name = "cia402"
    sequence_modulus = 0
    checksum = False
    fd = False
    echo_id: int | None = cia301.SYNC_ID

    def __init__(self, bus: BusConfig, n_axes: int, rated_force: Sequence[float], period_ns: int = 1_000_000) -> None:
        if not 1 <= n_axes <= MAX_AXES:
            raise LayoutError(f"{n_axes} axes: a shared RPDO carries 1 to {MAX_AXES}")
        if len(rated_force) != n_axes or not all(0 < force < 1e5 for force in rated_force):
            raise LayoutError(f"rated forces {list(rated_force)}: one per axis, above 0 and below 1e5, is needed")
        self.n_axes = n_axes
        self._bus = bus
        self._rated = list(rated_force)
        units = [rated_torque(force) for force in rated_force]
        self._gains = [1e6 / unit for unit, _ in units]
        self._limits = [limit for _, limit in units]
        self._rpdo = Struct("<" + _code(cia301.TORQUE) * n_axes)
        self._tpdo = Struct("<" + "".join(map(_code, TPDO_OBJECTS)))
        self.nodes = [
            NodeMaster(bus.node_id + axis, configuration(bus, axis, n_axes, force, period_ns))
            for axis, force in enumerate(rated_force)
        ]
        self.master = Master(self.nodes, cia301.RPDO2_ID + bus.node_id, cia301.RPDO3_ID + bus.node_id)
        self._tick = 0
        self._rpdo_id = cia301.RPDO1_ID + bus.node_id
        self._syncs = [Frame(cia301.SYNC_ID, bytes((count,))) for count in range(1, cia301.SYNC_COUNTER_MAX + 1)]
        self._clock = SamplingClock(n_axes, bus.bitrate, bus.data_bitrate, period_ns)
        self._statuses: dict[int, tuple[DriveState, int] | None] = {}
        self._axis = {cia301.TPDO1_ID + node.node_id: axis for axis, node in enumerate(self.nodes)}
        self._services = self._find_services()
        self._own = {cia301.NMT_ID, cia301.SYNC_ID, self._rpdo_id}
        self._own |= {cia301.RPDO2_ID + bus.node_id, cia301.RPDO3_ID + bus.node_id}
        self._own |= {cia301.SDO_REQUEST_ID + node.node_id for node in self.nodes}
        self._own.add(cia301.HEARTBEAT_ID + MASTER_ID)

    def _find_services(self) -> dict[int, tuple[int, NodeMaster]]:
        """Identifiers of what nodes send besides TPDOs: length and sender."""
        return {
            code + node.node_id: (length, node)
            for node in self.nodes
            for code, length in ((cia301.HEARTBEAT_ID, 1), (cia301.SDO_RESPONSE_ID, 8), (EMCY_ID, 8))
        }

    def decode(self, frame: Frame) -> Sample | Reject:
        """Sample of a TPDO; its stamp is an estimate (sampling_clock.py), its sequence -1."""
        can_id, data, flags, stamp_ns = frame
        axis = self._axis.get(can_id)
        if axis is None:
            if flags & ECHO:
                self._clock.triggered(stamp_ns)
                return Reject.OWN_ECHO
            return self._decode_service(can_id, data, flags)
        if flags & FD:
            return Reject.WRONG_FORMAT
        if len(data) != self._tpdo.size:
            return Reject.WRONG_LENGTH
        position, word = self._tpdo.unpack(data)
        try:
            known = self._statuses[word & _SIGNIFICANT]
        except KeyError:
            known = self._statuses[word & _SIGNIFICANT] = _interpret(word)
        if known is None:
            return Reject.INVALID_VALUE
        state, status = known
        node = self.nodes[axis]
        if state is not node.state:
            self.master.stir()
        node.on_state(state)
        return Sample(axis, position, status | node.alarms, -1, self._clock.instant(axis, frame))

    def _decode_service(self, can_id: int, data: bytes, flags: int) -> Reject:
        service = self._services.get(can_id)
        if service is None:
            return Reject.OWN_ECHO if can_id in self._own else reject_id(can_id, self._axis, -1)
        length, node = service
        if flags & FD:
            return Reject.WRONG_FORMAT
        if len(data) != length:
            return Reject.WRONG_LENGTH
        self.master.stir()
        kind = can_id - node.node_id
        if kind == cia301.SDO_RESPONSE_ID:
            return Reject.SERVICE if node.on_sdo(data) else Reject.INVALID_VALUE
        if kind == EMCY_ID:
            node.on_emergency(data[0] | data[1] << 8)
        else:
            node.on_heartbeat(data[0] & 0x7F)
        return Reject.SERVICE

    def encode(self, command: Command) -> list[Frame]:
        """RPDO, SYNC, [service frame]. Raises ValueError for a force not finite or beyond its rated force."""
        _, force, enable, reset = command
        check_force(force, self._rated)
        self._tick += 1
        self._clock.trigger()
        raw = []
        for axis, gain in enumerate(self._gains):
            value = round(force[axis] * gain) if enable >> axis & 1 else 0
            limit = self._limits[axis]
            raw.append(value if -limit <= value <= limit else max(-limit, min(limit, value)))
        cyclic = [Frame(self._rpdo_id, self._rpdo.pack(*raw)), self._syncs[self._tick % cia301.SYNC_COUNTER_MAX]]
        service = self.master.service(self._tick, enable, reset)
        return cyclic if service is None else [*cyclic, service]

    @property
    def problems(self) -> list[str]:
        """Why nodes were refused, for people."""
        return [node.problem for node in self.nodes if node.problem]

    def messages(self, period_ns: int) -> list[Message]:
        """The cyclic frames and the service traffic."""
        return cia402_messages(self._bus.node_id, self.n_axes, period_ns)


def _interpret(word: int) -> tuple[DriveState, int] | None:
    """Drive state and DriveStatus bits of a statusword; None where it is none of CiA 402's."""
    state = cia301.drive_state(word)
    if state is None:
        return None
    status = 0
    if state is DriveState.OPERATION_ENABLED:
        status |= DriveStatus.ENABLED
    if state in (DriveState.FAULT, DriveState.FAULT_REACTION):
        status |= DriveStatus.FAULT
    status |= DriveStatus.TORQUE_LIMITED if word & cia301.LIMIT_ACTIVE else 0
    status |= DriveStatus.HOMED if word & cia301.HOMED else 0
    status |= DriveStatus.BRAKE if word & cia301.BRAKE else 0
    return state, int(status)


def cia402_messages(node_id: int, n_axes: int, period_ns: int) -> list[Message]:
    """Traffic of the shared-RPDO layout for the schedulability analysis."""
    return [
        Message("torques", cia301.RPDO1_ID + node_id, 2 * n_axes, False, period_ns, period_ns, 0, "host"),
        Message("sync", cia301.SYNC_ID, 1, False, period_ns, period_ns, 0, "host"),
        *(
            Message(
                f"feedback {a}", cia301.TPDO1_ID + node_id + a, 6, False, period_ns, period_ns, 0, f"axis {a}", "sync"
            )
            for a in range(n_axes)
        ),
        *service_messages(node_id, n_axes, period_ns),
    ]


def service_messages(node_id: int, n_axes: int, period_ns: int) -> list[Message]:
    """What the master may send at most (an SDO request, or in its place a controlword or heartbeat) and its answer; the
    drives' heartbeats, and emergencies at the rate of heartbeats."""
    last = node_id + n_axes - 1
    service_ns = SERVICE_TICKS * period_ns
    slow = DRIVE_HEARTBEAT_MS * 1_000_000
    nodes = [(axis, node_id + axis) for axis in range(n_axes)]
    return [
        Message("service", cia301.SDO_REQUEST_ID + last, 8, False, service_ns, service_ns, 0, "host"),
        Message(
            "answer", cia301.SDO_RESPONSE_ID + last, 8, False, service_ns, slow, 0, f"axis {n_axes - 1}", "service"
        ),
        *(Message(f"emergency {a}", EMCY_ID + node, 8, False, slow, slow, 0, f"axis {a}") for a, node in nodes),
        *(
            Message(f"heartbeat {a}", cia301.HEARTBEAT_ID + node, 1, False, slow, slow, 0, f"axis {a}")
            for a, node in nodes
        ),
    ]
