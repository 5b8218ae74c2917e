"""A dish of cells under the emulated stage's tip: which one the tip is in, what it does to it, and what is true of it.

The force of a cell on the tip acts on the axis as a drive's does. It is held during one piece: a cell is soft, some 10
N/m against the kilograms of an axis.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, Protocol

from sim_plant.dish_config import DishConfig
from sim_plant.physics.cell import Cell, Puncture
from sim_plant.physics.drawn_cells import BROKEN_BY, Drawn, drawn

PIECE_NS: Final = 250_000  # of constant cell force, at most
_NEAR: Final = 50e-6  # m above the highest top
_CLEAR: Final = -50e-6  # m below a cell's top at which what failed with it works again
_NOWHERE: Final = 1e6  # m; where no cell is

Spot = tuple[float, float]


class Pulse(NamedTuple):
    """An opening of the valve. begin_ns, end_ns: when. pierced: the tip was in one pierced cell all the time. bolus: 1
    is a full one.
    """

    begin_ns: int
    end_ns: int
    pierced: bool
    bolus: float


class Moved(Protocol):
    """What a dish moves: the stage of stage.py."""

    @property
    def positions(self) -> list[float]:
        """Of the tips, m."""

    @property
    def velocities(self) -> list[float]:
        """m/s."""

    def advance(self, duration_ns: int, force: Sequence[float]) -> None:
        """Under a constant force, N."""


@dataclass
class DishCell:
    """What is true of one cell. anomaly: "" (good) or a word of DishConfig.anomalies. x, y: m, its middle as planned.
    top: m, position of the axis along which the tip touches it. pulses: into it, or above it.
    """

    number: int
    anomaly: str
    x: float
    y: float
    top: float
    model: Cell
    fails_at: float  # m below its top at which the anomaly's device fails
    fails_silent: bool
    flow: float  # boluses a second
    pulses: list[Pulse] = field(default_factory=list)

    @property
    def contact(self) -> float | None:
        """Position of the axis at which the tip touched it first, m; None: it never did."""
        return None if self.model.touched_ns is None else self.top

    @property
    def touched_ns(self) -> int | None:
        """When the tip touched it first."""
        return self.model.touched_ns

    @property
    def puncture(self) -> Puncture | None:
        """What opened it: at_ns, depth (m below its top), force (N), speed (m/s)."""
        return self.model.opening

    @property
    def pierced_ns(self) -> int | None:
        """When it was pierced; None: it is not."""
        return None if self.model.opening is None else self.model.opening.at_ns

    @property
    def doubled_ns(self) -> int | None:
        """When its far membrane was pierced, too; None: it is not."""
        return None if self.model.far is None else self.model.far.at_ns

    @property
    def peak_force(self) -> float:
        """The greatest force on the tip, N."""
        return self.model.peak_force

    @property
    def peak_pull(self) -> float:
        """The greatest pull at the tip, N."""
        return self.model.peak_pull

    @property
    def deepest(self) -> float:
        """Of the tip, m below its top; -inf: it never came."""
        return self.model.deepest

    @property
    def moved(self) -> float:
        """By how much it has rolled aside, m."""
        return self.model.moved

    @property
    def still_on_pipette(self) -> bool:
        """It left the dish with the pipette."""
        return self.model.still_on_pipette


class Dish:
    """The cells of [plant.dish].

    cells: in the order of positions. entered: the one that the tip is in. under: the one that the tip is above or in.
    stray: pulses where no cell was. radius: of a cell, m. direction: 1.0 or -1.0, of the motion into the cells.
    is_broken: the pipette is, since the cell of that anomaly.
    """

    def __init__(self, config: DishConfig, axis_names: Sequence[str], piece_ns: int = PIECE_NS) -> None:
        """piece_ns: of constant cell force. Raises ValueError for an axis that there is not."""
        for axis in config.axes:
            if axis not in axis_names:
                raise ValueError(f"plant.dish.axes: no axis '{axis}'; the axes are {', '.join(axis_names)}")
        self.cells = [_cell(config, number, spot) for number, spot in enumerate(config.positions)]
        self.entered: DishCell | None = None
        self.under: DishCell | None = None
        self.stray: list[Pulse] = []
        self.is_broken = False
        self.valve = config.valve
        self._pressure = config.pressure
        self._x, self._y, self._z = (list(axis_names).index(axis) for axis in config.axes)
        self.direction = float(config.direction)
        self.radius = config.radius
        self._piece_ns = piece_ns
        self._highest = min(self.direction * cell.top for cell in self.cells)
        self._bins: dict[tuple[int, int], list[DishCell]] = {}
        for cell in self.cells:
            for key in self._bins_of(cell.x, cell.y):
                self._bins.setdefault(key, []).append(cell)
        self._entry: Spot = (0.0, 0.0)  # where the tip entered
        self._open_ns = -1  # since when the valve is open
        self._pulse: tuple[DishCell | None, bool, float] = (None, True, 0.0)
        self._failing: DishCell | None = None

    # where the tip is ------------------------------------------------------------------------------------------------

    def _bins_of(self, x: float, y: float) -> list[tuple[int, int]]:
        r, pitch = self.radius, 2.0 * self.radius
        columns, rows = (range(math.floor((q - r) / pitch), math.floor((q + r) / pitch) + 1) for q in (x, y))
        return [(column, row) for column in columns for row in rows]

    def _cell_at(self, x: float, y: float) -> DishCell | None:
        """The cell above which the tip is, the nearest of several."""
        pitch = 2.0 * self.radius
        best, least = None, self.radius * self.radius
        for cell in self._bins.get((math.floor(x / pitch), math.floor(y / pitch)), ()):
            distance = (x - cell.x) * (x - cell.x) + (y - cell.y) * (y - cell.y)
            if distance <= least:
                best, least = cell, distance
        return best

    @property
    def force(self) -> float:
        """Of the cell on the tip now, N, pressing positive."""
        return self.entered.model.force if self.entered else 0.0

    @property
    def side(self) -> float:
        """How far the cell under the tip has moved aside, m; 0 where there is none."""
        return self.under.moved if self.under else 0.0

    @property
    def dimple(self) -> float:
        """How deep the tip has pressed in the cell that it is in, m; 0 once it is pierced."""
        cell = self.entered
        return max(0.0, cell.model.depth) if cell is not None and cell.pierced_ns is None else 0.0

    @property
    def bolus(self) -> float:
        """In the cell under the tip, of all pulses so far; 0 where there is none."""
        cell = self.under
        if cell is None:
            return 0.0
        given = self._pulse[2] if self._open_ns >= 0 and self._pulse[0] is cell else 0.0
        return given + sum(pulse.bolus for pulse in cell.pulses)

    @property
    def tip_error(self) -> float:
        """By how much the tip stands off along the axis, m: 0, or a broken one's way."""
        return -self.direction * self._shorter

    @property
    def _shorter(self) -> float:
        return BROKEN_BY if self.is_broken else 0.0

    def failure(self, is_camera: bool) -> str:
        """Of the camera or the force sensor: "", "silent" or "stuck"."""
        if self._failing is None or (self._failing.anomaly == "camera_frozen") != is_camera:
            return ""
        return "silent" if is_camera or self._failing.fails_silent else "stuck"

    def loaded(self, commands: Sequence[float]) -> list[float]:
        """The forces on the axes, N, with that of the cell."""
        forces = list(commands)
        forces[self._z] -= self.direction * self.force
        return forces

    # how time passes -------------------------------------------------------------------------------------------------

    def advance(self, stage: Moved, begin_ns: int, duration_ns: int, commands: Sequence[float]) -> None:
        """Move the stage by duration_ns from begin_ns under these forces (N) and those of the cell in its way."""
        inwards, speed = self._inwards(stage.positions), stage.velocities[self._z]
        reach = _NEAR + 2e-9 * duration_ns * abs(speed)
        near = self.entered is not None or inwards > self._highest - reach
        pieces = -(-duration_ns // self._piece_ns) if near else 1
        until_ns = begin_ns
        for index in range(1, pieces + 1):
            from_ns, until_ns = until_ns, begin_ns + duration_ns * index // pieces
            stage.advance(until_ns - from_ns, self.loaded(commands) if self.entered else commands)
            positions = stage.positions
            before, inwards = inwards, self._inwards(positions)
            spot = positions[self._x], positions[self._y]
            self.under = self.entered or self._cell_at(*spot)
            if near and self.under is not None:
                self._meet(self.under, (from_ns, until_ns), (before, inwards), spot)
            inwards -= self._damaged(inwards)
            if self._open_ns >= 0:
                self._inject(until_ns - from_ns)

    def _inwards(self, positions: Sequence[float]) -> float:
        """The tip's position along the axis, m, growing inwards."""
        return self.direction * positions[self._z] - self._shorter

    def _meet(self, cell: DishCell, span: tuple[int, int], way: tuple[float, float], spot: Spot) -> None:
        """The tip went `way` along the axis (m, inwards positive) above or in this cell."""
        if not cell.model.layers:
            return
        top = self.direction * cell.top
        if self.entered is None:
            if way[0] > top or way[1] <= top:
                return  # it has passed beside it, or is not there yet
            self.entered, self._entry = cell, spot
        dx, dy = spot[0] - self._entry[0], spot[1] - self._entry[1]
        cell.model.advance(span[0], span[1], way[0] - top, way[1] - top, math.sqrt(dx * dx + dy * dy))
        if cell.model.is_free:
            self.entered = None

    def _damaged(self, inwards: float) -> float:
        """What breaks or fails above the cell under the tip. Returns by how much the tip is shorter now, m."""
        cell = self.under
        if cell is None or cell.anomaly not in ("sensor_dead", "camera_frozen"):
            self._failing = None
            if cell is not None and cell.anomaly == "broken" and not self.is_broken:
                self.is_broken = True
                return BROKEN_BY
        else:
            depth = inwards - self.direction * cell.top
            if depth >= cell.fails_at:
                self._failing = cell
            elif depth < _CLEAR:
                self._failing = None
        return 0.0

    # the valve -------------------------------------------------------------------------------------------------------

    def outputs(self, bits: int, now_ns: int) -> None:
        """The host's outputs from now on, the stage having been advanced to now_ns."""
        is_open = bool(bits >> self.valve & 1)
        if is_open and self._open_ns < 0:
            self._open_ns = now_ns
            self._pulse = (self.under, self._is_in_a_pierced(), 0.0)
        elif not is_open and self._open_ns >= 0:
            cell, pierced, bolus = self._pulse
            pulse = Pulse(self._open_ns, now_ns, pierced, bolus)
            (cell.pulses if cell else self.stray).append(pulse)
            self._open_ns = -1

    @property
    def pressure(self) -> float:
        """In the injector, Pa."""
        return self._pressure if self._open_ns >= 0 else 0.0

    def _is_in_a_pierced(self) -> bool:
        return self.entered is not None and self.entered.pierced_ns is not None and self.entered.model.depth > 0.0

    def _inject(self, duration_ns: int) -> None:
        cell, pierced, bolus = self._pulse
        if self._is_in_a_pierced() and self.entered is cell and cell is not None:
            bolus += cell.flow * duration_ns * 1e-9
        else:
            pierced = False
        self._pulse = (cell, pierced, bolus)


def _cell(config: DishConfig, number: int, spot: Sequence[float]) -> DishCell:
    found: Drawn = drawn(config, number)
    top = config.top + found.height
    anomaly, fails_at, silent = found.anomaly, found.fails_at, found.fails_silent
    return DishCell(number, anomaly, spot[0], spot[1], top, found.model, fails_at, silent, found.flow)
