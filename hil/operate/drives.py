"""`hil drives`: bring up a rig's drives on the bus (bringup/), or say offline by an EDS how a drive can be used."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from drivers.eds.reader import Eds, EdsError, object_name, read_eds
from drivers.families.cia402.config import Cia402Config
from drivers.families.cia402.drive_plan import Axis, DrivePlan
from drivers.families.cia402.profile import DRIVE_HEARTBEAT_MS, MASTER_ID, plan_drives
from drivers.protocols.common import MAX_AXES
from hil.cli.console import plain_console
from hil.cli.exit_status import EXIT_FILE
from hil.cli.options import JsonTarget, Overrides, any_rig
from hil.cli.output import write_json
from hil.operate.bringup.command import JogAsked, bring_up

_REFUSED = 1  # exit status
_HERE = "here: --rated-torque"


def drives(
    rig: Annotated[
        Path | None,
        typer.Argument(
            metavar="[RIG]", callback=any_rig, show_default=False, help="rig file, or a shipped or running rig"
        ),
    ] = None,
    *,
    eds: Annotated[
        Path | None,
        typer.Option("--eds", help="offline: EDS or DCF file of a CiA 402 drive", exists=True, dir_okay=False),
    ] = None,
    axes: Annotated[int, typer.Option(min=1, max=MAX_AXES, help="--eds: so many of them on one bus")] = 1,
    node: Annotated[int, typer.Option(min=1, max=MASTER_ID - MAX_AXES, help="--eds: node of the first one")] = 1,
    rated_torque: Annotated[
        float | None, typer.Option(min=1e-6, max=1e6, help="--eds: what 6076h stands for, N m (N); else it is read")
    ] = None,
    rate_hz: Annotated[float, typer.Option(min=1, max=10_000, help="--eds: ticks per second")] = 1000.0,
    jog: Annotated[str | None, typer.Option(metavar="AXIS", help="then jog this axis while a key is held")] = None,
    force: Annotated[float | None, typer.Option(help="--jog: N (N m) at most [axes.NAME.push.force]")] = None,
    speed: Annotated[float | None, typer.Option(help="--jog: m/s (rad/s) [a twentieth of limits.speed]")] = None,
    distance: Annotated[float | None, typer.Option(help="--jog: m (rad) at most [a twentieth of the travel]")] = None,
    keys: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="--jog: read held keys from this pipe", hidden=True)
    ] = None,
    overrides: Overrides = None,
    json_file: JsonTarget = "",
) -> None:
    """Bring up the drives of RIG: who is on the bus, how each took its configuration, what it sends; --jog moves one.

    With --eds instead of RIG: say offline whether and how a drive can be used. Exit status 1: it cannot, or not yet.
    """
    if (rig is None) == (eds is None):
        raise typer.BadParameter("name a rig, or a drive's file with --eds")
    if eds is not None:
        _offline(eds, axes, node, rated_torque, rate_hz, json_file)
    elif rig is not None:
        asked = JogAsked(jog, force, speed, distance, keys) if jog else None
        bring_up(rig, overrides or [], json_file, asked)


def _offline(
    eds: Path, axes: int, node: int, rated_torque: float | None, rate_hz: float, json_file: str | None
) -> None:
    try:
        files = [read_eds(eds, node + axis) for axis in range(axes)]
    except EdsError as error:
        typer.echo(f"hil: {error}", err=True)
        raise typer.Exit(EXIT_FILE) from None
    settings = Cia402Config(eds=[str(eds)], rated_torque=[rated_torque] * axes if rated_torque else [])
    period_ns = round(1e9 / rate_hz)
    places = [Axis(number, axes, node + number, node, None, period_ns, DRIVE_HEARTBEAT_MS) for number in range(axes)]
    plan = plan_drives(files, places, settings)[0]
    plan.warnings += files[0].bitrate_notes()
    if json_file:
        write_json(as_document(plan, files[0]), json_file)
    if json_file != "-":
        _show(plan, files[0])
    if not plan.usable:
        raise typer.Exit(_REFUSED)


def as_document(plan: DrivePlan, eds: Eds) -> dict[str, Any]:
    """A plan as `--json` writes it."""
    return {
        "drive": plan.name,
        "usable": plan.usable,
        "mode": plan.mode or "refused",
        "offers": plan.offers,
        "rpdo": "shared" if plan.shared else "own",
        "sync_counter": plan.counter,
        "emergency_id": plan.emcy_id or None,
        "bitrates_kbit": sorted(rate for rate, can in eds.bitrates.items() if can),
        "steps": [
            {
                "object": object_name(item.step.object_index, item.step.subindex),
                "action": "write" if item.step.size else "read",
                "value": item.step.value if item.step.size or item.step.mask else None,
                "mask": item.step.mask or None,
                "need": item.need,
                "why": item.why,
                "skipped": item.skipped or None,
            }
            for item in plan.planned
        ],
        "reasons": [reason._asdict() for reason in plan.reasons],
        "warnings": plan.warnings,
    }


def _show(plan: DrivePlan, eds: Eds) -> None:
    """The plan for people."""
    console = plain_console(highlight=False)
    offers = ", ".join(plan.offers) or "not told by the file"
    console.print(f"{escape(plan.name)}: modes {offers}; {len(eds.entries)} objects")
    if plan.usable:
        rpdo = "one RPDO for all drives" if plan.shared else "an RPDO for each drive"
        counter = "with" if plan.counter else "without"
        console.print(f"usable in cyclic synchronous torque (CST); {rpdo}; SYNC {counter} counter", soft_wrap=True)
        table = Table(box=None, pad_edge=False)
        for title in ("object", "value", "need", "why"):
            table.add_column(title)
        for item in plan.planned:
            step = item.step
            value = f"{step.value:#x}" if step.size else (f"read, {step.value:#x}" if step.mask else "read")
            why = f"{item.why} [dim](skipped: {escape(item.skipped)})[/dim]" if item.skipped else item.why
            table.add_row(object_name(step.object_index, step.subindex), value, item.need, why)
        console.print(table)
    else:
        remedies = [reason.remedy for reason in plan.reasons]
        if all(remedies):
            stated = f"{' and '.join(remedies)} in the rig file ({_HERE})"
            console.print(f"[bold]can be used once you state[/bold] {stated}:", soft_wrap=True)
        else:
            console.print("[bold]cannot be used:[/bold]")
        for reason in plan.reasons:
            console.print(f"  {reason.object} {escape(reason.text)}", soft_wrap=True)
    for warning in plan.warnings:
        console.print(f"warning: {escape(warning)}", soft_wrap=True)
