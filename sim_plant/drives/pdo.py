"""A node's PDOs: communication and mapping parameters in the dictionary, turned into structs when they are written."""

from collections.abc import Callable
from struct import Struct

from drivers.eds.data_types import DATA_TYPES, DataType, Kind
from drivers.families.cia402.cia301 import PDO_INVALID, STANDARD_IDS, Abort, is_restricted
from drivers.frame import EXTENDED_MASK
from sim_plant.drives.object_dictionary import LAST_DUMMY, ObjectDictionary, SdoAbort, key_of

COB_ID, TRANSMISSION_TYPE = 1, 2
FIRST_TPDO = 0x1800  # below: RPDOs
MAX_BYTES = 8
MOST_PDOS = 8  # of a kind, that a drive is looked through for
EVENT_DRIVEN = (254, 255)  # transmission types of what is sent, or acted upon, at once
_LAST_SYNCHRONOUS = 240
_EXTENDED_ID = 1 << 29
_CODES = {1: "bB", 2: "hH", 4: "iI", 8: "qQ"}  # struct codes of whole numbers, with a sign and without


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
        mapped = [self._mapped(self._dictionary.number(key_of(self._mapping, at))) for at in range(1, count + 1)]
        layout = Struct("<" + "".join(_code(data_type) for _, data_type in mapped))
        if layout.size > MAX_BYTES:
            raise SdoAbort(Abort.PDO_LENGTH)
        self.layout, self.keys = layout, tuple(key for key, _ in mapped)
        self._odd = {at: kind for at, (_, kind) in enumerate(mapped) if _code(kind)[-1] == "s"}  # 24 to 56 bits

    def pack(self) -> bytes:
        """The mapped objects as they are now."""
        values = [self._dictionary.get(key) for key in self.keys]
        for at, data_type in self._odd.items():
            values[at] = data_type.pack(values[at])
        return self.layout.pack(*values)

    def unpack(self, data: bytes) -> list[int | float]:
        """Values of received bytes, which are at least as many as the layout's."""
        values = list(self.layout.unpack_from(data))
        for at, data_type in self._odd.items():
            values[at] = data_type.unpack(values[at])
        return values

    def _mapped(self, value: int) -> tuple[int, DataType]:
        """Dictionary key and type of a mapping entry."""
        index, subindex, bits = value >> 16, value >> 8 & 0xFF, value & 0xFF
        if index <= LAST_DUMMY:
            if index not in self._dictionary.dummies or not self._receives:
                raise SdoAbort(Abort.NOT_MAPPABLE)
            key, data_type = -1, DATA_TYPES[index]
        else:
            entry = self._dictionary.entry(index, subindex)
            allowed = entry.writable if self._receives else entry.readable
            if not (entry.mappable and allowed and entry.size):
                raise SdoAbort(Abort.NOT_MAPPABLE)
            key, data_type = key_of(index, subindex), entry.type
        if data_type.size * 8 != bits:
            raise SdoAbort(Abort.NOT_MAPPABLE)
        return key, data_type

    def _set_can_id(self, value: int) -> None:
        """CiA 301, 7.5.2.35: no identifier of others, none of 29 bits, and none but the present one while valid."""
        can_id = value & STANDARD_IDS
        valid = not value & PDO_INVALID
        if value & _EXTENDED_ID or (valid and is_restricted(can_id)):
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


def _code(data_type: DataType) -> str:
    """Struct code of a number; its bytes where struct has none of that width."""
    if data_type.kind is Kind.REAL:
        return "f" if data_type.bits == 32 else "d"
    codes = _CODES.get(data_type.size)
    return codes[not data_type.signed] if codes else f"{data_type.size}s"
