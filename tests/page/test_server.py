"""The page as browsers meet it: what is refused, who may what, what is streamed, and that all of it is in the audit."""

import asyncio
import json
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

from hil.analysis.loop_corners import check_corners
from hil.cycle.state_machine import State
from hil.live.runtime_paths import runtime_paths
from hil.live.stop_line import StopLine
from hil.operate.doctor import computer_findings
from hil.page.access import Access, Role
from hil.page.audit import Audit
from hil.page.frames import HEADER, Message
from hil.page.guard import HEADERS
from hil.page.margins import margins
from hil.page.server import PageServer, make_app
from tests.page.conftest import HOST, LIMIT_S, ORIGIN, RIG, Told
from tests.support.command_bench import CommandBench

FEED = "/rigs/paper/feed"
Paired = Callable[[Role], TestClient]


def entries(audit: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in audit.read_text().splitlines()]


@pytest.mark.parametrize("host", ["evil.example", "testserver:5006", "localhost", ""])
def test_another_host_is_refused_whatever_it_asks_for(client: TestClient, audit: Path, host: str) -> None:
    for path in ("/", "/static/app.js", "/me"):
        answer = client.get(path, headers={"Host": host})
        assert answer.status_code == 421, path
    assert client.post("/pair", json={}, headers={"Host": host}).status_code == 421
    found = [(entry["who"], entry["from"], entry["status"]) for entry in entries(audit)]
    assert found == [("nobody", "testclient", 421)] * 4


@pytest.mark.parametrize("origin", ["http://evil.example", f"https://{HOST}", "null"])
def test_another_origin_is_refused_before_its_code_is_looked_at(
    client: TestClient, access: Access, audit: Path, origin: str
) -> None:
    given = {"code": access.codes[Role.OPERATE], "name": "x"}
    assert client.post("/pair", json=given, headers={"Origin": origin}).status_code == 403
    assert access.pairings() == []
    assert entries(audit)[-1]["said"].startswith("Origin")
    with pytest.raises(WebSocketDisconnect) as refused, client.websocket_connect(FEED, headers={"Origin": origin}):
        pass
    assert refused.value.code == 1008  # a policy of ours, RFC 6455 7.4.1


def test_a_request_that_changes_something_needs_an_origin(client: TestClient, paired: Paired) -> None:
    browser = paired(Role.OPERATE)
    del browser.headers["Origin"]
    assert browser.post("/rigs/paper/estop").status_code == 403
    assert browser.get("/me").status_code == 200


def test_every_answer_forbids_foreign_scripts(client: TestClient) -> None:
    for answer in (client.get("/"), client.get("/static/app.js"), client.get("/runs"), client.get("/nothing")):
        for name, value in HEADERS.items():
            assert answer.headers[name] == value
    assert "unsafe" not in HEADERS["Content-Security-Policy"]
    assert "script-src 'self'" in HEADERS["Content-Security-Policy"]


@pytest.mark.parametrize("path", ["/runs", "/computer", "/rigs/paper/facts", "/rigs/paper/margins"])
def test_without_a_pairing_nothing_is_shown(client: TestClient, told: Told, path: str) -> None:
    assert client.get(path).status_code == 401
    assert client.get("/me").json() == {"role": ""}
    with client.websocket_connect(FEED) as socket, pytest.raises(WebSocketDisconnect) as refused:
        socket.receive_text()
    assert refused.value.code == 4401


def test_the_secret_is_kept_from_scripts_and_from_other_sites(client: TestClient, access: Access) -> None:
    answer = client.post("/pair", json={"code": access.codes[Role.WATCH], "name": "Ana"})
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert client.get("/me").json() == {"name": "Ana", "role": "watch", "rigs": []}


@pytest.mark.parametrize(
    ("role", "may"),
    [(Role.WATCH, set()), (Role.STOP, {"estop", "stop"}), (Role.OPERATE, {"estop", "stop", "reset"})],
)
def test_each_role_may_what_it_says_and_no_more(told: Told, paired: Paired, role: Role, may: set[str]) -> None:
    browser = paired(role)
    allowed = {name for name in ("estop", "stop", "reset") if browser.post(f"/rigs/paper/{name}").status_code != 403}
    assert allowed == may


@pytest.mark.requirement(id="SR-5.3")
@pytest.mark.parametrize("name", ["activate", "shutdown", "load-task", "home", "activate-hold"])
def test_nothing_that_brings_torque_can_be_asked_for(told: Told, paired: Paired, name: str) -> None:
    assert paired(Role.OPERATE).post(f"/rigs/paper/{name}").status_code == 404


def test_estop_presses_the_stop_page_without_any_sidecar(paired: Paired, audit: Path) -> None:
    directory = runtime_paths("paper").directory
    with StopLine(directory) as line:
        answer = paired(Role.STOP).post("/rigs/paper/estop").json()
        assert line.pressed()
    assert not answer["accepted"]  # nobody read the page: this loop does not run
    assert "pressed, but the process does not run" in answer["said"]
    assert entries(audit)[-1]["who"] == "Ana (stop)"
    assert "POST /rigs/paper/estop" in entries(audit)[-1]["what"]


def test_estop_of_a_rig_that_does_not_run_says_so(paired: Paired) -> None:
    answer = paired(Role.STOP).post("/rigs/nobody/estop").json()
    assert (answer["accepted"], answer["status"]) == (False, 69)


def test_stop_goes_through_the_sidecar_and_comes_back_with_the_verdict(paired: Paired) -> None:
    with CommandBench(runtime_paths("paper").directory) as bench:
        answer = paired(Role.STOP).post("/rigs/paper/stop").json()
        assert answer["accepted"], answer
        bench.dead = True
        hung = paired(Role.STOP).post("/rigs/paper/stop").json()
    assert not hung["accepted"]
    assert "the control process did not take it" in hung["said"]
    assert [entry.accepted for entry in bench.entries] == [True, False]


def test_without_a_sidecar_stop_says_whose_help_is_missing(told: Told, paired: Paired) -> None:
    answer = paired(Role.STOP).post("/rigs/paper/stop").json()
    assert not answer["accepted"]
    assert "`hil sidecar FILE` starts one" in answer["said"]


def test_one_operates_at_a_time_and_another_takes_over_by_saying_so(
    told: Told, client: TestClient, access: Access
) -> None:
    def operator(name: str) -> dict[str, str]:
        secret, _ = access.pair(access.codes[Role.OPERATE], name)
        return {"Cookie": f"hil_page={secret}", **ORIGIN}

    ana, ben = operator("Ana"), operator("Ben")
    assert client.post("/rigs/paper/reset", headers=ana).status_code == 200
    refused = client.post("/rigs/paper/reset", headers=ben)
    assert refused.status_code == 409
    assert "Ana operates" in refused.json()["said"]
    assert client.post("/rigs/paper/reset", headers=ben, json={"take": True}).status_code == 200
    assert client.post("/rigs/paper/reset", headers=ana).status_code == 409


@pytest.mark.parametrize("body", [b"[]", b"{", b"[" * 3000, b"x" * 5000])
def test_a_request_that_is_none_is_refused_in_words(client: TestClient, body: bytes) -> None:
    answer = client.post("/pair", content=body)
    assert answer.status_code in (400, 413)
    assert answer.json()["said"]


def received(socket: WebSocketTestSession) -> Iterator[Any]:
    """What the page sends. Raises TimeoutError after LIMIT_S, as its pulses never end by themselves."""
    until = time.monotonic() + LIMIT_S
    while time.monotonic() < until:
        yield socket.receive()
    raise TimeoutError


def binary(socket: WebSocketTestSession, kind: Message) -> np.ndarray:
    """The next binary message of a kind."""
    blocks = (np.frombuffer(message["bytes"], "<f8") for message in received(socket) if message.get("bytes"))
    return next(block for block in blocks if block[0] == kind)


def test_a_feed_describes_the_rig_then_streams_its_ticks_and_those_that_are_chosen(told: Told, paired: Paired) -> None:
    browser = paired(Role.WATCH)
    with browser.websocket_connect(FEED) as socket:
        run = json.loads(socket.receive_text())["run"]
        assert run["rig"] == "paper"
        assert run["states"][str(int(State.ACTIVE))] == "ACTIVE"
        chosen = next(n for n, signal in enumerate(run["signals"]) if signal["quantity"] == "force")
        socket.send_text(json.dumps({"ticks": [chosen]}))
        for index in range(1, 50):  # until a turn has taken the choice in
            told.tick(index, force=float(index))
            time.sleep(0.01)
        read = binary(socket, Message.ENVELOPE)
        assert read[1] == len(run["signals"])
        ticks = binary(socket, Message.TICKS)
        assert ticks[HEADER] == chosen
        count = int(ticks[4])
        instants, forces = ticks[HEADER + 1 : HEADER + 1 + count], ticks[HEADER + 1 + count :]
        assert forces.tolist() == pytest.approx((instants / (1 / run["rate"])).tolist())


@pytest.mark.parametrize(
    "text", ["{}", "[]", '{"ticks": [9999]}', '{"ticks": [true]}', '{"ticks": [0,0,0,0,0,0,0,0,0]}', "{"]
)
def test_a_browser_that_asks_for_nonsense_loses_its_feed(told: Told, paired: Paired, text: str) -> None:
    with paired(Role.WATCH).websocket_connect(FEED) as socket:
        socket.send_text(text)
        assert closing_code(socket) == 1008


def closing_code(socket: WebSocketTestSession) -> int:
    """With which code the page closes a feed, whatever it has sent before."""
    return next(int(message["code"]) for message in received(socket) if message["type"] == "websocket.close")


def test_a_revoked_browser_loses_its_feed_within_a_second(told: Told, paired: Paired, access: Access) -> None:
    with paired(Role.WATCH).websocket_connect(FEED) as socket:
        socket.receive_text()
        Access(access.folder).revoke("Ana")
        began = time.monotonic()
        assert closing_code(socket) == 4401
        assert time.monotonic() - began < 1.0


def test_the_facts_of_a_rig_are_its_limits_and_its_bus_load(told: Told, paired: Paired) -> None:
    facts = paired(Role.WATCH).get("/rigs/paper/facts").json()
    assert facts["axes"][0]["name"] == "x"
    assert 0.0 < facts["load"]["share"] < 1.0
    assert facts["load"]["fits"]
    assert facts["problem"] == ""


def test_a_folder_without_runs_is_an_empty_list(paired: Paired) -> None:
    assert paired(Role.WATCH).get("/runs").json() == {"folder": "runs", "runs": []}


def test_every_request_is_in_the_audit_with_who_made_it(told: Told, paired: Paired, audit: Path) -> None:
    browser = paired(Role.OPERATE)
    browser.get("/me")
    browser.post("/rigs/paper/stop")
    browser.get("/rigs/evil\u202e/facts")
    found = [(entry["who"], entry["what"], entry["status"]) for entry in entries(audit)]
    assert ("nobody", "POST /pair", 200) in found
    assert ("Ana (operate)", "GET /me", 200) in found
    assert ("Ana (operate)", "POST /rigs/paper/stop", 200) in found
    assert found[-1][2] == 404
    assert "\u202e" not in audit.read_text()


def test_a_full_disk_does_not_keep_anybody_from_stopping(paired: Paired, audit: Path, access: Access) -> None:
    browser = paired(Role.STOP)
    audit.unlink()
    audit.mkdir()  # nothing can be written there
    assert browser.post("/rigs/nobody/estop").status_code == 200


def served(access: Access, audit: Path, rigs: list[str], *, secure: bool) -> TestClient:
    """A browser before a page of its own."""
    notes = Audit(audit)
    server = PageServer(access, notes, rigs, audit.parent, cookie="hil_page", secure=secure)
    scheme = "https" if secure else "http"
    app = make_app(server, notes, [HOST], secure=secure)
    return TestClient(app, base_url=f"{scheme}://{HOST}", headers={"Origin": f"{scheme}://{HOST}"})


def test_over_tls_the_secret_never_travels_in_the_clear(access: Access, audit: Path) -> None:
    browser = served(access, audit, [], secure=True)
    given = {"code": access.codes[Role.WATCH], "name": "Ana"}
    assert browser.post("/pair", json=given, headers=ORIGIN).status_code == 403  # of the same name without TLS
    answer = browser.post("/pair", json=given)
    assert "secure" in answer.headers["set-cookie"].lower().split("; ")


def test_a_page_of_some_rigs_shows_and_stops_no_others(told: Told, access: Access, audit: Path) -> None:
    browser = served(access, audit, ["left", "right"], secure=False)
    browser.post("/pair", json={"code": access.codes[Role.OPERATE], "name": "Ana"})
    assert browser.get("/me").json()["rigs"] == ["left", "right"]
    for name in ("estop", "stop", "reset"):
        refused = browser.post(f"/rigs/paper/{name}")
        assert refused.status_code == 404
        assert "left, right" in refused.json()["said"]
    assert browser.post("/rigs/left/estop").json()["status"] == 69


def test_a_browser_that_leaves_is_paired_no_more(paired: Paired, access: Access) -> None:
    browser = paired(Role.STOP)
    assert browser.post("/leave").json()["accepted"]
    assert access.pairings() == []
    assert browser.post("/rigs/paper/estop").status_code == 401


@pytest.mark.long
def test_margins_are_those_of_the_loop_and_are_computed_once_a_run(told: Told, paired: Paired) -> None:
    browser = paired(Role.WATCH)
    found = browser.get("/rigs/paper/margins").json()
    assert found["problem"] == ""
    nominal = [row for row in found["rows"] if row["corner"] == "as the model says"]
    assert [row["axis"] for row in nominal] == ["x", "y"]
    corners = check_corners(RIG)
    wanted = [finding for finding in corners if finding.nominal]
    for row, finding in zip(nominal, wanted, strict=True):
        assert (row["gain_db"], row["phase_deg"]) == pytest.approx((finding.gain_db, finding.phase_deg))
        assert row["lacks"] == finding.shortfall()
    for axis in ("x", "y"):
        least = min(finding.gain_db for finding in corners if finding.axis == axis)
        assert pytest.approx(least) in [row["gain_db"] for row in found["rows"] if row["axis"] == axis]
    began = time.monotonic()
    assert browser.get("/rigs/paper/margins").json() == found
    assert time.monotonic() - began < 0.1  # a process of Python does not even start in that


def test_a_law_of_users_is_not_run_for_its_margins() -> None:
    own = {"rig": {"law": {"name": "./mine.py:Mine"}, "estimator": {"name": "motion-filter"}}}
    assert asyncio.run(margins(own)) == {
        "rows": [], "problem": "./mine.py:Mine is no law of hil, and the page does not run it: see hil check"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("wait_s", "words"),
    [(0.0, "too busy: they took more than 0 s"), (600.0, "cannot be computed: recorded by hil None")],
)
def test_margins_that_do_not_come_say_why_and_leave_no_process(wait_s: float, words: str) -> None:
    unfit = {"rig": {"law": {"name": "pid"}, "estimator": {"name": "motion-filter"}}}
    found = asyncio.run(margins(unfit, wait_s))
    assert words in found["problem"]
    assert found["rows"] == []
    children = subprocess.run(["ps", "-o", "args=", "--ppid", str(os.getpid())], capture_output=True, text=True).stdout
    assert "hil.page.margins" not in children


def test_the_page_says_what_doctor_says_of_this_computer(paired: Paired) -> None:
    found = paired(Role.WATCH).get("/computer").json()["findings"]
    assert [row["topic"] for row in found] == [finding.topic for finding in computer_findings()]
    assert {row["level"] for row in found} <= {"ok", "note", "warn"}
