"""Axes of one stage whose motion the native kernel computes (sim_plant/native), with the bits of `RealAxis`.

All that the kernel needs of an axis, its state included, lies in one row of an array, in the order of `axis` in
dynamics.h. What the kernel leaves to Python, because it would raise there, RealAxis does.
"""

from array import array
from collections.abc import Callable, Sequence
from typing import Final

from sim_plant.physics.dynamics import Dynamics
from sim_plant.physics.encoder import KEPT, Encoder, Point
from sim_plant.physics.real_axis import RealAxis, piece_times
from sim_plant.physics.structure import HUNG, LINES, SLIPS, Motion

Advance = Callable[[int, int, float, float, int, int], int]
Show = Callable[[int, float, int], float]

_MOTION: Final = 10 + 2 * HUNG + SLIPS  # words of a motion; of a point: 3
_PARAMETERS: Final = 2 + 24 + 3 * HUNG + 2 * SLIPS + 6 * LINES + 16 + 4 * HUNG + 6
_KEYS: Final = 3
_COMMAND: Final = _PARAMETERS + _KEYS
_STEPS: Final = _COMMAND + 1
_LAG_STEP: Final = _COMMAND + 2
_N_PAST: Final = _COMMAND + 6
_AT: Final = _COMMAND + 7
_VELOCITY: Final = _AT + 1
_PIERCED: Final = _AT + 2
_LOAD_VELOCITY: Final = _AT + 4
_PLAYED: Final = _AT + 8
_PAST: Final = _AT + _MOTION
WORDS: Final = _PAST + 3 * KEPT
WORD: Final = 8  # bytes
LEFT: Final = -1.0  # number of steps of an axis that the kernel left to Python


def takes(axis: object) -> bool:
    """Whether the kernel can compute this axis."""
    return isinstance(axis, RealAxis) and isinstance(axis.engine, Dynamics)


class NativeAxis:
    """One row. It has the members of RealAxis."""

    def __init__(self, reference: RealAxis, encoder: Encoder, words: "array[float]", row: int) -> None:
        """reference: the axis in Python, whose state it takes over. words: rows of WORDS."""
        self.reference = reference
        self.encoder = encoder
        self._words = words
        self._row = row * WORDS
        self._shows_motor = encoder.is_ideal
        self._fill()
        self.restore(reference.state)

    def _fill(self) -> None:
        axis, words = self.reference, self._words
        engine, disturbance = axis.engine, axis.disturbance
        assert isinstance(engine, Dynamics)
        values: list[float] = [float(engine.kind), axis.constant, *engine.parameters()]
        values += disturbance.parameters() if disturbance else [0.0, 0.0]
        values += self.encoder.parameters()
        assert len(values) == _PARAMETERS
        words[self._row : self._row + _PARAMETERS] = array("d", values)
        whole = memoryview(words).cast("B").cast("Q")
        keys = [*(disturbance.keys() if disturbance else (0, 0)), self.encoder.key]
        for index, key in enumerate(keys):
            whole[self._row + _PARAMETERS + index] = key
        words[self._row + _LAG_STEP] = -1.0

    @property
    def state(self) -> tuple[Motion, tuple[Point, ...]]:
        """What `restore` takes."""
        return self.motion, self.past

    def restore(self, state: tuple[Motion, tuple[Point, ...]]) -> None:
        """Back to a state it had."""
        motion, past = state
        begin, words = self._row, self._words
        words[begin + _AT : begin + _PAST] = array("d", motion)
        words[begin + _N_PAST] = float(len(past))
        for index, (time, position, velocity) in enumerate(past):
            place = begin + _PAST + 3 * index
            words[place] = time
            words[place + 1] = position
            words[place + 2] = velocity

    @property
    def motion(self) -> Motion:
        """Its state without its past."""
        return Motion(*self._words[self._row + _AT : self._row + _PAST])

    @property
    def past(self) -> tuple[Point, ...]:
        """Where its pieces began, oldest first."""
        begin, words = self._row + _PAST, self._words
        count = int(words[self._row + _N_PAST])
        return tuple([(words[i], words[i + 1], words[i + 2]) for i in range(begin, begin + 3 * count, 3)])

    @property
    def position(self) -> float:
        """The tool's, m."""
        return self._words[self._row + _PLAYED]

    @property
    def velocity(self) -> float:
        """The load's, m/s."""
        return self._words[self._row + _LOAD_VELOCITY]

    @property
    def pierced(self) -> float:
        """1.0 or 0.0."""
        return self._words[self._row + _PIERCED]

    def command(self, force: float) -> None:
        """The force (N) from now on."""
        self._words[self._row + _COMMAND] = force

    def finish(self, times: list[float], h: float, command: float, count: int) -> None:
        """Do these pieces in Python, if the kernel left them to it."""
        if self._words[self._row + _STEPS] == LEFT:
            self.reference.restore(self.state)
            self.reference.advance(times, h, command, count)
            self.restore(self.reference.state)

    def reading(self, show: Show, address: int, now: float) -> float:
        """What its encoder shows at that time (s), m; each call is a sample of its own. address: of the first row."""
        encoder = self.encoder
        count: int = encoder.read
        encoder.read = count + 1
        if self._shows_motor:
            return self._words[self._row + _AT]
        return show(address + self._row * WORD, now, count)


class NativeAxes:
    """Those axes of one stage that the kernel computes. axes: (index in the stage, axis)."""

    def __init__(self, advance: Advance, show: Show, found: list[tuple[int, RealAxis, Encoder]]) -> None:
        """advance, show: of the kernel (sim_plant/native/library.py). found: axes to take over."""
        words = array("d", bytes(WORDS * WORD * len(found)))
        self._advance = advance
        self.show = show
        self.address = words.buffer_info()[0]
        self.axes = [(i, NativeAxis(axis, encoder, words, row)) for row, (i, axis, encoder) in enumerate(found)]

    def advance(self, begin: float, h: float, number: int, commands: Sequence[float], count: int) -> None:
        """By `number` pieces of h seconds from `begin` (s). commands: N, of every axis. count: pieces begun."""
        for index, axis in self.axes:
            axis.command(commands[index])
        if self._advance(self.address, len(self.axes), begin, h, number, count):
            times = piece_times(begin, h, number)
            for index, axis in self.axes:
                axis.finish(times, h, commands[index], count)
