"""What both ends of a dbc: layout share: the messages that the rig binds, checked against each other."""

from collections.abc import Sequence
from pathlib import Path

from drivers.arbitration import arbitration_key
from drivers.config import BusConfig, DbcBinding, SignalBinding, StatusBinding
from drivers.protocols.base import DriveStatus, LayoutError, Message
from drivers.protocols.dbc_binding import Bound, Place, bind_messages, bound_items, check_binding
from drivers.protocols.dbc_codec import load_dbc

PREFIX = "dbc:"
ENABLED, FAULT = int(DriveStatus.ENABLED), int(DriveStatus.FAULT)
COUNTS = 2.0**53  # beyond which a count is none that a float can tell from the next
OCCASIONAL_NS = 10_000_000  # least period of a command that is not sent every tick, for the schedulability analysis


class DbcLayout:
    """What both ends share: the bound messages. Raises LayoutError naming every signal that is not there."""

    name = "dbc"
    problems: Sequence[str] = ()

    def __init__(self, bus: BusConfig, n_axes: int, rated_force: Sequence[float], base_dir: Path) -> None:
        binding = bus.dbc
        if binding is None:
            raise LayoutError(f"bus.protocol = {bus.protocol!r} needs a table [bus.dbc] that binds its signals")
        path = base_dir / bus.protocol.removeprefix(PREFIX)
        check_binding(binding, n_axes)
        self.n_axes = n_axes
        self._rated = list(rated_force)
        self._messages = bind_messages(load_dbc(path), binding, path.name)
        for key, item in bound_items(binding):
            if not key.startswith(("bus.dbc.position", "bus.dbc.torque")):
                self._messages[item.message].whole(key, item)
        for checksum in binding.checksum:
            self._messages[checksum.message].protect(checksum)
        self._free_running = binding.feedback == "cyclic"
        self._position = [self._bound(item) for item in binding.position]
        self._torque = [self._bound(item) for item in binding.torque]
        self._status = [self._bound(item) for item in binding.status]
        self._enable = [self._bound(item) for item in binding.enable]
        self._reset = [self._bound(item) for item in binding.reset]
        self._error = [self._bound(item) for item in binding.error]
        self._constant = [(self._bound(item), item.value) for item in binding.constant]
        self._switch = [(item.on, item.off) for item in binding.enable]
        self._bit_per_axis = len(self._enable) == 1 and self._enable[0].place.bits > 1 and self._switch[0] == (1, 0)
        self._reset_switch = [(item.on, item.off) for item in binding.reset]
        self._maps = [_status_map(item) for item in binding.status]
        self._echo = [self._bound(item) for item in binding.feedback_counter]
        self._counters = [self._bound(item) for item in binding.command_counter]
        self.sequence_modulus = 1 << self._counters[0].place.bits if self._counters else 0
        bound_commands = [*self._torque, *self._enable, *self._reset, *self._counters]
        commands = [bound.message for bound in [*bound_commands, *(bound for bound, _ in self._constant)]]
        self._commands = sorted(dict.fromkeys(commands), key=lambda message: arbitration_key(message.can_id))
        self._resets_alone = self._find_resets_alone(binding)
        self._on_change = {message.can_id for message in self._commands if message.name in binding.on_change}
        names = {message.name for message in self._commands}
        for name in binding.on_change:
            if name not in names:
                raise LayoutError(f"bus.dbc.on_change: {name!r} is no bound command message")
        self._cyclic = [message for message in self._commands if message.can_id not in self._on_change]
        self._wrap = [item.wrap for item in binding.position]
        ends = [_reach(at.place, wrap) for at, wrap in zip(self._position, self._wrap, strict=True)]
        self.positions: Sequence[tuple[float, float]] = ends
        self._feedback_period_ns = round(binding.feedback_period_s * 1e9)
        if not {bound.message.can_id for bound in self._torque}.isdisjoint(self._on_change) or not self._cyclic:
            raise LayoutError("bus.dbc.on_change names a message with a torque, which is sent every tick")
        self._feedback = [bound.message for bound in self._position]
        carried = {bound.message: axis for group in (self._status, self._error) for axis, bound in enumerate(group)}
        self._state_only = {message: axis for message, axis in carried.items() if message not in self._feedback}
        self.state_ns = round(binding.state_period_s * 1e9) if self._state_only else 0
        self.states = bool(self._status)
        self.causes = bool(self._maps) and all(meanings is None for meanings in self._maps)
        self.checksum = all(message.checksum_at >= 0 for message in self._messages.values())
        self.fd = any(message.fd for message in self._messages.values())
        self._check_places(binding, path.name)
        self._check_resets()

    def _find_resets_alone(self, binding: DbcBinding) -> set[int]:
        """Identifiers of on_change messages that carry resets and nothing else."""
        others = [*self._torque, *self._enable, *self._counters, *(bound for bound, _ in self._constant)]
        carried = {bound.message.can_id for bound in others}
        return {bound.message.can_id for bound in self._reset if bound.message.name in binding.on_change} - carried

    def _bound(self, binding: SignalBinding) -> Bound:
        message = self._messages[binding.message]
        return Bound(message, message.place(binding))

    def _check_places(self, binding: DbcBinding, file: str) -> None:
        """Feedback signals of one axis share a message; each axis has its own; counters echo; torques reach."""
        for key, group in (("feedback_counter", self._echo),):
            for axis, bound in enumerate(group):
                if bound.message is not self._feedback[axis]:
                    raise LayoutError(
                        f"bus.dbc.{key}[{axis}] is in message {bound.message.name}; it has to be in "
                        f"{self._feedback[axis].name}, which carries position[{axis}]"
                    )
        if len({message.can_id for message in self._feedback}) != self.n_axes:
            raise LayoutError(f"{file}: two positions in one message; each axis needs a message of its own")
        for message in [*self._feedback, *self._state_only]:
            if message in self._commands:
                raise LayoutError(f"{file}: message {message.name} is bound both as command and as feedback")
        if len({bound.place.bits for bound in [*self._counters, *self._echo]}) > 1:
            raise LayoutError("bus.dbc: command_counter and feedback_counter have signals of different lengths")
        for axis, (bound, rated) in enumerate(zip(self._torque, self._rated, strict=True)):
            place = bound.place
            reach = min(abs(place.value(place.low)), abs(place.value(place.high)))
            if reach < rated * (1 - 1e-9) or not place.low <= -place.offset / place.gain <= place.high:
                raise LayoutError(
                    f"bus.dbc.torque[{axis}]: {bound.message.name}.{binding.torque[axis].signal} reaches +-{reach:g}; "
                    f"the rated force is {rated:g}: check its scale"
                )
        if self._bit_per_axis and self._enable[0].place.bits < self.n_axes:
            raise LayoutError(f"bus.dbc.enable has {self._enable[0].place.bits} bits; 1, or one per axis, is needed")

    def _check_resets(self) -> None:
        """A reset that is asked for by nothing but the message has to be alone in it."""
        for (message, _), (on, off) in zip(self._reset, self._reset_switch, strict=True):
            if on == off and message.can_id not in self._resets_alone:
                raise LayoutError(
                    f"bus.dbc.reset: on = off = {on} in {message.name}, which is sent for more than resets, or every "
                    "tick: it would say nothing"
                )

    def messages(self, period_ns: int) -> list[Message]:
        """All commands, then the feedbacks, which the last command triggers, and what is sent less often."""
        trigger = None if self._free_running else self._cyclic[-1].name
        slow_ns = max(period_ns, OCCASIONAL_NS)
        state_ns = max(period_ns, self.state_ns)
        feedback_ns = self._feedback_period_ns or period_ns
        return [
            *(Message(m.name, m.can_id, m.length, m.fd, period_ns, period_ns, 0, "host") for m in self._cyclic),
            *(
                Message(m.name, m.can_id, m.length, m.fd, feedback_ns, feedback_ns, 0, f"axis {axis}", trigger)
                for axis, m in enumerate(self._feedback)
            ),
            *(
                Message(m.name, m.can_id, m.length, m.fd, state_ns, state_ns, 0, f"axis {axis}")
                for m, axis in self._state_only.items()
            ),
            *(
                Message(m.name, m.can_id, m.length, m.fd, slow_ns, slow_ns, 0, "host")
                for m in self._commands
                if m not in self._cyclic
            ),
        ]


def _status_map(binding: StatusBinding) -> dict[int, int] | None:
    """DriveStatus bits by raw value; None where the raw value is the bits."""
    if not binding.enabled and not binding.fault:
        return None
    return dict.fromkeys(binding.enabled, ENABLED) | dict.fromkeys(binding.fault, FAULT)


def _reach(place: Place, wrap: float) -> tuple[float, float]:
    """Least and greatest position (counts) that a signal can tell; one that wraps is unwrapped (dbc.py)."""
    if wrap:
        return -COUNTS, COUNTS
    ends = place.value(place.low), place.value(place.high)
    return max(min(ends), -COUNTS), min(max(ends), COUNTS)
