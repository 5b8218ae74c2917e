"""Goals of a client elsewhere, as they travel inside commands."""

from collections.abc import Iterable
from enum import IntEnum

from hil.cycle.goal import Goal, Values
from hil.telemetry import telemetry_pb2 as pb


class Act(IntEnum):
    """What is asked for."""

    DESCRIBE = 1  # which rig it is
    LOOK = 2  # what the axes do; nobody's lease
    TAKE = 3  # the lease
    TAKE_OVER = 4  # also from somebody else
    SEND = 5  # a goal
    BEAT = 6  # keep the lease
    GIVE_BACK = 7


def packed(goal: Goal, sent_ns: int) -> pb.GoalRequest:
    """A goal to send. sent_ns: on the sender's clock, monotonic."""
    return pb.GoalRequest(
        act=Act.SEND, kind=goal.kind, mask=goal.mask, flags=goal.flags, due_ns=goal.due_ns, valid_ns=goal.valid_ns,
        position=goal.position, velocity=goal.velocity, speed=goal.speed, sent_ns=sent_ns,
    )  # fmt: skip


def unpacked(request: pb.GoalRequest) -> Goal | None:
    """The goal that was sent; None for one that no client of ours sends."""
    if len(request.position) != 4 or len(request.velocity) != 4 or max(request.kind, request.mask) > 0xFF:
        return None
    return Goal(
        0, request.kind, request.mask, request.flags, request.due_ns, request.valid_ns, _values(request.position),
        _values(request.velocity), request.speed,
    )  # fmt: skip


def _values(values: Iterable[float]) -> Values:
    a, b, c, d = values
    return a, b, c, d
