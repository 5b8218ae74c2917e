"""CANopen drives in cyclic synchronous torque mode (CiA 301, CiA 402). Contract: cia402.eds.

Theory of operation. Every tick the host sends one RPDO that all nodes share, with four target torques (6071h) of which
each node takes its own and maps the others to dummy objects. SYNC with a counter follows: drives apply, sample, and
answer with position and statusword. Behind them goes at most one service frame, so that it delays no SYNC; master.py
decides which. node.py follows one drive: it configures the drive over SDO, starts it and watches its states.

Rules. Controlwords: two RPDOs carry them. A frame that disables any drive acts at once (RPDO 2), all others at the next
SYNC (RPDO 3), so that an enabled drive has its torque from the first moment. Else a weight would fall until then. Where
a drive hears neither the SYNC that an enabling frame waits for nor the next one, a disabling frame finds nothing to
disable. The drive is then enabled, without torque, until the host has seen it and repeats the command (4 ticks).

Torque: the rated torque (6076h, whole mN m; mN on a linear axis) is set so that the rated force is just within the
32767 thousandths that 6071h can express. A step is then 6076h * 1e-6 N, about 1/32767 of the rated force.

Sampling time: CANopen carries none; sampling_clock.py takes it from the echo of SYNC, or estimates it from the first
TPDO behind SYNC.
"""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from struct import Struct, pack
from typing import Any, Final

from drivers.base.text_file import words_of
from drivers.config import BusConfig, Wiring
from drivers.eds.reader import Eds, EdsError, read_eds
from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import DriveState
from drivers.families.cia402.config import Cia402Config, cia402_keys
from drivers.families.cia402.drive_plan import Axis, DrivePlan
from drivers.families.cia402.homing_mode import HomingMode, homing_mode
from drivers.families.cia402.inputs import LENGTH as INPUTS_LENGTH
from drivers.families.cia402.inputs import TELLS as INPUTS
from drivers.families.cia402.inputs import TPDO2_ID, InputWatch
from drivers.families.cia402.master import HEARTBEAT_TICKS, Master
from drivers.families.cia402.node import RUNNING, NodeMaster
from drivers.families.cia402.profile import DRIVE_HEARTBEAT_MS, MASTER_ID, plan_drives
from drivers.families.cia402.touch_probe import LENGTH as PROBE_LENGTH
from drivers.families.cia402.touch_probe import TPDO3_ID, TouchProbe, touch_probe
from drivers.families.cia402.traffic import cia402_messages
from drivers.frame import ECHO, FD, Frame
from drivers.native import path as native
from drivers.protocols.base import OF_DRIVES, Command, DriveStatus, LayoutError, Message, Reject, Sample
from drivers.protocols.common import INT32, MAX_AXES, check_force, reject_id
from drivers.protocols.sampling_clock import SamplingClock
from drivers.protocols.segments import of_axes

# Where a rig has no [bus.cia402]; how it ends is part of its contract.
OWN_DRIVE = Cia402Config(eds=[str(cia301.EDS)], write_rated_torque=True, stop_options="keep")
_SIGNIFICANT = 0x6F | cia301.LIMIT_ACTIVE  # bits of the statusword that are looked at
_FAULT = int(DriveStatus.FAULT)  # of a drive that sends positions before it is configured and read back
_OURS = cia301.HOMED | cia301.BRAKE  # the project's own drive has these two besides; others use them as they please
_OWN_WORDS: Final = int(DriveStatus.HOMED | DriveStatus.BRAKE)
_USUAL: Final = Struct("<IHH")  # of an axis: identifier of its answers, statusword as it is looked at, status


def _plain_torques(
    forces: Sequence[float], rated: Sequence[float], gains: Sequence[float], limits: Sequence[int], enable: int
) -> bytes | None:
    """6071h of every axis, 16 bits each, of forces in N or N m; None: not one per axis, each within its rated force."""
    if len(forces) != len(rated):
        return None
    raw = []
    for axis, (force, bound, gain, limit) in enumerate(zip(forces, rated, gains, limits, strict=True)):
        if not -bound <= force <= bound:
            return None
        value = round(force * gain) if enable >> axis & 1 else 0
        raw.append(value if -limit <= value <= limit else max(-limit, min(limit, value)))
    return pack(f"<{len(raw)}h", *raw)


_torques: Final[Callable[[Sequence[float], Sequence[float], Sequence[float], Sequence[int], int], bytes | None]] = (
    native.torques if native else _plain_torques
)
_tpdos: Final[Callable[[Sequence[Frame], bytearray, int, int, int], tuple[bytes, int, int]] | None] = (
    native.tpdos if native else None
)


def node_ids(bus: BusConfig, n_axes: int) -> list[int]:
    """Node numbers of the axes. Raises LayoutError where the rig's are not one per axis, each different, up to 126."""
    keys = cia402_keys(bus)
    stated = keys.cia402.nodes if keys.cia402 else []
    nodes = stated or [keys.node_id + axis for axis in range(n_axes)]
    if len(nodes) != n_axes or len(set(nodes)) != n_axes or max(nodes) >= MASTER_ID:
        raise LayoutError(f"bus.cia402.nodes = {nodes}: {n_axes} different numbers from 1 to 126 are needed")
    return nodes


def cut(bus: BusConfig, n_axes: int) -> Callable[[range], dict[str, Any]]:
    """What another segment has otherwise: the nodes on it, and what [bus.cia402] has one of per axis."""
    nodes, cia402 = node_ids(bus, n_axes), cia402_keys(bus).cia402
    if cia402 is None:  # the project's own drive, which is not told its number there
        return lambda axes: {"node_id": nodes[axes[0]]}
    return lambda axes: {
        "cia402": cia402.model_copy(
            update={
                "nodes": of_axes(axes, nodes),
                "eds": of_axes(axes, cia402.eds) if len(cia402.eds) == n_axes else cia402.eds,
                "rated_torque": of_axes(axes, cia402.rated_torque),
            }
        )
    }


def plan_rig(bus: BusConfig, rated_force: Sequence[float], base_dir: Path, period_ns: int) -> list[DrivePlan]:
    """How the drives of a rig are configured, by its EDS files, in axis order. Raises LayoutError where one cannot be
    used, naming the objects that decide it.
    """
    settings = cia402_keys(bus).cia402 or OWN_DRIVE
    nodes = node_ids(bus, len(rated_force))
    for key, values in (("eds", settings.eds), ("rated_torque", settings.rated_torque)):
        allowed = (1, len(nodes)) if key == "eds" else (0, len(nodes))
        if len(values) not in allowed:
            raise LayoutError(f"bus.cia402.{key} has {len(values)} entries for {len(nodes)} axes")
    files = settings.eds * len(nodes) if len(settings.eds) == 1 else settings.eds
    drives = [_read(base_dir / file, node) for file, node in zip(files, nodes, strict=True)]
    master_ms = max(DRIVE_HEARTBEAT_MS, 5 * HEARTBEAT_TICKS * period_ns // 1_000_000)
    axes = [
        Axis(number, len(nodes), node, nodes[0], force, period_ns, master_ms)
        for number, (node, force) in enumerate(zip(nodes, rated_force, strict=True))
    ]
    plans = plan_drives(drives, axes, settings)
    problems = [
        f"bus.cia402: axis {axis} ({plan.name}): {reason.object} {reason.text}"
        for axis, plan in enumerate(plans)
        for reason in plan.reasons
    ]
    for axis, drive in enumerate(drives):
        plans[axis].warnings += drive.bitrate_notes(bus.bitrate)
        if drive.rules_out(bus.bitrate):
            problems.append(f"bus.cia402: axis {axis} ({drive.name}): its EDS rules out {bus.bitrate} bit/s")
    if problems:
        raise LayoutError("; ".join(problems))
    return plans


def _read(path: Path, node: int) -> Eds:
    try:
        return read_eds(path, node)
    except EdsError as error:
        raise LayoutError(f"bus.cia402.eds: {error}") from None
    except OSError as error:
        raise LayoutError(f"bus.cia402.eds: {path}: {words_of(error)}") from None


class Cia402Host:
    """HostProtocol of cia402. Starts by resetting communication on the whole bus; the nodes' states are in `nodes`."""

    name = "cia402"
    sequence_modulus = 0
    checksum = False
    states = True
    causes = False  # a statusword says FAULT; why, an emergency message does
    resets = True
    fd = False
    state_ns = 0

    def __init__(self, wiring: Wiring) -> None:
        bus, n_axes, rated_force, period_ns, base_dir = wiring
        if not 1 <= n_axes <= MAX_AXES:
            raise LayoutError(f"{n_axes} axes: a shared RPDO carries 1 to {MAX_AXES}")
        if len(rated_force) != n_axes or not all(0 < force < 1e5 for force in rated_force):
            raise LayoutError(f"rated forces {list(rated_force)}: one per axis, above 0 and below 1e5, is needed")
        self.n_axes = n_axes
        self.echo_id: int | None = cia301.SYNC_ID
        self.acts_ns: Sequence[int] = ()
        self.stamp_wraps_ns: Sequence[int] = ()
        self.network_ids = (cia301.NMT_ID,)
        self.positions: Sequence[tuple[float, float]] = [INT32] * n_axes  # 6064h
        self._bus = bus
        self._rated = list(rated_force)
        self.plans = plan_rig(bus, rated_force, base_dir, period_ns)
        self.warnings = [
            f"bus.cia402: axis {axis} ({plan.name}): {text}"
            for axis, plan in enumerate(self.plans)
            for text in plan.warnings
        ]
        autostart = (cia402_keys(bus).cia402 or OWN_DRIVE).start == "autostart"
        nodes = node_ids(bus, n_axes)
        self.nodes = [
            NodeMaster(node, plan.steps, autostart=autostart) for node, plan in zip(nodes, self.plans, strict=True)
        ]
        self._shared = self.plans[0].shared
        first = nodes[0]
        word_ids = (cia301.RPDO2_ID + first, cia301.RPDO3_ID + first) if self._shared else None
        self.master = Master(self.nodes, word_ids, reset=not autostart)
        self._gains = [1e6 / plan.unit if plan.unit else 0.0 for plan in self.plans]  # 0: 6076h is not read yet
        self._limits = [plan.limit for plan in self.plans]
        self._tick = 0
        counts = range(1, cia301.SYNC_COUNTER_MAX + 1)
        self._syncs = [Frame(cia301.SYNC_ID, bytes((count,)) if self.plans[0].counter else b"") for count in counts]
        self._rpdo_ids = [cia301.RPDO1_ID + (first if self._shared else node) for node in nodes]
        self._tpdo = Struct("<iHb" if self.plans[0].watched else "<iH")
        inputs = self.plans[0].inputs
        own = _OWN_WORDS if cia402_keys(bus).cia402 is None else 0
        self.tells: int = OF_DRIVES & ~_OWN_WORDS | own | (INPUTS if inputs else 0)
        self._inputs = [InputWatch() for _ in nodes] if inputs else []
        self._input_axis = {TPDO2_ID + node: axis for axis, node in enumerate(nodes)} if inputs else {}
        probes: list[TouchProbe | str] = [
            touch_probe(node, plan) for node, plan in zip(self.nodes, self.plans, strict=True)
        ]
        # The project's own drive counts from its index and says so.
        self.index_finders = probes if cia402_keys(bus).cia402 else []
        gains = [partial(self._gains.__getitem__, axis) for axis in range(n_axes)]
        homers: list[HomingMode | str] = [
            homing_mode(*each) for each in zip(self.nodes, self.plans, gains, strict=True)
        ]
        self.drive_homers = homers if cia402_keys(bus).cia402 else []
        self._homers = [homer if isinstance(homer, HomingMode) else None for homer in homers]
        told = [plan.probe for plan in self.plans]
        self._finders = [probe for probe in probes if isinstance(probe, TouchProbe)]
        self._probes = {
            TPDO3_ID + node: probe
            for node, probe, tells in zip(nodes, probes, told, strict=True)
            if tells and isinstance(probe, TouchProbe)
        }
        self._significant = _SIGNIFICANT if cia402_keys(bus).cia402 else _SIGNIFICANT | _OURS
        self._clock = SamplingClock(n_axes, bus.bitrate, bus.data_bitrate, period_ns)
        self._statuses: dict[int, tuple[DriveState, int] | None] = {}
        self._axis = {cia301.TPDO1_ID + node: axis for axis, node in enumerate(nodes)}
        self._usual = bytearray(_USUAL.size * n_axes)  # by axis, what it last told; it holds while the drive runs
        self._services = self._find_services()
        self._own = {cia301.NMT_ID, cia301.SYNC_ID, *self._rpdo_ids, *(word_ids or ())}
        self._own |= {cia301.SDO_REQUEST_ID + node for node in nodes}
        self._own.add(cia301.HEARTBEAT_ID + MASTER_ID)

    def _find_services(self) -> dict[int, tuple[int, NodeMaster]]:
        """Identifiers of what nodes send besides TPDOs: length and sender."""
        found = {}
        for node, plan in zip(self.nodes, self.plans, strict=True):
            found[cia301.HEARTBEAT_ID + node.node_id] = 1, node
            found[cia301.SDO_RESPONSE_ID + node.node_id] = 8, node
            if plan.emcy_id:
                found[plan.emcy_id] = 8, node
        return found

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
        position, word, *mode = self._tpdo.unpack(data)
        try:
            known = self._statuses[word & self._significant]
        except KeyError:
            known = self._statuses[word & self._significant] = _interpret(word & self._significant)
        if known is None:
            return Reject.INVALID_VALUE
        state, status = known
        node = self.nodes[axis]
        if state is not node.state:
            self.master.stir()
        _USUAL.pack_into(self._usual, _USUAL.size * axis, can_id, word & self._significant, status)
        node.on_state(state)
        if node.away:
            self._hear_homing(axis, word)
        if mode:
            node.on_mode(mode[0])
        if self._tick and node.phase is not RUNNING:  # who only listens configures nobody
            status |= _FAULT
        if self._inputs and self._tick:
            status |= self._inputs[axis].status(self._tick)
        return Sample(axis, position, status | node.alarms, -1, self._clock.instant(axis, frame))

    def answers(self, frames: Sequence[Frame]) -> bytes:
        """As StageFdHost.answers, of SYNC's echo (axis -1) and the answers behind it that tell the states known."""
        if _tpdos is None or self._inputs or self._probes:
            return b""
        for node in self.nodes:
            if node.phase is not RUNNING or node.alarms or node.away:
                return b""
        read, echo_ns, heard = _tpdos(frames, self._usual, self._tpdo.size, self._significant, cia301.SYNC_ID)
        if echo_ns >= 0:
            self._clock.triggered(echo_ns)
        for axis, node in enumerate(self.nodes):
            if heard >> axis & 1:
                node.on_pdo()
        return read

    def _decode_inputs(self, axis: int, data: bytes, flags: int) -> Reject:
        if flags & FD:
            return Reject.WRONG_FORMAT
        if len(data) != INPUTS_LENGTH:
            return Reject.WRONG_LENGTH
        self._inputs[axis].hear(data, self._tick)
        return Reject.SERVICE

    def _hear_homing(self, axis: int, word: int) -> None:
        homer = self._homers[axis]
        self.master.stir()
        if homer is not None:
            homer.hear(word)

    def _decode_probe(self, probe: TouchProbe, data: bytes, flags: int) -> Reject:
        if flags & FD:
            return Reject.WRONG_FORMAT
        if len(data) != PROBE_LENGTH:
            return Reject.WRONG_LENGTH
        probe.hear(data)
        return Reject.SERVICE

    def _decode_service(self, can_id: int, data: bytes, flags: int) -> Reject:
        if can_id in self._input_axis:
            return self._decode_inputs(self._input_axis[can_id], data, flags)
        probe = self._probes.get(can_id)
        if probe is not None:
            return self._decode_probe(probe, data, flags)
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
            if node.on_sdo(data):  # else it answers another client: service traffic like ours
                self._note_unit(self.nodes.index(node))
        elif kind == cia301.HEARTBEAT_ID:
            node.on_heartbeat(data[0] & 0x7F)
        else:
            node.on_emergency(data)
        return Reject.SERVICE

    def _note_unit(self, axis: int) -> None:
        """The unit of 6071h, where it has just been read from the drive."""
        node = self.nodes[axis]
        unit = node.values.pop((cia301.TORQUE_RATED, 0), None)
        if unit is None:
            return
        limit = round(self._rated[axis] * 1e6 / unit) if unit else 0
        if not 0 < limit <= self.plans[axis].most:
            node.refuse(f"6076h:00 = {unit} mN m, with which 6071h cannot say the rated force {self._rated[axis]:g}")
        else:
            self._gains[axis], self._limits[axis] = 1e6 / unit, limit

    def encode(self, command: Command) -> list[Frame]:
        """RPDOs, SYNC, [service frame]. Raises ValueError for a force not finite or beyond its rated force."""
        _, force, enable, reset = command
        raw = _torques(force, self._rated, self._gains, self._limits, enable)
        if raw is None:
            check_force(force, self._rated)  # says which
            raise ValueError(f"{len(force)} forces for {self.n_axes} axes")
        self._tick += 1
        self._clock.trigger()
        service = self.master.service(self._tick, enable, reset)
        if self._shared:
            cyclic = [Frame(self._rpdo_ids[0], raw)]
        else:
            words = self.master.words(self._tick, enable)
            cyclic = [
                Frame(can_id, word.to_bytes(2, "little") + raw[2 * axis : 2 * axis + 2])
                for axis, (can_id, word) in enumerate(zip(self._rpdo_ids, words, strict=True))
            ]
        cyclic.append(self._syncs[self._tick % cia301.SYNC_COUNTER_MAX])
        return cyclic if service is None else [*cyclic, service]

    @property
    def problems(self) -> list[str]:
        """Why nodes were refused, and what their emergency messages say, for people."""
        asked = [*self._homers, *self._finders]
        found = [finder.problem for finder in asked if finder is not None and finder.problem]
        return [*(text for node in self.nodes for text in (node.problem, node.emergency) if text), *found]

    def messages(self, period_ns: int) -> list[Message]:
        """The cyclic frames and the service traffic."""
        return cia402_messages([node.node_id for node in self.nodes], self.plans, period_ns)


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
