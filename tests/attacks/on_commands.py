"""Attacks on the commands: on this machine's socket, and on TLS from elsewhere."""

import contextlib
import os
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.command_client import NoGatewayError, local_client, remote_client
from hil.telemetry.command_wire import REPLY, REQUEST, frame, opened, seal, unframe
from hil.telemetry.credentials import Credentials
from tests.attacks.on_zenoh import namespace
from tests.attacks.registry import attack
from tests.attacks.target import Target
from tests.support.certificates import certificates
from tests.support.paths import ROOT


class Raw:
    """One connection to a gateway, byte by byte."""

    def __init__(self, connection: socket.socket, secret: bytes = b"") -> None:
        self.connection = connection
        self.secret = secret
        self._buffer = bytearray()
        connection.settimeout(2.0)
        self.nonce = pb.Challenge.FromString(self.message()).nonce

    def message(self) -> bytes:
        while (message := unframe(self._buffer)) is None:
            received = self.connection.recv(1024)
            if not received:
                raise ConnectionError("closed")
            self._buffer += received
        return message

    def ask(self, **values: int) -> pb.CommandReply:
        request = {
            "kind": int(CommandKind.ACTIVATE),
            "sequence": 1,
            "expires_ns": time.monotonic_ns() + 10**8,
            **values,
        }
        return self.send(seal(pb.CommandRequest(**request).SerializeToString(), REQUEST, self.nonce, self.secret))

    def send(self, sealed: bytes) -> pb.CommandReply:
        self.connection.sendall(frame(sealed))
        body = opened(self.message(), REPLY, self.nonce, self.secret)
        assert body is not None, "a reply without a MAC"
        reply = pb.CommandReply.FromString(body)
        self.nonce = reply.challenge.nonce
        return reply


def locally(target: Target) -> socket.socket:
    handle = os.open(target.directory, os.O_PATH)
    connection = socket.socket(socket.AF_UNIX)
    connection.connect(f"/proc/self/fd/{handle}/commands")
    os.close(handle)
    return connection


def over_tls(target: Target, role: str, base: Path | None = None) -> Raw:
    credentials = Credentials((base or target.made) / role)
    plain = socket.create_connection(("127.0.0.1", target.command_port), timeout=2.0)
    return Raw(credentials.context(server=False).wrap_socket(plain), Credentials(target.made / "operator").secret)


def still_ready(target: Target, reason: str, wanted: str) -> str:
    assert reason.startswith(wanted), reason
    assert target.newest() is State.READY
    return f"{reason}; still READY"


# on this machine ------------------------------------------------------------------------------------------------------


AS_NOBODY = """
import os, socket, sys
sys.path.insert(0, sys.argv[1])
import hil.operate.estop
os.setgroups([]); os.setresgid(65534, 65534, 65534); os.setresuid(65534, 65534, 65534)
"""


def as_nobody(code: str) -> str:
    """Run it as another user of this machine; the last line it says."""
    line = [sys.executable, "-c", AS_NOBODY + code, str(ROOT)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=30)
    return ((done.stdout + done.stderr).strip().splitlines() or ["?"])[-1]


@attack("another user connects to the command socket", "permission denied")
def another_user(target: Target) -> Iterator[str]:
    said = as_nobody(f"socket.socket(socket.AF_UNIX).connect({str(target.directory / 'commands')!r})")
    assert "Permission" in said, said
    yield said


@attack("another user opens mailbox, ring and stop page", "permission denied")
def another_users_files(target: Target) -> Iterator[str]:
    said = [as_nobody(f"os.open({str(target.directory / f)!r}, os.O_RDWR)") for f in ("mailbox", "ring", "stop")]
    assert all("Permission" in one for one in said), said
    yield said[0]


@attack("another user presses stop (hil estop)", "no control process of that name for them; the rig goes on")
def another_user_stops(target: Target) -> Iterator[str]:
    said = as_nobody("print(hil.operate.estop.stop_rig('paper'))")
    assert target.newest() is State.READY
    assert "no control process" in said or said == "69", said
    yield said


@attack("300 idle connections of the same user", "an operator's verdict within a second", moving=True)
def idle_locally(target: Target) -> Iterator[str]:
    with contextlib.ExitStack() as stack:
        for _ in range(300):
            stack.enter_context(locally(target))
        yield target.obeyed()


@attack("300 connections that send nonsense", "an operator's verdict within a second", moving=True)
def nonsense(target: Target) -> Iterator[str]:
    with contextlib.ExitStack() as stack:
        for number in range(300):
            connection = stack.enter_context(locally(target))
            connection.sendall(os.urandom(1 + number))
        yield target.obeyed()


@attack("a message of 64 KiB", "the connection is closed")
def oversize(target: Target) -> Iterator[str]:
    raw = Raw(locally(target))
    raw.connection.sendall(b"\xff\xff")
    try:
        raw.message()
    except OSError as error:
        yield f"{error}; {target.obeyed()}"
    else:
        raise AssertionError("it was answered")


@attack("a request replayed on its connection", "refused as replayed, and recorded")
def replayed(target: Target) -> Iterator[str]:
    raw = Raw(locally(target))
    raw.ask(kind=int(CommandKind.HEARTBEAT))
    yield still_ready(target, raw.ask(kind=int(CommandKind.ACTIVATE)).reason, "replayed")


@attack("a request from the past", "refused as stale")
def stale(target: Target) -> Iterator[str]:
    yield still_ready(target, Raw(locally(target)).ask(expires_ns=time.monotonic_ns() - 1).reason, "stale")


@attack("a request that never expires", "refused")
def immortal(target: Target) -> Iterator[str]:
    yield still_ready(target, Raw(locally(target)).ask(expires_ns=2**62).reason, "expires too late")


@attack("an unknown command", "refused")
def unknown(target: Target) -> Iterator[str]:
    yield still_ready(target, Raw(locally(target)).ask(kind=2**31).reason, "unknown command")


@attack("swapped socket: another user listens in its place", "the client refuses to talk to it")
def swapped(target: Target) -> Iterator[str]:
    directory = target.base / "swapped"
    directory.mkdir(mode=0o700)
    code = "import os, socket, sys\nos.chdir(sys.argv[1]); s = socket.socket(socket.AF_UNIX)\n"
    code += "os.setresuid(65534, 65534, 65534); s.bind('commands'); s.listen(); print('up', flush=True); s.accept()"
    os.chmod(directory, 0o777)  # while the impostor moves in
    with subprocess.Popen([sys.executable, "-c", code, directory], stdout=subprocess.PIPE) as impostor:
        assert impostor.stdout
        impostor.stdout.readline()
        os.chmod(directory, 0o700)
        try:
            local_client(directory)
        except NoGatewayError as error:
            yield str(error).rpartition("/")[2]
        else:
            raise AssertionError("it talked to the impostor")
        finally:
            impostor.kill()


@attack("hung sidecar", "said so within a second or so; stop works", moving=True)
def hung_sidecar(target: Target) -> Iterator[str]:
    target.signal("sidecar", signal.SIGSTOP)
    began = time.monotonic()
    try:
        target.command(CommandKind.STOP)
    except NoGatewayError as error:
        took = time.monotonic() - began
        assert took < 1.5, f"{took:.1f} s"
        yield f"{error} ({took:.1f} s)"
    finally:
        target.signal("sidecar", signal.SIGCONT)


# from elsewhere -------------------------------------------------------------------------------------------------------


@attack("TLS without a certificate", "refused")
def no_certificate(target: Target) -> Iterator[str]:
    bare = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    bare.check_hostname, bare.verify_mode = False, ssl.CERT_NONE
    try:
        Raw(bare.wrap_socket(socket.create_connection(("127.0.0.1", target.command_port), timeout=2.0)))
    except OSError as error:
        yield str(error)
    else:
        raise AssertionError("it was answered")


@attack("a monitor's certificate with the operators' secret", "refused by role")
def monitors_role(target: Target) -> Iterator[str]:
    yield still_ready(target, over_tls(target, "monitor").ask().reason, "not authorised: the certificate's role")


@attack("an operator's expired certificate", "refused")
def expired(target: Target) -> Iterator[str]:
    old = target.base / "old"
    if not old.exists():
        subprocess.run(["cp", "-r", target.made, old], check=True)
        certificates(old, days=-1)
    try:
        over_tls(target, "operator", old)
    except OSError as error:
        yield str(error)
    else:
        raise AssertionError("it was answered")


@attack("an operator's certificate of another authority", "refused")
def other_authority(target: Target) -> Iterator[str]:
    other = certificates(target.base / "other")
    (other / "operator" / "authority.pem").write_bytes((target.made / "operator" / "authority.pem").read_bytes())
    try:
        over_tls(target, "operator", other)
    except OSError as error:
        yield str(error)
    else:
        raise AssertionError("it was answered")


@attack("an operator's certificate without the secret", "refused by MAC")
def wrong_secret(target: Target) -> Iterator[str]:
    raw = over_tls(target, "operator")
    true, raw.secret = raw.secret, bytes(32)
    body = pb.CommandRequest(kind=1, sequence=1, expires_ns=time.monotonic_ns() + 10**8).SerializeToString()
    sealed = seal(body, REQUEST, raw.nonce, raw.secret)
    raw.secret = true  # the reply's
    yield still_ready(target, raw.send(sealed).reason, "not authorised: the message's MAC")


@attack("a request recorded on another connection", "refused by MAC: another nonce")
def recorded(target: Target) -> Iterator[str]:
    first, second = over_tls(target, "operator"), over_tls(target, "operator")
    body = pb.CommandRequest(kind=1, sequence=1, expires_ns=time.monotonic_ns() + 10**8).SerializeToString()
    yield still_ready(target, second.send(seal(body, REQUEST, first.nonce, first.secret)).reason, "not authorised")


@attack("a nonce used twice", "refused by MAC: it is spent")
def nonce_twice(target: Target) -> Iterator[str]:
    raw = over_tls(target, "operator")
    spent = raw.nonce
    raw.ask(kind=int(CommandKind.HEARTBEAT))
    body = pb.CommandRequest(kind=1, sequence=2, expires_ns=time.monotonic_ns() + 10**8).SerializeToString()
    yield still_ready(target, raw.send(seal(body, REQUEST, spent, raw.secret)).reason, "not authorised")


@attack("a STOP made an ACTIVATE on its way", "refused by MAC")
def tampered(target: Target) -> Iterator[str]:
    raw = over_tls(target, "operator")
    body = pb.CommandRequest(kind=2, sequence=1, expires_ns=time.monotonic_ns() + 10**8).SerializeToString()
    sealed = pb.Authenticated.FromString(seal(body, REQUEST, raw.nonce, raw.secret))
    sealed.body = pb.CommandRequest(kind=1, sequence=1, expires_ns=time.monotonic_ns() + 10**8).SerializeToString()
    yield still_ready(target, raw.send(sealed.SerializeToString()).reason, "not authorised")


@attack("2000 idle connections to the TLS port", "an operator elsewhere is obeyed", moving=True)
def idle_tls(target: Target) -> Iterator[str]:
    with contextlib.ExitStack() as stack:
        for _ in range(2000):
            with contextlib.suppress(OSError):
                stack.enter_context(socket.create_connection(("127.0.0.1", target.command_port), timeout=0.2))
        with remote_client(target.where, Credentials(target.made / "operator")) as client:
            verdict = client.command(CommandKind.HEARTBEAT)
        yield f"{verdict}; {target.obeyed()}"


@attack("an impostor of the sidecar with a monitor's certificate", "the operator's client refuses it")
def impostor(target: Target) -> Iterator[str]:
    context = Credentials(target.made / "monitor").context(server=True)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        pid = os.fork()
        if pid == 0:
            with contextlib.suppress(Exception):
                context.wrap_socket(server.accept()[0], server_side=True).recv(1)
            os._exit(0)
        try:
            remote_client(f"127.0.0.1:{port}", Credentials(target.made / "operator"))
        except NoGatewayError as error:
            yield str(error)
        else:
            raise AssertionError("it was believed")
        finally:
            os.waitpid(pid, 0)


@attack("an operator in another network namespace, with and without certificate", "obeyed with it, refused without")
def elsewhere(target: Target) -> Iterator[str]:
    with namespace() as (name, host):
        words = ["command", str(target.rig), "heartbeat", "--connect", f"{host}:{target.command_port}"]
        said = []
        for role in ("operator", "router"):
            credentials = target.made / role
            if role == "router":
                shutil.copy(target.made / "operator" / "secret", credentials)  # with its mode
            line = ["ip", "netns", "exec", name, *target.hil(*words, "--credentials", str(credentials))]
            done = subprocess.run(line, capture_output=True, text=True, timeout=30, cwd=ROOT)
            said.append((done.returncode, (done.stdout + done.stderr).strip().splitlines()[0]))
        assert [code for code, _ in said] == [0, 1], said
        yield "; ".join(text for _, text in said)
