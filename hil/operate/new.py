"""`hil new FILE`: a rig file for a stage of one's own, from a few questions or flags, on which check and sim pass."""

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer

from drivers.base.named_file import naming
from hil.rig.scaffold import LAYOUTS, AxisSketch, Sketch, rig_text
from hil.rig.schema import RigConfig, RigError
from hil.rig.tables import AXIS_NAME, MAX_AXES

RATES_HZ = (1000.0, 500.0, 250.0, 200.0)  # the first at which the traffic fits and the loop is stable is taken
NAME = r"[a-z0-9][a-z0-9_-]{0,31}"


def new(
    file: Annotated[Path, typer.Argument(help="the rig file to write, for example my-stage.toml", show_default=False)],
    *,
    axes: Annotated[str | None, typer.Option(help="names of the axes, in bus order [x,y]")] = None,
    layout: Annotated[str | None, typer.Option(help=f"frame layout: {', '.join(LAYOUTS)} [{LAYOUTS[0]}]")] = None,
    mass: Annotated[str | None, typer.Option(help="moving mass, kg (kg m^2); one, or one per axis [0.5]")] = None,
    travel: Annotated[
        str | None, typer.Option(help="travel from end to end, m (rad); one, or one per axis [0.05]")
    ] = None,
    encoder: Annotated[
        str | None, typer.Option(help="encoder resolution, m (rad) per count; one, or one per axis [1e-7]")
    ] = None,
    force: Annotated[str | None, typer.Option(help="the drives' rated force, N (N m) [10]")] = None,
    friction: Annotated[str | None, typer.Option(help="Coulomb friction, N (N m) [a twentieth of the force]")] = None,
    rotary: Annotated[str | None, typer.Option(help="axes that turn, comma-separated [none]")] = None,
    vertical: Annotated[
        str | None, typer.Option(help="vertical axes, comma-separated; a brake holds each [none]")
    ] = None,
    watchdog: Annotated[float, typer.Option(help="the drives' watchdog, s", min=1e-6, max=1.0)] = 0.01,
    rate: Annotated[float | None, typer.Option(help="control rate, Hz [the highest that fits, up to 1000]")] = None,
) -> None:
    """The file has the least that runs. What no option says is asked for at a terminal; elsewhere its default holds."""
    name = file.stem
    if file.suffix != ".toml" or not re.fullmatch(NAME, name):
        raise typer.BadParameter(f"{file.name}: expected a name such as my-stage.toml: small letters, digits, - and _")
    if not file.parent.is_dir():
        raise typer.BadParameter(f"{file}: there is no folder {file.parent}")
    chosen = _choice("layout", layout, "Frame layout", LAYOUTS)
    names = _names("axes", _answer(axes, "Names of the axes, in bus order", "x,y"))
    turning = _among("rotary", _answer(rotary, "Which of them turn (Enter: none)", ""), names)
    hanging = _among("vertical", _answer(vertical, "Which are vertical (Enter: none)", ""), names)
    masses = _numbers("mass", _answer(mass, "Moving mass, kg (kg m^2)", "0.5"), names)
    travels = _numbers("travel", _answer(travel, "Travel from end to end, m (rad)", "0.05"), names)
    encoders = _numbers("encoder", _answer(encoder, "Encoder resolution, m (rad) per count", "1e-7"), names)
    forces = _numbers("force", _answer(force, "Rated force of the drives, N (N m)", "10"), names)
    frictions = _numbers("friction", friction, names) if friction else [0.05 * value for value in forces]
    turns, hangs = [name in turning for name in names], [name in hanging for name in names]
    columns = zip(names, masses, travels, encoders, forces, frictions, turns, hangs, strict=True)
    sketched = tuple(AxisSketch(*row) for row in columns)
    for axis in sketched:
        if abs(axis.gravity) + axis.friction >= 0.5 * axis.force:
            raise typer.BadParameter(
                f"axis {axis.name}: gravity and friction take {abs(axis.gravity) + axis.friction:.3g} N of the rated "
                f"{axis.force:g} N; at least half must be left for control"
            )
    sketch = _runnable(Sketch(name, sketched, chosen, rate or 0.0, watchdog), (rate,) if rate else RATES_HZ)
    written = {file: rig_text(sketch)} | {file.with_name(beside): text for beside, text in sketch.files.items()}
    for path in written:
        if path.exists():
            raise typer.BadParameter(f"{path}: exists already; it is left as it is")
    for path, text in written.items():
        with naming(path), path.open("x", encoding="utf-8") as stream:
            stream.write(text)
        print(f"written: {path}")
    print(f"{sketch.rate_hz:g} Hz on {chosen}. Next: hil check {file}; hil sim {file}; hil demo {file}")


def _runnable(sketch: Sketch, rates_hz: Sequence[float]) -> Sketch:
    """The sketch at the first rate at which the traffic fits the bus and the loop is stable. Raises RigError with what
    is wrong at the last.
    """
    problems: list[str] = []
    with TemporaryDirectory(prefix="hil-new-") as folder:
        for beside, text in sketch.files.items():
            (Path(folder) / beside).write_text(text, encoding="utf-8")
        for rate_hz in rates_hz:
            candidate = sketch._replace(rate_hz=rate_hz)
            problems = _problems(candidate, Path(folder))
            if not problems:
                return candidate
    raise RigError([f"at {rates_hz[-1]:g} Hz: {problem}" for problem in problems])


def _problems(sketch: Sketch, folder: Path) -> list[str]:
    """What `hil check` would find, and whether a run can begin."""
    from drivers.base.toml_file import parse_toml
    from hil.analysis.stability import check_stability
    from hil.rig.bus_load import analyse_rig, problems, rig_layout
    from hil.rig.file import build_rig
    from hil.virtual.sim import usable

    try:
        rig: RigConfig = build_rig(parse_toml(rig_text(sketch)))
        found = problems(rig, folder, analyse_rig(rig, rig_layout(rig, folder)))
        return [*found, *check_stability(usable(rig, folder / f"{sketch.name}.toml")).problems()]
    except RigError as error:
        return error.problems


def _answer(given: str | None, question: str, default: str) -> str:
    if given is not None:
        return given
    if not sys.stdin.isatty():
        return default
    return str(typer.prompt(question, default=default, show_default=bool(default)))


def _choice(option: str, given: str | None, question: str, choices: Sequence[str]) -> str:
    answer = _answer(given, f"{question} ({', '.join(choices)})", choices[0])
    if answer not in choices:
        raise typer.BadParameter(f"--{option} {answer}: expected one of {', '.join(choices)}")
    return answer


def _names(option: str, text: str) -> list[str]:
    names = [part.strip() for part in text.split(",") if part.strip()]
    wrong = [name for name in names if not re.fullmatch(AXIS_NAME, name)]
    if wrong or not 1 <= len(set(names)) == len(names) <= MAX_AXES:
        raise typer.BadParameter(
            f"--{option} {text}: expected one to {MAX_AXES} different names, small letters, digits and _, such as x,y,z"
        )
    return names


def _among(option: str, text: str, names: Sequence[str]) -> set[str]:
    chosen = {part.strip() for part in text.split(",") if part.strip()}
    if unknown := sorted(chosen - set(names)):
        raise typer.BadParameter(f"--{option} {unknown[0]}: the axes are {', '.join(names)}")
    return chosen


def _numbers(option: str, text: str, names: Sequence[str]) -> list[float]:
    """One positive number for all axes, or one per axis."""
    parts: list[Any] = [part.strip() for part in text.split(",")]
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    values = values * len(names) if len(values) == 1 else values
    if len(values) != len(names) or not all(1e-15 <= value <= 1e15 for value in values):
        raise typer.BadParameter(
            f"--{option} {text}: expected a number from 1e-15 to 1e15, or one for each of {', '.join(names)}"
        )
    return values
