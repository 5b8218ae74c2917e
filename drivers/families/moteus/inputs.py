"""Digital inputs of moteus controllers: registers 05Eh and 05Fh, a bit a pin, bit 0 of pin 1."""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from drivers.families.moteus.config import MoteusInput
from drivers.families.moteus.registers import Register, Type, Value, read
from drivers.protocols.base import DriveStatus, LayoutError

REPLY_BYTES: Final = 3  # of one register in an answer
_OF_AUX: Final = {1: Register.AUX1_GPIO_STATUS, 2: Register.AUX2_GPIO_STATUS}


class Pin(NamedTuple):
    """A switch: register and bit that tell it, the level with which it is closed, and its DriveStatus bit."""

    register: int
    bit: int
    closed: int
    status: int


class Pins:
    """The switches of one axis. tells: their DriveStatus bits. query: the subframes that ask for them. answer_length:
    bytes of the reply.
    """

    def __init__(self, entries: Sequence[MoteusInput]) -> None:
        self._pins = [
            Pin(int(_OF_AUX[entry.aux]), 1 << (entry.pin - 1), entry.closed, int(DriveStatus[entry.input.upper()]))
            for entry in entries
        ]
        registers = sorted({pin.register for pin in self._pins})
        self.tells = sum(pin.status for pin in self._pins)
        self.query = b"".join(read(register, Type.INT8) for register in registers)
        self.answer_length = REPLY_BYTES * len(registers)

    def status(self, told: Mapping[int, Value]) -> int:
        """DriveStatus bits of an answer; -1 where a register that was asked for is not in it."""
        status = 0
        for register, bit, closed, meant in self._pins:
            if register not in told:
                return -1
            if bool(int(told[register].raw) & bit) == bool(closed):
                status |= meant
        return status

    def parts(self, status: int) -> tuple[tuple[int, Type, float], ...]:
        """Registers with their values, as a drive with that DriveStatus answers."""
        values = dict.fromkeys((pin.register for pin in self._pins), 0)
        for register, bit, closed, meant in self._pins:
            values[register] |= bit if bool(status & meant) == bool(closed) else 0
        return tuple((register, Type.INT8, raw) for register, raw in sorted(values.items()))


def pins_of(entries: Sequence[MoteusInput], n_axes: int) -> list[Pins]:
    """By axis. Raises LayoutError for an axis that is not there, and for an input that is bound twice."""
    seen: set[tuple[int, str]] = set()
    for at, entry in enumerate(entries):
        if entry.axis >= n_axes:
            raise LayoutError(f"bus.moteus.inputs[{at}].axis = {entry.axis}: 0 to {n_axes - 1} are there")
        if (entry.axis, entry.input) in seen:
            raise LayoutError(f"bus.moteus.inputs[{at}]: {entry.input} of axis {entry.axis} is bound twice")
        seen.add((entry.axis, entry.input))
    return [Pins([entry for entry in entries if entry.axis == axis]) for axis in range(n_axes)]
