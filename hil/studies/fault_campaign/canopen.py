"""What can go wrong with drives that are CANopen nodes (cia402) and with no others: their services, their states."""

from dataclasses import replace

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import Abort, Emergency, NmtCommand, NmtState
from drivers.families.cia402.config import cia402_keys
from drivers.families.cia402.host import Cia402Host
from drivers.families.cia402.master import HEARTBEAT_TICKS, REPEAT_TICKS
from drivers.families.cia402.node import Phase
from drivers.families.cia402.profile import DRIVE_HEARTBEAT_MS, EMCY_ID, MASTER_ID
from drivers.frame import Frame
from drivers.wire.faults import FaultKind, WireFault
from hil.cycle.fault_table import Fault, Reaction
from hil.cycle.tick import CommandKind
from hil.rig.schema import RigConfig
from hil.studies.fault_campaign.layout_capabilities import Capability
from hil.studies.fault_campaign.trial import (
    ALWAYS,
    GONE,
    MOVING,
    WATCHING,
    Step,
    Trial,
    axis_name,
    disable_timeout,
    host_frames,
    once,
    periods,
    watchdog,
)
from hil.virtual.lockstep import LockstepRun

_DROP = FaultKind.DROP
_DISABLING = cia301.RPDO2_ID  # controlwords that act at once; those that enable wait for SYNC
_NO_CODE = 0x4210  # excess temperature of the device: CiA 301 has it, and no drive has to stop for it


def _node_id(run: LockstepRun, axis: int) -> int:
    return cia402_keys(run.rig.bus).node_id + axis


def _hosts(run: LockstepRun) -> list[Cia402Host]:
    """The master of every segment."""
    found = getattr(run.cycle.protocol, "segments", [run.cycle.protocol])
    assert all(isinstance(host, Cia402Host) for host in found)
    return list(found)


def _configuring(run: LockstepRun, axis: int) -> bool:
    nodes = [node for host in _hosts(run) for node in host.nodes]
    return nodes[axis].phase is Phase.CONFIGURE


def _network(command: NmtCommand) -> Step:
    """Another master on the bus sends the node an NMT command."""

    def act(run: LockstepRun, axis: int) -> None:
        data = bytes((command, _node_id(run, axis)))
        run.wire_of(axis).attach("another master", None).send(Frame(cia301.NMT_ID, data), run.wire.now_ns)

    return once(act)


def _says(code: int, payload: bytes) -> Step:
    """The node sends one frame more: identifier of its kind, payload."""

    def act(run: LockstepRun, axis: int) -> None:
        run.wire.nodes[axis_name(run, axis)].send(Frame(code + _node_id(run, axis), payload), run.wire.now_ns)

    return once(act)


def _emergency(code: int) -> Step:
    return _says(EMCY_ID, cia301.EMCY.pack(code, 1, bytes(5)))


def _lost(code: int, count: int = 0) -> Step:
    """Frames of that kind, with the node's number in their identifier, are lost: the next `count`, or all (0). Those of
    the host that are for all nodes have the first one's.
    """

    def act(run: LockstepRun, axis: int) -> None:
        can_id = code + _node_id(run, axis)
        run.wire.inject(WireFault(_DROP, from_ns=run.wire.now_ns, can_id=can_id, count=count))

    return once(act)


def _abort(run: LockstepRun, axis: int) -> None:
    """The node refuses what the master asks next."""
    can_id, armed = cia301.SDO_RESPONSE_ID + _node_id(run, axis), [True]

    def tap(sender: int, frame: Frame) -> tuple[Frame]:
        if frame.can_id == can_id and armed:
            armed.clear()
            _, index, subindex, _ = cia301.SDO.unpack(frame.data)
            refusal = cia301.SDO.pack(0x80, index, subindex, Abort.NO_OBJECT.to_bytes(4, "little"))
            return (frame._replace(data=refusal),)
        return (frame,)

    run.stage.frame_taps.append(tap)


def _terminate_busy(run: LockstepRun, axis: int, k: int) -> None:
    """SIGTERM to a master with something to say in each of its turns; the axis moves those from even to odd ticks."""
    if k >= axis:
        for host in _hosts(run):
            host.master.heartbeat_tick = 0
    run.stop = True


def _torque_watchdog(rig: RigConfig) -> int:
    """The drives' watchdog, an answer, and a tick to read it."""
    return watchdog(rig) + 2


def _master_heartbeat(rig: RigConfig) -> int:
    """What the drives wait for the master's heartbeat, an answer, and a tick to read it."""
    return max(periods(DRIVE_HEARTBEAT_MS * 1e-3, rig), 5 * HEARTBEAT_TICKS) + 3


_ASTRAY = (Fault.SPEED, Fault.FOLLOWING_ERROR, Fault.TRAVEL_PLANNED)  # an axis that keeps its torque, or has none
_DRIVE = (Fault.DRIVE_FAULT, Fault.DRIVE_WATCHDOG)

_TRIALS = (
    Trial("SYNC lost, 1 tick", host_frames(_DROP, can_id=cia301.SYNC_ID, count=1), per_axis=False, benign=True),
    Trial("SYNC lost, 2 ticks", host_frames(_DROP, can_id=cia301.SYNC_ID, count=2), per_axis=False, benign=True),
    Trial("SYNC lost", host_frames(_DROP, can_id=cia301.SYNC_ID), GONE, within=11, per_axis=False, armed=WATCHING),
    Trial(
        "torques lost, SYNC heard",
        _lost(cia301.RPDO1_ID),
        (*_DRIVE, *_ASTRAY),
        within=_torque_watchdog,
        per_axis=False,
        armed=WATCHING,
    ),
    Trial(
        "disabling controlwords lost once",
        _lost(_DISABLING, 1),
        per_axis=False,
        command=CommandKind.STOP,
        slack=REPEAT_TICKS,
    ),
    Trial(
        "disabling controlwords lost twice",
        _lost(_DISABLING, 2),
        per_axis=False,
        command=CommandKind.STOP,
        slack=2 * REPEAT_TICKS,
    ),
    Trial(
        "disabling controlwords lost for good",
        _lost(_DISABLING),
        (Fault.DRIVE_STAYS_ENABLED, Fault.ENCODER_JUMP),  # an axis with weight on it falls
        per_axis=False,
        certain=False,
        command=CommandKind.STOP,
        slack=lambda rig: disable_timeout(rig) + watchdog(rig),
    ),
    Trial("termination signal to a busy master", _terminate_busy),
    Trial("node reset by another master", _network(NmtCommand.RESET_NODE), (Fault.FOREIGN_COMMAND,), armed=ALWAYS),
    Trial("node stopped by another master", _network(NmtCommand.STOP), (Fault.FOREIGN_COMMAND,), armed=ALWAYS),
    Trial(
        "boot-up message of a node that runs on",
        _says(cia301.HEARTBEAT_ID, bytes((NmtState.BOOT_UP,))),
        (Fault.DRIVE_DISABLED, *_DRIVE, *GONE),
        within=5,
        following_only=True,
        armed=MOVING,
    ),
    Trial("drive's heartbeat lost", _lost(cia301.HEARTBEAT_ID), benign=True),
    Trial(
        "master's heartbeat lost",
        host_frames(_DROP, can_id=cia301.HEARTBEAT_ID + MASTER_ID),
        _DRIVE,
        within=_master_heartbeat,
        per_axis=False,
        armed=WATCHING,
        demand=Reaction.ZERO,
    ),
    Trial(
        "emergency: encoder",
        _emergency(Emergency.SENSOR),
        (Fault.ENCODER_FAULT,),
        armed=WATCHING,
        demand=Reaction.ZERO,
    ),
    Trial(
        "emergency: no more commands",
        _emergency(Emergency.RPDO_TIMEOUT),
        (Fault.DRIVE_WATCHDOG,),
        armed=WATCHING,
        demand=Reaction.ZERO,
    ),
    Trial("emergency: a warning", _emergency(_NO_CODE), benign=True),
    Trial("SDO abort", once(_abort), benign=True, unready=_configuring),
    Trial("SDO answers lost", _lost(cia301.SDO_RESPONSE_ID), benign=True, unready=_configuring),
)
CANOPEN_TRIALS = tuple(replace(trial, only=Capability.NODES) for trial in _TRIALS)
