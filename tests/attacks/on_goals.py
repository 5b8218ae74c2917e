"""Attacks on goals: on this machine's goal page, and over the TLS of commands. A rig that moves stays within its limits
and takes an operator's word throughout.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.cycle.goal import Goal, GoalKind, MotionError, MotionWord
from hil.cycle.limits import motion_limits
from hil.cycle.state_machine import State
from hil.live.goal_page import FIRST_SLOT, LEASE_NS, SIZE, GoalPage
from hil.live.ring import RingReader
from hil.telemetry.credentials import Credentials
from hil.telemetry.goal_wire import Act
from hil.telemetry.remote_link import RemoteLink
from tests.attacks.on_commands import as_nobody, over_tls
from tests.attacks.registry import attack
from tests.attacks.target import SLOW, Target
from tests.support.live_rig import rig_with
from tests.support.paths import ROOT

FLOOD: Final = 100_000
TLS_FLOOD: Final = 20
LEASES: Final = 20  # in a fight
FIGHT_S: Final = 1.0
JOG_S: Final = 0.5
REST_S: Final = 1.0  # from the end of a jog's validity to its rest, on a machine that does much else
FIELDS: Final = ("state", "fault", "motion", "lease", "setpoint_position", "setpoint_velocity")
RIG: Final = rig_with(SLOW)
LIMITS: Final = motion_limits(RIG)


def goal(kind: GoalKind, x: float = 0.0, velocity: float = 0.0) -> Goal:
    """Of the first axis."""
    at, speeds = (x, 0.0, 0.0, 0.0), (velocity, 0.0, 0.0, 0.0)
    return Goal(0, kind, 1, valid_ns=round(JOG_S * 1e9), position=at, velocity=speeds, speed=1.0)


class Watched:
    """The ticks from now on: what must hold in every one of them."""

    def __init__(self, target: Target) -> None:
        self._target, self._from = target, 0
        target.until(lambda: self.ticks()["motion"][-1:].tolist() not in ([], [MotionWord.NONE]), "it takes goals")
        with RingReader(target.directory / "ring") as reader:
            self._from = reader.written

    def ticks(self) -> NDArray[np.void]:
        """Oldest first."""
        with RingReader(self._target.directory / "ring") as reader:
            return reader.look(self._from, reader.written - self._from, FIELDS).records

    def sound(self) -> str:
        """No fault, set-points within the fence and the speed limits, an operator obeyed; in words."""
        ticks = self.ticks()
        assert len(ticks), "no tick"
        assert not ticks["fault"].any(), f"fault {ticks['fault'].max()}"
        assert (ticks["state"] == State.ACTIVE).all(), "it left ACTIVE"
        for axis, limits in enumerate(LIMITS):
            at, speed = ticks["setpoint_position"][:, axis], np.abs(ticks["setpoint_velocity"][:, axis])
            assert limits.low - 1e-9 <= np.nanmin(at), f"{np.nanmin(at)} m"
            assert np.nanmax(at) <= limits.high + 1e-9, f"{np.nanmax(at)} m"
            assert np.nanmax(speed) <= limits.speed * (1 + 1e-9), f"{np.nanmax(speed)} m/s"
        return f"{len(ticks)} ticks within fence and speed; {self._target.obeyed()}"

    def rests(self, within_s: float) -> float:
        """Wait until the set-points rest; how long that took, s."""
        began = time.monotonic()
        self._target.until(lambda: self.ticks()["motion"][-1:].tolist() == [MotionWord.HOLD], "it rests", within_s)
        return time.monotonic() - began


@contextlib.contextmanager
def holder(target: Target) -> Iterator[GoalPage]:
    """A client of this machine that moves the rig."""
    with GoalPage(target.directory / "goals") as page:
        page.take_lease(by_force=True)
        yield page
        page.give_back()


# on this machine ------------------------------------------------------------------------------------------------------


@attack("another user opens the goal page", "permission denied")
def another_users_goals(target: Target) -> Iterator[str]:
    said = as_nobody(f"os.open({str(target.directory / 'goals')!r}, os.O_RDWR)")
    assert "Permission" in said, said
    yield said


@contextlib.contextmanager
def program(code: str, *words: object) -> Iterator[subprocess.Popen[str]]:
    """Runs until the attack is over, and says "up" once it has begun."""
    line = [sys.executable, "-c", code, *map(str, words)]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "up\n"
            yield process
        finally:
            process.kill()


FLOODER = """
import sys
from pathlib import Path
from tests.attacks.on_goals import goal
from hil.cycle.goal import GoalKind
from hil.live.goal_page import GoalPage, GoalPageError
page, sent = GoalPage(Path(sys.argv[1])), 0
page.take_lease(by_force=True)
print("up", flush=True)
while True:
    try:
        page.post(goal(GoalKind.MOVE, 1e-3 * (1 - 2 * (sent % 2))))
    except GoalPageError:  # stop is pressed
        page.take_lease(by_force=True)
    sent += 1
"""


@attack("100 000 goals on the goal page without a pause", "limits kept, no fault, an operator obeyed", moving=True)
def flood(target: Target) -> Iterator[str]:
    watched, began = Watched(target), time.monotonic()
    with GoalPage(target.directory / "goals") as page, program(FLOODER, target.directory / "goals"):
        target.until(lambda: page.counts["passed"] > FLOOD, f"{FLOOD} passed over", 60.0)
        took_s = time.monotonic() - began
        yield f"{page.counts['passed'] / took_s:.0f} goals/s passed over; {watched.sound()}"


@attack("goals under a forged lease", "refused as foreign; the axes stay", moving=True)
def forged(target: Target) -> Iterator[str]:
    watched = Watched(target)
    with holder(target) as page, GoalPage(target.directory / "goals") as thief:
        page.post(goal(GoalKind.MOVE))
        watched.rests(5.0)
        before = watched.ticks()["setpoint_position"][-1].tolist()
        foreign = page.counts["foreign"]
        for lease in range(1, 200):
            thief._lease = page._lease + lease
            thief._keep = lambda: None  # type: ignore[method-assign]  # a client that asks nobody
            thief.post(goal(GoalKind.MOVE, 5e-3))
            time.sleep(1e-3)
        target.until(lambda: page.counts["foreign"] > foreign, "they are counted")
        assert watched.ticks()["setpoint_position"][-1].tolist() == before
        yield f"{page.counts['foreign'] - foreign} refused as foreign; {watched.sound()}"


@attack("random bytes all over the goal page", "damage counted, no fault, an operator obeyed", moving=True)
def noise(target: Target) -> Iterator[str]:
    watched = Watched(target)
    with holder(target) as page:
        damaged = page.counts["damaged"]
        for _ in range(200):
            slots = os.urandom(SIZE - FIRST_SLOT)
            page._map[FIRST_SLOT:SIZE] = slots
            page._words[8] += 1  # goals posted
            time.sleep(1e-3)
        target.until(lambda: page.counts["damaged"] > damaged, "it is counted")
        yield f"{page.counts['damaged'] - damaged} slots damaged; {watched.sound()}"


FIGHTER = """
import sys, time
from pathlib import Path
from tests.attacks.on_goals import goal
from hil.cycle.goal import GoalKind
from hil.live.goal_page import GoalPage, GoalPageError
page = GoalPage(Path(sys.argv[1]))
print("up", flush=True)
while True:
    time.sleep(1e-3)  # four times a tick; the processor is left to the rig
    page.take_lease(by_force=True)
    try:
        page.post(goal(GoalKind.MOVE, float(sys.argv[2])))
    except GoalPageError:  # the other one has taken it meanwhile
        pass
"""


@attack("two clients that take the lease from each other", "limits kept, no fault, an operator obeyed", moving=True)
def fight(target: Target) -> Iterator[str]:
    watched, page = Watched(target), target.directory / "goals"
    with program(FIGHTER, page, "2e-3"), program(FIGHTER, page, "-2e-3"):
        target.until(lambda: len(set(watched.ticks()["lease"].tolist())) > LEASES, f"{LEASES} leases")
        yield f"{len(set(watched.ticks()['lease'].tolist()))} leases; {watched.sound()}"


JOGGER = """
import sys, time
from pathlib import Path
from tests.attacks.on_goals import goal
from hil.cycle.goal import GoalKind
from hil.live.goal_page import GoalPage
page = GoalPage(Path(sys.argv[1]))
page.take_lease(by_force=True)
print("up", flush=True)
while True:
    page.post(goal(GoalKind.JOG, velocity=1e-3))
    time.sleep(0.02)
"""


def silenced(target: Target, number: signal.Signals) -> Iterator[str]:
    """A client that jogs gets a signal: its jog ends as its goal says, and so does its lease."""
    watched = Watched(target)
    with program(JOGGER, target.directory / "goals") as jogger:
        target.until(lambda: watched.ticks()["motion"][-1:].tolist() == [MotionWord.JOG], "it jogs")
        jogger.send_signal(number)
        took_s = watched.rests(JOG_S + REST_S)
        with GoalPage(target.directory / "goals") as page:
            target.until(lambda: page.holder() is None, "its lease ends", 2e-9 * LEASE_NS)
        yield f"at rest after {took_s:.2f} s; {watched.sound()}"


@attack("a client that jogs is killed", "at rest within the goal's time, the lease free", moving=True)
def killed(target: Target) -> Iterator[str]:
    yield from silenced(target, signal.SIGKILL)


@attack("a client that jogs is stopped", "at rest within the goal's time, the lease free", moving=True)
def stopped(target: Target) -> Iterator[str]:
    yield from silenced(target, signal.SIGSTOP)


# from elsewhere -------------------------------------------------------------------------------------------------------


def elsewhere(target: Target) -> RemoteLink:
    """An operator's client over TLS."""
    return RemoteLink(target.where, Credentials(target.made / "operator"))


@attack("goals over TLS with a monitor's certificate", "refused by role; the axes stay", moving=True)
def monitors_goals(target: Target) -> Iterator[str]:
    watched, raw = Watched(target), over_tls(target, "monitor")
    with raw.connection:
        reply = raw.ask(kind=0)
    assert not reply.accepted
    assert "role" in reply.reason, reply.reason
    assert MotionWord.MOVE not in watched.ticks()["motion"].tolist()
    yield f"{reply.reason}; {watched.sound()}"


@attack("goals over TLS without the lease", "refused; the axes stay", moving=True)
def without_lease(target: Target) -> Iterator[str]:
    watched = Watched(target)
    with elsewhere(target) as one, elsewhere(target) as other:
        one.take(by_force=True)
        try:
            other.send(goal(GoalKind.MOVE, 5e-3))
        except MotionError as error:
            said = str(error)
        else:
            raise AssertionError("it was taken")
        assert MotionWord.MOVE not in watched.ticks()["motion"].tolist()
        yield f"{said}; {watched.sound()}"


TLS_FLOODER = """
import sys, time
from pathlib import Path
from tests.attacks.on_goals import goal
from hil.cycle.goal import GoalKind
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.command_client import remote_client
from hil.telemetry.credentials import Credentials
from hil.telemetry.goal_wire import Act, packed
with remote_client(sys.argv[1], Credentials(Path(sys.argv[2]))) as client:
    assert client.goal(pb.GoalRequest(act=Act.TAKE_OVER)).accepted
    print("up", flush=True)
    sent = 0
    while True:
        client.goal(packed(goal(GoalKind.MOVE, 1e-3 * (1 - 2 * (sent % 2))), time.monotonic_ns()))
        sent += 1
"""


@attack("a flood of goals over TLS", "limits kept, no fault, an operator obeyed", moving=True)
def tls_flood(target: Target) -> Iterator[str]:
    watched = Watched(target)
    with GoalPage(target.directory / "goals") as page, program(TLS_FLOODER, target.where, target.made / "operator"):
        first, began = page._words[8], time.monotonic()
        target.until(lambda: page._words[8] - first > TLS_FLOOD, f"{TLS_FLOOD} goals")
        yield f"{TLS_FLOOD / (time.monotonic() - began):.0f} goals/s; {watched.sound()}"


@attack("two operators elsewhere that take the lease from each other", "limits kept, no fault", moving=True)
def tls_fight(target: Target) -> Iterator[str]:
    watched, taken = Watched(target), 0
    with elsewhere(target) as one, elsewhere(target) as other:
        until = time.monotonic() + FIGHT_S
        while time.monotonic() < until:
            for link, at in ((one, 2e-3), (other, -2e-3)):
                link._ask(Act.TAKE_OVER)
                taken += link.send(goal(GoalKind.MOVE, at))[1] == 0
        assert taken > 2, taken
        yield f"{taken} goals taken; {watched.sound()}"


@attack("goals over TLS with numbers that are none", "each refused; the axes stay", moving=True)
def no_numbers(target: Target) -> Iterator[str]:
    watched = Watched(target)
    with elsewhere(target) as link:
        link.take(by_force=True)
        hostile = [goal(GoalKind.MOVE, value) for value in (float("nan"), float("inf"), -1e308, 9.0)]
        hostile += [goal(GoalKind.JOG, velocity=float("nan")), goal(GoalKind.JOG, velocity=float("-inf"))]
        refused = [link.send(one)[1] for one in hostile]
        assert all(refused), refused
        words = {MotionWord(word).name for word in watched.ticks()["motion"].tolist()}
        assert not {"MOVE", "JOG"} & words, words
        yield f"{', '.join(one.name for one in refused)}; {watched.sound()}"


@attack("an operator elsewhere is cut off while he jogs", "at rest within the goal's time, the lease free", moving=True)
def cut_off(target: Target) -> Iterator[str]:
    watched, link = Watched(target), elsewhere(target)
    link.take(by_force=True)
    link.send(goal(GoalKind.JOG, velocity=1e-3))
    link._ended.set()  # no word more, and the lease is not given back
    link._client.close()
    took_s = watched.rests(JOG_S + REST_S)
    with GoalPage(target.directory / "goals") as page:
        target.until(lambda: page.holder() is None, "its lease ends", 3e-9 * LEASE_NS)
    yield f"at rest after {took_s:.2f} s; {watched.sound()}"
