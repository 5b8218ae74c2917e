"""Emergency messages of a CANopen node (CiA 301, 7.2.7): history in 1003h, inhibit time of 1015h."""

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import PDO_INVALID, STANDARD_IDS, Emergency
from drivers.frame import Frame
from sim_plant.drives.object_dictionary import ObjectDictionary, key_of

_HISTORY = 4  # entries of 1003h
_MOST_WAITING = 32  # in the inhibit time
_INHIBIT_UNIT_NS = 100_000  # of 1015h
_COUNT, _COB_ID, _INHIBIT = key_of(0x1003), key_of(0x1014), key_of(0x1015)


class EmergencyProducer:
    """Frames of one node. Within the inhibit time of the last one they wait, in order."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._waiting: list[bytes] = []
        self._free_ns = 0  # the inhibit time of the last one is over

    def reset(self) -> None:
        """Forget what waits, as at a reset of communication."""
        self._waiting.clear()
        self._free_ns = 0

    def raise_error(self, code: Emergency, register: int) -> None:
        """An error has come, or all are gone (Emergency.NONE)."""
        if code is not Emergency.NONE:
            self._remember(int(code))
        if len(self._waiting) < _MOST_WAITING:
            self._waiting.append(cia301.EMCY.pack(code, register, bytes(5)))

    def due(self, now_ns: int) -> list[Frame]:
        """What may be sent now."""
        cob_id = self._dictionary.number(_COB_ID, PDO_INVALID)
        if cob_id & PDO_INVALID:
            self._waiting.clear()
            return []
        frames = []
        inhibit_ns = self._dictionary.number(_INHIBIT) * _INHIBIT_UNIT_NS
        while self._waiting and now_ns >= self._free_ns:
            frames.append(Frame(cob_id & STANDARD_IDS, self._waiting.pop(0)))
            self._free_ns = now_ns + inhibit_ns
        return frames

    def forget_history(self) -> None:
        """1003h:00 was written with zero."""
        for subindex in range(1, _HISTORY + 1):
            self._store(subindex, 0)

    def _remember(self, code: int) -> None:
        for subindex in range(_HISTORY, 1, -1):
            self._store(subindex, self._dictionary.number(key_of(0x1003, subindex - 1)))
        self._store(1, code)
        self._store(0, min(self._dictionary.number(_COUNT) + 1, _HISTORY))

    def _store(self, subindex: int, value: int) -> None:
        self._dictionary.set(key_of(0x1003, subindex), value)
