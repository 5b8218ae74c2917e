"""A rig is moved from elsewhere over TLS: by who has the role, one at a time, and streams pass the jitter buffer."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import hil
from hil.cycle.goal import Goal, GoalKind, MotionError, MotionWord
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.command_client import remote_client
from hil.telemetry.credentials import Credentials
from hil.telemetry.goal_wire import Act, packed, unpacked
from hil.telemetry.remote_link import RemoteLink
from tests.support.live_rig import PATIENCE_S, every_record
from tests.support.remote_rig import Remote, remote_rig

MS = 1_000_000


def test_a_goal_comes_out_as_it_went_in_and_what_is_none_does_not() -> None:
    goal = Goal(0, GoalKind.KNOT, 3, 1, 5, 6, (1.0, 2.0, 3.0, 4.0), (5.0, 6.0, 7.0, 8.0), 0.5)
    request = pb.GoalRequest.FromString(packed(goal, 99).SerializeToString())
    assert unpacked(request) == goal
    assert request.sent_ns == 99
    request.position.append(0.0)
    assert unpacked(request) is None
    assert unpacked(pb.GoalRequest(act=Act.SEND, kind=1 << 20, position=[0.0] * 4, velocity=[0.0] * 4)) is None


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Remote, Path]]:
    """One rig for all tests, and its runtime directory."""
    runtime = tmp_path_factory.mktemp("runtime")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HIL_RUNTIME_DIR", str(runtime))
        with remote_rig(tmp_path_factory.mktemp("remote")) as remote:
            yield remote, runtime
            patch.setenv("HIL_RUNTIME_DIR", str(runtime))


@pytest.fixture
def remote(running: tuple[Remote, Path], monkeypatch: pytest.MonkeyPatch) -> Remote:
    """The same, which every test has a runtime directory of its own without."""
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(running[1]))
    return running[0]


def operator(remote: Remote) -> Credentials:
    return Credentials(remote.made / "operator")


@pytest.mark.live
def test_a_program_elsewhere_activates_moves_and_leaves_the_rig_holding(remote: Remote) -> None:
    with hil.connect(
        "paper", remote.endpoint, commands=remote.commands, credentials=remote.made / "operator"
    ) as rig, rig.motion() as m:  # fmt: skip
        look = m.move_to(x=1e-3, y=-5e-4).wait(PATIENCE_S)
        assert look.setpoint == [1e-3, -5e-4]
        told = rig.motion_status(PATIENCE_S)
        assert told.lease.startswith("certificate 'operator")
        with pytest.raises(hil.GoalRefusedError, match="x = 9: from"):
            m.move_to(x=9.0)
        with pytest.raises(hil.GoalRefusedError, match="beyond the travel"):
            m.move_by(x=9.0)
        with pytest.raises(hil.MotionError, match="moves this rig already"):
            hil.motion("paper", activate=False)
        m.path({"x": [1e-3, 2e-3], "y": [-5e-4, 0.0]}).wait(PATIENCE_S)
        m.move_by(x=0.2, speed=0.01)
    until = time.monotonic() + PATIENCE_S
    while every_record()["motion"][-1] != MotionWord.HOLD:
        assert time.monotonic() < until
        time.sleep(0.02)


@pytest.mark.live
def test_a_stream_from_elsewhere_keeps_its_even_steps(remote: Remote) -> None:
    with RemoteLink(remote.commands, operator(remote)) as link:
        link.hold()
        with hil.Mover(link) as m:
            m.move_to(x=0.0, y=0.0).wait(PATIENCE_S)
            done = m.stream(((0.02 * k, {"x": 5e-5 * k}) for k in range(50)), lead=0.1)
            assert done.sent + done.late == 50
            assert m.wait(PATIENCE_S).setpoint[0] == pytest.approx(49 * 5e-5, abs=1e-12)
            motion = link._ask(Act.LOOK).motion
            assert motion.stream_delay == pytest.approx(0.04, abs=0.015)  # two intervals
            lost = motion.stream_late, motion.stream_disordered
            old = packed(Goal(0, GoalKind.KNOT, 1, due_ns=50 * MS), time.monotonic_ns() - 300 * MS)
            assert link._sent(old).number == 0
            motion = link._ask(Act.LOOK).motion
            assert (motion.stream_late, motion.stream_disordered) == (lost[0], lost[1] + 1)


@pytest.mark.live
def test_nobody_moves_it_without_the_role_or_without_the_lease(remote: Remote) -> None:
    with pytest.raises(MotionError, match="the certificate's role is 'monitor', not 'operator'"):
        RemoteLink(remote.commands, Credentials(_with_secret(remote.made)))
    with RemoteLink(remote.commands, operator(remote)) as link, RemoteLink(remote.commands, operator(remote)) as other:
        link.hold()
        with pytest.raises(MotionError, match="the lease has ended: take it again"):
            other.send(Goal(0, GoalKind.HALT))
        link.take()
        with pytest.raises(MotionError, match=r"certificate 'operator.* moves this rig already"):
            other.take()
        with pytest.raises(MotionError, match="unknown act 99"):
            link._sent(pb.GoalRequest(act=99))
        assert link._sent(pb.GoalRequest(act=Act.SEND, kind=1)).refusal == 2  # UNKNOWN: no positions
        other.take(by_force=True)
        with pytest.raises(MotionError, match="the lease has ended"):
            link.send(Goal(0, GoalKind.HALT))
        assert other.send(Goal(0, GoalKind.HALT))[0] > 0


def _with_secret(made: Path) -> Path:
    """A monitor's certificate beside the operators' secret, as of a thief who has half."""
    secret = made / "monitor" / "secret"
    if not secret.exists():
        secret.write_text((made / "operator" / "secret").read_text())
        secret.chmod(0o600)
    return made / "monitor"


@pytest.mark.live
def test_a_client_that_is_gone_loses_the_lease_and_its_plan_goes_on_to_its_rest(remote: Remote) -> None:
    link = RemoteLink(remote.commands, operator(remote))
    link.hold()
    link.take()
    _, refusal = link.send(Goal(0, GoalKind.MOVE, 1, position=(3e-3, 0.0, 0.0, 0.0), speed=0.1))
    assert refusal == 0
    link._ended.set()  # it says nothing more, and does not give the lease back
    link._client.close()
    with remote_client(remote.commands, operator(remote)) as client:
        until = time.monotonic() + PATIENCE_S
        look = pb.GoalRequest(act=Act.LOOK)
        while (motion := client.goal(look).goal.motion).lease or motion.motion != "HOLD":
            assert time.monotonic() < until
            time.sleep(0.05)
    assert motion.setpoint[0] == 3e-3
