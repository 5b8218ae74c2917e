"""CANopen's services in words, for people."""

from collections.abc import Callable
from pathlib import Path

from drivers.config import BusConfig
from drivers.families.cia402 import cia301
from drivers.families.cia402.emergency import emergency_words
from drivers.families.cia402.sdo import request_words, response_words
from drivers.frame import ERROR, EXTENDED, FD, REMOTE, Frame

_COMMANDS = {command.value: command.name.lower().replace("_", " ") for command in cia301.NmtCommand}
_STATES = {state.value: state.name.lower().replace("_", "-") for state in cia301.NmtState}


def reader(bus: BusConfig, base_dir: Path, cyclic: Callable[[Frame], str]) -> Callable[[Frame], str]:
    """Words for services, before those for process data: what is heard is not for this master, which asked for
    nothing.
    """
    return lambda frame: service_text(frame) or cyclic(frame)


def service_text(frame: Frame) -> str:
    """CANopen's own traffic (CiA 301): NMT, SYNC, emergencies, heartbeats, SDO. Empty for process data."""
    can_id, data = frame.can_id, frame.data
    if frame.flags & FD or can_id & (EXTENDED | REMOTE | ERROR):
        return ""
    node, kind = can_id & 0x7F, can_id & 0x780
    if can_id == cia301.NMT_ID and len(data) == 2:
        return f"NMT {_COMMANDS.get(data[0], f'command {data[0]:#x}')}, {f'node {data[1]}' if data[1] else 'all nodes'}"
    if can_id == cia301.SYNC_ID:
        return "SYNC" + (f" {data[0]}" if len(data) == 1 else "")
    if kind == cia301.HEARTBEAT_ID and node and len(data) == 1:
        return f"node {node}: {_STATES.get(data[0] & 0x7F, f'state {data[0]:#x}')}"
    if len(data) != 8 or not node:
        return ""
    if kind in (cia301.EMCY_ID, 0x680):
        return f"node {node}: {emergency_words(data)}"
    if kind == cia301.SDO_REQUEST_ID:
        return f"to node {node}: {request_words(data)}"
    return f"node {node}: {response_words(data)}" if kind == cia301.SDO_RESPONSE_ID else ""
