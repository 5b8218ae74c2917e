"""`protocol = "mit"`: drives that take position, speed, gains and torque in one frame, as MIT's Mini Cheetah had them.

Rules:
- Every tick each drive gets one frame, which it answers at once. It samples and applies its torque when it receives it.
- Gains are zero: torque alone. Position and speed in the frame mean nothing then.
- Torque has 12 bits (RobStride 16) over its whole range, and no code for zero: a drive that is enabled and told zero
  applies half a step, at most torque / 4095.
- To enable: the drive's own order, every tick until it says that it is enabled; a drive that never says (CubeMars) gets
  it twice. While disabled it gets the order to stop, which it answers, too: so there is a position from the beginning.
- A drive tells the end of its range for what is beyond: no travel may reach there (`positions`).
- The drive's own timeout has to be set in the drive; no frame carries it.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final

from drivers.config import BusConfig, Wiring
from drivers.families.mit.config import MitConfig, mit_keys
from drivers.families.mit.packing import POSITION_BITS, CubeMars, Damiao, Packing, RobStride
from drivers.frame import ECHO, ERROR, EXTENDED, EXTENDED_MASK, FD, REMOTE, Frame
from drivers.protocols.base import Command, DriveStatus, LayoutError, Message, Reject, Sample
from drivers.protocols.common import check_force
from drivers.protocols.count_size import CountSize
from drivers.protocols.sampling_clock import SamplingClock, leads_ns
from drivers.protocols.segments import of_axes

CODES: Final = (1 << POSITION_BITS) - 1
MIDDLE: Final = 1 << (POSITION_BITS - 1)  # count 0; half a step beside the middle of the range
_STARTS: Final = 2  # orders to enable, to a drive that does not tell whether it is
_DLC: Final = 8
_ENABLED: Final = int(DriveStatus.ENABLED)
_OF_NUMBER = {"damiao": 0x10, "cubemars": 0}  # answers in its number and this


def mit_drives(bus: BusConfig, n_axes: int) -> MitConfig:
    """[bus.mit] with every list as long as there are axes. Raises LayoutError."""
    stated = mit_keys(bus).mit or MitConfig()
    nodes = stated.nodes or list(range(1, n_axes + 1))
    answers = stated.answers or [_OF_NUMBER.get(stated.kind, 0) + node for node in nodes]
    whole = {"nodes": nodes, "answers": answers}
    for name in ("position", "torque"):
        values = getattr(stated, name)
        whole[name] = values * n_axes if len(values) == 1 else values
    for name, values in whole.items():
        if len(values) != n_axes:
            raise LayoutError(f"bus.mit.{name} has {len(values)} values for {n_axes} axes")
    for name in ("nodes", "answers"):
        if len(set(whole[name])) != n_axes:
            raise LayoutError(f"bus.mit.{name} = {whole[name]}: a value twice")
    if stated.kind == "damiao" and len({node & 0xF for node in nodes}) != n_axes:
        raise LayoutError(f"bus.mit.nodes = {nodes}: an answer tells the lowest four bits alone, which must differ")
    crossed = {*nodes} & {*answers} - {node for node, answer in zip(nodes, answers, strict=True) if node == answer}
    if stated.kind != "robstride" and crossed:
        raise LayoutError(f"bus.mit.answers: {min(crossed)} is the number of another drive")
    return stated.model_copy(update=whole)


def cut(bus: BusConfig, n_axes: int) -> Callable[[range], dict[str, Any]]:
    """What another segment of the rig has otherwise: the drives on it."""
    drives = mit_drives(bus, n_axes)
    lists = ("nodes", "answers", "position", "torque")
    return lambda axes: {"mit": drives.model_copy(update={n: of_axes(axes, getattr(drives, n)) for n in lists})}


def packing_of(drives: MitConfig) -> Packing:
    """How these drives pack their values."""
    if drives.kind == "robstride":
        return RobStride(drives.host, frozenset(drives.nodes))
    return (Damiao if drives.kind == "damiao" else CubeMars)(frozenset(drives.answers))


class MitLayout:
    """What both ends share. Raises LayoutError for a rig that it cannot carry."""

    name = "mit"
    sequence_modulus = 0
    checksum = causes = False  # no answer tells every cause: Damiao's none of the encoder, others none of a timeout
    resets = True
    fd = False
    state_ns = 0

    def __init__(self, wiring: Wiring) -> None:
        self.n_axes = wiring.n_axes
        self._rated = list(wiring.rated_force)
        self._drives = mit_drives(wiring.bus, wiring.n_axes)
        self._packing = packing_of(self._drives)
        self.states = self._packing.states
        self.tells = self._packing.tells
        self.own_mask, self.answer_mask = self._packing.own_mask, self._packing.answer_mask
        self.node_mask = self._packing.node_mask
        self._torque_codes = (1 << self._packing.torque_bits) - 1
        for axis, (rated, most) in enumerate(zip(self._rated, self._drives.torque, strict=True)):
            if rated > most:
                raise LayoutError(f"bus.mit.torque = {most:g} N m: the drive of axis {axis} is to give {rated:g}")
        nodes = self._drives.nodes
        self.command_ids = [self._packing.apply(node, self._torque_codes // 2).can_id for node in nodes]
        self.count_sizes = [
            CountSize(2.0 * most / CODES, True, True, f"2/65535 of bus.mit.position = {most:g}")
            for most in self._drives.position
        ]
        pairs = zip(nodes, self._drives.answers, strict=True)
        self.answer_ids = [self._packing.answer_id(node, answers) for node, answers in pairs]

    def messages(self, period_ns: int) -> list[Message]:
        """A frame to each drive and one from it, every tick."""
        names = [(f"command {axis}", f"answer {axis}") for axis in range(self.n_axes)]
        host = [
            Message(name, can_id, _DLC, False, period_ns, period_ns, 0, "host")
            for (name, _), can_id in zip(names, self.command_ids, strict=True)
        ]
        return host + [
            Message(answer, can_id, _DLC, False, period_ns, period_ns, 0, f"axis {axis}", command)
            for axis, ((command, answer), can_id) in enumerate(zip(names, self.answer_ids, strict=True))
        ]


class MitHost(MitLayout):
    """HostProtocol of these drives. Forces are N m of the output shaft; count 0 is the middle of the range."""

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        bus, n_axes = wiring.bus, wiring.n_axes
        self.positions: Sequence[tuple[float, float]] = [(1.0 - MIDDLE, CODES - 1.0 - MIDDLE)] * n_axes
        self.problems: Sequence[str] = ()
        self.acts_ns: Sequence[int] = ()
        self.stamp_wraps_ns: Sequence[int] = ()
        self._clock = SamplingClock(n_axes, bus.bitrate, bus.data_bitrate, wiring.period_ns)
        self._axis = {node: axis for axis, node in enumerate(self._drives.nodes)}
        self._own = {can_id & self.own_mask for can_id in self.command_ids}
        self._last_node = self._drives.nodes[-1]
        self.echo_id: int | None = self.command_ids[-1]
        self._status = [0] * n_axes
        self._starts = [0] * n_axes  # orders to enable since it was disabled
        self._enabled = 0
        self._lead_ns = [0] * n_axes  # by which each drive had its frame before the last one had
        self._bitrates = bus.bitrate, bus.data_bitrate

    def decode(self, frame: Frame) -> Sample | Reject:
        """Sample of an answer."""
        can_id, data, flags, stamp_ns = frame
        if flags & ECHO:
            if can_id == self.echo_id:
                self._clock.triggered(stamp_ns)
            return Reject.OWN_ECHO
        if not self._packing.is_answer(can_id):
            return self._reject_id(can_id)
        if flags & FD:
            return Reject.WRONG_FORMAT
        if len(data) != _DLC:
            return Reject.WRONG_LENGTH
        node, raw, status = self._packing.read(frame)
        axis = self._axis.get(node, -1)
        if axis < 0 or status < 0 or not self._is_from(axis, can_id):
            return Reject.INVALID_VALUE
        if not self.states and not status:
            status = self._enabled >> axis & _ENABLED
        self._status[axis] = status
        sampled_ns = self._clock.instant(axis, frame)
        if sampled_ns >= 0:
            sampled_ns -= self._lead_ns[axis]
        return Sample(axis, raw - MIDDLE, status, -1, sampled_ns)

    def _is_from(self, axis: int, can_id: int) -> bool:
        """The drive that it names speaks in this identifier; RobStride's has its number itself."""
        return bool(can_id & EXTENDED) or can_id == self.answer_ids[axis]

    def _reject_id(self, can_id: int) -> Reject:
        if can_id & ERROR:
            return Reject.ERROR_FRAME
        if can_id & REMOTE:
            return Reject.WRONG_FORMAT if self._packing.is_answer(can_id & ~REMOTE) else Reject.UNKNOWN_ID
        if self._packing.is_answer(can_id ^ EXTENDED if can_id & EXTENDED else can_id & EXTENDED_MASK | EXTENDED):
            return Reject.WRONG_FORMAT  # an identifier of the other length
        return Reject.OWN_ECHO if can_id & self.own_mask in self._own else Reject.UNKNOWN_ID

    def encode(self, command: Command) -> list[Frame]:
        """One frame a drive. Raises ValueError for a force not finite or beyond its rated force."""
        check_force(command.force, self._rated)
        self._clock.trigger()
        frames = [self._frame(axis, command) for axis in range(self.n_axes)]
        self._enabled = command.enable
        self.echo_id = frames[-1].can_id  # RobStride's has the torque in it
        self._lead_ns = leads_ns(frames, *self._bitrates)
        return frames

    def _frame(self, axis: int, command: Command) -> Frame:
        packing, node = self._packing, self._drives.nodes[axis]
        if not command.enable >> axis & 1:
            self._starts[axis] = 0
            return packing.clear(node) if command.reset else packing.stop(node)
        running = self._status[axis] & _ENABLED if self.states else self._starts[axis] >= _STARTS
        if not running:
            self._starts[axis] += 1
            return packing.start(node)
        most = self._drives.torque[axis]
        return packing.apply(node, round((command.force[axis] + most) / (2.0 * most) * self._torque_codes))
