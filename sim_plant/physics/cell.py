"""One layered cell as its tool feels it: depths in, forces out. It knows no axis, no motor and no dish.

Each layer (a membrane) presses back with k u^n of a depth u, of which a share fades when the depth is held. It is a
spring u^n in series with a damper, so that the layer gives back less work than it got whatever the tip does. Force or
depth pierce it. Then its force is gone within the slip time, and the shaft of the pipette rubs in the hole: the
membrane is dragged along until the friction is reached, inwards, or the adhesion, outwards.

Only + - * / and roots: a run is the same on every machine. Values and their sources: sim_plant/cell_presets.py.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from sim_plant.physics.number import decay

LONGEST_NS: Final = 250_000  # of a substep
REFERENCE_SPEED: Final = 1e-3  # m/s, at which a layer's puncture force is stated
DECADES: Final = 2.0  # of loading speed around it in which the puncture force changes
_LN2: Final = 0.6931471805599453
_LN10: Final = 2.302585092994046


class Layer(NamedTuple):
    """One membrane.

    offset: m below the cell's top; of a far layer, below where the cell was opened. stiffness: k, N/m^power. power:
    1.5, 2 or 3. force: N, pierces it at REFERENCE_SPEED. puncture_depth: m, pierces it at the latest. viscous_share (0
    to 0.95), viscous_time (s): part of a held force that fades, and how fast. rate_gain: more force by this part for
    each decade of loading speed. slip_time: s. friction, adhesion: N, of the shaft inwards and outwards. shaft: N/m, of
    the membrane that sticks to it. drag: N s/m, once pierced. is_far: piercing it is one too many.
    """

    offset: float
    stiffness: float
    power: float
    force: float
    puncture_depth: float = math.inf
    viscous_share: float = 0.0
    viscous_time: float = 0.15
    rate_gain: float = 0.0
    slip_time: float = 3e-3
    friction: float = 0.0
    adhesion: float = 0.0
    shaft: float = 4.0
    drag: float = 0.0
    is_far: bool = False


class Handling(NamedTuple):
    """How the whole cell gives way: lateral_stiffness (N/m), slip_off (N, sideways). It rolls away for roll_distance
    (m) within roll_time (s) once it bears roll_force (N). It leaves the dish with the pipette once that pulls with hold
    (N).
    """

    lateral_stiffness: float = 0.0
    slip_off: float = math.inf
    roll_force: float = math.inf
    roll_distance: float = 0.0
    roll_time: float = 0.05
    hold: float = math.inf


@dataclass
class Puncture:
    """at_ns: when. depth: m below the cell's top. force: N of this layer. speed: m/s of the tip."""

    at_ns: int
    depth: float
    force: float
    speed: float


@dataclass
class LayerState:
    """One layer in time. force: N, pressing positive. crept: m, what of its depth has faded."""

    layer: Layer
    force: float = 0.0
    puncture: Puncture | None = None
    crept: float = 0.0
    touched_s: float = 0.0  # for how long the tip has pressed on it
    slipped_s: float = 0.0  # since it was pierced
    stretch: float = 0.0  # m of the membrane along the shaft, pulled inwards positive
    released: bool = False  # the shaft has left the hole since

    def press(self, depth: float, before: float, h: float) -> float:
        """Force (N) of the whole layer after h seconds in which the tip went to this depth (m, in the layer)."""
        layer = self.layer
        lasting = layer.power * layer.viscous_time
        mean = 0.5 * (max(depth, 0.0) + max(before, 0.0))
        self.crept += (mean - self.crept) * (h / (lasting + 0.5 * h))
        if depth <= 0.0:
            self.touched_s = 0.0
            return 0.0
        self.touched_s += h * (depth / (depth - before) if before < 0.0 else 1.0)
        spring = layer.stiffness * power_of(depth, layer.power)
        fading = layer.stiffness * power_of(max(depth - self.crept, 0.0), layer.power)
        return (1.0 - layer.viscous_share) * spring + layer.viscous_share * fading

    def rest(self, seconds: float) -> None:
        """Let time pass without the tip."""
        self.crept *= decay(seconds / (self.layer.power * self.layer.viscous_time))
        self.touched_s = 0.0

    def strength(self, depth: float) -> float:
        """Force (N) that pierces it at the mean speed since the touch."""
        layer = self.layer
        if not layer.rate_gain:
            return layer.force
        speed = depth / self.touched_s if self.touched_s > 0.0 else REFERENCE_SPEED
        decades = max(-DECADES, min(DECADES, decades_of(speed / REFERENCE_SPEED)))
        return layer.force * (1.0 + layer.rate_gain * decades)

    def slip(self, depth: float, way: float, h: float) -> float:
        """Force (N) once pierced: what is left of the membrane's, the shaft's and the drag."""
        layer, puncture = self.layer, self.puncture
        assert puncture
        self.slipped_s += h
        left = puncture.force * max(0.0, 1.0 - self.slipped_s / layer.slip_time)
        if layer.shaft > 0.0:
            stretch = self.stretch + way
            self.stretch = max(-layer.adhesion / layer.shaft, min(layer.friction / layer.shaft, stretch))
        if depth <= min(self.stretch, 0.0) or (self.released and depth <= 0.0):
            self.stretch, self.released = 0.0, True
            return 0.0
        if depth > 0.0:
            self.released = False
        return left + layer.shaft * self.stretch + layer.drag * way / h


class Cell:
    """A cell that the tip meets from above.

    force: N on the tip now, pressing positive. depth: m below the top now. peak_force, peak_pull: N, the greatest so
    far. deepest: m. moved: m that it has rolled sideways. has_slipped_off: the tip has left it sideways.
    still_on_pipette: it left the dish with it. touched_ns: the first touch.
    """

    def __init__(self, layers: list[Layer], handling: Handling | None = None) -> None:
        self.layers = [LayerState(layer) for layer in layers]
        self.handling = handling or Handling()
        self.force = self.depth = self.peak_force = self.peak_pull = self.moved = 0.0
        self.deepest = -math.inf
        self.has_slipped_off = self.still_on_pipette = False
        self.touched_ns: int | None = None
        self._rolling_s = -1.0  # since it began to roll
        self._give = 0.0  # m by which it gives way when it rolls
        self._now_ns = 0

    @property
    def opening(self) -> Puncture | None:
        """The puncture that opened the cell: of the last of its layers; None before."""
        found = [state.puncture for state in self.layers if not state.layer.is_far]
        last = None
        for puncture in found:
            if puncture is None:
                return None
            last = puncture if last is None or puncture.at_ns > last.at_ns else last
        return last

    @property
    def far(self) -> Puncture | None:
        """The puncture that was one too many; None before."""
        return next((state.puncture for state in self.layers if state.layer.is_far and state.puncture), None)

    @property
    def is_free(self) -> bool:
        """The tip is out, and nothing holds on to it."""
        return self.depth <= 0.0 and self.force == 0.0

    def advance(self, begin_ns: int, end_ns: int, begin: float, end: float, lateral: float = 0.0) -> float:
        """The force (N) after a motion of the tip at constant speed from depth `begin` to `end` (m below the top).

        begin_ns, end_ns: its instants, begin_ns < end_ns; what was between the last end and this begin the cell spent
        without the tip. lateral: m by which the tip stands beside where it entered.
        """
        if begin_ns > self._now_ns and begin <= 0.0:
            for state in self.layers:
                state.rest((begin_ns - self._now_ns) * 1e-9)
        self._now_ns = end_ns
        handling = self.handling
        self.has_slipped_off |= end > 0.0 and lateral * handling.lateral_stiffness > handling.slip_off
        duration = end_ns - begin_ns
        number = -(-duration // LONGEST_NS)
        h = duration * 1e-9 / number
        way = (end - begin) / number
        depth = begin
        for index in range(1, number + 1):
            before, depth = depth, begin + (end - begin) * index / number
            self._step(before, depth, way, h, begin_ns + duration * (index - 1) // number)
        if end <= 0.0:
            self.has_slipped_off = False
        return self.force

    def _step(self, before: float, depth: float, way: float, h: float, from_ns: int) -> None:
        self.depth = depth
        self.deepest = max(self.deepest, depth)
        if self.touched_ns is None and depth > 0.0:
            self.touched_ns = from_ns + (round(h * 1e9 * before / (before - depth)) if before < 0.0 else 0)
        if self.has_slipped_off or self.still_on_pipette:
            self.force = 0.0
            return
        give = self._rolled(h)
        total, opening = 0.0, self.opening
        for state in self.layers:
            offset = state.layer.offset + give
            if state.layer.is_far:
                if opening is None:
                    continue
                offset += opening.depth
            if state.puncture is not None:
                state.force = state.slip(depth - offset, way, h)
            else:
                self._press(state, offset, (before - offset, depth - offset), (way, h, from_ns))
            total += state.force
        self.force = total
        self.peak_force = max(self.peak_force, total)
        self.peak_pull = max(self.peak_pull, -total)
        if self._rolling_s < 0.0 and total > self.handling.roll_force and self.opening is None:
            self._rolling_s, self._give = 0.0, 0.8 * depth
        if -total > self.handling.hold:
            self.still_on_pipette, self.force = True, 0.0

    def _press(
        self, state: LayerState, top: float, depths: tuple[float, float], step: tuple[float, float, int]
    ) -> None:
        """One layer that is whole and begins at `top`, up to its puncture and behind it."""
        (before, depth), (way, h, from_ns) = depths, step
        was = state.force
        force = state.press(depth, before, h)
        state.force = force
        if depth <= 0.0 or self._rolling_s >= 0.0:
            return
        strength, deepest = state.strength(depth), state.layer.puncture_depth
        by_force = (strength - was) / (force - was) if force >= strength and force > was else 1.0
        by_depth = (deepest - before) / (depth - before) if depth >= deepest and depth > before else 1.0
        if force < strength and depth < deepest:
            return
        part = max(0.0, min(by_force, by_depth))
        bore = was + part * (force - was)
        state.puncture = Puncture(from_ns + round(part * h * 1e9), top + before + part * way, bore, way / h)
        self.peak_force = max(self.peak_force, self.force - was + bore)
        state.force = state.slip(depth, (1.0 - part) * way, max((1.0 - part) * h, 1e-12))

    def _rolled(self, h: float) -> float:
        """m by which it has given way to the tip, after h seconds more."""
        if self._rolling_s < 0.0:
            return 0.0
        self._rolling_s += h
        part = min(1.0, self._rolling_s / self.handling.roll_time)
        self.moved = part * self.handling.roll_distance
        return part * self._give


def power_of(depth: float, power: float) -> float:
    """depth to the power 1.5, 2 or 3, depth >= 0."""
    if power == 2.0:
        return depth * depth
    return depth * depth * depth if power == 3.0 else depth * math.sqrt(depth)


def decades_of(ratio: float) -> float:
    """log10 of a ratio within 1e-10, from + - * / alone; -DECADES where it is not above 0."""
    if ratio <= 0.0:
        return -DECADES
    mantissa, exponent = math.frexp(ratio)
    if mantissa < 0.7071067811865476:
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    y = (mantissa - 1.0) / (mantissa + 1.0)
    z = y * y
    series = 1.0 + z * (1.0 / 3.0 + z * (0.2 + z * (1.0 / 7.0 + z * (1.0 / 9.0 + z * (1.0 / 11.0 + z / 13.0)))))
    return (exponent * _LN2 + 2.0 * y * series) / _LN10
