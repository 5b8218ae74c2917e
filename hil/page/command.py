"""`hil page`: watch and stop rigs from a browser, on this machine or, over TLS, from a phone beside it."""

import contextlib
import ipaddress
import os
import shlex
import socket
import ssl
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from hil.cli.exit_status import EXIT_UNAVAILABLE
from hil.page.access import Access, Role, spelt
from hil.rig.extras import install_command

if TYPE_CHECKING:
    from uvicorn import Config

    from hil.page.server import Offers

PORT = 5006
_LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
_NOT_INSTALLED = f"hil page: its server is not installed: {install_command('page')}"


class Place(NamedTuple):
    """Where the page is served. names: others under which browsers ask for it. key: of the certificate."""

    port: int
    bind: str
    names: tuple[str, ...]
    certificate: Path | None
    key: Path | None


def page(
    rigs: Annotated[
        list[str] | None, typer.Argument(metavar="[RIG]...", help="names of rigs [all that run here]")
    ] = None,
    *,
    port: Annotated[int, typer.Option(min=1, max=65535, help="TCP port")] = PORT,
    bind: Annotated[
        str, typer.Option(metavar="ADDRESS", help="address to listen at; beyond loopback only with --certificate")
    ] = "127.0.0.1",
    host: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="host name that browsers may use; may be repeated")
    ] = None,
    certificate: Annotated[Path | None, typer.Option(help="TLS certificate chain, PEM")] = None,
    key: Annotated[Path | None, typer.Option(help="private key of --certificate, PEM")] = None,
    runs: Annotated[Path, typer.Option(metavar="FOLDER", help="the folder of the runs")] = Path("runs"),
    paired: Annotated[bool, typer.Option("--paired", help="list the paired browsers, and end")] = False,
    revoke: Annotated[str, typer.Option(metavar="NAME", help="take a browser's rights away, and end")] = "",
    metrics: Annotated[bool, typer.Option("--metrics", help="answer /metrics too, in OpenMetrics")] = False,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="answer /foxglove/RIG too, for Lichtblick and Foxglove")
    ] = False,
    token: Annotated[str, typer.Option(metavar="NAME", help="print a secret for a program that watches, and end")] = "",
) -> None:
    """Show rigs in a browser until Ctrl-C. A browser is paired once, by a code that this command prints.

    Exit status 69: no port, or the server is not installed; 1: --revoke names no paired browser.
    """
    access = Access(state_folder(), port)
    if token:
        secret, pairing = access.admit(token, Role.WATCH)
        print(f"{pairing.name} may watch, until hil page --revoke {shlex.quote(pairing.name)}", file=sys.stderr)
        print(secret)
        return
    if paired or revoke:
        _administer(access, revoke)
        return
    place = Place(port, bind, tuple(host or ()), certificate, key)
    try:
        config = configured(access, place, rigs or [], runs, metrics=metrics, foxglove=foxglove)
    except ImportError:
        print(_NOT_INSTALLED, file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    try:
        listening = _listen(bind, port)
    except OSError as error:
        why = os.strerror(error.errno or 0)
        print(f"hil page: {bind} port {port}: {why}; choose another with --port", file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    access.renew()
    scheme = "https" if certificate else "http"
    shown = (host or ["localhost"])[0] if ipaddress.ip_address(bind).is_loopback else (host or [bind])[0]
    print(f"page at {scheme}://{shown}:{port}/; Ctrl-C ends")
    print(f"to pair a browser, give it one of these codes (good once; new ones: cat {access.codes_file})")
    for role, code in access.codes.items():
        print(f"  {role.name.lower():8} {spelt(code)}")
    sys.stdout.flush()
    _serve(config, listening)


def dashboard(
    rig: Annotated[str | None, typer.Argument(help="name of the rig [all that run here]")] = None,
    port: Annotated[int, typer.Option(min=1, max=65535, help="TCP port")] = PORT,
    _connect: Annotated[str | None, typer.Option("--connect", hidden=True)] = None,
    _key: Annotated[str | None, typer.Option("--key", hidden=True)] = None,
    _show: Annotated[bool, typer.Option("--show/--no-show", hidden=True)] = False,
) -> None:
    """The former name of `hil page`; it goes with the next version. Its other options have no effect any more."""
    print("hil dashboard is now hil page; this name goes with the next version", file=sys.stderr)
    page([rig] if rig else None, port=port)


def state_folder() -> Path:
    """Where pairings, codes and the audit are kept: below $STATE_DIRECTORY (set by systemd), else $XDG_STATE_HOME/hil,
    else ~/.local/state/hil.
    """
    service = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    home = Path(os.environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")) / "hil"
    return (Path(service) if service else home) / "page"


def configured(
    access: Access, place: Place, rigs: list[str], runs: Path, *, metrics: bool = False, foxglove: bool = False
) -> "Config":
    """The server. Raises ImportError where it is not installed, typer.BadParameter for what cannot be served."""
    from uvicorn import Config

    from hil.page.audit import Audit
    from hil.page.server import PageServer, make_app

    certificate, key = place.certificate, place.key
    secure = certificate is not None
    hosts = allowed_hosts(place.bind, place.names, place.port, secure=secure)
    if (certificate is None) != (key is None):
        raise typer.BadParameter("--certificate and --key belong together", param_hint="--key")
    if certificate and key:
        _refuse_unusable(certificate, key)
    audit = Audit(access.folder / "audit.jsonl")
    cookie = f"hil_page_{place.port}"
    server = PageServer(access, audit, rigs, runs, cookie=cookie, secure=secure, offers=_offers(metrics, foxglove))
    return Config(
        make_app(server, audit, hosts, secure=secure),
        log_level="warning",
        server_header=False,
        proxy_headers=False,
        ws_max_size=4096,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
        ssl_certfile=certificate,
        ssl_keyfile=key,
    )


def _offers(metrics: bool, foxglove: bool) -> "Offers":
    """What was asked for; nothing else is loaded."""
    from hil.page.server import Offers

    offers = Offers()
    if metrics:
        from hil.page.metrics import exposition

        offers = offers._replace(exposition=exposition)
    if foxglove:
        from hil.page.foxglove import SUBPROTOCOLS, WAITING, LiveStreams

        offers = offers._replace(streams=LiveStreams, subprotocols=SUBPROTOCOLS, waiting=WAITING)
    return offers


def allowed_hosts(bind: str, names: Sequence[str], port: int, *, secure: bool) -> list[str]:
    """Values of Host that are this page's. Raises typer.BadParameter for an address that may not be served so."""
    try:
        address = ipaddress.ip_address(bind)
    except ValueError:
        raise typer.BadParameter(f"{bind}: expected an IP address", param_hint="--bind") from None
    if not address.is_loopback and not secure:
        raise typer.BadParameter(
            f"{bind} can be reached from elsewhere: that needs --certificate and --key", param_hint="--bind"
        )
    if address.is_unspecified and not names:
        raise typer.BadParameter("with --bind to all addresses, say under which name: --host NAME", param_hint="--host")
    own = f"[{bind}]" if address.version == 6 else bind
    every = dict.fromkeys([*_LOOPBACK, *([] if address.is_unspecified else [own]), *names])
    usual = 443 if secure else 80
    return [text for name in every for text in ([f"{name}:{port}", name] if port == usual else [f"{name}:{port}"])]


def _refuse_unusable(certificate: Path, key: Path) -> None:
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key)
    except (ssl.SSLError, OSError) as error:
        raise typer.BadParameter(f"{certificate}, {key}: {error}", param_hint="--certificate") from None


def _listen(bind: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in bind else socket.AF_INET
    return socket.create_server((bind, port), family=family, backlog=64)


def _serve(config: "Config", listening: socket.socket) -> None:
    from uvicorn import Server

    with contextlib.suppress(KeyboardInterrupt):
        Server(config).run(sockets=[listening])


def _administer(access: Access, revoke: str) -> None:
    if revoke and not access.revoke(revoke):
        print(f"hil page: no paired browser has the name {revoke!a}: hil page --paired lists them", file=sys.stderr)
        raise typer.Exit(1)
    rows: list[Any] = access.pairings()
    for each in rows:
        when = time.strftime("%Y-%m-%d %H:%M", time.localtime(each.wall))
        print(f"{each.role.name.lower():8} {when}  {each.name}")
    print(f"{len(rows)} paired")
