"""What a sidecar says of the axes: the same as who reads the ring sees, and 50 times a second."""

import math
import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hil.cycle.goal import RELATIVE, Goal, GoalKind, Refusal
from hil.cycle.record import RECORD
from hil.live.goal_page import GoalPage
from hil.rig.file import load_rig
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.client import RigClient, decoded_motion
from hil.telemetry.motion_watch import MotionWatch
from hil.virtual.goal_link import LockstepLink
from tests.support.paths import RIGS
from tests.telemetry.test_sidecar import Bench

RIG = load_rig(RIGS / "microscope-ideal.toml")


class Watched:
    """A rig in virtual time, and a sidecar's word on it in batches of 20 ticks, as it reads them."""

    def __init__(self) -> None:
        self._records: list[np.ndarray] = []
        self.watch = MotionWatch(RIG)
        self.link = LockstepLink(RIG, RIGS, self._keep)

    def _keep(self, record: np.void) -> None:
        self._records.append(np.array([record], RECORD))
        if len(self._records) == 20:
            self.flush()

    def flush(self) -> None:
        if self._records:
            self.watch.add(np.concatenate(self._records))
            self._records = []

    def tell(self, lag_ns: int = 0) -> pb.Motion:
        self.flush()
        assert self.watch.last is not None
        return self.watch.tell(int(self.watch.last["now_ns"]) + lag_ns, "somebody")

    def move(self, axis: int, place: float, flags: int = 0) -> None:
        position = tuple(place if k == axis else 0.0 for k in range(4))
        goal = Goal(0, GoalKind.MOVE, 1 << axis, flags, position=position)  # type: ignore[arg-type]
        assert self.link.send(goal)[1] is Refusal.NONE


@pytest.fixture
def watched() -> Watched:
    return Watched()


def test_a_move_is_told_with_its_target_from_its_tick_until_the_axes_are_in_position(watched: Watched) -> None:
    watched.link.wait(0.1)
    held = watched.tell()
    assert (held.state, held.motion, held.moving, held.in_position) == ("ACTIVE", "HOLD", False, True)
    assert held.target == held.setpoint
    watched.move(0, 1e-3)
    begun = watched.tell(lag_ns=5_000_000)
    assert (begun.motion, begun.goal, begun.moving, begun.in_position) == ("MOVE", 1, True, False)
    assert begun.target[0] == 1e-3
    assert list(begun.target[1:]) == list(held.target[1:])
    assert (begun.lag, begun.lease) == (0.005, "somebody")
    words = set()
    while not watched.link.look().in_position:
        watched.link.wait(1e-3)
        told, look = watched.tell(), watched.link.look()
        words.add((told.moving, told.in_position))
        assert (told.in_position, told.motion) == (look.in_position, look.motion.name)
        assert list(told.position) == look.position
    assert words == {(True, False), (False, False), (False, True)}
    assert watched.tell().target[0] == watched.tell().setpoint[0] == 1e-3


def test_a_target_is_told_only_where_a_motion_has_one(watched: Watched) -> None:
    watched.move(0, 1e-3)
    watched.link.wait(0.01)
    watched.move(0, 5e-4, RELATIVE)  # counts from the target in force
    assert watched.tell().target[0] == 1.5e-3
    watched.link.send(Goal(0, GoalKind.JOG, 2, valid_ns=100_000_000, velocity=(0.0, 1e-3, 0.0, 0.0)))
    told = watched.tell()
    assert (told.motion, told.target[0]) == ("JOG", 1.5e-3)
    assert math.isnan(told.target[1])
    assert watched.link.send(Goal(0, GoalKind.MOVE, 1, position=(9.0, 0.0, 0.0, 0.0)))[1] is Refusal.FENCE
    assert watched.tell().target[0] == 1.5e-3


def test_before_a_tick_was_read_nothing_is_claimed() -> None:
    told = MotionWatch(RIG).tell(0)
    assert (told.state, told.moving, told.in_position, list(told.position)) == ("", False, False, [])


def test_what_is_no_motion_message_is_not_shown() -> None:
    assert decoded_motion(b"\xff") is None
    assert decoded_motion(pb.Motion(position=[0.0] * 2, target=[0.0]).SerializeToString()) is None
    told = decoded_motion(pb.Motion(lease="a\x1b[2J").SerializeToString())
    assert told is not None
    assert "\x1b" not in told.lease


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.close()


@pytest.mark.live
def test_who_subscribes_hears_fifty_times_a_second(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.sidecar()
    bench.control()
    with RigClient(bench.endpoint) as client:
        first = client.wait_motion(30.0)
        began, told = time.monotonic(), [first]
        while len(told) < 50:
            told.append(client.wait_motion(30.0))
        took = time.monotonic() - began
    assert took < 2.0  # of 1 s; a shared machine may be late
    indices = [motion.index for motion in told]
    assert indices == sorted(set(indices))
    assert {motion.state for motion in told} == {"READY"}
    assert min(motion.lag for motion in told) < 0.05


@pytest.mark.live
def test_it_is_told_who_moves_the_rig(bench: Bench) -> None:
    bench.sidecar()
    bench.control()
    path = bench.runtime / "microscope-ideal" / "goals"
    with RigClient(bench.endpoint) as client:
        assert client.wait_motion(30.0).lease == ""
        with GoalPage.create(path) as page:
            page.take_lease()
            until = time.monotonic() + 30.0
            while not (lease := client.wait_motion(30.0).lease):
                page.beat()
                assert time.monotonic() < until
            assert lease == f"process {os.getpid()} of user {os.getuid()}"
            page.give_back()
            while client.wait_motion(30.0).lease:
                assert time.monotonic() < until
