"""`hil check`: the rig by calculation (hil/operate/check.py); with --law, whether a law may go to it, by trying."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from drivers.base.plugins import file_of
from hil.cli.console import plain_console
from hil.cli.options import JsonTarget, Overrides, ReadRig
from hil.cli.output import drawable, write_json
from hil.operate.check import check_rig
from hil.studies.acceptance.law import Demand, accept_law

_USUAL = Demand()
_VERDICTS = {True: Text("passed", "green"), False: Text("FAILED", "bold red"), None: Text("not tried", "yellow")}


def check(
    rig_file: ReadRig,
    *,
    overrides: Overrides = None,
    json_path: JsonTarget = "",
    picture: Annotated[Path | None, typer.Option(callback=drawable, help="draw one tick's timeline there")] = None,
    measured: Annotated[
        list[str] | None, typer.Option(metavar="AXIS=FILE", help="CSV with the axis' measured frequency response")
    ] = None,
    frd: Annotated[Path | None, typer.Option(metavar="FILE", help="write the loop's frequency response, JSON")] = None,
    law: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="is this law fit to run? A name, ./file.py:Class or package.module:Class"),
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="is this estimator fit to run? Named the same way; with the rig's law, or --law"
        ),
    ] = None,
    margin: Annotated[float, typer.Option(min=0.0, help="--law: least gain margin, dB")] = _USUAL.gain_db,
    phase_margin: Annotated[float, typer.Option(min=0.0, help="--law: least phase margin, degrees")] = _USUAL.phase_deg,
    stride: Annotated[
        int, typer.Option(min=1, help="--law: try every n-th case of the fault campaign")
    ] = _USUAL.stride,
) -> None:
    """It computes the worst-case response time of every frame, the bus load, and stability on and off the nominal
    model. It tells whether the task keeps the limits. Exit status 78 where one of them fails.

    --law and --estimator run the rig's task, time the ticks, look for memory that grows, and compare two processes.
    They also take the margins and run a part of the fault campaign. Exit status 1 where one of them fails.
    """
    wanted = {"law": law, "estimator": estimator}
    names = {kind: _found(name, rig_file) for kind, name in wanted.items() if name is not None}
    if not names:
        check_rig(rig_file, overrides or (), json_path=json_path, picture=picture, measured=measured or (), frd=frd)
        return
    console = plain_console(stderr=json_path == "-")
    findings = []
    demand = Demand(margin, phase_margin, stride=stride)
    named = [f"{kind}.name={json.dumps(name)}" for kind, name in names.items()]
    for finding in accept_law(rig_file, [*(overrides or ()), *named], demand):
        findings.append(finding)
        verdict = _VERDICTS[finding.passed]
        console.print(Text(f"{finding.step:16} ").append(verdict).append(f"  {finding.text}"), soft_wrap=True)
    accepted = all(finding.passed for finding in findings)
    told = ", ".join(f"{kind} {name}" for kind, name in wanted.items() if name is not None)
    console.print(f"{told}: " + ("accepted" if accepted else "not accepted"), markup=False, highlight=False)
    if json_path:
        write_json({**wanted, "accepted": accepted, "steps": [step._asdict() for step in findings]}, json_path)
    if not accepted:
        raise typer.Exit(1)


def _found(name: str, rig_file: Path) -> str:
    """A plug-in's name; a file that is not beside the rig, but in the present folder, by its whole path."""
    file = file_of(name)
    if file and not (rig_file.parent / file).exists() and Path(file).exists():
        return str(Path(file).resolve()) + name.removeprefix(file)
    return name
