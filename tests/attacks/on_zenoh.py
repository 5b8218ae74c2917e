"""Attacks by whoever can open a Zenoh session with the sidecar: on loopback, every local account."""

import contextlib
import os
import socket
import subprocess
import time
from collections.abc import Iterator
from typing import Any

import zenoh

from hil.cycle.tick import CommandKind
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.client import NoSidecarError, RigClient
from hil.telemetry.credentials import Credentials
from hil.telemetry.session import client_config
from tests.attacks.registry import attack
from tests.attacks.target import NAME, Target
from tests.support.certificates import certificates

COMMAND = f"hil/{NAME}/command"


@contextlib.contextmanager
def attacker(target: Target) -> Iterator[zenoh.Session]:
    with zenoh.open(client_config(target.endpoint)) as session:
        yield session


def queryable(target: Target, answer: Any) -> Iterator[str]:
    with attacker(target) as session:
        held = [session.declare_queryable(key, answer) for key in (COMMAND, "hil/**")]
        time.sleep(0.2)
        yield f"{target.obeyed()}; {target.watched()}"
        for one in held:
            one.undeclare()


def lie(query: zenoh.Query, **values: Any) -> None:
    reply = pb.CommandReply(accepted=True, state="ESTOP", now_ns=time.monotonic_ns(), **values)
    query.reply(COMMAND, reply.SerializeToString())


@attack("queryable that holds", "an operator's verdict within a second", moving=True)
def holds(target: Target) -> Iterator[str]:
    kept: list[zenoh.Query] = []
    yield from queryable(target, kept.append)


@attack("queryable that lies", "the verdict is the rig's", moving=True)
def lies(target: Target) -> Iterator[str]:
    yield from queryable(target, lie)


@attack("queryable that lies about the clock", "the verdict is the rig's", moving=True)
def lies_about_the_clock(target: Target) -> Iterator[str]:
    yield from queryable(target, lambda query: lie(query, reason="stale", sequence=2**60))


@attack("queryable that answers twice", "the verdict is the rig's", moving=True)
def answers_twice(target: Target) -> Iterator[str]:
    yield from queryable(target, lambda query: (lie(query), lie(query)))


def heard(target: Target, key: str, spoof: bytes) -> Iterator[str]:
    """A subscriber beside a spoofer."""
    got: list[bytes] = []
    with attacker(target) as spoofer, attacker(target) as us:
        subscriber = us.declare_subscriber(key, lambda sample: got.append(sample.payload.to_bytes()))
        until = time.monotonic() + 1.0
        while time.monotonic() < until:
            spoofer.put(key, spoof)
            time.sleep(0.02)
        assert spoof not in got, "the spoofed one arrived"
        assert got, "nothing of the rig's arrived"
        yield f"{len(got)} of the rig's arrived, none of 50 spoofed"
        subscriber.undeclare()


@attack("spoofed status", "nobody hears it", moving=True)
def spoofed_status(target: Target) -> Iterator[str]:
    yield from heard(target, f"hil/{NAME}/status", pb.Status(rig=NAME, state="READY").SerializeToString())


@attack("spoofed telemetry", "nobody hears it")
def spoofed_telemetry(target: Target) -> Iterator[str]:
    yield from heard(target, f"hil/{NAME}/tick", pb.Status(rig=NAME).SerializeToString())


@attack("spoofed status with ESC and HTML in every string", "nobody hears it")
def hostile_status(target: Target) -> Iterator[str]:
    yield from heard(
        target, f"hil/{NAME}/status", pb.Status(rig="\x1b[2J<script>", state="\x1b[2J").SerializeToString()
    )


@attack("spoofed liveliness", "only the sidecar is alive")
def spoofed_liveliness(target: Target) -> Iterator[str]:
    with attacker(target) as spoofer, attacker(target) as us:
        token = spoofer.liveliness().declare_token("hil/evil/alive")
        time.sleep(0.3)
        alive = [str(reply.ok.key_expr) for reply in us.liveliness().get("hil/**", timeout=3.0) if reply.ok]
        assert alive == [f"hil/{NAME}/alive"], alive
        yield f"alive: {', '.join(alive)}"
        token.undeclare()


@attack("spoofed end of the sidecar (its liveliness deleted)", "it stays alive")
def spoofed_death(target: Target) -> Iterator[str]:
    with attacker(target) as spoofer, attacker(target) as us:
        spoofer.delete(f"hil/{NAME}/alive")
        spoofer.delete(f"hil/{NAME}/status")
        time.sleep(0.2)
        alive = [str(reply.ok.key_expr) for reply in us.liveliness().get("hil/**", timeout=3.0) if reply.ok]
        assert alive == [f"hil/{NAME}/alive"], alive
        yield target.watched()


@attack("100 000 messages", "operator and monitors are served", moving=True)
def flood(target: Target) -> Iterator[str]:
    with attacker(target) as session:
        for number in range(100_000):
            session.put(f"hil/{NAME}/status", number.to_bytes(4, "little"))
        yield f"{target.obeyed()}; {target.watched()}"


@attack("20 MB payloads", "operator and monitors are served", moving=True)
def large(target: Target) -> Iterator[str]:
    with attacker(target) as session:
        payload = bytes(20 * 2**20)
        for _ in range(3):
            with contextlib.suppress(zenoh.ZError):
                session.put(f"hil/{NAME}/status", payload)
        yield f"{target.obeyed()}; {target.watched()}"


@attack("10 000 queries", "operator and monitors are served", moving=True)
def queries(target: Target) -> Iterator[str]:
    with attacker(target) as session:
        for _ in range(10_000):
            session.get(f"hil/{NAME}/rig", handler=zenoh.handlers.RingChannel(1), timeout=1.0)
        yield f"{target.obeyed()}; {target.watched()}"


@attack("2000 idle connections", "operator and monitors are served", moving=True)
def idle(target: Target) -> Iterator[str]:
    with contextlib.ExitStack() as stack:
        for _ in range(2000):
            with contextlib.suppress(OSError):
                stack.enter_context(socket.create_connection(("127.0.0.1", target.zenoh_port), timeout=0.2))
        yield f"{target.obeyed()}; {target.watched(10.0)}"


def refused(target: Target, credentials: Credentials | None) -> Iterator[str]:
    with RigClient(target.tls, rig=NAME, credentials=credentials) as client:
        try:
            client.wait_status(2.0)
        except NoSidecarError:
            yield "no session"
        else:
            raise AssertionError("it was let in")


@attack("Zenoh over TLS without a certificate", "no session")
def no_certificate(target: Target) -> Iterator[str]:
    yield from refused(target, None)


@attack("Zenoh over TLS with an expired certificate", "no session")
def expired(target: Target) -> Iterator[str]:
    old = target.base / "old"
    if not old.exists():
        subprocess.run(["cp", "-r", target.made, old], check=True)
        certificates(old, days=-1)
    yield from refused(target, Credentials(old / "monitor"))


@attack("Zenoh over TLS with another authority's certificate", "no session")
def other_authority(target: Target) -> Iterator[str]:
    other = certificates(target.base / "other")
    mixed = target.base / "mixed"
    subprocess.run(["cp", "-r", other / "monitor", mixed], check=True)
    (mixed / "authority.pem").write_bytes((target.made / "monitor" / "authority.pem").read_bytes())
    yield from refused(target, Credentials(mixed))


@attack("Zenoh over TLS with a monitor's certificate, publishing", "it may watch, nobody hears what it says")
def monitor_publishes(target: Target) -> Iterator[str]:
    credentials = Credentials(target.made / "monitor")
    with (
        zenoh.open(client_config(target.tls, credentials)) as session,
        RigClient(target.tls, rig=NAME, credentials=credentials) as client,
    ):
        for _ in range(50):
            session.put(f"hil/{NAME}/status", pb.Status(rig=NAME, state="SPOOFED").SerializeToString())
            assert client.wait_status(5.0).state != "SPOOFED"
        yield "50 statuses heard, all the rig's"


@attack("another network namespace, at the loopback endpoint", "cannot be reached")
def other_namespace(target: Target) -> Iterator[str]:
    with namespace() as (name, host):
        code = f"import socket; socket.create_connection(('{host}', {target.zenoh_port}), timeout=2)"
        done = subprocess.run(["ip", "netns", "exec", name, "python3", "-c", code], capture_output=True, text=True)
        assert done.returncode != 0, "it was reached"
        yield done.stderr.strip().splitlines()[-1]


@contextlib.contextmanager
def namespace() -> Iterator[tuple[str, str]]:
    """A network namespace beside this one, and this one's address as seen from there."""
    name, link = f"hil-{os.getpid()}", f"hil{os.getpid() % 10**6}"
    host, guest = "10.213.7.1", "10.213.7.2"
    try:
        for line in (
            f"netns add {name}",
            f"link add {link}a type veth peer name {link}b netns {name}",
            f"addr add {host}/24 dev {link}a",
            f"link set {link}a up",
            f"-n {name} addr add {guest}/24 dev {link}b",
            f"-n {name} link set {link}b up",
            f"-n {name} link set lo up",
        ):
            subprocess.run(["ip", *line.split()], check=True, capture_output=True)
        yield name, host
    finally:
        subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)


@attack("the old command key, as an operator would have asked", "nobody takes commands over Zenoh")
def old_key(target: Target) -> Iterator[str]:
    with attacker(target) as session:
        request = pb.CommandRequest(kind=CommandKind.ACTIVATE, sequence=1, expires_ns=time.monotonic_ns() + 10**8)
        replies = [r for r in session.get(COMMAND, payload=request.SerializeToString(), timeout=1.0) if r.ok]
        assert not replies, "it was answered"
        assert target.newest().name == "READY"
        yield "no reply; still READY"
