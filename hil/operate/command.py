"""`hil command RIG ACTION`: an operator's command through the gateway, with the control process's verdict."""

import signal
import sys
import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.exit_status import EXIT_UNAVAILABLE
from hil.cycle.tick import CommandKind
from hil.live.runtime_paths import Known, known_sidecars, runtime_paths
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.telemetry.client import DEFAULT_ENDPOINT, NoSidecarError, RigClient, listens

CONNECT_S = 3.0


class Action(StrEnum):
    """What can be asked for on the command line."""

    ACTIVATE = "activate"
    STOP = "stop"
    RESET = "reset"
    ESTOP = "estop"
    HOME = "home"
    SHUTDOWN = "shutdown"
    HEARTBEAT = "heartbeat"


def find_sidecar(rig: RigConfig, endpoint: str | None) -> Known:
    """Where the rig's sidecar listens, and the token file that goes with it."""
    for known in known_sidecars(rig.name):
        if known.endpoint == endpoint or (endpoint is None and listens(known.endpoint)):
            return known
    listen = endpoint or (rig.telemetry.listen or [DEFAULT_ENDPOINT])[0]
    return Known(rig.name, listen, runtime_paths(rig.name).token)


def command(
    rig: Annotated[Path, typer.Argument(help="rig file", show_default=False)],
    action: Annotated[Action, typer.Argument(help="what to ask for", show_default=False)],
    connect: Annotated[str | None, typer.Option(help="Zenoh endpoint of the sidecar [found by itself]")] = None,
    hold: Annotated[bool, typer.Option(help="keep sending the operator's heartbeat until Ctrl-C, then stop")] = False,
) -> None:
    """Exit status 0: the control process took it; 1: refused, with the reason; 69: nobody to ask."""
    config = load_rig(rig)
    sidecar = find_sidecar(config, connect)
    try:
        token = sidecar.token.read_text(encoding="utf-8")
    except OSError as error:
        print(f"hil command: {sidecar.token}: {error.strerror}: is the sidecar running, as this user?", file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    with RigClient(sidecar.endpoint, config.telemetry.key, config.name) as client:
        try:
            client.wait_status(CONNECT_S)
            accepted = _hold(client, token, action, config) if hold else _ask(client, token, action)
        except NoSidecarError as error:
            print(f"hil command: {error}", file=sys.stderr)
            raise typer.Exit(EXIT_UNAVAILABLE) from None
    if not accepted:
        raise typer.Exit(1)


def _ask(client: RigClient, token: str, action: Action) -> bool:
    reply = client.command(CommandKind[action.name], token)
    print(f"{action}: {'accepted' if reply.accepted else reply.reason}; state {reply.state}", flush=True)
    return reply.accepted


def _hold(client: RigClient, token: str, action: Action, rig: RigConfig) -> bool:
    """A deadman's handle: the rig moves while this runs, and stops within safety.heartbeat_s when it does not."""
    interval = (rig.safety.heartbeat_s or 1.0) / 4
    if not client.command(CommandKind.HEARTBEAT, token).accepted or not _ask(client, token, action):
        return False
    released: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: released.append(1))
    while not released:
        client.command(CommandKind.HEARTBEAT, token)
        time.sleep(interval)
    return _ask(client, token, Action.STOP)
