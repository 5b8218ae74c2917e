"""`hil command RIG ACTION`: an operator's command, with the control process' verdict.

On the rig's machine through the sidecar's Unix socket, as the rig's user or root; `estop` through the stop page,
without anybody's help. From elsewhere (--connect) over TLS, where the sidecar allows it.
"""

import contextlib
import shlex
import signal
import sys
import time
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from drivers.base.text_file import printable
from hil.analysis.task_figures import excursion_notes
from hil.cli.exit_status import EXIT_UNAVAILABLE
from hil.cli.options import shipped_rig
from hil.cycle.tick import CommandKind
from hil.live.runtime_paths import nearest
from hil.live.task_loading import law_document, task_document
from hil.operate.estop import stop_rig
from hil.rig.file import law_of_file, load_rig, task_of_file
from hil.rig.schema import RigConfig
from hil.telemetry.command_client import CommandClient, NoGatewayError, Verdict, local_client, remote_client
from hil.telemetry.credentials import Credentials, CredentialsError


class Action(StrEnum):
    """What can be asked for on the command line."""

    ACTIVATE = "activate"
    ACTIVATE_HOLD = "activate-hold"
    STOP = "stop"
    RESET = "reset"
    ESTOP = "estop"
    HOME = "home"
    SHUTDOWN = "shutdown"
    HEARTBEAT = "heartbeat"
    LOAD_TASK = "load-task"
    SET_LAW = "set-law"


def command(
    rig: Annotated[
        Path,
        typer.Argument(metavar="RIG", help="rig file, or the name of a running or shipped rig", show_default=False),
    ],
    action: Annotated[Action, typer.Argument(help="what to ask for", show_default=False)],
    file: Annotated[
        Path | None,
        typer.Argument(help="load-task: CSV or NPZ with a path, or TOML with a table [task]; set-law: with [law]"),
    ] = None,
    *,
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="a key of [task] or [law]: task.repeat=true, law.gains.kp=9e4"),
    ] = None,
    connect: Annotated[str | None, typer.Option(help="host:port of a sidecar elsewhere [this machine's]")] = None,
    credentials: Annotated[Path | None, typer.Option(help="directory with an operator's, for --connect")] = None,
    hold: Annotated[bool, typer.Option(help="keep sending the operator's heartbeat until Ctrl-C, then stop")] = False,
) -> None:
    """Exit status 0: the control process took it; 1: refused, with the reason; 69: nobody to ask."""
    config = config_of(rig)
    document = _document(config, action, file, overrides or ())
    if connect and credentials is None:
        raise typer.BadParameter("commands from elsewhere need --credentials", param_hint="--connect")
    if action is Action.ESTOP and not connect:
        sys.exit(stop_rig(config.name))
    try:
        client = remote_client(connect, Credentials(credentials)) if connect and credentials else at_hand(config.name)
        here = "" if connect else config.name
        with client:
            if document:
                load = client.load_task if action is Action.LOAD_TASK else client.set_law
                accepted = _say(load(document), client, action, here)
            else:
                accepted = _hold(client, action, config, here) if hold else _ask(client, action, here)
    except (NoGatewayError, CredentialsError) as error:
        print(f"hil command: {error}", file=sys.stderr)
        print(
            f"hil command: whatever else fails, `hil estop {config.name}` on the rig's machine stops", file=sys.stderr
        )
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    if not accepted:
        raise typer.Exit(1)


def _document(rig: RigConfig, action: Action, file: Path | None, overrides: Sequence[str]) -> str:
    """The task or law that goes with an action, JSON; empty for one that takes none. Raises RigError, BadParameter."""
    if action is Action.LOAD_TASK and file is not None:
        task = task_of_file(rig, file, overrides)
        for note in excursion_notes(rig.model_copy(update={"task": task})):
            print(note, file=sys.stderr)
        return task_document(task)
    if action is Action.SET_LAW and (file is not None or overrides):
        return law_document(law_of_file(rig, file, overrides))
    if action is Action.LOAD_TASK or file is not None:
        raise typer.BadParameter("load-task takes a file, set-law may, and nothing else does", param_hint="FILE")
    if action is Action.SET_LAW or overrides:
        raise typer.BadParameter("set-law and load-task, and nothing else, take a key of theirs", param_hint="--set")
    return ""


def config_of(rig: Path) -> RigConfig:
    """The rig of a file, of the running rig of that name, or of a shipped one. Raises RigError; typer.Exit with status
    69, having said how a rig is started, where there is none of that name.
    """
    if rig.exists() or len(rig.parts) > 1:
        return load_rig(rig)
    with contextlib.suppress(NoGatewayError), at_hand(str(rig)) as client:
        return client.rig()
    try:
        found = shipped_rig(rig)
    except FileNotFoundError as error:
        file = rig.with_suffix(".toml")
        words = f"hil: {rig}: no rig of that name runs here, and {error.strerror}"
        print(printable(words), file=sys.stderr)
        print(printable(_how_to_start(str(file) if file.exists() else "FILE")), file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    assert found is not None
    return load_rig(found)


def _how_to_start(file: str) -> str:
    rig = shlex.quote(file)
    return f"hil: start it: hil run {rig}, and beside it hil sidecar {rig}; on an emulated stage: hil demo {rig} --hold"


def at_hand(rig: str) -> CommandClient:
    """A connection to the sidecar of that rig on this machine, a demo's first. Raises NoGatewayError."""
    return nearest(rig, local_client, NoGatewayError)


def _ask(client: CommandClient, action: Action, here: str) -> bool:
    return _say(client.command(CommandKind[action.name]), client, action, here)


def _say(verdict: Verdict, client: CommandClient, action: Action, here: str) -> bool:
    print(f"{action}: {'accepted' if verdict.accepted else verdict.reason}; state {verdict.state}", flush=True)
    if verdict.accepted and (silent := client.silent()):  # why it may not lead where it was meant to
        print(f"hil command: {silent}", file=sys.stderr)
    if here and not verdict.accepted and (step := next_step(action, here, verdict)):
        print(f"hil command: next: {step}", file=sys.stderr)
    return verdict.accepted


def next_step(action: Action, rig: str, verdict: Verdict) -> str:
    """What to do about a refusal, as commands that can be pasted; empty where the reason says all there is."""
    again = f"hil command {rig} {action}"
    if verdict.reason.startswith("stale"):
        return f"this computer was held up; give it again: {again}; or stop at once: hil estop {rig}"
    starts = action in (Action.ACTIVATE, Action.ACTIVATE_HOLD, Action.HOME)
    if starts and verdict.state in ("FAULT", "ESTOP"):
        return f"hil events {rig} says why it stopped; then hil command {rig} reset, then {again}"
    if starts and verdict.state in ("ACTIVE", "HOMING"):
        return f"hil command {rig} stop, then {again}"
    return ""


def _hold(client: CommandClient, action: Action, rig: RigConfig, here: str) -> bool:
    """A deadman's handle: the rig moves while this runs, and stops within safety.heartbeat_s when it does not."""
    interval = (rig.safety.heartbeat_s or 1.0) / 4
    if not client.command(CommandKind.HEARTBEAT).accepted or not _ask(client, action, here):
        return False
    released: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: released.append(1))
    while not released:
        client.command(CommandKind.HEARTBEAT)
        time.sleep(interval)
    return _ask(client, Action.STOP, here)
