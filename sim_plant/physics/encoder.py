"""What an encoder shows of the motor's position: late, with an error within the signal period, and with noise.

    shown(t) = q + E sin(2 pi q / P) + noise,   q = position(t - latency)

One source for floats and arrays (number.py). The sinusoid is the subdivisional error of interpolated sine and cosine
signals (Heydemann, Applied Optics 20(19), 1981) in its first harmonic.
"""

from collections.abc import Sequence
from typing import Final

from sim_plant.physics.noise import ENCODER, Key, Stream
from sim_plant.physics.number import Number, anywhere, select, sine

Point = tuple[float, Number, Number]  # time, s; position, m; velocity, m/s

KEPT: Final = 8  # points of the past: more than the longest latency takes


class Encoder:
    """Of one axis (floats) or of many (arrays). read: samples drawn so far."""

    def __init__(self, values: tuple[Number, Number, Number, Number], key: tuple[Key, Key]) -> None:
        """values: noise, m RMS; amplitude and period of the periodic error, m; latency, s. key: seed and axis."""
        noise, error, period, latency = values
        self._noise = noise
        self._error = error
        self._wavenumber: Number = 1.0 / period
        self._latency = latency
        self._stream = Stream(key[0], key[1], ENCODER)
        self._is_noisy = anywhere(noise != 0.0)
        self._is_periodic = anywhere(error != 0.0)
        self.is_late = anywhere(latency != 0.0)
        self.read = 0

    @property
    def is_ideal(self) -> bool:
        """Whether it shows the position as it is."""
        return not (self._is_noisy or self._is_periodic or self.is_late)

    def parameters(self) -> list[Number]:
        """Noise (m), amplitude (m) and wavenumber (turns/m) of the periodic error, latency (s)."""
        return [self._noise, self._error, self._wavenumber, self._latency]

    @property
    def key(self) -> int:
        """Of one axis: the key of its stream of noise."""
        key: int = self._stream.key
        return key

    def show(self, past: Sequence[Point], now: Point) -> Number:
        """The next sample, m. past: earlier points, oldest first."""
        shown = _delayed(past, now, self._latency) if self.is_late else now[1]
        if self._is_periodic:
            shown = shown + self._error * sine(shown * self._wavenumber)
        if self._is_noisy:
            shown = shown + self._noise * self._stream.at(self.read)
        self.read += 1
        return shown


def _delayed(past: Sequence[Point], now: Point, latency: Number) -> Number:
    """Position `latency` before now: cubic Hermite interpolation; before the first point, that one's."""
    t1, q1, v1 = now
    shown = q1
    for t0, q0, v0 in reversed(past):
        inside = latency > now[0] - t1
        if not anywhere(inside):
            break
        h = t1 - t0
        s = (now[0] - latency - t0) / h
        s = select(s < 0.0, 0.0, s)
        r = 1.0 - s
        earlier = r * r * (q0 * (1.0 + 2.0 * s) + h * s * v0) + s * s * (q1 * (1.0 + 2.0 * r) - h * r * v1)
        shown = select(inside, earlier, shown)
        t1, q1, v1 = t0, q0, v0
    return shown
