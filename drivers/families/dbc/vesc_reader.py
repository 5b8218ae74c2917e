"""What a VESC's configurations have to say before its drive is believed, [bus.dbc.vesc].

Source: the firmware (github.com/vedderb/bldc, confgenerator.c of every version from 3.50 to 7.00). Rules:
- COMM_GET_MCCONF and COMM_GET_APPCONF are answered with the whole configuration. It begins with a signature, which
  differs between firmwares whose layouts differ: with another one than the rig file's nothing in it is read.
- An answer keeps the bus busy for milliseconds, and goes before the drives' positions. So one drive is asked at a time,
  only while no drive is enabled, and not again once all is right, until a reset or a silence of SILENCE_NS.
- Parts of answers are no flood: of each question as many are due as the longest answer has. An answer that is late may
  come beside the next one, and that to an earlier process' question before the first.
- A digest of a whole configuration would change by itself: the firmware measures the offsets of its current sensors at
  each start and keeps them in it.
"""

from collections.abc import Mapping, Sequence
from struct import Struct
from typing import Final, NamedTuple

from drivers.families.dbc.config import VescBinding, VescValue
from drivers.families.dbc.vesc_packets import (
    MOST_FRAMES,
    PROCESS_SHORT_BUFFER,
    Assembly,
    Packet,
    identifier,
    question,
)
from drivers.frame import EXTENDED, Frame
from drivers.frame_length import worst_case_bits
from drivers.protocols.base import SERVICE, LayoutError, Message, Reject
from drivers.protocols.read_back import ANSWER_TICKS, Question, ReadBack

CONFIGURATIONS: Final = {"motor": 14, "application": 17}  # COMM_GET_MCCONF, COMM_GET_APPCONF
SILENCE_NS: Final = 100_000_000  # of a drive's positions, after which it may have restarted
_SET_CURRENT: Final = 1
_LONGEST_ANSWER: Final = sum(MOST_FRAMES.values())  # frames
_SHARE: Final = 2  # times the bus time of an answer, in which it comes: others send, too
_FORMATS: Final = {"uint8": "B", "uint16": ">H", "uint32": ">I", "int16": ">h", "float32": ">f"}
_ANOTHER_FIRMWARE: Final = "its firmware has its values at other places than the rig file says"
_ANOTHER_VALUE: Final = "the rig file allows no other; VESC Tool changes it"


class Place(NamedTuple):
    """Where a value stands: in which configuration, from which byte on, counted from the signature's first; its type;
    value of 1 in its number.
    """

    configuration: str
    at: int
    type: str
    scale: float = 1.0


SIGNATURE: Final = {name: Place(name, 0, "uint32") for name in CONFIGURATIONS}
PLACES: Final[Mapping[str, Place]] = {  # the same in every one of these versions
    "motor_type": Place("motor", 6, "uint8"),
    "sensor_mode": Place("motor", 7, "uint8"),
    "l_current_max": Place("motor", 8, "float32"),
    "l_current_min": Place("motor", 12, "float32"),
    "l_in_current_max": Place("motor", 16, "float32"),
    "l_in_current_min": Place("motor", 20, "float32"),
    "controller_id": Place("application", 4, "uint8"),
    "timeout_msec": Place("application", 5, "uint32"),
    "timeout_brake_current": Place("application", 9, "float32"),
}


class Asked(NamedTuple):
    """A value that is read, and what it may be."""

    place: Place
    question: Question


class VescReader:
    """The questions to the VESCs of a bus, and their answers.

    vesc_ids: of the drives, by axis. asked_ids: identifiers of the questions. heard_ids: of the answers. Raises
    LayoutError for a table that cannot be.
    """

    def __init__(self, binding: VescBinding, vesc_ids: Sequence[int], bitrate: int, period_ns: int) -> None:
        self._ids = list(vesc_ids)
        self._askers = [binding.ask_as + axis for axis in range(len(self._ids))]
        self._check_ids(binding)
        asked = [_asked_of(binding, axis, len(self._ids)) for axis in range(len(self._ids))]
        nominal, _ = worst_case_bits(8, fd=False, extended=True)
        answer_ns = _LONGEST_ANSWER * nominal * 1_000_000_000 // bitrate
        self._period_ns = period_ns
        self._answer_ticks = ANSWER_TICKS + -(-_SHARE * answer_ns // period_ns)
        self._asked = asked
        self._proofs = [
            ReadBack(f"axis {axis}, VESC {self._ids[axis]}", [each.question for each in theirs], 0, self._answer_ticks)
            for axis, theirs in enumerate(asked)
        ]
        self._assemblies = {asker: (axis, Assembly(self._ids[axis])) for axis, asker in enumerate(self._askers)}
        self.asked_ids = [identifier(PROCESS_SHORT_BUFFER, vesc_id) for vesc_id in self._ids]
        self.heard_ids = [identifier(command, asker) for asker in self._askers for command in MOST_FRAMES]
        self._commands = {identifier(command, 0): command for command in MOST_FRAMES}
        self._due = _LONGEST_ANSWER  # an earlier process may have asked
        self._waits: tuple[int, int] | None = None  # axis and number of the question
        self._turn = self._free_tick = 0
        self._silence_ticks = SILENCE_NS // period_ns
        self._sample_tick = [0] * len(self._ids)

    def _check_ids(self, binding: VescBinding) -> None:
        shared = sorted(set(self._ids).intersection(self._askers))
        if shared or self._askers[-1] > 254:
            what = f"{shared[0]} is a drive's" if shared else "254 is the greatest"
            raise LayoutError(
                f"bus.dbc.vesc.ask_as = {binding.ask_as}: {len(self._ids)} axes are asked as VESC IDs "
                f"{self._askers[0]} to {self._askers[-1]}; {what}"
            )

    def hears(self, can_id: int) -> bool:
        """Whether a frame is a part of an answer to whomever: the question may have been damaged."""
        return can_id & ~0xFF in self._commands

    def take(self, frame: Frame, tick: int) -> Reject | None:
        """A frame that it hears. None for a part of an answer, so many of which are due by the questions; else why it
        is of no use.
        """
        axis, assembly = self._assemblies.get(frame.can_id & 0xFF, (-1, None))
        if not self._due:
            return Reject.SERVICE if assembly else Reject.UNKNOWN_ID
        self._due -= 1
        if assembly is None:
            return None
        came = assembly.take(self._commands[frame.can_id & ~0xFF], frame)
        if not isinstance(came, Packet):
            return came
        if self._waits == (axis, came.command):
            self._waits, self._free_tick = None, tick
            self._judge(axis, came, tick)
        return None

    def _judge(self, axis: int, packet: Packet, tick: int) -> None:
        """All values that one answer tells, the signature first."""
        proof, theirs = self._proofs[axis], self._asked[axis]
        told = [n for n, each in enumerate(theirs) if CONFIGURATIONS[each.place.configuration] == packet.command]
        for number in told:
            if number != told[0]:
                proof.ask(tick)  # in the same answer
            proof.answer(number, value_in(packet.data, theirs[number].place), tick)

    def sampled(self, axis: int, tick: int) -> None:
        """A position of its drive came. After a silence it may have restarted, with another configuration."""
        if tick - self._sample_tick[axis] > self._silence_ticks:
            self._proofs[axis].begin()
            self._waits = None if self._waits and self._waits[0] == axis else self._waits
        self._sample_tick[axis] = tick

    def begin(self) -> None:
        """After a reset all is asked anew."""
        self._waits = None
        for proof in self._proofs:
            proof.begin()

    def ask(self, tick: int) -> list[Frame]:
        """The question that is due: to one drive at a time, while none is enabled."""
        if tick < self._free_tick:
            return []
        count = len(self._ids)
        for axis in ((self._turn + step) % count for step in range(count)):
            number = None if self._proofs[axis].proved else self._proofs[axis].ask(tick)
            if number is not None:
                self._turn, self._free_tick = axis + 1, tick + self._answer_ticks
                command = CONFIGURATIONS[self._asked[axis][number].place.configuration]
                self._waits, self._due = (axis, command), min(self._due, _LONGEST_ANSWER) + _LONGEST_ANSWER
                return [question(command, self._ids[axis], self._askers[axis])]
        return []

    def proved(self, axis: int) -> bool:
        """Whether the axis' drive has told all values rightly."""
        return self._proofs[axis].proved

    @property
    def problems(self) -> list[str]:
        """What drives have otherwise, or do not answer, for people."""
        return [proof.problem for proof in self._proofs if proof.problem]

    def messages(self) -> list[Message]:
        """Traffic while drives are asked: one longest answer in `_answer_ticks`, by the drives in turn."""
        between_ns = len(self._ids) * self._answer_ticks * self._period_ns
        found = []
        for axis, (vesc_id, asker, asked_id) in enumerate(zip(self._ids, self._askers, self.asked_ids, strict=True)):
            name = f"{SERVICE} question to VESC {vesc_id}"
            found.append(Message(name, asked_id, 3, False, between_ns, between_ns, 0, "host", at_rest=1))
            for (command, frames), length in zip(MOST_FRAMES.items(), (8, 8, 6), strict=True):
                name, can_id = f"{SERVICE} answer of VESC {vesc_id}, {command}", identifier(command, asker)
                found.append(
                    Message(name, can_id, length, False, between_ns, between_ns, 0, f"axis {axis}", at_rest=frames)
                )
        return found


def vesc_ids(torques: Sequence[tuple[str, int]]) -> list[int]:
    """VESC ID of each axis' drive, by name and identifier of the message that tells it its current. Raises LayoutError
    for one that is no SET_CURRENT.
    """
    for name, can_id in torques:
        if not can_id & EXTENDED or (can_id & ~EXTENDED) >> 8 != _SET_CURRENT:
            raise LayoutError(f"bus.dbc.vesc: {name}, which has a torque, is no CAN_PACKET_SET_CURRENT of a VESC")
    return [can_id & 0xFF for _, can_id in torques]


def value_in(configuration: bytes, place: Place) -> float:
    """A value of a configuration; NaN where it ends before."""
    form = Struct(_FORMATS[place.type])
    if place.at + form.size > len(configuration):
        return float("nan")
    number: float = form.unpack_from(configuration, place.at)[0]
    return number * place.scale if place.scale != 1.0 else number


def _asked_of(binding: VescBinding, axis: int, n_axes: int) -> list[Asked]:
    """What one drive is asked, by configuration, the signature first. Raises LayoutError."""
    values: dict[str, list[Asked]] = {name: [] for name in CONFIGURATIONS}
    for at, item in enumerate(binding.values):
        key = f"bus.dbc.vesc.values[{at}]"
        if item.axis is not None and item.axis >= n_axes:
            raise LayoutError(f"{key}.axis = {item.axis}: 0 to {n_axes - 1} are there")
        if not item.least <= item.most:
            raise LayoutError(f"{key}: least = {item.least:g} is above most = {item.most:g}")
        place = _place(key, item)
        if not _signature(binding, place.configuration):
            raise LayoutError(
                f"{key}: {item.value} is in the {place.configuration} configuration, so "
                f"bus.dbc.vesc.{place.configuration}_signature is needed"
            )
        if item.axis in (None, axis):
            values[place.configuration].append(
                Asked(place, Question(item.value, item.least, item.most, _ANOTHER_VALUE))
            )
    found = []
    for name, theirs in values.items():
        signature = _signature(binding, name)
        if signature:
            named = Question(f"signature of the {name} configuration", signature, signature, _ANOTHER_FIRMWARE)
            found += [Asked(SIGNATURE[name], named), *theirs]
    if not found:
        raise LayoutError("bus.dbc.vesc: motor_signature or application_signature is needed, else nothing is asked")
    return found


def _signature(binding: VescBinding, configuration: str) -> int:
    return binding.motor_signature if configuration == "motor" else binding.application_signature


def _place(key: str, item: VescValue) -> Place:
    if item.at is not None:
        return Place(item.configuration, item.at, item.type, item.scale)
    if item.value not in PLACES:
        raise LayoutError(f"{key}: value = {item.value!r} needs `at`; without it there are {', '.join(PLACES)}")
    stated = {name: value for name, value in item if name in ("configuration", "type", "scale")}
    ignored = [name for name, value in stated.items() if value != VescValue.model_fields[name].default]
    if ignored:
        raise LayoutError(f"{key}.{ignored[0]}: where {item.value} stands is known; it goes with `at` alone")
    return PLACES[item.value]
