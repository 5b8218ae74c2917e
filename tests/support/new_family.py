"""A new family of drives, as a folder that nothing of the product knows: torque in, position out, one frame each."""

from pathlib import Path

FAMILY = '''
"""Drives with one frame each way."""

from pydantic import BaseModel

from drivers.base.keys import STRICT, key
from drivers.families import Family, Sides


class Keys(BaseModel):
    """What this family adds to [bus]."""

    model_config = STRICT
    torquebox_id: int = key(
        0x200, "torquebox: identifier of the first torque", "1", ge=0, le=0x6F0, exclude_if=lambda one: one == 0x200
    )


_SIDES = "drivers.families.torquebox.sides"
FAMILY = Family({"torquebox": Sides(f"{_SIDES}:Host", f"{_SIDES}:Drives")}, Keys)
'''
SIDES = '''
"""Torque: int16, 1/32767 of the rated one, enable and reset. Position: int32 counts, status, number of the command."""

from struct import Struct

from drivers.frame import Frame
from drivers.protocols.base import OF_DRIVES, Command, Message, Reject, Sample
from drivers.protocols.common import INT32, check_force, reject_id
from drivers.protocols.sampling_clock import SamplingClock

_TORQUE, _POSITION = Struct("<hBB"), Struct("<iBB")


class _Ends:
    name, sequence_modulus, fd = "torquebox", 256, False

    def __init__(self, wiring):
        self.n_axes, self._rated = wiring.n_axes, list(wiring.rated_force)
        first = wiring.bus.torquebox_id
        self._torques = {first + axis: axis for axis in range(self.n_axes)}
        self._positions = {first + 0x80 + axis: axis for axis in range(self.n_axes)}


class Host(_Ends):
    checksum, states, causes, resets, acts_ns, state_ns, problems = False, True, True, True, (), 0, ()
    tells, stamp_wraps_ns = OF_DRIVES, ()

    def __init__(self, wiring):
        super().__init__(wiring)
        self.positions = [INT32] * self.n_axes
        self.echo_id = max(self._torques)
        self._clock = SamplingClock(self.n_axes, wiring.bus.bitrate, wiring.bus.data_bitrate, wiring.period_ns)

    def decode(self, frame):
        if frame.can_id == self.echo_id and frame.flags:
            self._clock.triggered(frame.timestamp_ns)
            return Reject.OWN_ECHO
        axis = self._positions.get(frame.can_id)
        if axis is None:
            return reject_id(frame.can_id, self._positions, self.echo_id)
        if frame.flags:
            return Reject.WRONG_FORMAT
        if len(frame.data) != _POSITION.size:
            return Reject.WRONG_LENGTH
        position, status, sequence = _POSITION.unpack(frame.data)
        if status & ~OF_DRIVES:
            return Reject.INVALID_VALUE
        return Sample(axis, position, status, sequence, self._clock.instant(axis, frame))

    def encode(self, command):
        check_force(command.force, self._rated)
        self._clock.trigger()
        frames = []
        for can_id, axis in self._torques.items():
            raw = round(command.force[axis] / self._rated[axis] * 32767)
            switches = (command.enable >> axis & 1) | 2 * bool(command.reset)
            frames.append(Frame(can_id, _TORQUE.pack(raw, switches, command.sequence % 256)))
        return frames

    def messages(self, period_ns):
        found = [
            Message(f"torque {axis}", can_id, _TORQUE.size, False, period_ns, period_ns, 0, "host")
            for can_id, axis in self._torques.items()
        ]
        return found + [
            Message(
                f"position {axis}", can_id, 6, False, period_ns, period_ns, 0, f"axis {axis}", found[-1].name
            )
            for can_id, axis in self._positions.items()
        ]


class Drives(_Ends):
    force_resolution, enable_lag = 0.5 / 32767, 0

    def __init__(self, wiring):
        super().__init__(wiring)
        self._told = {}

    def decode_command(self, frame):
        axis = self._torques.get(frame.can_id)
        if axis is None or frame.flags:
            return reject_id(frame.can_id, self._torques, -1) if axis is None else Reject.WRONG_FORMAT
        if len(frame.data) != _TORQUE.size:
            return Reject.WRONG_LENGTH
        raw, switches, sequence = _TORQUE.unpack(frame.data)
        if raw == -32768 or switches > 3:
            return Reject.INVALID_VALUE
        self._told[axis] = raw / 32767 * self._rated[axis], switches, sequence
        if axis != self.n_axes - 1 or {told[2] for told in self._told.values()} != {sequence}:
            return Reject.SERVICE
        told = [self._told.get(number, (0.0, 0, 0)) for number in range(self.n_axes)]
        enable = sum((switches & 1) << number for number, (_, switches, _) in enumerate(told))
        return Command(sequence, [force for force, _, _ in told], enable, bool(switches & 2))

    def encode_feedback(self, sample):
        can_id = next(can_id for can_id, axis in self._positions.items() if axis == sample.axis)
        return Frame(can_id, _POSITION.pack(sample.position, sample.status & OF_DRIVES, sample.sequence % 256))
'''


def write_family(folder: Path) -> Path:
    """The folder `torquebox` in `folder`, which is to be a place of families."""
    place = folder / "torquebox"
    place.mkdir(parents=True)
    for name, text in (("__init__", ""), ("family", FAMILY), ("sides", SIDES)):
        (place / f"{name}.py").write_text(text)
    return folder
