"""Firefox over WebDriver BiDi (w3.org/TR/webdriver-bidi), which it speaks itself."""

import base64
import contextlib
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from tests.support.browser import LARGEST, Browser, BrowserError, program, wait_for_file

TOLD = ("log.entryAdded", "network.beforeRequestSent")
SCHEME = "layout.css.prefers-color-scheme.content-override"  # 0: dark, 1: light; BiDi has no word for it


class Firefox(Browser):
    """One tab of Firefox."""

    def __init__(self, socket: ClientConnection) -> None:
        super().__init__(socket)
        self.call("session.new", capabilities={})
        self._tab = self._first_tab()
        self._chrome = self._first_tab(**{"moz:scope": "chrome"})
        self.call("session.subscribe", events=TOLD, contexts=[self._tab])

    def _first_tab(self, **scope: str) -> str:
        return str(self.call("browsingContext.getTree", **scope)["contexts"][0]["context"])

    def note(self, method: str, told: dict[str, Any]) -> None:
        if method == "log.entryAdded" and told["level"] in ("error", "warn"):
            self.errors.append(f"{told['text']} {json.dumps(told.get('stackTrace'))}")
        elif method == "network.beforeRequestSent":
            self.requested.append(told["request"]["url"])

    def run(self, script: str) -> Any:
        told = self._evaluate(f"Promise.resolve({script.rstrip().rstrip(';')}).then((v) => JSON.stringify(v))")
        return json.loads(told["value"]) if "value" in told else None

    def _evaluate(self, script: str, *, chrome: bool = False) -> dict[str, Any]:
        target = {"context": self._chrome if chrome else self._tab}
        found = self.call("script.evaluate", expression=script, target=target, awaitPromise=True)
        if found["type"] == "exception":
            raise BrowserError(json.dumps(found["exceptionDetails"]))
        result: dict[str, Any] = found["result"]
        return result

    def size(self, width: int, height: int, *, dark: bool) -> None:
        self.call("browsingContext.setViewport", context=self._tab, viewport={"width": width, "height": height})
        self._evaluate(f"Services.prefs.setIntPref({SCHEME!r}, {0 if dark else 1})", chrome=True)

    def open(self, url: str) -> None:
        self.call("browsingContext.navigate", context=self._tab, url=url, wait="complete")

    def picture(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self.call("browsingContext.captureScreenshot", context=self._tab)["data"]))


@contextlib.contextmanager
def firefox(profile: Path) -> Iterator[Firefox]:
    """A browser of its own with an empty profile, ended afterwards; skips the test where none is installed."""
    profile.mkdir(exist_ok=True)
    flags = ("--headless", "--no-remote", "--remote-debugging-port=0", "--remote-allow-system-access", "--profile")
    with program(
        [shutil.which("firefox-esr"), shutil.which("firefox")], "firefox-esr", [*flags, str(profile)]
    ) as process:
        found = json.loads(wait_for_file(profile / "WebDriverBiDiServer.json", process))
        address = f"ws://{found['ws_host']}:{found['ws_port']}/session"
        with connect(address, max_size=LARGEST, proxy=None, ping_interval=None) as socket:
            yield Firefox(socket)
