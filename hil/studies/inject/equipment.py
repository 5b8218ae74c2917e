"""What a rig needs beside its axes to inject cells; for a rig that has none of it, the reference equipment.

A force sensor of 5 uN RMS on the cell's side, a camera of 30 Hz whose frames come 50 ms late, a valve, and cells like
those of zebrafish embryos. All of it is assumed.
"""

import json
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from hil.cycle.limits import motion_limits
from hil.rig.schema import RigConfig, RigError
from hil.rig.task_file import TaskFileError, csv_columns, file_bytes

Positions = list[tuple[float, float]]

MOST_CELLS = 2000
TOP_SHARE = 0.2  # of the travel, above its lower end: where the tops of the cells are
FLOW = 20.0  # boluses a second: one in a pulse of 50 ms
ABOVE = 0.8e-3  # m from there to the safe height
_SLOW = "silent_ticks=2000, stuck_ticks=0"  # of the camera; the motion itself looks at the age of its frames
_SENSORS = {
    "force": '{can_id=0x3F1, unit="N", scale=1e-8, noise=5e-6, range=[-0.01, 0.01], silent_ticks=200, stuck_ticks=200}',
    "shift": f'{{can_id=0x3F2, unit="m", scale=1e-9, noise=7e-7, range=[-0.5, 0.5], {_SLOW}}}',
    "tip": f'{{can_id=0x3F3, unit="m", scale=1e-9, noise=7e-7, range=[-0.5, 0.5], {_SLOW}}}',
    "bolus": f'{{can_id=0x3F4, unit="1", scale=1e-6, noise=0.02, range=[-100.0, 100.0], {_SLOW}}}',
}
_DIMPLE = f'{{can_id=0x3F5, unit="m", scale=1e-9, noise=7e-7, range=[-0.5, 0.5], {_SLOW}}}'
_MEASURED = {"shift": "cell_shift", "tip": "tip_error", "bolus": "bolus"}
_CAMERA = {**_MEASURED, "dimple": "dimple"}
_NAMES = 'force="force", shift="shift", tip="tip", bolus="bolus", valve="valve"'


def grid(rows: int, columns: int, pitch: float, centre: tuple[float, float]) -> Positions:
    """Row by row, every second one backwards, around `centre`, m."""
    found: Positions = []
    for row in range(rows):
        across = range(columns) if row % 2 == 0 else reversed(range(columns))
        y = centre[1] + (row - (rows - 1) / 2) * pitch
        found += [(centre[0] + (column - (columns - 1) / 2) * pitch, y) for column in across]
    return found


def read_positions(path: Path) -> Positions:
    """The columns x and y (m) of a CSV file, one row a cell. Raises RigError naming file, row and column."""
    rows = _columns(path, {"x": "m", "y": "m"})
    if not rows:
        raise RigError([f"{path}: no cell; expected a row of x and y, m, for each"])
    return [(row[0], row[1]) for row in rows]


def read_angles(path: Path, axis: str) -> list[float]:
    """The column of that rotary axis, rad, one row a cell; none without an axis. Raises RigError as read_positions."""
    return [] if not axis else [row[0] for row in _columns(path, {axis: "rad"})]


def _columns(path: Path, wanted: Mapping[str, str]) -> list[list[float]]:
    """wanted: the columns' units, by name."""
    units = ", ".join(f"{name} in {unit}" for name, unit in wanted.items())

    def chosen(header: Sequence[str]) -> list[str]:
        if missing := [name for name in wanted if name not in header]:
            raise TaskFileError(f"{path}: no column {missing[0]!r}; expected {units}")
        if twice := [name for name in wanted if header.count(name) > 1]:
            raise TaskFileError(f"{path}: two columns {twice[0]!r}; expected one")
        return list(wanted)

    try:
        _, rows = csv_columns(path, file_bytes(path), chosen, MOST_CELLS)
    except TaskFileError as error:
        raise RigError([str(error)]) from None
    for number, row in enumerate(rows, 1):
        if not all(isfinite(value) for value in row):
            shown = ", ".join(f"{name} = {value}" for name, value in zip(wanted, row, strict=True))
            raise RigError([f"{path}: row {number}: {shown}; expected finite numbers: {units}"])
    return [list(row) for row in rows]


def middle(rig: RigConfig) -> tuple[float, float]:
    """Of the travel of x and y, m. Raises RigError where the rig has no such axes."""
    for name in ("x", "y", "z"):
        if name not in rig.axes:
            raise RigError([f"axes: {', '.join(rig.axes)}; an injection needs x, y and z"])
    low_high = [rig.axes[name].limits.position for name in ("x", "y")]
    return (sum(low_high[0]) / 2, sum(low_high[1]) / 2)


def check_within(rig: RigConfig, places: Positions, source: str) -> None:
    """Refuse cells beyond the travel of x and y. source: the file or option that they are of. Raises RigError."""
    limits = dict(zip(rig.axis_names, motion_limits(rig), strict=True))
    for number, place in enumerate(places, 1):
        for name, value in zip(("x", "y"), place, strict=True):
            low, high = limits[name].low, limits[name].high
            if not low <= value <= high:
                raise RigError([f"{source}: cell {number} has {name} = {value:g} m; allowed: {low:g} to {high:g}"])


def has_equipment(rig: RigConfig) -> bool:
    """Whether the rig says itself how it injects."""
    return rig.motion.name == "cells"


def assumed(rig: RigConfig) -> str:
    """What `words` adds that the rig does not say, for people; empty where it says all."""
    if not has_equipment(rig):
        return "The rig names no motion for cells: with the reference sensors, valve and dish, all assumed."
    if not rig.plant.sensors:
        return "plant.sensors is empty: the emulated sensors measure the reference dish, which is assumed."
    return ""


def _measures(axis: str, force: str, camera: Mapping[str, str]) -> str:
    """The override that says what the emulated sensors measure. camera: by name of the sensor."""
    frames = [
        f"{{sensor='{name}', measures='{what}', axis='{axis}', frame_s=0.0333333333, delay=0.05}}"
        for name, what in camera.items()
    ]
    felt = f"{{sensor='{force}', measures='tip_force', axis='{axis}'}}"
    return f"plant.sensors=[{', '.join([felt, *frames])}]"


def words(
    rig: RigConfig, places: Positions, seed: int, share: float, anomalies: Sequence[str] = (), *, fd: bool,
    how: Mapping[str, Any] | None = None, angles: Sequence[float] = (),
) -> list[str]:  # fmt: skip
    """The overrides that put these cells under the rig's tip. share: of cells that are not as they should be;
    anomalies: of the first ones, by word. fd: the rig's bus has CAN FD frames. how: more of [motion.parameters].
    angles: of the holder at each cell, rad, where `how` has the axis that turns it.
    """
    li = motion_limits(rig)[rig.axis_names.index("z")]
    own = rig.motion.parameters
    top = own["cells"][0][2] if has_equipment(rig) else round(li.low + TOP_SHARE * (li.high - li.low), 6)
    flat = [list(place) for place in places]
    cells = [[*place, top] for place in flat]
    if angles:
        cells = [[*cell, angle] for cell, angle in zip(cells, angles, strict=True)]
    dish: dict[str, Any] = {"positions": flat, "top": top, "seed": seed, "anomaly_share": share}
    if anomalies:
        dish["anomalies"] = list(anomalies)
    found = ["plant.cells=[]", *(f"plant.dish.{key}={json.dumps(value)}" for key, value in dish.items())]
    if has_equipment(rig):
        more = [f"motion.parameters.{key}={json.dumps(value)}" for key, value in (how or {}).items()]
        if not rig.plant.sensors:
            camera = {own[role]: what for role, what in _CAMERA.items() if own.get(role)}
            more += [_measures(own.get("along", "z"), own.get("force", "force"), camera), f"plant.dish.flow={FLOW}"]
        return [*found, f"motion.parameters.cells={json.dumps(cells)}", *more]
    seen, sensors, given = dict(_MEASURED), dict(_SENSORS), dict(how or {})
    if given.get("z_law") == "visual":
        given["dimple"] = seen["dimple"] = "dimple"
        sensors["dimple"] = _DIMPLE
    more = [f", {key}={json.dumps(value)}" for key, value in given.items()]
    return [
        *found,
        "task.kind=hold",
        f"plant.dish.flow={FLOW}",
        *(f"sensors.{name}={table}" for name, table in sensors.items()),
        *(f"sensors.{name}.fd={str(fd).lower()}" for name in sensors),
        _measures("z", "force", seen),
        "outputs.valve={can_id=0x3E0, bit=0, longest_s=0.2}",
        "motion.name=cells",
        f"motion.parameters={{cells={json.dumps(cells)}, safe={top + ABOVE}, {_NAMES}{''.join(more)}}}",
    ]
