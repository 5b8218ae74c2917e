"""The detectors: each looks at one thing and flags the faults it finds; the gravest one decides what the tick does.

Rules:
- A detector only flags, with what it measured, the limit it holds that against, and the axis. It changes nothing but
  its own streak counters, and reacts to nothing.
- Detectors run in every state. fault_table.py says in which states a fault is armed; one that is not armed is dropped.
- A fault is present in this tick or it is not: what must last for several ticks (streaks) is counted by the detector,
  and flagged once it has lasted long enough.

Theory of operation: `begin` clears `active`, the checks set one bit per fault, and `worst_fault` masks what is not
armed, counts what is, and returns the gravest with its reaction. Reactions: R0 COUNT; R1 BRIDGE: for at most two ticks
the law runs on the filter's prediction. (Holding the last torque instead would throw away what the model knows.
Decaying it would drop the friction compensation: 13 um in one tick on the paper's X axis.) R2 STOP: damped stop, zero
within stop_s; R3 ZERO: zero and disabled now, latched; R4 SILENT: R3, and nothing more is sent until an explicit reset,
so that the drives' own watchdogs act. Bits, because a tick in which nothing is wrong then costs one comparison with
zero.
"""

import math
from collections.abc import Sequence
from typing import Final

from drivers.bus.counters import BusState, PortCounters
from drivers.protocols.base import DriveStatus
from hil.control.laws.base import Reference
from hil.cycle.fault_evidence import AxisLimits, Evidence
from hil.cycle.fault_table import ROWS, Fault, Reaction
from hil.cycle.inbox import Inbox
from hil.cycle.oscillation import OscillationDetector
from hil.cycle.record import MAX_EVIDENCE, NO_AXIS
from hil.cycle.rest_watch import RestWatch
from hil.cycle.state_machine import State
from hil.cycle.tick import Tick
from hil.cycle.travel import Travel
from hil.rig.schema import SafetyConfig

_FAULTS: Final = list(Fault)  # by number
REACTIONS: Final = [Reaction.COUNT] + [ROWS[fault].reaction for fault in Fault if fault]
_BLOCKING: Final = sum(1 << f for f, rule in ROWS.items() if rule.reaction >= Reaction.STOP and not rule.drive_latched)
_STATUS_FAULTS: Final = [(int(rule.status), fault) for fault, rule in ROWS.items() if rule.status]
_BAD_STATUS: Final = sum(bits for bits, _ in _STATUS_FAULTS)
_ENABLED: Final = int(DriveStatus.ENABLED)  # interpreted, the operator of a flag is a function in Python
NO_ACK_TICKS: Final = 2  # in a row
RECORDER_FIRST_NS: Final = 1_000_000_000  # a recorder's first sign may take as long as each further one
_ARMED: Final = [sum(1 << fault for fault, rule in ROWS.items() if state in rule.states) for state in State]


def _gravity(evidence: Evidence) -> int:
    return -REACTIONS[evidence.fault]


class FaultMonitor:
    """The detectors. Each method looks at one thing and flags faults as bits of `active`, with their `evidence`."""

    def __init__(
        self, safety: SafetyConfig, axes: Sequence[AxisLimits], period_ns: int, innovation_limit: Sequence[float]
    ) -> None:
        self._safety = safety
        self._flood_frames, self._bad_frame_limit = safety.flood_frames, safety.bad_frame_limit  # read in every tick
        self._axes = list(axes)
        self._innovation_limit = list(innovation_limit)  # m
        self._port = PortCounters()
        self._previous_index = -1
        self._previous_now_ns = 0
        self._skipped = 0  # slots before this tick
        self._held_up = False  # frames lost while slots were skipped may still have to be told
        self._stuck_position = [0.0] * len(axes)
        self._swings = [OscillationDetector(limits.oscillation, period_ns * 1e-9) for limits in axes]
        self.rest = [RestWatch(li.rest_window, li.jump_step, li.coasting_s, period_ns * 1e-9) for li in axes]
        self.travel = [Travel(li.position_low, li.position_high, li.following_error) for li in axes]
        self.switched = [axis for axis, limits in enumerate(self._axes) if limits.switches]
        self.closed = [0] * len(axes)  # limit switches, as DriveStatus bits
        self._known = [0] * len(axes)  # of these, those that were closed at a reset, or are homed on: no fault
        self._recorder_due = RECORDER_FIRST_NS // period_ns  # ticks in which it may have yet to begin
        self.active = 0
        self.evidence: list[Evidence] = []
        self.counts = [0] * len(Fault)
        self.restart()

    def restart(self) -> None:
        """Forget streaks; at every activation and reset."""
        n = len(self._axes)
        self._glitches = [0] * n
        self._diverging = [0] * n
        self._stuck = [0] * n
        self._no_ack_ticks = self._refused_ticks = self._overruns = 0
        self._enabled_ticks = 0  # in which a drive said so although it was told otherwise
        for swings, travel in zip(self._swings, self.travel, strict=True):
            swings.restart(0.0)
            travel.restart()
        self.watch_rest(coasting=False)

    def watch_rest(self, *, coasting: bool) -> None:
        """The axes rest where they are next seen without torque. coasting: a run comes before it."""
        for watch in self.rest:
            watch.restart(coasting=coasting)

    def forgive_switches(self) -> None:
        """At a reset: the way back from a switch that is closed is free."""
        self._known = list(self.closed)

    def allow_way_back(self, positions: Sequence[float]) -> None:
        """The axes rest there, m (rad), some of them perhaps beyond their travel, and goals bring them back."""
        for travel, position in zip(self.travel, positions, strict=True):
            travel.begin_at(position)

    def begin(self) -> None:
        """A new tick: nothing is flagged yet."""
        self.active = 0
        if self.evidence:
            self.evidence = []

    def withdraw(self, fault: Fault) -> None:
        """Mark a grant as missing in this tick; it is there or not, so that there is nothing to measure."""
        self.active |= 1 << fault

    def flag(self, fault: Fault, value: float, limit: float, axis: int = NO_AXIS) -> None:
        """Mark a fault as present in this tick, with what was measured and the limit it is beyond."""
        self.active |= 1 << fault
        self.evidence.append(Evidence(fault, axis, float(value), float(limit)))

    def flag_state(self, fault: Fault, value: int, axis: int = NO_AXIS) -> None:
        """Mark as present what is so or not, and has no limit. value: which of the row's words says it."""
        self.active |= 1 << fault
        self.evidence.append(Evidence(fault, axis, float(value), math.nan))

    def armed_evidence(self) -> list[Evidence]:
        """Of the faults that counted in this tick; the gravest first where a record cannot hold all."""
        armed = [evidence for evidence in self.evidence if self.active >> evidence.fault & 1]
        return armed if len(armed) <= MAX_EVIDENCE else sorted(armed, key=_gravity)

    def check_bus(self, tick: Tick, useless_now: int) -> None:
        """Fault confinement, transmit queue, flood; from the port's counters and the frames that were of no use."""
        port, before = tick.port, self._port
        self._check_flood(tick.index - self._previous_index, port, useless_now)
        if port == before:
            self._no_ack_ticks = self._refused_ticks = 0
            if port.state is not BusState.ERROR_ACTIVE:
                self._flag_bus_state(port)
            return
        self._port = port
        if port.state is not BusState.ERROR_ACTIVE or port.bus_off != before.bus_off or port.down != before.down:
            self._flag_bus_state(port)
            if port.bus_off != before.bus_off:
                self.flag_state(Fault.BUS_OFF, BusState.BUS_OFF)
            if port.down != before.down:
                self.flag_state(Fault.INTERFACE_DOWN, BusState.DOWN)
        self._no_ack_ticks = self._no_ack_ticks + 1 if port.no_ack > before.no_ack else 0
        if self._no_ack_ticks >= NO_ACK_TICKS:
            self.flag(Fault.NO_ACK, self._no_ack_ticks, NO_ACK_TICKS)
        self._refused_ticks = self._refused_ticks + 1 if port.refused > before.refused else 0
        if self._refused_ticks:
            limit = self._safety.transmit_refused_limit
            self.flag(Fault.TRANSMIT_REFUSED, port.refused - before.refused, 0.0)
            if self._refused_ticks >= limit:
                self.flag(Fault.TRANSMIT_BLOCKED, self._refused_ticks, limit)

    def _check_flood(self, slots: int, port: PortCounters, useless_now: int) -> None:
        """More than so many slots can hold; what piles up behind a stall, or is lost there, is late and no flood."""
        most = self._flood_frames * max(1, slots)
        if useless_now >= most:
            self.flag(Fault.RECEIVE_FLOOD, useless_now, most)
        before = self._port
        if slots > 1:
            self._held_up = True
        elif self._held_up:  # a bus tells what was lost with the first frame after it, which answers this tick's
            self._held_up = port.received == before.received
        elif port.overflow > before.overflow or port.discarded > before.discarded:
            self.flag(Fault.RECEIVE_FLOOD, port.overflow + port.discarded - before.overflow - before.discarded, 0.0)

    def _flag_bus_state(self, port: PortCounters) -> None:
        if port.state == BusState.ERROR_PASSIVE:
            self.flag_state(Fault.BUS_PASSIVE, port.state)
        elif port.state == BusState.BUS_OFF:
            self.flag_state(Fault.BUS_OFF, port.state)
        elif port.state == BusState.DOWN:
            self.flag_state(Fault.INTERFACE_DOWN, port.state)

    def check_timing(self, tick: Tick) -> None:
        """Skipped slots and long gaps between ticks."""
        first = self._previous_index < 0
        self._skipped = skipped = 0 if first else tick.index - self._previous_index - 1
        self._overruns = self._overruns + 1 if skipped else 0
        if skipped:
            safety, gap_ns = self._safety, tick.now_ns - self._previous_now_ns
            self.flag(Fault.OVERRUN, skipped, 0.0)
            if self._overruns >= safety.overrun_streak:
                self.flag(Fault.OVERRUN_BURST, self._overruns, safety.overrun_streak)
            if gap_ns > safety.overrun_zero_s * 1e9:
                self.flag(Fault.OVERRUN_LONG, gap_ns * 1e-9, safety.overrun_zero_s)
        self._previous_index = tick.index
        self._previous_now_ns = tick.now_ns

    def check_grants(self, tick: Tick) -> None:
        """What makes a new ACTIVE unacceptable without stopping a running one."""
        if not tick.realtime_ok:
            self.withdraw(Fault.REALTIME_DENIED)
        if tick.recorder_ok:
            self._recorder_due = 0
        elif self._recorder_due:
            self._recorder_due -= 1
        else:
            self.withdraw(Fault.RECORDER_LOST)
        if not tick.rig_ok:
            self.withdraw(Fault.RIG_CHANGED)

    def check_samples(self, inbox: Inbox, enabled_seen: bool) -> None:
        """Silence, bad frames and what the drives say of themselves."""
        if inbox.oldest():
            self._flag_silence(inbox)
        if inbox.bad_frames >= self._bad_frame_limit:
            self.flag(Fault.BAD_FRAMES, inbox.bad_frames, self._bad_frame_limit, inbox.suspect_axis)
        if inbox.foreign_id >= 0:
            self.flag_state(Fault.FOREIGN_COMMAND, inbox.foreign_id)
        if inbox.differ_axis >= 0:
            self.flag_state(Fault.ANSWERS_DIFFER, 0, inbox.differ_axis)
        for axis, sample in enumerate(inbox.samples):
            if sample is None:
                continue
            if sample.status & _BAD_STATUS:
                for bits, fault in _STATUS_FAULTS:
                    if sample.status & bits:
                        self.flag_state(fault, 1, axis)
            if enabled_seen and not sample.status & _ENABLED:
                self.flag_state(Fault.DRIVE_DISABLED, 0, axis)

    def check_switches(self, inbox: Inbox, *, homing: bool) -> None:
        """Limit switches that close. One that was closed at the last reset, or that the axis homes on, is no fault
        until it has opened.
        """
        for axis in self.switched:
            sample = inbox.samples[axis]
            if sample is None:
                continue
            self.closed[axis] = closed = sample.status & self._axes[axis].switches
            if homing:
                self._known[axis] |= self._axes[axis].home_switch
            self._known[axis] &= closed
            fresh = closed & ~self._known[axis]
            if fresh:
                self.flag_state(Fault.LIMIT_SWITCH, 0 if fresh & DriveStatus.LIMIT_LOW else 1, axis)

    def _flag_silence(self, inbox: Inbox) -> None:
        stop, zero = self._safety.silent_stop_ticks, self._safety.silent_zero_ticks
        for axis, age in enumerate(inbox.age):
            if not age:
                continue
            self.flag(Fault.ENCODER_GAP, age, 0.0, axis)
            if age >= stop:
                self.flag(Fault.ENCODER_LOST, age, stop, axis)
            if age >= zero:
                self.flag(Fault.ENCODER_DEAD, age, zero, axis)

    def flag_not_enabled(self, waited: int, inbox: Inbox) -> None:
        """Axes that do not say, `waited` ticks after they were told to, that they apply torque."""
        for axis, sample in enumerate(inbox.samples):
            if sample is None or not sample.status & _ENABLED:
                self.flag(Fault.ENABLE_TIMEOUT, waited, self._safety.enable_timeout_ticks, axis)

    def flag_requests(self, requested: Sequence[float]) -> None:
        """Forces asked for that are no finite number."""
        for axis, force in enumerate(requested):
            if force - force != 0.0:
                self.flag(Fault.NOT_FINITE, force, self._axes[axis].force, axis)

    def flag_heartbeat(self, now_ns: int, heard_ns: int | None) -> None:
        """The operator's heartbeat, last heard at heard_ns, is overdue."""
        self.flag(Fault.HEARTBEAT_LOST, (now_ns - (heard_ns or 0)) * 1e-9, self._safety.heartbeat_s)

    def check_released(self, inbox: Inbox) -> None:
        """Where no torque is permitted: a drive that goes on saying it is enabled."""
        enabled = NO_AXIS
        for axis, sample in enumerate(inbox.samples):
            if inbox.fresh[axis] and sample is not None and sample.status & _ENABLED:
                enabled = axis
                break
        self._enabled_ticks = self._enabled_ticks + 1 if enabled != NO_AXIS else 0
        if self._enabled_ticks >= self._safety.disable_timeout_ticks:
            self.flag(Fault.DRIVE_STAYS_ENABLED, self._enabled_ticks, self._safety.disable_timeout_ticks, enabled)

    def check_rest(self, inbox: Inbox) -> None:
        """Where no torque is permitted: an axis that moves all the same."""
        for axis, watch in enumerate(self.rest):
            if self._skipped:
                watch.pass_ticks(self._skipped)
            sample = inbox.samples[axis]
            if inbox.fresh[axis] and sample is not None:
                watch.take(sample.position * self._axes[axis].resolution)
            else:
                watch.pass_ticks(1)
            if watch.moving:
                self.flag(Fault.AXIS_MOVED, watch.distance, watch.window, axis)
                if not watch.allowed:
                    self.flag(Fault.STANDSTILL, watch.distance, watch.window, axis)

    def implausible(self, axis: int, step: float, periods: float) -> bool:
        """Whether a sample that is `step` m from the last trusted one, `periods` ago, cannot be true."""
        limit = self._axes[axis].jump_step * (periods if periods > 1.0 else 1.0)
        if abs(step) <= limit:
            self._glitches[axis] = 0
            return False
        self._glitches[axis] += 1
        # Of an axis that moves at rest it is known why its samples are far apart: STANDSTILL says so.
        jump = self._glitches[axis] >= 2 and not self.rest[axis].moving
        self.flag(Fault.ENCODER_JUMP if jump else Fault.ENCODER_GLITCH, abs(step), limit, axis)
        return True

    def check_filter(self, axis: int, innovation: float) -> None:
        """An innovation (m) that stays beyond its limit, or is not finite."""
        limit = self._innovation_limit[axis]
        if -limit <= innovation <= limit:
            self._diverging[axis] = 0
            return
        self._diverging[axis] += 1
        if innovation != innovation:
            self.flag(Fault.NOT_FINITE, innovation, limit, axis)
        if self._diverging[axis] >= self._safety.nis_ticks:
            self.flag(Fault.FILTER_DIVERGED, abs(innovation), limit, axis)

    def check_motion(
        self, axis: int, q: float, v: float, force: float, sample: Reference, planned: float, *, following: bool
    ) -> None:
        """Travel, speed, following error and its swings, stuck encoder of one axis; measured and planned. SI units.

        q: measured position. v: estimated velocity. sample: setpoint at the sample's instant. planned: setpoint
        position at the end of the coming interval. following: the axis is meant to follow the setpoint (not in a damped
        stop).
        """
        limits, travel, vd = self._axes[axis], self.travel[axis], sample.velocity
        if travel.wide:
            travel.follow(q)
        low, high = travel.low, travel.high
        if not low <= q <= high:
            self.flag(Fault.TRAVEL, q, low if q < low else high, axis)
        if abs(v) > limits.speed or v != v:
            self.flag(Fault.SPEED, abs(v), limits.speed, axis)
        if abs(vd) > limits.speed:
            self.flag(Fault.SPEED_PLANNED, abs(vd), limits.speed, axis)
        self._check_stuck(axis, q, force, limits.stuck_force)
        if not following:
            return
        stopped_at = q + v * abs(v) / (2.0 * limits.braking)
        if not (low <= planned <= high and low <= stopped_at <= high):
            outside = stopped_at if low <= planned <= high else planned
            self.flag(Fault.TRAVEL_PLANNED, outside, low if outside < low else high, axis)
        error, most = q - sample.position, limits.following_error * (1.0 + abs(vd) / limits.speed)
        if abs(error) > most:
            self.flag(Fault.FOLLOWING_ERROR, abs(error), most, axis)
        if self._swings[axis].seen(error):
            self.flag(Fault.OSCILLATION, self._swings[axis].swing, limits.oscillation, axis)

    def _check_stuck(self, axis: int, position: float, force: float, threshold: float) -> None:
        if -threshold < force < threshold or position != self._stuck_position[axis]:
            self._stuck[axis] = 0
            self._stuck_position[axis] = position
            return
        self._stuck[axis] += 1
        if self._stuck[axis] >= self._safety.stuck_ticks:
            self.flag(Fault.ENCODER_STUCK, self._stuck[axis], self._safety.stuck_ticks, axis)

    def worst_fault(self, state: State) -> tuple[Fault, Reaction]:
        """The gravest fault armed in `state` (lowest number first among equals), counted; (NONE, COUNT) when there is
        none.
        """
        armed = self.active & _ARMED[state]
        self.active = armed
        worst, reaction = Fault.NONE, Reaction.COUNT
        while armed:
            low = armed & -armed
            fault = _FAULTS[low.bit_length() - 1]
            armed ^= low
            self.counts[fault] += 1
            if worst is Fault.NONE or REACTIONS[fault] > reaction:
                worst, reaction = fault, REACTIONS[fault]
        return worst, reaction

    def named_counts(self) -> dict[str, int]:
        """Ticks each fault was flagged in, while armed."""
        return {fault.name.lower(): self.counts[fault] for fault in Fault if fault}

    def blocks_reset(self) -> bool:
        """Whether a fault that latched may still be present."""
        return bool(self.active & _BLOCKING)
