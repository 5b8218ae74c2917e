"""What stands before every request: the right Host, the right Origin, and headers that let no foreign script run.

A page elsewhere can make a browser send requests here (a forged Origin), and a name server elsewhere can make it take
this machine for another (a forged Host). Both are refused before anything else is looked at. A viewer's stream may have
any Origin, as it needs a secret in its address: no cookie counts there, so a page elsewhere gains nothing.
"""

from collections.abc import Collection
from typing import Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from hil.page.audit import Audit

HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
FOXGLOVE: Final = "/foxglove/"  # streams for viewers
_HARMLESS: Final = ("GET", "HEAD")
REFUSED_HOST, REFUSED_ORIGIN = 421, 403


class Guard:
    """hosts: the names, with port, under which the page may be asked for. secure: over TLS."""

    def __init__(self, app: ASGIApp, hosts: Collection[str], secure: bool, audit: Audit) -> None:
        self._app, self._hosts, self._audit = app, frozenset(hosts), audit
        self._scheme = "https" if secure else "http"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request, WebSocket or life of the server."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        status, why = self._judge(scope, Headers(scope=scope))
        if status:
            address = (scope.get("client") or ("",))[0]
            self._audit.note("nobody", address, f"{scope.get('method', 'WS')} {scope['path']}", status, why)
            await self._refuse(status, why, scope, receive, send)
            return
        await self._app(scope, receive, _with_headers(send))

    def _judge(self, scope: Scope, headers: Headers) -> tuple[int, str]:
        host, origin = headers.get("host", ""), headers.get("origin")
        if host not in self._hosts:
            return REFUSED_HOST, f"Host {host[:80]!a} is not one of this page's; --host NAME adds one"
        if scope["path"].startswith(FOXGLOVE):
            return 0, ""
        asks = scope["type"] == "websocket" or scope["method"] not in _HARMLESS
        if origin != f"{self._scheme}://{host}" and (asks or origin is not None):
            return REFUSED_ORIGIN, f"Origin {str(origin)[:80]!a} is not this page's"
        return 0, ""

    @staticmethod
    async def _refuse(status: int, why: str, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
            return
        await PlainTextResponse(why, status, dict(HEADERS))(scope, receive, send)


def _with_headers(send: Send) -> Send:
    async def sends(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers[name] = value
        await send(message)

    return sends
