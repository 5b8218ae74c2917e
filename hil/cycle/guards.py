"""Guards: what keeps an operator's event from being taken although the table of states has it.

The words for an operator are made elsewhere, from the same facts (hil/events/refusals.py).
"""

from collections.abc import Sequence
from typing import Final

from drivers.bus.counters import BusState
from hil.cycle.axes import Axes
from hil.cycle.command_desk import CommandDesk
from hil.cycle.fault_monitor import FaultMonitor
from hil.cycle.homing import Homing
from hil.cycle.state_machine import Event, State
from hil.cycle.tick import Tick
from hil.cycle.withdrawal import Withdrawal
from hil.rig.schema import RigConfig

_FROM_REST: Final = frozenset({Event.ACTIVATE, Event.HOME, Event.RESET})


def within(positions: Sequence[float], ranges: Sequence[tuple[float, float]]) -> bool:
    """Each position, m (rad), is in its axis' range, ends included."""
    for axis, position in enumerate(positions):
        low, high = ranges[axis]
        if not low <= position <= high:
            return False
    return True


class Guards:
    """Of one control cycle. homing: how axes find their positions; None: none has to. way_out: of the rig's motion;
    None: it declares none.
    """

    def __init__(
        self, rig: RigConfig, monitor: FaultMonitor, axes: Axes, commands: CommandDesk, homing: Homing | None,
        way_out: Withdrawal | None,
    ) -> None:  # fmt: skip
        self._rig, self._monitor, self._axes, self._commands = rig, monitor, axes, commands
        self._homing, self._way_out = homing, way_out

    def allow(self, event: Event, tick: Tick, state: State, ranges: Sequence[tuple[float, float]]) -> bool:
        """An operator's event may be taken in this state. ranges: by axis, where the task may begin, m (rad)."""
        if event in (Event.ACTIVATE, Event.HOME) and not self.may_activate(tick):
            return False
        if event is Event.HOME and self.inside():
            return False
        if event is Event.ACTIVATE and self.homeless():
            return False
        if event is Event.ACTIVATE and not self._commands.hold_asked and not self.within(ranges):
            return False
        if event is Event.RESET and (self._monitor.blocks_reset() or tick.port.state >= BusState.BUS_OFF):
            return False
        return event not in _FROM_REST or state is State.CONNECTED or not self.moves()

    def may_activate(self, tick: Tick) -> bool:
        """The rig file, the recorder, real time and the heartbeat are as the rig asks for."""
        rig = self._rig
        if not tick.rig_ok or (rig.telemetry.recording_required and not tick.recorder_ok):
            return False
        if not tick.realtime_ok and not rig.timing.allow_degraded:
            return False
        heartbeat_ns = self._commands.heartbeat_ns
        alive = heartbeat_ns is not None and tick.now_ns - heartbeat_ns <= rig.safety.heartbeat_s * 1e9
        return not rig.safety.heartbeat_s or alive

    def homeless(self) -> bool:
        """Positions mean nothing yet: HOMING_REQUIRED."""
        return self._homing is not None and self._homing.required

    def inside(self) -> bool:
        """The tip is beyond its safe height, or on its way there."""
        way_out = self._way_out
        if way_out is None or self.homeless():
            return False
        return way_out.needed(self._axes.measured[way_out.axis], self._axes.ahead_velocity()[way_out.axis])

    def moves(self) -> bool:
        """An axis is not known to rest although it has no torque."""
        return any(watch.restless for watch in self._monitor.rest)

    def within(self, ranges: Sequence[tuple[float, float]]) -> bool:
        """Each axis stands where the task keeps every limit from."""
        return within(self._axes.measured, ranges)
