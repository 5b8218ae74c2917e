"""What tests of the page begin with: a rig that left a ring, and a client that speaks to the page as a browser does."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.types import Message

from hil.cycle.record import RECORD
from hil.cycle.state_machine import State
from hil.live.ring import RingWriter
from hil.live.runtime_paths import runtime_paths
from hil.page.access import Access, Role
from hil.page.audit import Audit
from hil.page.server import PageServer, make_app
from hil.rig.file import load_rig
from hil.rig.provenance import describe_run
from tests.support.paths import RIGS

RIG = load_rig(RIGS / "paper.toml")
HOST = "testserver"  # as the test client calls itself, and its cookies with it
ORIGIN = {"Origin": f"http://{HOST}"}
LIMIT_S = 10.0  # of waiting for one message of a feed


class Told:
    """A ring of rig `paper`, written tick by tick."""

    def __init__(self) -> None:
        metadata = describe_run(RIG, RIGS, realtime="none: a test")
        self.ring = RingWriter(runtime_paths("paper").ring, 256, period_ns=RIG.period_ns, metadata=metadata)

    def tick(self, index: int, now_ns: int = 1, **fields: Any) -> None:
        """One record. fields: by name; per axis the same value for all."""
        record = np.zeros(1, RECORD)[0]
        record["index"], record["now_ns"], record["scheduled_ns"] = index, now_ns, now_ns
        record["state"], record["task_ns"] = State.ACTIVE, 0
        for name, value in fields.items():
            record[name] = value
        self.ring.append(record)


@pytest.fixture(autouse=True)
def no_feed_is_waited_for_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A page that sends no more fails a test with TimeoutError; the client itself would wait for ever."""

    def receive(session: WebSocketTestSession) -> Message:
        waiting = session.portal.start_task_soon(session._send_rx.receive)
        try:
            return waiting.result(LIMIT_S)
        finally:
            waiting.cancel()

    monkeypatch.setattr(WebSocketTestSession, "receive", receive)


@pytest.fixture
def told() -> Iterator[Told]:
    found = Told()
    yield found
    found.ring.close()


@pytest.fixture
def access(tmp_path: Path) -> Access:
    found = Access(tmp_path / "page")
    found.renew()
    return found


@pytest.fixture
def audit(access: Access) -> Path:
    return access.folder / "audit.jsonl"


@pytest.fixture
def client(access: Access, audit: Path, tmp_path: Path) -> Iterator[TestClient]:
    """A browser that is not paired."""
    notes = Audit(audit)
    server = PageServer(access, notes, [], tmp_path / "runs", cookie="hil_page", secure=False)
    app = make_app(server, notes, [HOST], secure=False)
    with TestClient(app, base_url=f"http://{HOST}", headers=ORIGIN) as browser:
        yield browser


@pytest.fixture
def paired(client: TestClient, access: Access) -> Callable[[Role], TestClient]:
    """The browser, paired for a role."""

    def pair(role: Role) -> TestClient:
        answer = client.post("/pair", json={"code": access.codes[role], "name": "Ana"})
        assert answer.status_code == 200, answer.text
        return client

    return pair
