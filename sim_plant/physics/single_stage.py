"""The axes of one stage, of floats, and their encoders: what a lockstep run and the live emulator advance."""

from collections.abc import Sequence
from typing import Final

from sim_plant.physics.encoder import Encoder
from sim_plant.physics.native_axis import NativeAxes, NativeAxis
from sim_plant.physics.noise import Key
from sim_plant.physics.real_axis import RealAxis, piece_times
from sim_plant.physics.single_axis import SingleAxis

IDEAL_PIECE_NS: Final = 1_000_000  # of constant force, at most, for an ideal axis
# Of constant noise, at most, for one that deviates; its steps are chosen anew for each. Half a period of 1 kHz, and the
# hundredth that one tick may be longer than another.
REAL_PIECE_NS: Final = 505_000


def encoder_of(values: tuple[float, float, float, float], key: tuple[Key, Key], read: int) -> Encoder:
    """The encoder of an axis of floats, from which `read` samples were taken."""
    encoder = Encoder(values, key)
    encoder.read = read
    return encoder


class SingleStage:
    """axes and encoders: in axis order. drifts: m/s each, of the tool against its encoder; none: empty. native: those
    of the axes that the native kernel computes.
    """

    def __init__(
        self,
        axes: list[SingleAxis | RealAxis | NativeAxis],
        encoders: list[Encoder],
        constants: list[float],
        drifts: list[float],
        native: NativeAxes | None,
    ) -> None:
        """constants: N, gravity and bias of each axis."""
        self.axes = axes
        self.encoders = encoders
        self.is_ideal = all(isinstance(axis, SingleAxis) for axis in axes)
        self._shows_truth = self.is_ideal and all(encoder.is_ideal for encoder in encoders)
        self._constants = constants
        self._drifts = drifts
        self._native = native

    def positions(self, elapsed: float) -> list[float]:
        """Of the tools, m, after that many seconds of drift."""
        if not self._drifts:
            return [axis.position for axis in self.axes]
        return [axis.position + drift * elapsed for axis, drift in zip(self.axes, self._drifts, strict=True)]

    def velocities(self) -> list[float]:
        """Of the tools, m/s."""
        if not self._drifts:
            return [axis.velocity for axis in self.axes]
        return [axis.velocity + drift for axis, drift in zip(self.axes, self._drifts, strict=True)]

    def readings(self, now: float) -> list[float]:
        """What the encoders show at that time (s), m; each call is a sample of its own."""
        if self._shows_truth:
            return [axis.position for axis in self.axes]
        return [self.reading(index, now) for index in range(len(self.axes))]

    def reading(self, index: int, now: float) -> float:
        """What one encoder shows at that time (s), m; each call is a sample of its own."""
        axis, native = self.axes[index], self._native
        if native is not None and isinstance(axis, NativeAxis):
            return axis.reading(native.show, native.address, now)
        encoder = self.encoders[index]
        if isinstance(axis, RealAxis):
            motion, past = axis.motion, axis.past
            shown: float = encoder.show(past, (now, motion.position, motion.velocity))
        else:
            shown = encoder.show((), (now, axis.position, axis.velocity))
        return shown

    def advance(self, duration_ns: int, elapsed_ns: int, commands: Sequence[float], count: int) -> int:
        """Advance by duration_ns > 0, from elapsed_ns, with these forces (N) held. `count`: real pieces before; returns
        how many there are now."""
        pieces = -(-duration_ns // IDEAL_PIECE_NS)
        h = duration_ns * 1e-9 / pieces
        if self.is_ideal:
            for index, axis in enumerate(self.axes):
                if isinstance(axis, SingleAxis):
                    axis.advance(pieces, h, commands[index] + self._constants[index])
            return count
        number, native = real_pieces(duration_ns), self._native
        begin, short = elapsed_ns * 1e-9, duration_ns * 1e-9 / number
        if native is not None:
            native.advance(begin, short, number, commands, count)
        for index, axis in enumerate(self.axes):
            if isinstance(axis, RealAxis):
                axis.advance(piece_times(begin, short, number), short, commands[index], count)
            elif isinstance(axis, SingleAxis):
                axis.advance(pieces, h, commands[index] + self._constants[index])
        return count + number


def real_pieces(duration_ns: int) -> int:
    """How many equal pieces of so long a time an axis that deviates is advanced by."""
    return -(-duration_ns // REAL_PIECE_NS)
