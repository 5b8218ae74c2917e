"""[plant.dish]: a dish of cells under the emulated stage's tip. What the cells are like: cell_presets.py."""

from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from drivers.base.keys import REQUIRED, Table, key

Anomaly = Literal[
    "", "no_cell", "rolled", "not_pierced", "double", "clogged", "stuck", "sensor_dead", "camera_frozen", "broken"
]
# What a share of anomalies is drawn from. A broken pipette is not: no cell after it is reached.
DRAWN: Final[tuple[Anomaly, ...]] = (
    "no_cell", "rolled", "not_pierced", "double", "clogged", "stuck", "sensor_dead", "camera_frozen",
)  # fmt: skip
PresetName = Literal["zebrafish-assumed", "zebrafish-blastula", "zebrafish-prehatching", "mouse-mii", "mouse-pn"]

Share = Annotated[float, Field(ge=0, le=1)]
Spread = Annotated[float, Field(ge=0, le=1)]
Length = Annotated[float, Field(ge=1e-9, le=1e-2)]
Coordinate = Annotated[float, Field(ge=-1e3, le=1e3)]
Spot = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]
Newton = Annotated[float, Field(ge=1e-12, le=1)]
Stiffness = Annotated[float, Field(ge=1e-6, le=1e15)]
POWERS: Final = (1.5, 2.0, 3.0)
MOST_CELLS: Final = 100_000
MOST_LAYERS: Final = 8


class LayerConfig(Table):
    """[[plant.dish.layers]]: a membrane of a cell, force = k depth^power until it is pierced (physics/cell.py).

    Spreads are standard deviations as fractions, of a normal distribution cut off at three of them.
    """

    offset: float = key(0.0, "its depth below the cell's top", "m", ge=0, le=1e-2)
    power: float = key(2.0, "of the depth: 1.5 small strain, 3 a point load on a membrane, 2 between", "1")
    force: Newton = key(REQUIRED, "force at which it is pierced, at 1 mm/s", "N")
    force_spread: Spread = key(0.0, "spread of that between cells", "1")
    depth: Length | None = key(None, "depth at which a fast press reaches that force; this or stiffness", "m")
    stiffness: Stiffness | None = key(None, "k, of a fast press; this or depth", "N/m^power")
    spread: Spread = key(0.0, "spread of depth or stiffness, whichever is stated, between cells", "1")
    puncture_depth: Length | None = key(
        None, "depth at which it is pierced at the latest; without: by force alone", "m"
    )
    viscous_share: float = key(0.0, "part of a held force that fades", "1", ge=0, le=0.95)
    viscous_time: float = key(0.15, "time constant with which it fades", "s", ge=1e-4, le=100)
    rate_gain: float = key(0.0, "by how much more it bears for each decade of loading speed", "1", ge=0, le=0.3)
    slip_time: float = key(3e-3, "in which the force is gone once it is pierced", "s", ge=1e-4, le=1)
    friction: float = key(0.0, "of the membrane on the shaft, once pierced, while the tip goes on", "N", ge=0, le=1)
    adhesion: float = key(0.0, "of the membrane on the shaft, once pierced, while the tip goes out", "N", ge=0, le=1)
    drag: float = key(0.0, "viscous drag on the tip behind it, once pierced", "N s/m", ge=0, le=1)

    @model_validator(mode="after")
    def _consistent(self) -> "LayerConfig":
        if self.power not in POWERS:
            raise ValueError(f"power = {self.power}: allowed: {', '.join(f'{power:g}' for power in POWERS)}")
        if (self.depth is None) == (self.stiffness is None):
            raise ValueError("state one of depth and stiffness")
        return self


class DishConfig(Table):
    """[plant.dish]: cells at positions under the tip. Only one with its tip above a cell meets it.

    Each cell's values are drawn by the seed and its number, so that a cell more moves no other.
    """

    axes: Annotated[list[str], Field(min_length=3, max_length=3)] = key(
        ["x", "y", "z"], "the two axes across, and the one along which the tip enters"
    )
    direction: int = key(-1, "sign of the motion into the cells: -1 or 1", "1", ge=-1, le=1)
    preset: PresetName = key("zebrafish-assumed", "what the cells are like, by animal and stage")
    positions: list[Spot] = key(
        REQUIRED, "positions of the two axes across at which the tip is above the middle of each cell", "m"
    )
    top: Coordinate = key(REQUIRED, "position of the third axis at which the tip touches, without spread", "m")
    radius: Length = key(0.5e-3, "of a cell; a tip farther from its middle meets nothing", "m")
    spread: bool = key(True, "cells differ; false: each has the preset's mean values")
    top_spread: float | None = key(
        None, "standard deviation of the tops", "m", derived="of the preset: zebrafish 15 um, mouse 5 um", ge=0, le=1e-3
    )
    layers: list[LayerConfig] = key([], "in place of the preset's; at most 8")
    tip: float = key(
        1.0, "radius of the tip over that of a new one; a blunt one needs as much more force", "1", ge=0.2, le=5
    )
    seed: int = key(1, "of all that is drawn", "1", ge=0, lt=2**32)
    anomalies: list[Anomaly] = key(
        [],
        'what is wrong with each cell, in the order of positions: "" (good), "no_cell", "rolled", "not_pierced", '
        '"double", "clogged", "stuck", "sensor_dead", "camera_frozen", "broken"; those beyond the list: anomaly_share',
    )
    anomaly_share: Share = key(0.0, "of the cells beyond that list: part that has an anomaly, drawn; never broken", "1")
    valve: int = key(0, "bit of the host's outputs that opens the injection valve", "1", ge=0, le=7)
    pressure: float = key(
        5e4, "in the injector while its valve is open; 0 while it is shut", "Pa", gt=0, le=1e7,
        exclude_if=lambda pressure: pressure == 5e4,
    )  # fmt: skip
    flow: float = key(10.0, "through the open valve, in planned boluses a second", "1/s", gt=0, le=1e4)

    @model_validator(mode="after")
    def _consistent(self) -> "DishConfig":
        if not self.direction:
            raise ValueError("direction = 0: allowed: -1, 1")
        if len(set(self.axes)) < 3:
            raise ValueError(f"axes = {self.axes}: three axes, none twice")
        if not 1 <= len(self.positions) <= MOST_CELLS:
            raise ValueError(f"positions: {len(self.positions)} cells; allowed: 1 to {MOST_CELLS}")
        if len(self.layers) > MOST_LAYERS:
            raise ValueError(f"layers: {len(self.layers)}; allowed: at most {MOST_LAYERS}")
        if len(self.anomalies) > len(self.positions):
            raise ValueError(f"anomalies: {len(self.anomalies)} for {len(self.positions)} positions; at most one each")
        return self
