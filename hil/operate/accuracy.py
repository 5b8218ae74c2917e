"""`hil accuracy RIG`: where each axis comes to rest when it is sent somewhere, from both directions, as data sheets do.

The cycle of ISO 230-2: through the targets in one direction and back in the other, with a way beyond each end, so that
every target is approached as the one before it; several runs. On an emulated stage in virtual time, with the true
positions beside the encoder's; or (--live) on a running rig, by its encoders. With --reference nothing moves: the
figures are those of an instrument that stood beside it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from hil.analysis.positioning import LEAST_RUNS, LEAST_TARGETS, Positioning, positioning, targets
from hil.cli.console import plain_console
from hil.cli.options import JsonTarget, Overrides, named_axes
from hil.cli.output import drawable, metres, print_plant_notes, writable, write_json
from hil.cli.progress import Steps
from hil.control.laws.base import Array
from hil.cycle.goal import MotionWord
from hil.live.goal_link import IN_POSITION_S
from hil.operate.approach_file import Deviations, read_reference, write_approaches
from hil.operate.command import config_of
from hil.operate.error_map_file import write_corrected
from hil.operate.move import told
from hil.operate.moving import motion
from hil.runs.mover import LOOK_S, Mover
from hil.runs.rigs import load_rig
from hil.runs.virtual_mover import VirtualMover

Rows = dict[str, tuple["Approaches", Positioning]]

SHARE: Final = 0.8  # of the way that goals have, between the first and the last target
BEYOND: Final = 0.05  # of it, beyond either end
SETTLE_S: Final = 2.0  # at most, to be in position
DWELL_S: Final = 0.1  # in position, before it is measured
MEASURE_S: Final = 0.1  # over which positions are averaged
HOLD_S: Final = 1.0


class Approaches(NamedTuple):
    """Of one axis, (targets, runs): deviations as its encoder says; as they are, on an emulated stage (else empty);
    times from the set-point's rest until the axis stays in position, s. hold: RMS about the mean at the last target.
    """

    targets: list[float]
    up: Array
    down: Array
    true_up: Array
    true_down: Array
    settled_s: Array
    hold: float


def approaches(mover: Mover, name: str, count: int, runs: int, tell: Callable[[], None] = lambda: None) -> Approaches:
    """Run the cycle on one axis; the others hold. tell: after each approach. Raises MotionError as the mover."""
    axis = mover.axes.index(name)
    low, high = mover.range_of(name)
    middle, half = 0.5 * (low + high), 0.5 * SHARE * (high - low)
    places = targets(middle - half, middle + half, count)
    beyond = BEYOND * 2.0 * half
    found = np.zeros((2, 2, count, runs))  # encoder and truth, up and down
    settled: list[float] = []
    for run in range(runs):
        for side, order in enumerate((range(count), range(count - 1, -1, -1))):
            _go(mover, name, places[order[0]] + (beyond if side else -beyond))
            for place in order:
                settled.append(_go(mover, name, places[place]))
                read, true, _ = _measure(mover, axis, MEASURE_S)
                found[:, side, place, run] = read - places[place], true - places[place]
                tell()
    _, _, hold = _measure(mover, axis, HOLD_S)
    true_up, true_down = found[1] if isinstance(mover, VirtualMover) else np.empty((2, 0, 0))
    return Approaches(places, found[0, 0], found[0, 1], true_up, true_down, np.array(settled), hold)


def _go(mover: Mover, name: str, place: float) -> float:
    """Send the axis there; how long it took to be in position once its set-point was at rest, s; NaN: it never was."""
    target: dict[str, Any] = {name: place}
    move = mover.move_to(**target)
    mover.await_rest(lambda look: look.motion is MotionWord.HOLD or move.done)
    rests_ns = mover.now_ns()
    settled = 0.0
    while not mover.status().in_position and settled < SETTLE_S:
        mover.sleep(LOOK_S)
        settled = (mover.now_ns() - rests_ns) * 1e-9
    mover.sleep(DWELL_S)
    return max(0.0, settled - IN_POSITION_S) if settled < SETTLE_S else math.nan


def _measure(mover: Mover, axis: int, seconds: float) -> tuple[float, float, float]:
    """Means of encoder and truth (NaN on a rig) over a time, and the encoder's RMS about its mean."""
    read, true = [], []
    until_ns = mover.now_ns() + round(seconds * 1e9)
    while mover.now_ns() < until_ns:
        read.append(mover.status().position[axis])
        if isinstance(mover, VirtualMover):
            true.append(mover.true_position[axis])
        mover.sleep(0.0)
    return float(np.mean(read)), float(np.mean(true)) if true else float("nan"), float(np.std(read))


def accuracy(
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="rig file or shipped name; --live: a running rig")],
    *,
    axes: Annotated[str, typer.Option(help="comma-separated; default: all of the rig's")] = "",
    targets: Annotated[int, typer.Option(min=LEAST_TARGETS, max=100, help="targets along each axis")] = LEAST_TARGETS,
    runs: Annotated[int, typer.Option(min=2, max=100, help="approaches of each target from each side")] = LEAST_RUNS,
    live: Annotated[bool, typer.Option("--live", help="move the running rig; it must be under torque")] = False,
    out: Annotated[
        str, typer.Option(callback=writable, help="write every approach as CSV; then add a column `reference` to it")
    ] = "",
    reference: Annotated[
        Path | None, typer.Option(help="CSV of --out with the instrument's readings in `reference`; nothing moves")
    ] = None,
    write: Annotated[
        Path | None, typer.Option(help="with --reference: new rig file that corrects each axis by what was read")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(callback=drawable, help="draw deviations over targets, as data sheets do")
    ] = None,
    overrides: Overrides = None,
    json_target: JsonTarget = "",
) -> None:
    """Positioning accuracy, repeatability and reversal of each axis by ISO 230-2, with settling times and hold.

    What an encoder cannot see of its own scale, a laser interferometer or a second scale does. `--out FILE` writes the
    approaches. Note the instrument's reading at each stop in a column `reference`, and give the file to `--reference`.
    `--write NEW.toml` beside it makes a rig file whose axes are corrected by these readings.

    Exit status 0: measured; 69: the rig does not run here, or left ACTIVE on the way; each with the reason.
    """
    console = plain_console(stderr=json_target == "-")
    if live and overrides:
        raise typer.BadParameter("a running rig is as it is", param_hint="--set")
    if write and not reference:
        raise typer.BadParameter("needs the readings of --reference FILE", param_hint="--write")
    if write and write.exists():
        raise typer.BadParameter(f"{write} exists; name a new file", param_hint="--write")
    if reference and (live or out):
        raise typer.BadParameter("nothing moves with --reference: leave --live and --out out", param_hint="--reference")
    if reference:
        config = load_rig(rig, overrides or ()).config
        found = read_reference(reference, named_axes(axes, config.axis_names))
        kinds = {name: axis.kind for name, axis in config.axes.items()}
        said = f"{reference.name}, read by the reference instrument"
        rows = {name: (_unmoved(axis), positioning(axis.up, axis.down)) for name, axis in found.items()}
        _tell(console, kinds, rows, said, picture, json_target, "reference")
        if write:
            write_corrected(rig, config, reference, write)
            if config.law.learnt:
                console.print("law.learnt is left out: it was learnt without this correction", soft_wrap=True)
            console.print(f"written to {write}; next: hil accuracy {write}", markup=False, soft_wrap=True)
        return
    of = config_of(rig).name if live else load_rig(rig, overrides or ())
    with told("accuracy"), motion(of, activate=False) as mover:
        made = _all(mover, named_axes(axes, mover.axes), targets, runs)
    if isinstance(mover, VirtualMover):
        print_plant_notes(console, mover.config)
    if out:
        write_approaches(Path(out), {name: _by_encoder(axis) for name, axis in made.items()})
    rows = {name: (axis, positioning(axis.up, axis.down)) for name, axis in made.items()}
    _tell(console, mover.kinds, rows, f"{targets} targets, {runs} runs from either side", picture, json_target)


def _tell(
    console: Console,
    kinds: Mapping[str, str],
    rows: Rows,
    title: str,
    picture: Path | None,
    json_target: str,
    read: str = "encoder",
) -> None:
    """The table; picture and JSON where they are asked for. read: who did."""
    console.print(_table(kinds, rows, title))
    if picture:
        from hil.operate.accuracy_picture import accuracy_picture  # matplotlib: half a second, for this alone

        accuracy_picture(picture, {name: _by_encoder(axis) for name, (axis, _) in rows.items()}, kinds, title)
        console.print(f"Deviations: {picture}", soft_wrap=True, markup=False)
    if json_target:
        write_json(_document(kinds, rows, read), json_target)


def _by_encoder(axis: Approaches) -> Deviations:
    return Deviations(axis.targets, axis.up, axis.down)


def _unmoved(axis: Deviations) -> Approaches:
    """What an instrument read, with nothing of what only a run knows."""
    return Approaches(*axis, np.empty((2, 0)), np.empty((2, 0)), np.empty(0), math.nan)


def _all(mover: Mover, names: Sequence[str], count: int, runs: int) -> dict[str, Approaches]:
    """Of the axes, one after the other, each back where it was."""
    found = {}
    with Steps("approaches", 2 * count * runs * len(names)) as steps:
        for name in names:
            begun = mover.status().setpoint[mover.axes.index(name)]
            found[name] = approaches(mover, name, count, runs, steps.advance)
            _go(mover, name, begun)
    return found


_FIGURES: Final = (
    ("accuracy A", "accuracy"), ("A up", "accuracy_up"), ("A down", "accuracy_down"), ("systematic E", "systematic"),
    ("mean M", "mean_range"), ("repeatability R", "repeatability"), ("R up", "repeatability_up"),
    ("R down", "repeatability_down"), ("reversal B", "reversal"),
)  # fmt: skip


def _table(kinds: Mapping[str, str], rows: Rows, title: str) -> Table:
    """Figures down, axes across; of an emulated stage by encoder and as it is."""
    columns: list[tuple[str, str, Approaches, Positioning | None]] = []
    for name, (of, by_encoder) in rows.items():
        columns.append((name, name, of, by_encoder))
        if of.true_up.size:
            columns.append((name, f"{name}, true", of, positioning(of.true_up, of.true_down)))
    table = Table("", *(head for _, head, _, _ in columns), title=f"positioning by ISO 230-2: {title}")
    for words, figure in _FIGURES:
        cells = [metres(getattr(figures, figure), kinds[name]) for name, _, _, figures in columns]
        table.add_row(words, *cells)
    own = [head == name for name, head, _, _ in columns]
    settled = [_settled(of.settled_s) for _, _, of, _ in columns]
    table.add_row("settled, median / most", *(cell if mine else "" for cell, mine in zip(settled, own, strict=True)))
    held = ["" if math.isnan(of.hold) else metres(of.hold, kinds[name]) for name, _, of, _ in columns]
    table.add_row(f"hold, RMS of {HOLD_S:g} s", *(cell if mine else "" for cell, mine in zip(held, own, strict=True)))
    return table


def _settled(seconds: Array) -> str:
    """Of those approaches that came into position, and how many did not."""
    if not len(seconds):
        return ""
    never = int(np.isnan(seconds).sum())
    words = f", {never} never" if never else ""
    if never == len(seconds):
        return "never"
    return f"{np.nanmedian(seconds) * 1e3:.0f} / {np.nanmax(seconds) * 1e3:.0f} ms{words}"


def _document(kinds: Mapping[str, str], rows: Rows, read: str) -> dict[str, Any]:
    """Keys: axes.NAME.{targets, encoder or reference, true, settled_s, hold}; the first two by who `read`, and true: up
    and down (targets, runs) and the figures of Positioning, m (rad).
    """
    axes = {}
    for name, (of, by_encoder) in rows.items():
        said: dict[str, Any] = {"unit": "m" if kinds[name] == "linear" else "rad", "targets": of.targets}
        said[read] = _figures(of.up, of.down, by_encoder)
        if of.true_up.size:
            said["true"] = _figures(of.true_up, of.true_down, positioning(of.true_up, of.true_down))
        axes[name] = {**said, "settled_s": of.settled_s.tolist(), "hold": of.hold}
    return {"axes": axes}


def _figures(up: Array, down: Array, found: Positioning) -> dict[str, Any]:
    plain = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in found._asdict().items()}
    return {"up": up.tolist(), "down": down.tolist(), **plain}
