"""Commands: who may give them, what is refused with which reason, and that nobody can be kept from giving them."""

import os
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.cycle.record import RECORD
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.mailbox import Mailbox
from hil.rig.file import load_rig
from hil.rig.provenance import describe_run
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.command_client import CommandClient, NoGatewayError, local_client, remote_client
from hil.telemetry.command_server import CONNECTIONS, Asked, Connection
from hil.telemetry.command_wire import LIMIT, REPLY, REQUEST, WireError, frame, opened, seal, unframe
from hil.telemetry.credentials import Credentials, CredentialsError
from hil.telemetry.gateway import Gateway, explain
from hil.virtual.lockstep import LockstepRun, activate_when_ready
from tests.support.certificates import certificates
from tests.support.command_bench import CommandBench
from tests.support.paths import RIGS, ROOT


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return certificates(tmp_path_factory.mktemp("certificates"))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[CommandBench]:
    with CommandBench(tmp_path / "rig") as bench:
        yield bench


def free_port() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def remote(tmp_path: Path, made: Path) -> Iterator[tuple[CommandBench, str]]:
    where = free_port()
    with CommandBench(tmp_path / "rig", (where, Credentials(made / "sidecar"))) as bench:
        yield bench, where


# the wire -------------------------------------------------------------------------------------------------------------


@given(st.lists(st.binary(max_size=LIMIT), max_size=5), st.integers(1, 50))
def test_messages_come_out_as_they_went_in_however_they_were_cut(messages: list[bytes], part: int) -> None:
    stream, buffer, found = b"".join(map(frame, messages)), bytearray(), []
    for start in range(0, len(stream), part):
        buffer += stream[start : start + part]
        while (message := unframe(buffer)) is not None:
            found.append(message)
    assert found == messages


def test_a_message_that_announces_too_much_is_refused_before_it_is_received() -> None:
    with pytest.raises(WireError, match="at most"):
        unframe(bytearray(b"\xff\xff"))


@given(st.binary(), st.binary(min_size=1), st.integers(0, 10_000))
def test_a_mac_holds_for_its_bytes_direction_nonce_and_secret_alone(body: bytes, secret: bytes, flip: int) -> None:
    message = seal(body, REQUEST, b"nonce", secret)
    assert opened(message, REQUEST, b"nonce", secret) == body
    assert opened(message, REPLY, b"nonce", secret) is None
    assert opened(message, REQUEST, b"nonc3", secret) is None
    assert opened(message, REQUEST, b"nonce", secret + b"!") is None
    sealed = pb.Authenticated.FromString(message)
    sealed.mac = bytes(byte ^ (1 << flip % 8) if at == flip % 32 else byte for at, byte in enumerate(sealed.mac))
    assert opened(sealed.SerializeToString(), REQUEST, b"nonce", secret) is None


# the gateway ----------------------------------------------------------------------------------------------------------


def gateway_of(expiry_s: float) -> Gateway:
    rig = load_rig(RIGS / "microscope-ideal.toml")
    short_lived = rig.model_copy(update={"safety": rig.safety.model_copy(update={"command_expiry_s": expiry_s})})
    return Gateway(short_lived, Path("/nowhere"), lambda _: None)


def asked(refusal: str = "", last: int = 0, **changes: int) -> Asked:
    values = {"kind": int(CommandKind.STOP), "sequence": 1, "expires_ns": 1_100, **changes}
    connection = cast(Connection, SimpleNamespace(last_sequence=last, who="a test"))
    return Asked(connection, pb.CommandRequest(**values), refusal)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, ""),
        ({"kind": 0}, "unknown command 0"),
        ({"kind": 99}, "unknown command 99"),
        ({"kind": 2**32 - 1}, "unknown command"),
        ({"sequence": 0}, "replayed"),
        ({"last": 1}, "replayed"),
        ({"expires_ns": 1_000}, "stale"),
        ({"expires_ns": -(2**62)}, "stale"),
        ({"expires_ns": 1_501}, "expires too late"),
        ({"expires_ns": 1_500}, ""),
        ({"kind": 4, "expires_ns": 0, "sequence": 0}, ""),  # an ESTOP waits for no clock and is never a replay
        ({"refusal": "not authorised"}, "not authorised"),
        ({"refusal": "not authorised", "kind": 4}, "not authorised"),
    ],
)
def test_the_gateway_refuses_with_the_reason(changes: dict[str, int], reason: str) -> None:
    answer = gateway_of(500e-9).judge(asked(**changes), 1_000)  # type: ignore[arg-type]
    assert answer.startswith(reason)
    assert bool(answer) == bool(reason)


def test_a_refusal_says_what_stands_against_the_drives(bench: CommandBench) -> None:
    bench.problems = ["node 3: 6502h:00 aborted", "n" * 5000, *(f"node {node}" for node in range(100))]
    with local_client(bench.directory) as client:
        assert client.command(CommandKind.STOP).accepted
        verdict = client.command(CommandKind.RESET)
    assert not verdict.accepted
    assert "RESET is not possible in state READY; node 3: 6502h:00 aborted; nnn" in verdict.reason


def test_a_refused_request_uses_no_sequence_number() -> None:
    gateway, request = gateway_of(500e-9), asked(expires_ns=900)
    assert gateway.judge(request, 1_000).startswith("stale")
    assert gateway.judge(Asked(request.connection, asked().request, ""), 1_000) == ""
    assert gateway.judge(Asked(request.connection, asked().request, ""), 1_000).startswith("replayed")


def test_a_task_that_cannot_begin_where_the_stage_stands_is_refused_by_axis_time_value_limit_and_key() -> None:
    sets = ["task.kind=point_to_point", 'task.axes=["x"]', "task.target=[0.02]", "task.move_s=1.0"]
    run = LockstepRun(
        load_rig(RIGS / "microscope-ideal.toml", [*sets, "plant.initial_position=[-0.024, 0.0, 0.0, 0.0]"]),
        RIGS,
        operator=activate_when_ready,
    )
    records = [run.tick().record for _ in range(300)]
    (refused, *_) = [record for record in records if record["n_commands"]]
    command = refused["commands"][0]
    assert (run.cycle.state, bool(command["accepted"])) == (State.READY, False)
    reason = explain(CommandKind(int(command["kind"])), int(command["expires_ns"]), refused, run.cycle.rig)
    assert reason.startswith("refused: the task cannot begin here: axis x: speed 0.076032 m/s 0.400 s after the start")
    assert reason.endswith("the limit less its margin is 0.076; change [task] or axes.x.limits.speed = 0.08")


def test_what_cannot_be_done_because_drives_are_silent_is_refused_by_axis_and_age() -> None:
    rig = load_rig(RIGS / "paper.toml")
    record = np.zeros(1, RECORD)[0]
    record["state"], record["age_ticks"][:2] = State.CONNECTED, (0, 1200)
    reason = explain(CommandKind.ACTIVATE, 1, record, rig)
    assert reason == "ACTIVATE is not possible in state CONNECTED; no answer from y for 1.2 s"
    record["age_ticks"][:2] = 100
    assert explain(CommandKind.ACTIVATE, 1, record, rig) == "ACTIVATE is not possible in state CONNECTED"


def test_reasons_are_told_by_the_rig_that_the_control_process_runs_not_by_the_sidecars_file() -> None:
    gateway = gateway_of(0.5)
    running = load_rig(RIGS / "paper.toml", ["safety.command_expiry_s=0.25"])
    gateway.follow(describe_run(running, RIGS))
    late = asked(expires_ns=1_000 + 300_000_000)
    assert gateway.judge(late, 1_000) == "expires too late: at most 0.25 s ahead (safety.command_expiry_s)"


@pytest.mark.parametrize("damaged", [True, False])
def test_where_what_the_control_process_runs_cannot_be_read_the_reason_says_whose_rig_it_is(damaged: bool) -> None:
    replies: list[pb.CommandReply] = []
    metadata = describe_run(load_rig(RIGS / "paper.toml"), RIGS)
    if damaged:
        metadata["rig"]["of_a_later_version"] = 1
    gateway = Gateway(load_rig(RIGS / "paper.toml"), Path("/nowhere"), lambda _: None)
    gateway.follow(metadata)
    request = asked()
    request.connection.answer = replies.append  # type: ignore[method-assign]
    gateway.take(request, cast(Mailbox, SimpleNamespace(post=lambda *_: 7)), 1_000, "READY")
    records = np.zeros(1, RECORD)
    records["n_commands"], records["state"] = 1, State.CONNECTED
    records["commands"][0, 0] = (CommandKind.STOP, 0, 7, 1_100)
    gateway.verdicts(records, 0, 1_050)
    assert replies[0].reason.endswith("cannot be read") is damaged
    assert replies[0].reason.startswith("STOP is not possible in state CONNECTED")


# on this machine ------------------------------------------------------------------------------------------------------


@pytest.mark.live
def test_a_command_is_accepted_or_refused_by_the_control_process_and_both_are_recorded(bench: CommandBench) -> None:
    with local_client(bench.directory) as client:
        assert client.command(CommandKind.STOP) == (True, "", "READY")
        refused = client.command(CommandKind.RESET)
        assert (refused.accepted, refused.state) == (False, "READY")
        stopped = client.command(CommandKind.ESTOP)
        assert (stopped.accepted, stopped.state) == (True, "ESTOP")
    noted = [(CommandKind(entry.kind).name, entry.accepted) for entry in bench.entries]
    assert noted == [("STOP", True), ("RESET", False), ("ESTOP", True)]
    assert all(entry.who == f"uid {os.getuid()} (pid {os.getpid()})" for entry in bench.entries)


@pytest.mark.requirement(id="SR-9.3")
@pytest.mark.live
def test_a_control_process_that_takes_nothing_is_said_to_within_a_second(bench: CommandBench) -> None:
    bench.dead = True
    with local_client(bench.directory) as client:
        began = time.monotonic()
        verdict = client.command(CommandKind.STOP)
        assert time.monotonic() - began < 1.0
        assert (verdict.accepted, verdict.reason) == (False, "the control process did not take it")


@pytest.mark.live
def test_a_sidecar_that_hangs_is_said_to_within_a_second(tmp_path: Path) -> None:
    directory = tmp_path / "rig"
    directory.mkdir(mode=0o700)
    os.chdir(directory)
    with socket.socket(socket.AF_UNIX) as hung:
        hung.bind("commands")
        hung.listen()
        began = time.monotonic()
        with pytest.raises(NoGatewayError, match="hangs"):
            local_client(directory)
        assert time.monotonic() - began < 1.5
    os.chdir(ROOT)


@pytest.mark.live
def test_a_gateway_that_lies_about_the_verdict_is_found_out(tmp_path: Path) -> None:
    """It answers "accepted, ESTOP" itself, and names a tick in which nothing of the kind happened."""
    with CommandBench(tmp_path / "rig"):
        ours, liars = socket.socketpair()
        liars.sendall(frame(pb.Challenge(nonce=b"n", now_ns=time.monotonic_ns()).SerializeToString()))
        with CommandClient(ours, b"", tmp_path / "rig" / "ring") as client:
            lie = pb.CommandReply(accepted=True, state="ESTOP", sequence=1, posted=1, tick=1)
            liars.sendall(frame(seal(lie.SerializeToString(), REPLY, b"n", b"")))
            with pytest.raises(NoGatewayError, match="does not hold the command"):
                client.command(CommandKind.STOP)
            lie.sequence = 2
            liars.sendall(frame(seal(lie.SerializeToString(), REPLY, b"n", b"")))
        liars.close()


def test_a_peer_may_be_silent_for_ten_seconds_from_the_reply_on_however_long_that_took() -> None:
    second = 1_000_000_000
    near, far = socket.socketpair()
    near.setblocking(False)
    with far, near:
        connection = Connection(near, "a test", "here", b"", 0)
        for asked, told in ((1 * second, 61 * second), (70 * second, 71 * second)):
            request = pb.CommandRequest(kind=CommandKind.LOAD_TASK, sequence=1)
            far.sendall(frame(seal(request.SerializeToString(), REQUEST, connection._nonce, b"")))
            assert connection.poll(asked) is not None
            assert not connection.overdue(told), "who waits for a reply is not idle"
            connection.answer(pb.CommandReply(now_ns=told))
            assert not connection.overdue(told + 10 * second)
            assert connection.overdue(told + 10 * second + 1)


@pytest.mark.live
def test_idle_connections_and_nonsense_keep_no_operator_out(bench: CommandBench) -> None:
    handle = os.open(bench.directory, os.O_PATH)
    idle = []
    for number in range(5 * CONNECTIONS):
        connection = socket.socket(socket.AF_UNIX)
        connection.connect(f"/proc/self/fd/{handle}/commands")
        if number % 2:
            connection.sendall(os.urandom(100))
        idle.append(connection)
    with local_client(bench.directory) as client:
        assert client.command(CommandKind.STOP).accepted
    for connection in idle:
        connection.close()
    os.close(handle)


@pytest.mark.requirement(id="SR-5.3")
@pytest.mark.skipif(os.geteuid() != 0, reason="becomes another user")
@pytest.mark.live
def test_another_user_who_got_hold_of_a_connection_is_refused_and_recorded(bench: CommandBench) -> None:
    code = f"""
import os, socket
handle = os.open({str(bench.directory)!r}, os.O_PATH)
root = socket.socket(socket.AF_UNIX)
import sys; sys.path.insert(0, {str(ROOT)!r})
from hil.telemetry.command_client import CommandClient
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
os.setresuid(65534, 65534, 65534)
root.connect(f"/proc/self/fd/{{handle}}/commands")
print(CommandClient(root, b"", None).command(CommandKind.STOP))
"""
    os.chmod(bench.directory / "commands", 0o777)  # left open to everybody
    for parent in (bench.directory, *bench.directory.parents[:4]):
        os.chmod(parent, os.stat(parent).st_mode | 0o111)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert "not authorised: uid 65534" in done.stdout, done.stderr
    assert [entry.accepted for entry in bench.entries] == [False]
    assert bench.entries[0].who.startswith("uid 65534")


# from elsewhere -------------------------------------------------------------------------------------------------------


@pytest.mark.live
def test_an_operator_elsewhere_commands_and_is_recorded_by_name_and_role(
    remote: tuple[CommandBench, str], made: Path
) -> None:
    bench, where = remote
    with remote_client(where, Credentials(made / "operator")) as client:
        assert client.command(CommandKind.STOP).accepted
        assert client.command(CommandKind.ESTOP).state == "ESTOP"
    assert {entry.who for entry in bench.entries} == {"certificate 'operator', role 'operator', from 127.0.0.1"}


@pytest.mark.requirement(id="SR-5.3")
@pytest.mark.live
def test_whoever_lacks_certificate_role_or_secret_is_refused_and_recorded(
    remote: tuple[CommandBench, str], made: Path, tmp_path: Path
) -> None:
    bench, where = remote
    host, port = where.split(":")

    def refused(message: str) -> None:
        limit = time.monotonic() + 10
        while not any(message in entry.reason for entry in bench.entries):
            assert time.monotonic() < limit, bench.entries
            time.sleep(0.01)

    (made / "monitor" / "secret").write_text((made / "operator" / "secret").read_text())
    (made / "monitor" / "secret").chmod(0o600)
    with remote_client(where, Credentials(made / "monitor")) as client:
        assert "role is 'monitor'" in client.command(CommandKind.ESTOP).reason
    refused("role is 'monitor'")

    other = tmp_path / "other"
    other.mkdir()
    for name in ("authority.pem", "certificate.pem", "key.pem"):
        (other / name).write_bytes((made / "operator" / name).read_bytes())
        (other / name).chmod(0o600)
    (other / "secret").write_text("00" * 32)
    (other / "secret").chmod(0o600)
    with remote_client(where, Credentials(other)) as client, pytest.raises(NoGatewayError, match="MAC"):
        client.command(CommandKind.STOP)
    refused("MAC is wrong")

    bare = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    bare.check_hostname, bare.verify_mode = False, ssl.CERT_NONE
    with bare.wrap_socket(socket.create_connection((host, int(port)))) as nobody, pytest.raises(ssl.SSLError):
        nobody.recv(10)  # in TLS 1.3 the client hears of its refusal with its first byte
    refused("PEER_DID_NOT_RETURN_A_CERTIFICATE")
    assert not any(entry.accepted for entry in bench.entries)


@pytest.mark.live
def test_an_expired_certificate_is_refused(remote: tuple[CommandBench, str], made: Path, tmp_path: Path) -> None:
    _, where = remote
    old = tmp_path / "old"
    subprocess.run(["cp", "-r", made, old], check=True)
    certificates(old, days=-1)
    with pytest.raises(NoGatewayError), remote_client(where, Credentials(old / "operator")) as client:
        client.command(CommandKind.STOP)


def test_a_private_file_that_others_can_read_is_refused(made: Path, tmp_path: Path) -> None:
    subprocess.run(["cp", "-r", made / "operator", tmp_path / "mine"], check=True)
    (tmp_path / "mine" / "key.pem").chmod(0o644)
    with pytest.raises(CredentialsError, match="chmod 600"):
        Credentials(tmp_path / "mine")
