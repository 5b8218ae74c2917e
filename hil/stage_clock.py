"""The control cycle with a clock at the seams between its stages.

The cycle itself reads no clock, so that lockstep and replay are exact; only the live shell wants to know where the time
goes, and wraps what it runs.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

from drivers.frame import Frame
from hil.config import RigConfig
from hil.cycle import ControlCycle
from hil.laws.base import Array, Law, LawInputs
from hil.state_machine import State
from hil.tick import Tick

ESTIMATE, CONTROL, GATE, RECORD = range(4)  # indices into `stamps`: when each of them began


class _StampedLaw(Law):
    """A law that notes when it has answered: from then on it is the gate's turn."""

    GAINS: ClassVar[dict[str, Any]] = {}

    def __init__(self, law: Law, stamps: list[int], clock: Callable[[], int]) -> None:
        self.name = law.name
        self._law, self._stamps, self._clock = law, stamps, clock

    def __getattr__(self, name: str) -> Any:
        return getattr(self._law, name)

    @property
    def denominator_floors(self) -> int:
        """Asked for in every tick; by way of __getattr__ a law without it would cost an exception each time."""
        return int(getattr(self._law, "denominator_floors", 0))

    def reset(self, position: Array, force: Array) -> None:
        self._law.reset(position, force)

    def force(self, inputs: LawInputs) -> Array:
        asked = self._law.force(inputs)
        self._stamps[GATE] = self._clock()
        return asked


class TimedCycle(ControlCycle):
    """stamps: when the tick's estimate, control, gate and record began, on `clock` (ns).

    record_bytes: the record of every tick's result, for the fields that only the shell knows.
    """

    def __init__(self, rig: RigConfig, base_dir: Path, clock: Callable[[], int]) -> None:
        super().__init__(rig, base_dir)
        self.stamps = [0, 0, 0, 0]
        self.record_bytes = memoryview(self._records.buffer)
        self._clock = clock
        self.law = _StampedLaw(self.law, self.stamps, clock)

    def _estimate(self, tick: Tick) -> None:
        self.stamps[ESTIMATE] = self._clock()
        super()._estimate(tick)
        self.stamps[CONTROL] = self._clock()

    def _act(self, tick: Tick, before: State) -> list[Frame]:
        self.stamps[GATE] = self._clock()  # where no law is asked
        frames = super()._act(tick, before)
        self.stamps[RECORD] = self._clock()
        return frames
