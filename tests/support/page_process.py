"""`hil page` as a process of its own, and requests to it as a paired browser makes them."""

import http.client
import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from hil.page.access import Role

PATIENCE_S = 60.0


class PageProcess:
    """state: folder for pairings and codes. arguments: of `hil page`, beside its port."""

    def __init__(self, state: Path, *arguments: str) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = int(probe.getsockname()[1])
        self.folder = state / "hil" / "page"
        command = [sys.executable, "-m", "hil", "page", "--port", str(self.port), *arguments]
        environment = {**os.environ, "XDG_STATE_HOME": str(state), "STATE_DIRECTORY": ""}
        self.process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        self.cookie = ""

    def __enter__(self) -> "PageProcess":
        assert self.process.stdout
        self.first = self.process.stdout.readline()
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            try:
                self.ask("GET", "/me")
            except OSError:
                time.sleep(0.02)
            else:
                return self
        raise AssertionError(f"hil page did not answer; it said {self.first!r}")

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        self.process.communicate(timeout=PATIENCE_S)

    @property
    def url(self) -> str:
        return f"http://localhost:{self.port}"

    def code(self, role: Role) -> str:
        """The code in force for a role, as the rig's group reads it."""
        words = dict(line.split() for line in (self.folder / f"codes-{self.port}").read_text().splitlines())
        return words[role.name.lower()]

    def pair(self, role: Role, name: str) -> None:
        answer, cookie = self._send("POST", "/pair", {"code": self.code(role), "name": name})
        assert answer["accepted"], answer
        self.cookie = cookie.partition(";")[0]

    def ask(self, method: str, path: str, document: Any = None) -> dict[str, Any]:
        """The answer to a request. Raises OSError where nobody listens."""
        return self._send(method, path, document)[0]

    def _send(self, method: str, path: str, document: Any = None) -> tuple[dict[str, Any], str]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        headers = {"Host": f"localhost:{self.port}", "Origin": self.url, "Cookie": self.cookie}
        try:
            connection.request(method, path, json.dumps(document or {}), headers)
            answer = connection.getresponse()
            return json.loads(answer.read()), answer.getheader("Set-Cookie", "")
        finally:
            connection.close()
