"""`hil events NAME|RUN`: what happened, of a running rig, of one that ran, or of a recording."""

import json
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.exit_status import EXIT_FILE, EXIT_UNAVAILABLE
from hil.events.event import Event
from hil.events.sources import RingEvents
from hil.live.ring import RingError, RingReader
from hil.live.runtime_paths import known_sidecars, runtime_paths
from hil.runs.last import named_or_last
from hil.runs.summary import load_run
from hil.telemetry.client import NoSidecarError, RigClient, find_endpoint
from hil.telemetry.credentials import Credentials
from hil.telemetry.event_codec import decode
from hil.telemetry.recording import RecordingError

ANSWER_S = 3.0
POLL_S = 0.1


def events(
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME|RUN", help="name of a rig, a recording, or the folder of a run [the last run of runs/]"
        ),
    ] = None,
    follow: Annotated[bool, typer.Option("--follow", "-f", help="of a rig: go on until Ctrl-C")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object a line")] = False,
    connect: Annotated[str | None, typer.Option(help="Zenoh endpoint of the sidecar [found by itself]")] = None,
    key: Annotated[str, typer.Option(help="[telemetry] key of the rig file")] = "hil",
    credentials: Annotated[Path | None, typer.Option(help="directory of credentials, for an endpoint tls/...")] = None,
) -> None:
    """Every event, one line each: tick, time, axis, measured value, limit, cause, what to do next.

    Of a rig on this machine whose sidecar does not answer, those its ring still holds. Exit status 69: nobody knows
    that rig; 74: the recording cannot be read, or ticks are
    missing from it.
    """
    what = what or str(named_or_last(None))
    path = Path(what)
    try:
        if path.exists() or path.suffix == ".mcap":
            found, loss = of_recording(path)
            show(found, as_json=as_json)
            if loss:
                raise RecordingError(f"{path}: {loss}")
        else:
            secret = Credentials(credentials) if credentials else None
            with RigClient(connect or find_endpoint(what), key, what, secret) as client:
                _of_rig(client, what, as_json=as_json, follow=follow, remote=connect is not None)
    except RecordingError as error:
        print(f"hil events: {error}", file=sys.stderr)
        raise typer.Exit(EXIT_FILE) from None
    except (NoSidecarError, RingError) as error:
        print(f"hil events: {error}", file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    except KeyboardInterrupt:
        if not follow:
            raise


def show(found: Iterable[Event], *, as_json: bool) -> None:
    """To standard output, one line each."""
    for event in found:
        print(json.dumps(event.document) if as_json else event.line, flush=True)


def of_recording(path: Path) -> tuple[list[Event], str]:
    """Those a recording holds, and what is missing from it; of one that was made before there were any, those a replay
    tells. Raises RecordingError.
    """
    path = path / "run.mcap" if path.is_dir() else path
    if (run := load_run(path)).events:
        return run.events, run.loss
    from hil.virtual.replay import replay_run

    return (replay := replay_run(path)).events, replay.loss


def of_ring(name: str) -> list[Event]:
    """Those the ring of a rig on this machine still holds, whether its control process lives or not. Raises
    RingError.
    """
    paths = runtime_paths(name)
    found: list[Event] = []
    with RingReader(paths.ring) as reader:
        told = RingEvents(reader, paths.notes, begin=None)
        while len((batch := reader.read()).records):
            found += told.tell(batch)
    return [*found, *told.close()]


def _of_rig(client: RigClient, name: str, *, as_json: bool, follow: bool, remote: bool) -> None:
    try:
        if not (remote or known_sidecars(name)):
            raise NoSidecarError(f"no sidecar of {name} runs here")
        show(map(decode, client.wait_events(ANSWER_S)), as_json=as_json)
    except NoSidecarError:
        if remote:
            raise
        if not (ring := runtime_paths(name).ring).exists():
            raise NoSidecarError(f"{name}: no rig of that name runs here, and none left its ticks in {ring}") from None
        show(of_ring(name), as_json=as_json)
        print("hil events: no sidecar answers; these are the events that the ring still holds", file=sys.stderr)
    while follow:
        show(map(decode, client.events()), as_json=as_json)
        time.sleep(POLL_S)
