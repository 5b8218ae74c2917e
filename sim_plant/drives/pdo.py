"""A node's PDOs: communication and mapping parameters in the dictionary, turned into structs when they are written."""

from collections.abc import Callable
from struct import Struct

from drivers.frame import EXTENDED_MASK
from drivers.protocols.canopen.cia301 import BASIC_TYPES, PDO_INVALID, STANDARD_IDS, Abort
from sim_plant.drives.object_dictionary import LAST_DUMMY, ObjectDictionary, SdoAbort, key_of

COB_ID, TRANSMISSION_TYPE = 1, 2
FIRST_TPDO = 0x1800  # below: RPDOs
MAX_BYTES = 8
MOST_PDOS = 8  # of a kind, that a drive is looked through for
EVENT_DRIVEN = (254, 255)  # transmission types of what is sent, or acted upon, at once
_LAST_SYNCHRONOUS = 240
_EXTENDED_ID = 1 << 29
# Identifiers that no PDO may have (CiA 301, 7.3.5): NMT, reserved, SDO, heartbeats.
_RESTRICTED = ((0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF))


class Pdo:
    """One PDO.

    can_id: identifier, or -1 while invalid. layout: struct of the mapped objects. keys: dictionary key per value, or -1
    for a dummy entry. synchronous: sent, or acted upon, at SYNC. event_driven: a TPDO that is sent when its drive's
    state changes.
    """

    def __init__(
        self, dictionary: ObjectDictionary, communication: int, mapping: int, changed: Callable[[], None]
    ) -> None:
        self._dictionary = dictionary
        self._communication = communication
        self._mapping = mapping
        self._changed = changed
        self._receives = communication < FIRST_TPDO
        dictionary.setters[key_of(communication, COB_ID)] = self._set_can_id
        dictionary.setters[key_of(communication, TRANSMISSION_TYPE)] = self._set_type
        dictionary.setters[key_of(mapping, 0)] = self._set_count
        for subindex in range(1, 9):
            dictionary.setters[key_of(mapping, subindex)] = self._set_entry
        self.restore()

    def restore(self) -> None:
        """Take over what the dictionary holds, after it went back to its defaults; a default mapping that cannot be is
        none."""
        number = self._dictionary.number
        self._use_type(number(key_of(self._communication, TRANSMISSION_TYPE), EVENT_DRIVEN[-1]))
        try:
            self._use_mapping(number(key_of(self._mapping, 0)))
        except SdoAbort:
            self._use_mapping(0)
        self._use_can_id(number(key_of(self._communication, COB_ID), PDO_INVALID))

    def _use_can_id(self, value: int) -> None:
        self.can_id = -1 if value & PDO_INVALID else value & EXTENDED_MASK

    def _use_type(self, value: int) -> None:
        self.period = value  # 1 to 240: every so many SYNCs
        self.synchronous = value <= _LAST_SYNCHRONOUS
        self.event_driven = value in EVENT_DRIVEN and not self._receives

    def _use_mapping(self, count: int) -> None:
        layout, keys = "<", []
        for subindex in range(1, count + 1):
            key, code = self._mapped(self._dictionary.number(key_of(self._mapping, subindex)))
            layout += code
            keys.append(key)
        if Struct(layout).size > MAX_BYTES:
            raise SdoAbort(Abort.PDO_LENGTH)
        self.layout, self.keys = Struct(layout), tuple(keys)

    def _mapped(self, value: int) -> tuple[int, str]:
        """Dictionary key and struct code of a mapping entry."""
        index, subindex, bits = value >> 16, value >> 8 & 0xFF, value & 0xFF
        if index <= LAST_DUMMY:
            if index not in self._dictionary.dummies or not self._receives:
                raise SdoAbort(Abort.NOT_MAPPABLE)
            key, code = -1, BASIC_TYPES[index]
        else:
            entry = self._dictionary.entry(index, subindex)
            allowed = entry.writable if self._receives else entry.readable
            if not (entry.mappable and allowed) or entry.layout is None:
                raise SdoAbort(Abort.NOT_MAPPABLE)
            key, code = key_of(index, subindex), entry.layout.format[1:]
        if Struct("<" + code).size * 8 != bits:
            raise SdoAbort(Abort.NOT_MAPPABLE)
        return key, code

    def _set_can_id(self, value: int) -> None:
        """CiA 301, 7.5.2.35: no identifier of others, none of 29 bits, and none but the present one while valid."""
        can_id = value & STANDARD_IDS
        valid = not value & PDO_INVALID
        if value & _EXTENDED_ID or (valid and any(low <= can_id <= high for low, high in _RESTRICTED)):
            raise SdoAbort(Abort.VALUE_RANGE)
        if valid and self.can_id >= 0 and can_id != self.can_id:
            raise SdoAbort(Abort.DEVICE_STATE)
        self._use_can_id(value)
        self._changed()

    def _set_type(self, value: int) -> None:
        """Acyclic TPDOs and TPDOs on request are not supported."""
        first = 0 if self._receives else 1
        if not first <= value <= _LAST_SYNCHRONOUS and value not in EVENT_DRIVEN:
            raise SdoAbort(Abort.VALUE_RANGE)
        self._use_type(value)
        self._changed()

    def _set_count(self, value: int) -> None:
        if self.can_id >= 0:
            raise SdoAbort(Abort.DEVICE_STATE)
        self._use_mapping(value)

    def _set_entry(self, value: int) -> None:
        if self.can_id >= 0 or self._dictionary.number(key_of(self._mapping, 0)):
            raise SdoAbort(Abort.DEVICE_STATE)
        if value:
            self._mapped(value)
