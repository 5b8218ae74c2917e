"""The command `hil identify`: what an axis is like, from experiments or from a recording."""

import datetime
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from hil.cli.exit_status import EXIT_FAULT, EXIT_FILE, EXIT_UNAVAILABLE
from hil.cli.options import JsonTarget, Overrides, ReadRig, named_axes
from hil.cli.output import drawable, write_json
from hil.identify.estimate import Estimate
from hil.identify.experiments import EXPERIMENTS
from hil.identify.findings import Findings, from_run
from hil.identify.lockstep import identify as run_experiments
from hil.identify.written import changes, model_values, rig_text
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.runs.api import load_run

EXIT_REFUSED = 4  # something was measured, and something was refused
NOT_SEEN = ("mode", "friction_variation", "cogging_amplitude", "cable_stiffness")  # an axis may have none


def identify(
    rig: ReadRig,
    *,
    axes: Annotated[str, typer.Option(help="axes to identify, comma-separated; default: all")] = "",
    only: Annotated[
        str, typer.Option(help=f"experiments, comma-separated: {', '.join(EXPERIMENTS)}; default: all")
    ] = "",
    recording: Annotated[
        Path | None, typer.Option("--from", metavar="RUN", help="identify from this recording; nothing is run")
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="in real time on the rig; with bus.interface=local on an emulated stage")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(help="folder of the live recordings; named again, it continues an interrupted run [runs/<time>]"),
    ] = None,
    agreed: Annotated[bool, typer.Option("--yes", help="ask nothing before the rig moves")] = False,
    write: Annotated[Path | None, typer.Option(help="new rig file with the identified model")] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            callback=drawable, help="draw frequency response, friction along the travel and over speed, loops"
        ),
    ] = None,
    responses: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="write AXIS.csv there: the frequency response, for hil check")
    ] = None,
    overrides: Overrides = None,
    json_target: JsonTarget = "",
) -> None:
    """Identify mass, friction, presliding, lag and resonance of each axis, with 95 % intervals.

    Without --from and --live, the experiments run in virtual time against the emulated stage. Exit status 3: one ended
    in a fault; 4: a value of the model was refused; 69: a live one did not come to its end.
    """
    from hil.cli.console import plain_console

    config = load_rig(rig, overrides or ())
    names = named_axes(axes, config.axis_names)
    if write and write.exists():
        raise typer.BadParameter(f"{write} exists; name a new file", param_hint="--write")
    if live and recording:
        raise typer.BadParameter("nothing moves with --from", param_hint="--live")
    if (out or agreed) and not live:
        raise typer.BadParameter("of --live alone", param_hint="--out" if out else "--yes")
    console = plain_console(stderr=json_target == "-")
    if live:
        findings, evidence = _found_live(config, rig, names, _experiments(only), console, out, agreed=agreed)
    else:
        findings, evidence = _found(config, rig, names, recording, _experiments(only), console)
    _show(console, config, findings)
    if json_target:
        write_json(_document(config, findings, evidence), json_target)
    if picture or responses:
        _report(console, rig, config, findings, picture, responses)
    if write and any(model_values(one.found) for one in findings.values()):
        found = {name: one.found for name, one in findings.items()}
        checked = {name: one.validation for name, one in findings.items() if one.validation}
        try:
            text = rig_text(rig, found, datetime.date.today().isoformat(), evidence, checked)
            write.write_text(text, encoding="utf-8")
        except OSError as error:
            console.print(f"hil: {write}: {error.strerror}", markup=False)
            raise typer.Exit(EXIT_FILE) from None
        console.print(f"written to {write}; next: hil check {write}", markup=False, soft_wrap=True)
    elif write:
        console.print(f"{write} is not written: no value of the model was found", markup=False, soft_wrap=True)
        raise typer.Exit(EXIT_REFUSED)
    else:
        console.print(
            f"next: hil identify {rig} --write NEW.toml, then hil check NEW.toml", markup=False, soft_wrap=True
        )
    if any(one.ended for one in findings.values()):
        raise typer.Exit(EXIT_FAULT)
    if any(name not in NOT_SEEN for one in findings.values() for name in one.refused):
        raise typer.Exit(EXIT_REFUSED)


def _report(
    console: Any, file: Path, rig: RigConfig, findings: dict[str, Findings], picture: Path | None, folder: Path | None
) -> None:
    from hil.identify.report import identification_picture, write_responses  # matplotlib: half a second

    def say(text: str) -> None:
        console.print(text, markup=False, highlight=False, soft_wrap=True)

    try:
        if picture:
            kinds = {name: axis.kind for name, axis in rig.axes.items()}
            identification_picture(picture, findings, kinds)
            say(f"picture: {picture}")
        for name, path in (write_responses(folder, findings) if folder else {}).items():
            say(f"{name}: frequency response in {path}; next: hil check {file} --measured {name}={path}")
    except OSError as error:
        say(f"hil: {picture or folder}: {error.strerror}")
        raise typer.Exit(EXIT_FILE) from None


def _found(
    config: RigConfig, rig: Path, names: list[str], recording: Path | None, only: list[str], console: Any
) -> tuple[dict[str, Findings], str]:
    """By axis, and the evidence in words."""
    if recording is None:
        found = run_experiments(config, rig.parent, names, _teller(console), only)
        return found, f"in virtual time: {_traces(found)}"
    run = load_run(recording)
    if missing := [name for name in names if name not in run.axes]:
        raise RigError([f"{recording}: no axis {missing[0]}; it has {', '.join(run.axes)}"])
    file = recording / "run.mcap" if recording.is_dir() else recording
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    return {name: from_run(run, name) for name in names}, f"{file.name} sha256 {digest[:16]}"


def _found_live(
    config: RigConfig, rig: Path, names: list[str], only: list[str], console: Any, out: Path | None, *, agreed: bool
) -> tuple[dict[str, Findings], str]:
    """By axis, from experiments in real time, and the evidence in words."""
    from hil.identify.live import LiveError, LiveExperiments, live_runtime  # the processes of a live run
    from hil.operate.demo_live import Signals
    from hil.telemetry.blackbox import run_directory

    def agrees(words: str) -> bool:
        console.print(words, markup=False, highlight=False, soft_wrap=True)
        return agreed or typer.confirm("Does it move freely, and may it move now?")

    folder = out or run_directory()
    try:
        with live_runtime(config) as runtime:
            runner = LiveExperiments(folder, console, Signals(), agrees, runtime)
            found = run_experiments(config, rig.parent, names, _teller(console), only, runner)
    except LiveError as error:
        console.print(f"hil: {error}\nto go on from there: --live --out {folder}", markup=False, soft_wrap=True)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    return found, f"in real time, {folder}: {_traces(found)}"


def _teller(console: Any) -> Callable[[str], None]:
    def tell(text: str) -> None:
        console.print(text, markup=False, highlight=False)

    return tell


def _traces(found: dict[str, Findings]) -> str:
    """Hashes of the runs."""
    return ", ".join(
        f"{name} {what} {trace[:12]}" for name, one in found.items() for what, trace in one.evidence.items()
    )


def _experiments(only: str) -> list[str]:
    wanted = [name.strip() for name in only.split(",") if name.strip()] or list(EXPERIMENTS)
    if unknown := [name for name in wanted if name not in EXPERIMENTS]:
        raise typer.BadParameter(f"--only {unknown[0]}: the experiments are {', '.join(EXPERIMENTS)}")
    return wanted


def _show(console: Any, rig: RigConfig, findings: dict[str, Findings]) -> None:
    from rich.table import Table

    table = Table(title=f"{rig.name}: identified, with 95 % intervals")
    for column in ("axis", "quantity", "value", "half width", "unit", "rig file"):
        table.add_column(column, justify="right" if column in ("value", "half width", "rig file") else "left")
    for name, one in findings.items():
        for quantity, estimate in one.found.items():
            cells = (f"{estimate.value:.5g}", f"{estimate.half_width:.2g}", _unit(estimate, rig.axes[name].kind))
            table.add_row(name, quantity, *cells, _stated(rig, name, quantity))
    console.print(table)
    for name, one in findings.items():
        if one.validation:
            error, own = one.validation
            unit = "N" if rig.axes[name].kind == "linear" else "N m"
            text = f"{name}: {error:.2g} {unit} RMS unexplained in a motion that no fit used, {own:.2g} {unit} in moves"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
        for quantity, why in one.refused.items():
            console.print(f"{name}: {quantity} refused: {why}", markup=False, highlight=False, soft_wrap=True)
        for text in _changes(rig, name, one):
            console.print(f"{name}: changed: {text}", markup=False, highlight=False, soft_wrap=True)


def _changes(rig: RigConfig, axis: str, one: Findings) -> list[str]:
    """Since the measurement that the rig file tells of."""
    before = rig.axes[axis].measured
    return [] if before is None else changes(before, one.found)


def _unit(estimate: Estimate, kind: str) -> str:
    if kind == "linear":
        return estimate.unit
    return {"kg": "kg m^2", "N": "N m", "m": "rad", "N s/m": "N m s/rad", "N/m": "N m/rad", "N s": "N m s"}.get(
        estimate.unit, estimate.unit
    )


def _stated(rig: RigConfig, axis: str, quantity: str) -> str:
    """What the rig file says of it."""
    model = rig.axes[axis].model
    if quantity == "constant":
        return f"{0.0 - model.gravity:.5g}"
    value = getattr(model, quantity, None)
    if isinstance(value, list):
        return " to ".join(f"{each:.3g}" for each in value)
    return "" if value is None else f"{value:.5g}"


def _document(rig: RigConfig, findings: dict[str, Findings], evidence: str) -> dict[str, Any]:
    axes = {
        name: {
            "found": {quantity: estimate._asdict() for quantity, estimate in one.found.items()},
            "refused": one.refused,
            "validation": one.validation,
            "model": model_values(one.found),
            "changes": _changes(rig, name, one),
        }
        for name, one in findings.items()
    }
    return {"rig": rig.name, "evidence": evidence, "axes": axes}
