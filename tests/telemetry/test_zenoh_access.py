"""Zenoh denies by default: those who connect may subscribe and query, and nothing they say is passed on."""

import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh

from hil.telemetry.credentials import Credentials
from hil.telemetry.publisher import Publisher
from hil.telemetry.session import client_config
from tests.support.certificates import certificates
from tests.support.paths import ROOT

pytestmark = pytest.mark.live


def free(protocol: str = "tcp") -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"{protocol}/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def publisher() -> Iterator[Publisher]:
    with Publisher("hil", "rig", [free()]) as publisher:
        yield publisher


def until(told: Callable[[], object], wanted: Callable[[], bool], seconds: float = 20) -> None:
    limit = time.monotonic() + seconds
    while not wanted():
        assert time.monotonic() < limit
        told()
        time.sleep(0.02)


def test_only_the_sidecars_status_reaches_who_subscribes(publisher: Publisher) -> None:
    with (
        zenoh.open(client_config(publisher.listen[0])) as spoofer,
        zenoh.open(client_config(publisher.listen[0])) as us,
    ):
        heard: list[bytes] = []
        subscriber = us.declare_subscriber("hil/*/status", lambda sample: heard.append(sample.payload.to_bytes()))

        def both() -> None:
            spoofer.put("hil/rig/status", b"spoofed")
            spoofer.put("hil/other/status", b"spoofed")
            publisher.put("status", b"true")

        until(both, lambda: len(heard) >= 10)
        assert set(heard) == {b"true"}
        subscriber.undeclare()


def test_nobody_else_answers_queries_or_shows_itself_alive(publisher: Publisher) -> None:
    with (
        zenoh.open(client_config(publisher.listen[0])) as spoofer,
        zenoh.open(client_config(publisher.listen[0])) as us,
    ):
        lie = spoofer.declare_queryable("hil/**", lambda query: query.reply("hil/rig/rig", b"spoofed"))
        token = spoofer.liveliness().declare_token("hil/other/alive")
        until(lambda: None, lambda: bool(list(us.liveliness().get("hil/**", timeout=2.0))))
        assert [str(reply.ok.key_expr) for reply in us.liveliness().get("hil/**", timeout=2.0)] == ["hil/rig/alive"]
        answers = us.get("hil/*/rig", handler=zenoh.handlers.FifoChannel(8), timeout=5.0)
        until(
            lambda: publisher.answer_queries({"rig": lambda: b"true", "schema": lambda: b""}),
            lambda: publisher.answered > 0,
        )
        assert [reply.ok.payload.to_bytes() for reply in answers] == [b"true"]
        lie.undeclare()
        token.undeclare()


def test_through_a_router_with_mutual_tls_a_monitor_hears_and_nobody_without_a_certificate(tmp_path: Path) -> None:
    made = certificates(tmp_path / "certificates")
    listen, routed = free("tls"), free("tls")
    monitor = Credentials(made / "monitor")
    script = [sys.executable, str(ROOT / "deploy" / "zenoh" / "router.py"), listen, routed, str(made / "router")]
    with (
        Publisher("hil", "rig", [listen], Credentials(made / "sidecar")) as publisher,
        subprocess.Popen(script, stdout=subprocess.PIPE, cwd=ROOT) as router,
    ):
        try:
            assert router.stdout
            router.stdout.readline()
            with (
                zenoh.open(client_config(routed, monitor)) as us,
                zenoh.open(client_config(routed, monitor)) as spoofer,
            ):
                heard: list[bytes] = []
                subscriber = us.declare_subscriber("hil/*/status", lambda s: heard.append(s.payload.to_bytes()))

                def both() -> None:
                    spoofer.put("hil/rig/status", b"spoofed")
                    publisher.put("status", b"true")

                until(both, lambda: len(heard) >= 5)
                assert set(heard) == {b"true"}
                subscriber.undeclare()
            for endpoint in (listen, routed):
                with pytest.raises(zenoh.ZError):
                    zenoh.open(client_config(endpoint)).close()
        finally:
            router.terminate()
