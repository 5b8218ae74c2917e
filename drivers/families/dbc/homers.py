"""Which drives of a dbc: layout can be told to home by themselves: ODrives, whose endpoints are known by a file."""

from pathlib import Path
from typing import Any, Final

from drivers.config import Wiring
from drivers.families.dbc.config import dbc_keys
from drivers.families.dbc.endpoints import Endpoint, known_endpoints
from drivers.families.dbc.layout import ENABLED
from drivers.families.dbc.odrive_homing import HEARTBEAT, HOMING, READ, WRITTEN, OdriveHoming
from drivers.families.dbc.odrive_words import CLOSED_LOOP, IDLE
from drivers.families.dbc.page import BoundMessage
from drivers.families.dbc.traffic import DbcTraffic
from drivers.frame import Frame

SET_AXIS_STATE, SET_CONTROLLER_MODE = 0x07, 0x0B
MODE_LENGTH: Final = 8  # bytes
_STATES: Final = (CLOSED_LOOP, IDLE)


class DbcHomers(DbcTraffic):
    """drive_homers: what lets each axis' drive home by itself, or why it cannot."""

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        binding = dbc_keys(wiring.bus).dbc
        file = wiring.base_dir / binding.endpoints if binding is not None and binding.endpoints else None
        self.drive_homers = [self._homer_of(axis, file, wiring.period_ns) for axis in range(self.n_axes)]
        self._homers = [homer if isinstance(homer, OdriveHoming) else None for homer in self.drive_homers]
        self._odrives = [homer for homer in self._homers if homer is not None]
        self._homing = {can_id: homer for homer in self._odrives for can_id in homer.heard_ids}
        for homer in self._odrives:
            meanings = self._maps[homer.axis]
            if meanings is not None:
                self._maps[homer.axis] = {HOMING: ENABLED} | meanings  # it has power

    def _homer_of(self, axis: int, file: Path | None, period_ns: int) -> OdriveHoming | str:
        """file: flat_endpoints.json. Raises LayoutError for one that cannot be read."""
        if file is None:
            return (
                "bus.dbc.endpoints is not stated: of the drives that a DBC file describes, ODrives alone can be told "
                "to home, by the numbers in their flat_endpoints.json"
            )
        node = self._torque[axis].message.can_id & ~0x1F
        if problem := self._unlike_odrive(axis, node):
            return problem
        pages = [bound.message for bound, _ in self._constant if bound.message.can_id == node | SET_CONTROLLER_MODE]
        if not pages or pages[0].length != MODE_LENGTH:
            return f"bus.dbc.constant has no Set_Controller_Mode (identifier node * 32 + 11) for axis {axis}"
        endpoints = _endpoints(file)
        if isinstance(endpoints, str):
            return endpoints
        places = self._position[axis].place, self._torque[axis].place
        return OdriveHoming(axis, self._with_constants(pages[0]), places, endpoints, period_ns, self.state_ns)

    def _unlike_odrive(self, axis: int, node: int) -> str:
        """What of a binding is not the maker's, or lacks; empty where nothing is. node: its first identifier."""
        own = len(self._enable) == self.n_axes
        if not own or self._enable[axis].message.can_id != node | SET_AXIS_STATE or self._switch[axis] != _STATES:
            return f"bus.dbc.enable[{axis}] is no Set_Axis_State (identifier node * 32 + 7) with on = 8 and off = 1"
        if not self._status or self._status[axis].message.can_id != node | HEARTBEAT:
            return f"bus.dbc.status[{axis}] is not in the Heartbeat (identifier node * 32 + 1)"
        if axis not in [asked.axis for asked in self._read_back]:
            return f"bus.dbc.read_back has no entry with axis = {axis}: its watchdog is to be known before READY"
        return ""

    def _with_constants(self, page: BoundMessage) -> Frame:
        """The frame of a page with nothing in it but what never changes."""
        values: list[Any] = page.blank()
        for (message, place), raw in self._constant:
            if message is page:
                values[place.at] = raw
        return page.frame(values)

    def _hear_homing(self, frame: Frame) -> None:
        homer = self._homing.get(frame.can_id)
        if homer is not None:
            homer.hear(frame)


def _endpoints(file: Path) -> dict[str, Endpoint] | str:
    """What a homing reads and writes, by path; or what the firmware has not."""
    found: dict[str, Endpoint] = {}
    for path, endpoint in known_endpoints(file, (*WRITTEN, *READ)).items():
        if endpoint is None or endpoint.bits > 32 or (path in WRITTEN and endpoint.form != "float"):
            return f"{file.name} has no {path!r} with a number and a type of at most four bytes"
        found[path] = endpoint
    return found
