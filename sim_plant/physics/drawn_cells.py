"""Each cell of a dish, drawn: values around the preset's, its anomaly, and what that makes of it.

A cell's numbers are a function of the dish's seed and its place in the list; each value has its own count, so that
neither a cell nor a value more moves another. Amounts of anomalies are assumed, and stated here alone.
"""

import math
from typing import Final, NamedTuple

from sim_plant.cell_presets import PRESETS
from sim_plant.dish_config import DRAWN, DishConfig, LayerConfig
from sim_plant.physics.cell import Cell, Handling, Layer, power_of
from sim_plant.physics.noise import CELL, Stream, uniform_of

BROKEN_BY: Final = 1e-3  # m that a broken pipette lacks
_CUT: Final = 3.0  # standard deviations
_LEAST: Final = 0.25  # of a mean, whatever its spread

# Counts of the uniform numbers; normal ones are counted by layer behind _HEIGHT.
_HAS_ANOMALY, _WHICH, _AMOUNT, _WHEN, _HOW = range(5)
_HEIGHT: Final = 0
_PER_LAYER: Final = 4


class Drawn(NamedTuple):
    """anomaly: a word, "" if it is good. height: m of its top over the dish's, along the axis. fails_at: m below its
    top at which sensor or camera fails. flow: boluses a second through the valve into it.
    """

    model: Cell
    anomaly: str
    height: float
    fails_at: float
    fails_silent: bool
    flow: float


class _Numbers:
    """The numbers of one cell."""

    def __init__(self, seed: int, number: int, spread: bool) -> None:
        self._stream = Stream(seed, number, CELL)
        self._spread = spread

    def uniform(self, count: int) -> float:
        return uniform_of(self._stream.key ^ 0x5851F42D4C957F2D, count)

    def between(self, count: int, low: float, high: float) -> float:
        return low + (high - low) * self.uniform(count)

    def normal(self, count: int) -> float:
        """Mean 0, standard deviation 1; 0 where cells do not differ."""
        return max(-_CUT, min(_CUT, float(self._stream.at(count)))) if self._spread else 0.0

    def around(self, mean: float, spread: float, count: int) -> float:
        return mean * max(_LEAST, 1.0 + spread * self.normal(count))


def drawn(config: DishConfig, number: int) -> Drawn:
    """The cell at that place of the list."""
    numbers = _Numbers(config.seed, number, config.spread)
    preset = PRESETS[config.preset]
    layers = [_layer(entry, config.tip, numbers, place) for place, entry in enumerate(config.layers or preset.layers)]
    anomaly = _anomaly(config, number, numbers)
    outermost = layers[0]
    amount = numbers.between(_AMOUNT, 0.0, 1.0)
    handling = Handling(preset.lateral_stiffness, preset.slip_off)
    if anomaly == "no_cell":
        layers = []
    elif anomaly == "not_pierced":
        layers = [_tougher(layer, 3.0 + 2.0 * amount) for layer in layers]
    elif anomaly == "double":
        layers.append(_far(outermost, amount))
    elif anomaly == "rolled":
        force = (0.2 + 0.5 * amount) * outermost.force
        distance, time = 25e-6 + 35e-6 * numbers.uniform(_WHEN), 5e-3 + 55e-3 * numbers.uniform(_HOW)
        handling = handling._replace(roll_force=force, roll_distance=distance, roll_time=time)
    elif anomaly == "stuck":
        hold = (0.5 + 0.5 * amount) * outermost.force
        layers = [layer._replace(adhesion=2.0 * hold) for layer in layers]
        handling = handling._replace(hold=hold)
    top_spread = preset.top_spread if config.top_spread is None else config.top_spread
    fails_at = numbers.between(_WHEN, -20e-6, 0.8 * _depth(outermost))
    flow = config.flow * (0.25 if anomaly == "clogged" else 1.0)
    height = top_spread * numbers.normal(_HEIGHT)
    return Drawn(Cell(layers, handling), anomaly, height, fails_at, numbers.uniform(_HOW) < 0.5, flow)


def _anomaly(config: DishConfig, number: int, numbers: _Numbers) -> str:
    if number < len(config.anomalies):
        return config.anomalies[number]
    if numbers.uniform(_HAS_ANOMALY) >= config.anomaly_share:
        return ""
    return DRAWN[int(numbers.uniform(_WHICH) * len(DRAWN))]


def _layer(entry: LayerConfig, tip: float, numbers: _Numbers, place: int) -> Layer:
    first = _HEIGHT + 1 + _PER_LAYER * place
    force = numbers.around(entry.force, entry.force_spread, first)
    if entry.depth is not None:
        depth = numbers.around(entry.depth, entry.spread, first + 1)
        stiffness = force / power_of(depth, entry.power)
    else:
        assert entry.stiffness is not None
        stiffness = numbers.around(entry.stiffness, entry.spread, first + 1)
    puncture_depth = math.inf if entry.puncture_depth is None else entry.puncture_depth
    layer = Layer(
        entry.offset, stiffness, entry.power, force * tip, puncture_depth, entry.viscous_share, entry.viscous_time,
        entry.rate_gain, entry.slip_time, entry.friction, entry.adhesion, 1.0, entry.drag,
    )  # fmt: skip
    return layer._replace(shaft=layer.force / _depth(layer))


def _tougher(layer: Layer, factor: float) -> Layer:
    """One that bears so many times as much, and gives way as before."""
    return layer._replace(force=factor * layer.force, puncture_depth=math.inf)


def _far(layer: Layer, amount: float) -> Layer:
    """A second membrane close behind the puncture of the first."""
    force = (0.5 + 0.4 * amount) * layer.force
    depth = 12e-6 + 13e-6 * amount
    return Layer(5e-6, force / (depth * depth), 2.0, force, slip_time=layer.slip_time, is_far=True)


def _depth(layer: Layer) -> float:
    """m at which a fast press reaches the puncture force."""
    ratio = layer.force / layer.stiffness
    if layer.power == 2.0:
        return math.sqrt(ratio)
    # ratio = depth^1.5 or depth^3: Newton's steps for the cube, from above, which end in the same bits everywhere
    cube = ratio * ratio if layer.power == 1.5 else ratio
    root, lower = math.inf, max(1.0, cube)
    while lower < root:
        root, lower = lower, lower - (lower * lower * lower - cube) / (3.0 * lower * lower)
    return root
