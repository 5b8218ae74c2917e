"""Carries fault scenarios (sim_plant/scenario/language.py) out on the emulated stage, and hands those of the bus to its
wire.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from drivers.frame import Frame
from drivers.protocols.base import DriveStatus, Sample
from drivers.wire.faults import FOREVER_NS, Random
from drivers.wire.segments import WireSegments
from drivers.wire.wire import Wire
from sim_plant.emulator import EmulatedStage
from sim_plant.nodes import sensor
from sim_plant.scenario.language import (
    KINDS,
    PLANT_PREFIX,
    FaultConfig,
    Scenario,
    ScenarioError,
    load_scenario,
    wire_fault,
)

__all__ = ["KINDS", "FaultConfig", "Injector", "Scenario", "ScenarioError", "load_scenario"]

_MOST_NEGATIVE = -(1 << 31)

Undo = Callable[[], None]


class Injector:
    """Carries a scenario out on one stage and its wire.

    wire: None where there is none to be had (a live bus); then wire_... kinds raise ValueError. period_ns: what a tick
    is to `at_tick`, `duration_ticks` and `stale_feedback`. The scenario must have been checked against the rig.
    began: kinds that have begun so far, in order, with their instants (ns).
    """

    def __init__(
        self, scenario: Scenario, stage: EmulatedStage, wire: Wire | WireSegments | None, period_ns: int
    ) -> None:
        self.began: list[tuple[int, FaultConfig]] = []
        self._stage = stage
        self._wire = wire
        self._period_ns = period_ns
        self._waiting: list[_Waiting] = []
        self._state = self._phase = ""
        start_ns = stage.now_ns
        for fault in scenario.fault:
            if fault.on_wire and wire is None:
                raise ValueError(f"kind = '{fault.kind}': only a simulated wire can do that; use `hil sim`")
            if fault.at_s is not None:
                self._plan(fault, start_ns + round(fault.at_s * 1e9))
            elif fault.at_tick is not None:
                self._plan(fault, start_ns + fault.at_tick * period_ns)
            else:
                self._waiting.append(_Waiting(fault, fault.occurrence))

    def observe(self, now_ns: int, state: str, phase: str) -> None:
        """Tell where the control process is at now_ns; call it once a tick, after the cycle's step."""
        if (state, phase) == (self._state, self._phase):
            return
        entered = [
            waiting
            for waiting in self._waiting
            if (state != self._state and waiting.fault.at_state == state)
            or (phase != self._phase and waiting.fault.at_phase == phase)
        ]
        self._state, self._phase = state, phase
        for waiting in entered:
            waiting.entries_left -= 1
            if waiting.entries_left == 0:
                self._waiting.remove(waiting)
                self._plan(waiting.fault, now_ns + round(waiting.fault.after_s * 1e9))

    def _plan(self, fault: FaultConfig, from_ns: int) -> None:
        until_ns = FOREVER_NS
        if fault.duration_s is not None:
            until_ns = from_ns + max(1, round(fault.duration_s * 1e9))
        elif fault.duration_ticks is not None:
            until_ns = from_ns + fault.duration_ticks * self._period_ns
        if fault.on_wire:
            assert self._wire is not None
            self._wire.inject(wire_fault(fault, from_ns, until_ns))
            self._stage.at(from_ns, lambda: self.began.append((from_ns, fault)))
        else:
            self._stage.at(from_ns, lambda: self._begin(fault, until_ns))

    def _begin(self, fault: FaultConfig, until_ns: int) -> None:
        self.began.append((self._stage.now_ns, fault))
        if fault.kind in _OF_SENSORS:
            nodes = [node for node in self._stage.sensors if fault.sensor in (None, node.name)]
            undo = sensor.tapped(nodes, _OF_SENSORS[fault.kind](fault.amount))
            if until_ns < FOREVER_NS:
                self._stage.at(until_ns, undo)
            return
        names = self._stage.axis_names
        axes = range(len(names)) if fault.axis is None else (names.index(fault.axis),)
        for axis in axes:
            undone = _BEGIN[fault.kind](self._stage, axis, fault)
            if undone is not None and until_ns < FOREVER_NS:
                self._stage.at(until_ns, undone)


@dataclass
class _Waiting:
    """A fault that waits for a state or phase."""

    fault: FaultConfig
    entries_left: int


# one function per kind: begins it on one axis, and returns how to end it ----------------------------------------------


def _tap_samples(stage: EmulatedStage, axis: int, tap: Callable[[Sample], Sample]) -> Undo:
    taps = stage.drives[axis].taps
    taps.append(tap)
    return lambda: taps.remove(tap)


def _tap_frames(stage: EmulatedStage, axis: int, change: Callable[[Frame], Sequence[Frame]]) -> Undo:
    def tap(sender: int, frame: Frame) -> Sequence[Frame]:
        return change(frame) if sender == axis else (frame,)

    stage.frame_taps.append(tap)
    return lambda: stage.frame_taps.remove(tap)


def _counts(stage: EmulatedStage, axis: int, metres: float) -> int:
    return round(metres / stage.drives[axis].resolution)


def _random(fault: FaultConfig, axis: int) -> Random:
    return Random(fault.seed * 1000 + axis)


def _silent(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    return _tap_frames(stage, axis, lambda _frame: ())


def _stuck(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    count = round(float(stage.position[axis]) / stage.drives[axis].resolution)
    return _tap_samples(stage, axis, lambda sample: replace(sample, position=count))


def _jump(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    offset = _counts(stage, axis, fault.amount)
    return _tap_samples(stage, axis, lambda sample: replace(sample, position=sample.position + offset))


def _glitch(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    offset, random = _counts(stage, axis, fault.amount), _random(fault, axis)

    def tap(sample: Sample) -> Sample:
        return replace(sample, position=sample.position + offset) if random.chance(fault.probability) else sample

    return _tap_samples(stage, axis, tap)


def _noise(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    span, random = _counts(stage, axis, fault.amount), _random(fault, axis)
    return _tap_samples(
        stage, axis, lambda sample: replace(sample, position=sample.position + random.below(2 * span + 1) - span)
    )


def _extreme(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    return _tap_samples(stage, axis, lambda sample: replace(sample, position=_MOST_NEGATIVE))


def _show(stage: EmulatedStage, axis: int, bits: int) -> Undo:
    drive = stage.drives[axis]
    drive.extra_status |= int(bits)

    def undo() -> None:
        drive.extra_status &= ~int(bits)

    return undo


def _status(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    return _show(stage, axis, KINDS[fault.kind].shows)


def _limit_switch(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    return _show(stage, axis, DriveStatus.LIMIT_LOW if fault.amount < 0 else DriveStatus.LIMIT_HIGH)


def _drive_fault(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo | None:
    drive = stage.drives[axis]
    drive.fail()
    if fault.duration_s is None and fault.duration_ticks is None:
        return None  # happened once; a reset clears it
    drive.broken = True

    def repair() -> None:
        drive.broken = False

    return repair


def _drive_watchdog(stage: EmulatedStage, axis: int, fault: FaultConfig) -> None:
    stage.drives[axis].trip(stage.now_ns)


def _wrong_sequence(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    offset = round(fault.amount)
    return _tap_samples(stage, axis, lambda sample: replace(sample, sequence=sample.sequence + offset))


def _bad_checksum(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    random = _random(fault, axis)

    def change(frame: Frame) -> tuple[Frame]:
        if not frame.data or not random.chance(fault.probability):
            return (frame,)
        flipped = int.from_bytes(frame.data, "little") ^ 1 << random.below(8 * len(frame.data))
        return (frame._replace(data=flipped.to_bytes(len(frame.data), "little")),)

    return _tap_frames(stage, axis, change)


def _garbage(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    random = _random(fault, axis)
    return _tap_frames(
        stage, axis, lambda frame: (frame._replace(data=bytes(random.below(256) for _ in range(len(frame.data)))),)
    )


def _stale(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    kept: deque[Frame] = deque(maxlen=round(fault.amount) + 1)

    def change(frame: Frame) -> tuple[Frame]:
        kept.append(frame)
        return (kept[0],)

    return _tap_frames(stage, axis, change)


def _duplicate(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    return _tap_frames(stage, axis, lambda frame: (frame, frame))


def _reordered(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    held: list[Frame] = []

    def change(frame: Frame) -> Sequence[Frame]:
        if held:
            return (frame, held.pop())
        held.append(frame)
        return ()

    return _tap_frames(stage, axis, change)


def _clock_jump(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    offset_ns = round(fault.amount * 1e9)
    return _tap_samples(stage, axis, lambda sample: replace(sample, stamp_ns=sample.stamp_ns + offset_ns))


def _torque_constant(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    drive = stage.drives[axis]
    drive.gain = fault.amount

    def undo() -> None:
        drive.gain = 1.0

    return undo


def _jam(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    stage.jam(axis, fault.amount)
    return lambda: stage.jam(axis, 0.0)


def _push(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    stage.push(axis, fault.amount)
    return lambda: stage.push(axis, 0.0)


def _change_plant(stage: EmulatedStage, axis: int, fault: FaultConfig) -> Undo:
    key = fault.kind.removeprefix(PLANT_PREFIX)
    before = stage.change_plant(axis, key, fault.amount)

    def undo() -> None:
        stage.change_plant(axis, key, before)

    return undo


_BEGIN: dict[str, Callable[[EmulatedStage, int, FaultConfig], Undo | None]] = {
    "encoder_silent": _silent,
    "encoder_stuck": _stuck,
    "encoder_jump": _jump,
    "encoder_glitch": _glitch,
    "encoder_noise": _noise,
    "encoder_extreme": _extreme,
    "limit_switch": _limit_switch,
    "drive_fault": _drive_fault,
    "drive_watchdog": _drive_watchdog,
    "wrong_sequence": _wrong_sequence,
    "bad_checksum": _bad_checksum,
    "garbage": _garbage,
    "stale_feedback": _stale,
    "duplicate_feedback": _duplicate,
    "reordered_feedback": _reordered,
    "clock_jump": _clock_jump,
    "torque_constant": _torque_constant,
    "axis_jam": _jam,
    "push": _push,
}
_OF_SENSORS: dict[str, Callable[[float], Callable[[sensor.SensorNode], sensor.Tap]]] = {
    "sensor_silent": lambda _: sensor.silent,
    "sensor_stuck": lambda _: sensor.stuck,
    "sensor_value": sensor.showing,
    "sensor_invalid": lambda _: sensor.invalid,
    "sensor_sequence": lambda value: sensor.renumbered(round(value)),
}
_BEGIN |= {kind: _change_plant for kind in KINDS if kind.startswith(PLANT_PREFIX)}
_BEGIN |= {kind: _status for kind, meaning in KINDS.items() if meaning.shows}
