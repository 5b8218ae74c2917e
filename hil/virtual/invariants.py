"""What must hold in every tick of every run, checked on the frames themselves: through the drives' own decoder, not the
gate's variables.
"""

from collections.abc import Sequence
from pathlib import Path

from drivers.frame import Frame
from drivers.protocols import device_protocol
from drivers.protocols.base import Command
from hil.cycle.fault_table import ROWS, Fault, Reaction
from hil.cycle.state_machine import TORQUE_STATES, State
from hil.cycle.tick import CycleResult, Tick
from hil.rig.schema import RigConfig

TOLERANCE = 1e-6  # of the force limit: float32 on the bus


class InvariantError(AssertionError):
    """A tick that must never happen; the text says which rule broke, and when."""


class Invariants:
    """Observer of a run (`observe` fits LockstepRun's observer). Raises InvariantError at the first violation."""

    def __init__(self, rig: RigConfig, base_dir: Path) -> None:
        axes = list(rig.axes.values())
        self._device = device_protocol(rig.bus, len(axes), [axis.rated_force for axis in axes], base_dir, rig.mountings)
        self._modulus = getattr(self._device, "sequence_modulus", 0)
        self._limit = [axis.limits.force * (1 + TOLERANCE) + self._quantum(axis.rated_force) for axis in axes]
        period = rig.period_ns * 1e-9
        self._step = [
            axis.limits.force_rate * period + self._limit[i] * TOLERANCE + 2 * self._quantum(axis.rated_force)
            for i, axis in enumerate(axes)
        ]
        self._force = [0.0] * len(axes)
        self._sequence = -1
        self._enable_lag = int(getattr(self._device, "enable_lag", 0))
        self._forbidden = 0  # commands in a row that the state permits no torque in
        self._previous = State.BOOT
        self._silent = False
        self.ticks = 0
        self.peak = [0.0] * len(axes)

    def _quantum(self, rated_force: float) -> float:
        return rated_force * float(getattr(self._device, "force_resolution", 0.0))

    def observe(self, tick: Tick, frames: Sequence[Frame], result: CycleResult) -> None:
        """Check one tick."""
        self.ticks += 1
        state = State(int(result.record["state"]))
        fault = Fault(int(result.record["fault"]))
        self._check_silence(tick, state, fault, result)
        for frame in result.frames:
            command = self._device.decode_command(frame)
            if isinstance(command, Command):
                self._check_command(tick, state, command)
        self._previous = state

    def _check_silence(self, tick: Tick, state: State, fault: Fault, result: CycleResult) -> None:
        entering = self._previous is not state
        if result.frames and (state is State.BOOT or (state is State.SHUTDOWN and not entering)):
            self._fail(tick, f"frames sent in {state.name}")
        if state is State.FAULT and fault is not Fault.NONE and ROWS[fault].reaction is Reaction.SILENT:
            self._silent = True
        elif state is State.CONNECTED:
            self._silent = False
        if self._silent and result.frames:
            self._fail(tick, f"frames sent after {fault.name}, whose reaction is silence")

    def _check_command(self, tick: Tick, state: State, command: Command) -> None:
        self._check_sequence(tick, command)
        permitted = state in TORQUE_STATES
        self._forbidden = 0 if permitted else self._forbidden + 1
        enabled = command.enable if self._forbidden > self._enable_lag else 0
        for axis, force in enumerate(command.force):
            if force - force != 0.0:
                self._fail(tick, f"axis {axis}: force {force} is not finite")
            if not permitted and (force != 0.0 or enabled):
                self._fail(tick, f"axis {axis}: force {force}, enable {command.enable} in {state.name}")
            if abs(force) > self._limit[axis]:
                self._fail(tick, f"axis {axis}: force {force} beyond the limit {self._limit[axis]}")
            change = abs(force - self._force[axis])
            if permitted and force != 0.0 and change > self._step[axis]:
                self._fail(tick, f"axis {axis}: force changed by {change}, allowed {self._step[axis]} in a tick")
            self._force[axis] = force
            self.peak[axis] = max(self.peak[axis], abs(force))

    def _check_sequence(self, tick: Tick, command: Command) -> None:
        if not self._modulus:
            return
        if self._sequence >= 0 and (command.sequence - self._sequence) % self._modulus != 1:
            self._fail(tick, f"sequence {command.sequence} after {self._sequence}")
        self._sequence = command.sequence

    @staticmethod
    def _fail(tick: Tick, what: str) -> None:
        raise InvariantError(f"tick {tick.index}: {what}")
