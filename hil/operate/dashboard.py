"""`hil dashboard`: a rig in the browser. A Bokeh page (extra `dashboard`) that streams status messages from Zenoh."""

import html
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from hil.cli.exit_status import EXIT_UNAVAILABLE
from hil.operate.monitor import Newest, banner, event_lines, silence
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.client import RigClient, find_endpoint
from hil.telemetry.window import silent_axes

ROLLOVER = 1200  # points kept per line: two minutes at 10 Hz
UPDATE_MS = 100
SOURCE = "statuses"  # of the page's lines
EVENTS_LISTED = 50
_COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728")


def row(status: pb.Status) -> dict[str, list[float]]:
    """One column per axis and quantity, as Bokeh streams them."""
    values = {
        "t": [status.index * status.period_ns * 1e-9],
        "p50": [status.lateness_p50 * 1e6],
        "p99": [status.lateness_p99 * 1e6],
        "late": [status.lateness_max * 1e6],
    }
    scales = {"setpoint": 1e3, "position": 1e3, "max_error": 1e6, "force": 1.0}
    for quantity, scale in scales.items():
        for axis, value in enumerate(getattr(status, quantity)):
            values[f"{quantity}_{axis}"] = [value * scale]
    return values


def headline(status: pb.Status, age_s: float = 0.0) -> str:
    """State and counters in one line of HTML; names come from elsewhere and are escaped. age_s: of the status."""
    counts = status.counters
    fate = "" if status.control_alive else " · control process " + ("ended" if status.control_ended else "killed")
    fault = f" · fault {status.fault}" if status.fault not in ("", "NONE") else ""
    dead = silence(status, age_s)
    silent = silent_axes(status.axes, status.answer_age)
    wrong = html.escape(" · ".join([*([silent] if silent else []), *status.drive_problems]))
    text = html.escape(
        f"{status.rig} · {status.law} · {status.state or '-'}{fault}{fate} · missed {counts.missed_own} own, "
        f"{counts.missed_host} the host's · {counts.samples_lost} samples lost · {status.dropped} ticks not published"
    )
    text += f' · <b style="color: red">{wrong}</b>' if wrong else ""
    return f'<b style="color: red">{html.escape(dead)}</b> · it was: {text}' if dead else text


def event_list(status: pb.Status, events: Sequence[pb_events.Event]) -> str:
    """The latched fault as a banner, and the last events, the newest first, as HTML; all words are escaped."""
    latched = html.escape(banner(status, events).plain)
    lines = [html.escape(line) for line in event_lines(list(events)[-EVENTS_LISTED:]).plain.splitlines()]
    head = f'<div style="background: red; color: white; padding: 4px"><b>{latched}</b></div>' if latched else ""
    return head + "<br>".join(reversed(lines))


class Page:
    """One browser session's document, fed by a client of its own."""

    def __init__(self, document: Any, client: RigClient) -> None:
        self._document = document
        self._newest = Newest(client)
        self._source: Any = None
        self._title: Any = None
        self._events: Any = None
        document.title = "hil"
        document.add_periodic_callback(self.update, UPDATE_MS)
        document.on_session_destroyed(lambda _context: client.close())

    def update(self) -> None:
        """Take the newest status in; the page is laid out when the first one names the axes."""
        fresh, status = self._newest.look(), self._newest.status
        if status is None or not (status.position or self._source):
            return
        if self._source is None or self._source.data.keys() != row(status).keys():  # another rig's axes
            self._lay_out(status)
        self._title.text = headline(status, self._newest.age_s)
        self._events.text = event_list(status, list(self._newest.events))
        if fresh and status.position:
            self._source.stream(row(status), rollover=ROLLOVER)

    def _lay_out(self, status: pb.Status) -> None:
        from bokeh.layouts import column, gridplot
        from bokeh.models import ColumnDataSource
        from bokeh.models.widgets import Div

        self._document.clear()
        self._source = ColumnDataSource({name: [] for name in row(status)}, name=SOURCE)
        self._title = Div(text="", styles={"font-size": "1.1em"})
        self._events = Div(text="", sizing_mode="stretch_width")
        panels = [
            self._panel("setpoint, mm (mrad)", status, "setpoint"),
            self._panel("largest following error of the last second, µm (µrad)", status, "max_error"),
            self._panel("force, N (N m)", status, "force"),
            self._lateness(),
        ]
        grid = gridplot([panels[:2], panels[2:]], sizing_mode="stretch_width")
        self._document.add_root(column(self._title, grid, self._events, sizing_mode="stretch_width"))

    def _panel(self, title: str, status: pb.Status, quantity: str) -> Any:
        from bokeh.plotting import figure

        panel = figure(title=title, height=280, x_axis_label="s")
        for axis, name in enumerate(status.axes[: len(getattr(status, quantity))]):
            panel.line("t", f"{quantity}_{axis}", source=self._source, color=_COLOURS[axis], legend_label=name)
        if panel.legend:
            panel.legend.location = "top_left"
        return panel

    def _lateness(self) -> Any:
        from bokeh.plotting import figure

        panel = figure(title="tick lateness over the last second, µs", height=280, x_axis_label="s", y_axis_type="log")
        for name, label, colour in zip(("p50", "p99", "late"), ("p50", "p99", "max"), _COLOURS, strict=False):
            panel.line("t", name, source=self._source, color=colour, legend_label=label)
        panel.legend.location = "top_left"
        return panel


def make_server(endpoint: str, key: str, rig: str, port: int) -> Any:
    """A Bokeh server on loopback; every browser session gets a Zenoh client of its own. Raises ImportError, OSError."""
    from bokeh.server.server import Server

    def open_page(document: Any) -> None:
        Page(document, RigClient(endpoint, key, rig))

    origins = [f"localhost:{port}", f"127.0.0.1:{port}"]
    return Server({"/": open_page}, address="127.0.0.1", port=port, allow_websocket_origin=origins)


def dashboard(
    rig: Annotated[str | None, typer.Argument(help="name of the rig [any]")] = None,
    connect: Annotated[str | None, typer.Option(help="Zenoh endpoint of the sidecar [found by itself]")] = None,
    key: Annotated[str, typer.Option(help="[telemetry] key of the rig file")] = "hil",
    port: Annotated[int, typer.Option(min=1, max=65535, help="of the page, on loopback")] = 5006,
    show: Annotated[bool, typer.Option(help="open a browser")] = True,
) -> None:
    """Watch a rig in a browser until Ctrl-C."""
    try:
        server = make_server(connect or find_endpoint(rig), key, rig or "*", port)
    except ImportError:
        print('hil dashboard: Bokeh is not installed: pip install "hil[dashboard]"', file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    except OSError as error:
        print(f"hil dashboard: port {port}: {error.strerror}; choose another with --port", file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    print(f"dashboard at http://localhost:{port}/; Ctrl-C ends", flush=True)
    if show:
        server.io_loop.add_callback(server.show, "/")
    try:
        server.run_until_shutdown()
    except KeyboardInterrupt:
        server.stop()
