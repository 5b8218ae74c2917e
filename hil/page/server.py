"""The page's requests: what each needs, and who may make it. Everything but the page's own files asks for a pairing."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from drivers.base.text_file import words_of
from hil.cycle.tick import CommandKind
from hil.page.access import Access, Pairing, PairingError, Role
from hil.page.audit import Audit
from hil.page.guard import FOXGLOVE, Guard
from hil.page.hub import Heard, Hub, Viewer
from hil.page.rig_facts import clean, rig_facts, runs_in
from hil.page.ring_feed import running_rigs
from hil.page.sidecar_feed import SidecarFeed
from hil.page.stopping import ask, emergency_stop

STATIC: Final = Path(__file__).with_name("static")
METRICS: Final = "/metrics"
Exposition = Callable[[dict[str, Heard]], tuple[bytes, str]]


class Streams(Protocol):
    """What a viewer that is no browser is sent (hil/page/foxglove.py)."""

    async def run(self) -> None:
        """Until it is cancelled."""

    def take(self, text: str) -> None:
        """A message of the viewer. Raises ValueError."""


class Offers(NamedTuple):
    """What is off by default. exposition: makes the answer to /metrics, and its media type. streams: for a viewer of
    the Foxglove protocol; subprotocols: its words for it, the best first; waiting: messages kept for it.
    """

    exposition: Exposition | None = None
    streams: Callable[[str, SidecarFeed, Viewer], Streams] | None = None
    subprotocols: Sequence[str] = ()
    waiting: int = 1


NOTHING_MORE: Final = Offers()


LARGEST: Final = 4096  # bytes of a request
VIEWERS: Final = 32
CHECKED_S: Final = 0.2  # how often an open page's rights are looked at
COOKIE_S: Final = 90 * 24 * 3600
_COMMANDS: Final = {"stop": (CommandKind.STOP, Role.STOP), "reset": (CommandKind.RESET, Role.OPERATE)}


class RefusedError(Exception):
    """A request that is answered with this status and text."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status, self.text = status, text


class PageServer:
    """rigs: names of those that are shown; empty: all that run here. cookie: its name. secure: over TLS."""

    def __init__(
        self, access: Access, audit: Audit, rigs: Sequence[str], runs: Path, *, cookie: str, secure: bool,
        offers: Offers = NOTHING_MORE,
    ) -> None:  # fmt: skip
        self._access, self._audit = access, audit
        self._named, self._runs = tuple(rigs), runs
        self._cookie, self._secure, self._offers = cookie, secure, offers
        self.hubs: dict[str, Hub] = {}
        self._others: set[Viewer] = set()  # that are no browsers

    def routes(self) -> list[BaseRoute]:
        """All there is to ask for."""
        more: list[BaseRoute] = []
        if self._offers.exposition:
            more.append(Route(METRICS, self._answer(self._scrape), methods=["GET"]))
        if self._offers.streams:
            more.append(WebSocketRoute(FOXGLOVE + "{rig}", self._view))
        return [
            *more,
            Route("/", self._answer(self._front), methods=["GET"]),
            Route("/pair", self._answer(self._pair), methods=["POST"]),
            Route("/leave", self._answer(self._leave), methods=["POST"]),
            Route("/me", self._answer(self._me), methods=["GET"]),
            Route("/runs", self._answer(self._list_runs), methods=["GET"]),
            Route("/computer", self._answer(self._computer), methods=["GET"]),
            Route("/rigs/{rig}/facts", self._answer(self._facts), methods=["GET"]),
            Route("/rigs/{rig}/margins", self._answer(self._margins), methods=["GET"]),
            Route("/rigs/{rig}/estop", self._answer(self._estop), methods=["POST"]),
            Route("/rigs/{rig}/{command:str}", self._answer(self._command), methods=["POST"]),
            WebSocketRoute("/rigs/{rig}/feed", self._feed),
            Mount("/static", StaticFiles(directory=STATIC)),
        ]

    def _answer(self, handle: Callable[[Request], Awaitable[Response]]) -> Callable[[Request], Awaitable[Response]]:
        """The same with refusals answered, and every request in the audit."""

        async def answered(request: Request) -> Response:
            try:
                response = await handle(request)
            except RefusedError as error:
                response = JSONResponse({"accepted": False, "said": error.text}, error.status)
            except (PairingError, OSError) as error:
                response = JSONResponse({"accepted": False, "said": words_of(error)}, 403)
            except asyncio.CancelledError:  # nobody waits for the answer any more
                response = JSONResponse({"accepted": False, "said": "the page's server ends"}, 503)
            answer = bytes(response.body).decode() if request.method == "POST" else ""
            self._note(request, request.method, response.status_code, answer)
            return response

        return answered

    def _note(self, request: HTTPConnection, method: str, status: int, said: str = "") -> None:
        pairing = self._pairing(request)
        who = f"{pairing.name} ({pairing.role.name.lower()})" if pairing else "nobody"
        self._audit.note(
            who, request.client.host if request.client else "", f"{method} {request.url.path}", status, said
        )

    def _pairing(self, request: HTTPConnection) -> Pairing | None:
        if request.url.path.startswith(FOXGLOVE):  # a program's, which has no other place for it than its address
            return self._access.pairing_of(request.query_params.get("token"))
        scheme, _, secret = request.headers.get("Authorization", "").partition(" ")
        if self._offers.exposition and request.url.path == METRICS and scheme.lower() == "bearer":
            return self._access.pairing_of(secret.strip())  # a program's: it looks at figures, and no more
        return self._access.pairing_of(request.cookies.get(self._cookie))

    def _may(self, request: HTTPConnection, role: Role) -> Pairing:
        pairing = self._pairing(request)
        if pairing is None:
            raise RefusedError(401, "this browser is not paired: give it a code")
        if pairing.role < role:
            raise RefusedError(403, f"{pairing.name} may {pairing.role.name.lower()}, not {role.name.lower()}")
        return pairing

    def rigs(self) -> list[str]:
        """Names of the rigs that can be looked at."""
        return list(self._named) or running_rigs()

    def _rig(self, request: HTTPConnection) -> str:
        """The rig that a request names. Raises RefusedError for one that is not shown."""
        name = str(request.path_params["rig"])
        if name not in self.rigs():
            raise RefusedError(404, f"no rig {name[:80]!a}: {', '.join(self.rigs()) or 'none runs here'}")
        return name

    def _hub(self, rig: str) -> Hub:
        if rig not in self.hubs:
            self.hubs[rig] = Hub(rig)
        return self.hubs[rig]

    async def _front(self, _request: Request) -> Response:
        return FileResponse(STATIC / "index.html")

    async def _pair(self, request: Request) -> Response:
        given = await _document(request)
        secret, pairing = self._access.pair(str(given.get("code", ""))[:40], str(given.get("name", "")))
        response = JSONResponse({"accepted": True, "said": f"paired as {pairing.name}: {pairing.role.name.lower()}"})
        response.set_cookie(
            self._cookie, secret, max_age=COOKIE_S, httponly=True, samesite="strict", secure=self._secure
        )
        return response

    async def _leave(self, request: Request) -> Response:
        self._access.revoke(self._may(request, Role.WATCH).name)
        response = JSONResponse({"accepted": True, "said": "this browser is no longer paired"})
        response.delete_cookie(self._cookie, httponly=True, samesite="strict", secure=self._secure)
        return response

    async def _me(self, request: Request) -> Response:
        pairing = self._pairing(request)
        if pairing is None:
            return JSONResponse({"role": ""})
        return JSONResponse({"name": pairing.name, "role": pairing.role.name.lower(), "rigs": self.rigs()})

    async def _list_runs(self, request: Request) -> Response:
        self._may(request, Role.WATCH)
        return JSONResponse({"folder": self._runs.name, "runs": await asyncio.to_thread(runs_in, self._runs)})

    async def _facts(self, request: Request) -> Response:
        self._may(request, Role.WATCH)
        hub = self._hub(self._rig(request))
        return JSONResponse(await asyncio.to_thread(rig_facts, hub.ring.metadata))

    async def _computer(self, request: Request) -> Response:
        """What `hil doctor` finds, but for what only the control process' user can try."""
        self._may(request, Role.WATCH)
        from hil.operate.doctor import computer_findings

        found = await asyncio.to_thread(computer_findings)
        return JSONResponse({"findings": clean([finding._asdict() for finding in found])})

    async def _margins(self, request: Request) -> Response:
        self._may(request, Role.WATCH)
        return JSONResponse(await self._hub(self._rig(request)).margins())

    async def _scrape(self, request: Request) -> Response:
        assert self._offers.exposition is not None
        self._may(request, Role.WATCH)
        text, media_type = self._offers.exposition({name: self._hub(name).heard() for name in self.rigs()})
        return Response(text, media_type=media_type)

    async def _estop(self, request: Request) -> Response:
        self._may(request, Role.STOP)
        rig = str(request.path_params["rig"])
        if self._named and rig not in self._named:
            raise RefusedError(404, f"no rig {rig[:80]!a}: {', '.join(self._named)}")
        return JSONResponse(await emergency_stop(rig))

    async def _command(self, request: Request) -> Response:
        name, rig = str(request.path_params["command"]), self._rig(request)
        if name not in _COMMANDS:
            raise RefusedError(404, f"no command {name[:40]!a}: {', '.join(_COMMANDS)}, estop")
        kind, role = _COMMANDS[name]
        pairing = self._may(request, role)
        given = await _document(request)
        if role is Role.OPERATE and not self._hub(rig).take(pairing.name, over=given.get("take") is True):
            raise RefusedError(409, f"{self._hub(rig).operator} operates this rig: take over from there first")
        return JSONResponse(await asyncio.to_thread(ask, rig, kind))

    async def _feed(self, socket: WebSocket) -> None:
        """A rig's stream, for as long as the browser is there and may watch."""
        if (found := await self._admit(socket)) is None:
            return
        pairing, hub = found
        viewer = Viewer(pairing.name)
        hub.join(viewer)
        try:
            await self._stream(socket, viewer, lambda text: viewer.choose(text, len(hub.ring.signals)))
        finally:
            hub.leave(viewer)

    async def _view(self, socket: WebSocket) -> None:
        """A rig's stream for a viewer of the Foxglove protocol."""
        assert self._offers.streams is not None
        wanted = socket.scope["subprotocols"]
        chosen = next((each for each in self._offers.subprotocols if each in wanted), None)
        if (found := await self._admit(socket, chosen)) is None:
            return
        pairing, hub = found
        viewer = Viewer(pairing.name, self._offers.waiting)
        self._others.add(viewer)
        try:
            streams = self._offers.streams(hub.rig, hub.sidecar, viewer)
            await self._stream(socket, viewer, streams.take, streams.run())
        finally:
            self._others.discard(viewer)

    async def _admit(self, socket: WebSocket, subprotocol: str | None = None) -> tuple[Pairing, Hub] | None:
        """Who watches which rig; None where that was refused, and the socket closed with the reason."""
        await socket.accept(subprotocol)  # first, so that a viewer can tell why: a refused handshake says nothing
        try:
            pairing, hub = self._may(socket, Role.WATCH), self._hub(self._rig(socket))
        except RefusedError as error:
            self._note(socket, "WS", error.status, error.text)
            await socket.close(4000 + error.status, error.text[:100])
            return None
        if sum(len(each.viewers) for each in self.hubs.values()) + len(self._others) >= VIEWERS:
            await socket.close(4503, f"{VIEWERS} pages are open")
            return None
        self._note(socket, "WS", 101)
        return pairing, hub

    async def _stream(
        self, socket: WebSocket, viewer: Viewer, take: Callable[[str], None], *works: Coroutine[Any, Any, None]
    ) -> None:
        """Until the first of these ends: sending, what the viewer asks for, its right to watch, works."""

        async def send(message: bytes | str) -> None:
            await (socket.send_bytes(message) if isinstance(message, bytes) else socket.send_text(message))

        async def listen() -> None:
            while True:
                take((await socket.receive_text())[:LARGEST])

        async def watch_rights() -> None:
            while self._pairing(socket) is not None:
                await asyncio.sleep(CHECKED_S)

        tasks = [asyncio.create_task(work) for work in (viewer.pump(send), listen(), watch_rights(), *works)]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
        error = next((found for task in tasks if not task.cancelled() and (found := task.exception())), None)
        with contextlib.suppress(WebSocketDisconnect, RuntimeError, OSError):  # the viewer is gone
            if error is None:
                await socket.close(4401, "revoked")
            elif isinstance(error, ValueError | KeyError):  # KeyError: bytes where a text belongs
                await socket.close(1008, str(error)[:100])
            else:
                raise error

    @contextlib.asynccontextmanager
    async def lifespan(self, _app: Starlette) -> AsyncIterator[None]:
        """Nothing to begin; at the end all rigs are let go."""
        yield
        for hub in self.hubs.values():
            await hub.close()


async def _document(request: Request) -> dict[str, Any]:
    """The JSON object of a request; {} where it has none. Raises RefusedError."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > LARGEST:
            raise RefusedError(413, f"a request of more than {LARGEST} bytes")
    try:
        found = json.loads(body or b"{}")
    except (ValueError, RecursionError):
        raise RefusedError(400, "the request is no JSON") from None
    if not isinstance(found, dict):
        raise RefusedError(400, "the request is no JSON object")
    return found


def make_app(server: PageServer, audit: Audit, hosts: Sequence[str], *, secure: bool) -> Starlette:
    """The whole application. hosts: names with port under which it may be asked for."""
    guard = Middleware(Guard, hosts=hosts, secure=secure, audit=audit)
    zipped = Middleware(GZipMiddleware, minimum_size=500)
    return Starlette(routes=server.routes(), middleware=[guard, zipped], lifespan=server.lifespan)
