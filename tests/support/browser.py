"""A real browser without a screen, driven over its own protocol: no test tool of others is needed.

The engines are in tests/support/chromium.py and tests/support/firefox.py.
"""

import contextlib
import json
import subprocess
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection

PATIENCE_S = 30.0
LARGEST = 64 * 2**20  # bytes of a message: a screenshot


class BrowserError(Exception):
    """The page or the browser did what it should not; the text says what."""


class Browser(ABC):
    """One tab. Everything the page logs, throws or asks for elsewhere is kept."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._number = 0
        self.errors: list[str] = []
        self.requested: list[str] = []

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A command of the protocol, and its result. Raises BrowserError."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(PATIENCE_S))
            if message.get("id") == self._number:
                if "error" in message:
                    raise BrowserError(f"{method}: {message['error']} {message.get('message', '')}")
                result: dict[str, Any] = message["result"]
                return result
            self.note(message["method"], message["params"])

    @abstractmethod
    def note(self, method: str, told: dict[str, Any]) -> None:
        """Keep what the browser tells without being asked."""

    @abstractmethod
    def run(self, script: str) -> Any:
        """The value of a script in the page; promises are awaited. Raises BrowserError where it throws."""

    @abstractmethod
    def size(self, width: int, height: int, *, dark: bool) -> None:
        """Of the window, CSS pixels, and the scheme that its user prefers."""

    @abstractmethod
    def open(self, url: str) -> None:
        """Go to a page and wait until it is there."""

    @abstractmethod
    def picture(self, path: Path) -> None:
        """A screenshot, PNG."""

    def wait(self, script: str, patience_s: float = PATIENCE_S) -> Any:
        """The first value of a script that counts as true. Raises BrowserError."""
        until = time.monotonic() + patience_s
        while not (found := self.run(script)):
            if time.monotonic() > until:
                raise BrowserError(f"never true: {script}; the page says: {self.run('document.body.innerText')[:500]}")
            time.sleep(0.02)
        return found


@contextlib.contextmanager
def program(names: Sequence[str | None], package: str, flags: Sequence[str]) -> Iterator["subprocess.Popen[bytes]"]:
    """The first of these that is installed, ended afterwards; skips the test where there is none."""
    found = next(filter(None, names), None)
    if found is None:
        pytest.skip(f"not run: no {package} on this machine: apt-get install {package}")
    process = subprocess.Popen([found, *flags], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def wait_for_file(file: Path, process: "subprocess.Popen[bytes]") -> str:
    """What a browser writes there once it listens. Raises BrowserError."""
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until and process.poll() is None:
        if file.exists() and (text := file.read_text()).strip():
            return text
        time.sleep(0.05)
    raise BrowserError(f"the browser did not start: exit status {process.poll()}")
