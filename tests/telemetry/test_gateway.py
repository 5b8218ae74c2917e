"""The gateway without sockets or threads: who is answered what and when, what is recorded, and every reason in full."""

import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from hil.cycle.limits import motion_limits
from hil.cycle.record import RECORD
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.mailbox import SLOTS, Mailbox
from hil.live.stop_line import StopLine
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.codec import ESTOP, REALTIME_OK, RECORDER_OK, RIG_OK
from hil.telemetry.command_server import Asked, Connection
from hil.telemetry.gateway import VERDICT_TIMEOUT_NS, Gateway, explain
from hil.telemetry.task_loader import MOST_BYTES
from tests.support.paths import RIGS

NOW = 5_000_000_000
GRANTED = RECORDER_OK | REALTIME_OK | RIG_OK


class Desk:
    """A gateway with all that is around it. replies, entries: what was answered and recorded."""

    def __init__(self, directory: Path) -> None:
        self.replies: list[pb.CommandReply] = []
        self.entries: list[pb.CommandEntry] = []
        self.problems: list[str] = []
        self.mailbox = Mailbox.create(directory / "mailbox")
        self.stop = StopLine(directory)
        rig = load_rig(RIGS / "paper.toml", ["safety.command_expiry_s=0.5"])
        self.gateway = Gateway(rig, directory / "stop", self.entries.append, lambda: self.problems, directory / "task")
        self.connection = cast(
            Connection,
            SimpleNamespace(last_sequence=0, who="a test", upload=b"", answer=self.replies.append, open=True),
        )

    def asked(self, kind: CommandKind, sequence: int = 1, **more: object) -> Asked:
        request = pb.CommandRequest(kind=int(kind), sequence=sequence, expires_ns=NOW + 1, **more)  # type: ignore[arg-type]
        return Asked(self.connection, request, "")

    def take(self, kind: CommandKind, sequence: int = 1, *, mailbox: bool = True, **more: object) -> None:
        box = self.mailbox if mailbox else None
        self.gateway.take(self.asked(kind, sequence, **more), box, NOW, "READY")


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(tmp_path)
    yield made
    made.mailbox.close()
    made.stop.close()


def tick(state: State = State.READY, flags: int = GRANTED, now_ns: int = NOW) -> np.void:
    record: np.void = np.zeros(1, RECORD)[0]
    record["state"], record["flags"], record["now_ns"] = int(state), flags, now_ns
    return record


def ticks(*judged: tuple[int, CommandKind, bool]) -> np.ndarray:
    """Three ticks, of which the second judged these commands: sequence in the mailbox, kind, whether accepted."""
    records = np.zeros(3, RECORD)
    records["state"], records["flags"], records["now_ns"] = State.CONNECTED, GRANTED, NOW
    records["n_commands"][1] = len(judged)
    for place, (sequence, kind, accepted) in enumerate(judged):
        records["commands"][1, place] = (kind, accepted, sequence, NOW + 1)
    return records


# one request ----------------------------------------------------------------------------------------------------------


def test_a_request_waits_for_the_tick_that_judged_it_which_the_reply_names(desk: Desk) -> None:
    desk.take(CommandKind.STOP, 1)
    desk.take(CommandKind.RESET, 2)
    assert [(command.kind, command.expires_ns) for command in desk.mailbox.poll()] == [
        (CommandKind.STOP, NOW + 1), (CommandKind.RESET, NOW + 1),
    ]  # fmt: skip
    desk.gateway.verdicts(ticks(), 40, NOW + 2)
    assert desk.replies == []
    desk.gateway.verdicts(ticks((1, CommandKind.STOP, True), (2, CommandKind.RESET, False)), 40, NOW + 3)
    stopped, refused = desk.replies
    assert (stopped.accepted, stopped.reason, stopped.state, stopped.now_ns) == (True, "", "CONNECTED", NOW + 3)
    assert [(reply.sequence, reply.posted, reply.tick) for reply in desk.replies] == [(1, 1, 42), (2, 2, 42)]
    assert (refused.accepted, refused.reason) == (False, "RESET is not possible in state CONNECTED")
    told = [(entry.who, entry.kind, entry.when_ns, entry.accepted, entry.reason, entry.state) for entry in desk.entries]
    assert told == [
        ("a test", CommandKind.STOP, NOW + 3, True, "", "CONNECTED"),
        ("a test", CommandKind.RESET, NOW + 3, False, "RESET is not possible in state CONNECTED", "CONNECTED"),
    ]
    assert desk.gateway.refused == 1
    assert all(entry.posted == 0 and entry.task == b"" for entry in desk.entries), "no task, nothing to replay"
    desk.gateway.verdicts(ticks((1, CommandKind.STOP, True)), 43, NOW + 4)
    assert len(desk.replies) == 2, "answered once"


def test_a_command_of_another_sender_is_nobodys_verdict_here(desk: Desk) -> None:
    desk.take(CommandKind.STOP)
    desk.gateway.verdicts(ticks((9, CommandKind.STOP, True)), 0, NOW)
    assert desk.replies == []


@pytest.mark.parametrize("kind", [CommandKind.STOP, CommandKind.ESTOP])
def test_what_nobody_judges_is_given_up_after_half_a_second_and_not_before(kind: CommandKind, desk: Desk) -> None:
    desk.take(kind)
    desk.gateway.give_up(NOW + VERDICT_TIMEOUT_NS, "READY")
    assert desk.replies == []
    desk.gateway.give_up(NOW + VERDICT_TIMEOUT_NS + 1, "HUNG")
    desk.gateway.give_up(NOW + 2 * VERDICT_TIMEOUT_NS, "HUNG")
    (reply,) = desk.replies
    yet = " yet: stop stays pressed" if kind is CommandKind.ESTOP else ""
    assert (reply.accepted, reply.reason) == (False, "the control process did not take it" + yet)
    assert (reply.state, reply.now_ns) == ("HUNG", NOW + VERDICT_TIMEOUT_NS + 1)


def test_at_the_end_everybody_is_answered_at_once(desk: Desk) -> None:
    for sequence, kind in enumerate((CommandKind.STOP, CommandKind.ESTOP, CommandKind.RESET), start=1):
        desk.take(kind, sequence)
    desk.gateway.give_up(NOW, "READY", everything=True)
    assert sorted(reply.sequence for reply in desk.replies) == [1, 2, 3]
    assert desk.gateway.refused == 3
    assert VERDICT_TIMEOUT_NS == 500_000_000


@pytest.mark.parametrize("kind", [CommandKind.STOP, CommandKind.LOAD_TASK])
def test_without_a_control_process_it_is_said_at_once(kind: CommandKind, desk: Desk) -> None:
    desk.take(kind, mailbox=False)
    (reply,) = desk.replies
    assert reply.reason.startswith("no control process is running this rig")
    assert (reply.state, reply.now_ns, reply.accepted) == ("READY", NOW, False)


def test_a_full_mailbox_is_said_at_once(desk: Desk) -> None:
    for sequence in range(1, SLOTS + 2):
        desk.take(CommandKind.HEARTBEAT, sequence)
    (reply,) = desk.replies
    assert reply.reason == "64 commands are waiting already: the control process does not take them"
    assert reply.sequence == SLOTS + 1


def test_parts_of_a_task_are_accepted_until_they_are_too_long_and_then_forgotten(desk: Desk) -> None:
    half = bytes(MOST_BYTES // 2)
    for sequence in (1, 2):
        desk.take(CommandKind.LOAD_TASK, sequence, task=half, more=True)
    assert [(reply.accepted, reply.sequence, reply.now_ns) for reply in desk.replies] == [
        (True, 1, NOW),
        (True, 2, NOW),
    ]
    assert len(desk.connection.upload) == MOST_BYTES
    assert desk.entries == [], "a part is no command"
    desk.take(CommandKind.LOAD_TASK, 3, task=b"x", more=True)
    assert desk.replies[-1].reason == "what is sent is longer than 2097152 bytes, compressed"
    assert desk.connection.upload == b""


def test_a_request_that_never_came_to_be_one_is_recorded(desk: Desk) -> None:
    desk.gateway.note_rejected("uid 5", "no certificate", NOW)
    (entry,) = desk.entries
    assert (entry.who, entry.kind, entry.when_ns, entry.accepted, entry.reason) == (
        "uid 5",
        0,
        NOW,
        False,
        "no certificate",
    )
    assert (desk.gateway.refused, desk.replies) == (1, [])


# stop -----------------------------------------------------------------------------------------------------------------


def test_stop_is_pressed_on_the_page_and_answered_by_the_tick_that_read_it(desk: Desk) -> None:
    before = len(os.listdir("/proc/self/fd"))
    desk.take(CommandKind.ESTOP)
    assert desk.stop.pressed()
    assert desk.mailbox.poll() == ()
    records = ticks()
    records["flags"][2] |= ESTOP
    records["state"][2] = State.ESTOP
    desk.gateway.verdicts(records, 40, NOW + 9)
    (reply,) = desk.replies
    assert (reply.accepted, reply.state, reply.tick, reply.now_ns) == (True, "ESTOP", 43, NOW + 9)
    assert [(entry.who, entry.kind) for entry in desk.entries] == [("a test", CommandKind.ESTOP)]
    assert len(os.listdir("/proc/self/fd")) == before, "the page is closed again"


def test_a_press_from_elsewhere_is_recorded_under_the_name_that_the_page_has(desk: Desk) -> None:
    desk.take(CommandKind.ESTOP)
    records = ticks()
    records["flags"][:2] |= ESTOP
    desk.gateway.verdicts(records, 0, NOW)
    ours, elsewhere = desk.entries
    assert ours.who == "a test"
    assert elsewhere.who == f"uid {os.getuid()} (pid {os.getpid()}) says the stop page"
    assert (elsewhere.kind, elsewhere.accepted, elsewhere.when_ns) == (CommandKind.ESTOP, True, NOW)
    assert len(desk.replies) == 1
    desk.stop.close()
    open_files = len(os.listdir("/proc/self/fd"))
    desk.gateway.verdicts(records[:1], 0, NOW)
    assert desk.entries[-1].who == "unknown"
    assert len(os.listdir("/proc/self/fd")) == open_files


def test_stop_without_a_control_process_is_refused(desk: Desk) -> None:
    desk.stop.close()
    desk.take(CommandKind.ESTOP)
    assert [reply.reason for reply in desk.replies] == ["no control process is running this rig"]
    desk.gateway.give_up(2 * NOW, "READY")
    assert len(desk.replies) == 1, "nothing waits"


# reasons --------------------------------------------------------------------------------------------------------------

WITH_HEARTBEAT = ["safety.heartbeat_s=0.5"]
STILL_THERE = "the cause of the fault is still there, or an axis moved in the last 0.05 s"


@pytest.mark.parametrize(
    ("kind", "record", "late_ns", "overrides", "reason"),
    [
        (CommandKind.STOP, tick(), 2_340_000, [], "stale: expired 2.3 ms before the tick that took it"),
        (CommandKind.STOP, tick(State.FAULT), 1, [], "stale: expired 0.0 ms before the tick that took it"),
        (CommandKind.STOP, tick(State.FAULT), 0, [], "STOP is not possible in state FAULT"),
        (CommandKind.ESTOP, tick(State.SHUTDOWN), 1, [], "ESTOP is not possible in state SHUTDOWN"),
        (CommandKind.ACTIVATE, tick(State.ACTIVE, 0), 0, [], "ACTIVATE is not possible in state ACTIVE"),
        (CommandKind.ACTIVATE, tick(), 0, WITH_HEARTBEAT, "refused: no operator heartbeat"),
        (CommandKind.ACTIVATE, tick(), 0, [], "refused: the task cannot begin here"),
        (CommandKind.HOME, tick(), 0, WITH_HEARTBEAT, "refused: no operator heartbeat"),
        (CommandKind.HOME, tick(flags=GRANTED & ~RECORDER_OK), 0, [], "refused: no recorder is alive"),
        (CommandKind.ACTIVATE, tick(flags=GRANTED & ~REALTIME_OK), 0, [],
         "refused: the kernel did not grant real time (timing.allow_degraded)"),
        (CommandKind.ACTIVATE, tick(flags=RECORDER_OK), 0, WITH_HEARTBEAT,
         "refused: the kernel did not grant real time (timing.allow_degraded) and the rig file has changed since the "
         "start"),
        (CommandKind.LOAD_TASK, tick(), 0, [], "refused: the task cannot begin where the axes stand"),
        (CommandKind.LOAD_TASK, tick(State.HOMING), 0, [], "LOAD_TASK is not possible in state HOMING"),
        (CommandKind.SET_LAW, tick(), 0, [], "refused: it came without a law"),
        (CommandKind.SET_LAW, tick(State.HOMING), 0, [], "SET_LAW is not possible in state HOMING"),
        (CommandKind.RESET, tick(State.FAULT), 0, [], f"refused in FAULT: {STILL_THERE}"),
        (CommandKind.RESET, tick(State.ESTOP), 0, [], f"refused in ESTOP: {STILL_THERE}"),
        (CommandKind.RESET, tick(State.READY), 0, [], "RESET is not possible in state READY"),
    ],
)  # fmt: skip
def test_every_reason_of_a_refusal(
    kind: CommandKind, record: np.void, late_ns: int, overrides: list[str], reason: str
) -> None:
    rig = load_rig(RIGS / "paper.toml", overrides)
    assert explain(kind, NOW - late_ns, record, rig) == reason


@pytest.mark.parametrize(("place", "target"), [(0.03, "0.02523"), (-0.03, "-0.02523")])
def test_beyond_the_travel_the_commands_are_printed_that_lead_back(place: float, target: str) -> None:
    rig = load_rig(RIGS / "microscope.toml")
    record = tick()
    record["position"][0] = place
    told = explain(CommandKind.ACTIVATE, NOW, record, rig)
    assert told.startswith("refused: the task cannot begin here: axis x: position")
    assert told.endswith(f"hil command microscope activate-hold && hil move microscope x={target}")
    fence = motion_limits(rig)[0]
    assert fence.low < float(target) < fence.high


def test_a_drive_that_is_silent_is_named_where_a_reset_is_refused(paper: RigConfig) -> None:
    record = tick(State.FAULT)
    record["age_ticks"][1] = 501
    text = explain(CommandKind.RESET, NOW, record, paper)
    assert text == f"refused in FAULT: {STILL_THERE}; no answer from y for 0.5 s"
    record["age_ticks"][1] = 500
    assert explain(CommandKind.RESET, NOW, record, paper).endswith(STILL_THERE)


def test_an_axis_that_moves_is_named_where_a_reset_is_refused(paper: RigConfig) -> None:
    record = tick(State.FAULT)
    record["velocity_estimate"][0] = -0.25
    assert (
        explain(CommandKind.RESET, NOW, record, paper) == "refused in FAULT: x moves at 0.25 m/s: it has to rest first"
    )


def test_of_many_problems_three_are_said_each_cut_to_what_a_reply_holds(desk: Desk) -> None:
    desk.problems = ["a" * 161, "b" * 160, "c", "d"]
    desk.take(CommandKind.RESET)
    desk.gateway.verdicts(ticks((1, CommandKind.RESET, False)), 0, NOW)
    words = ["RESET is not possible in state CONNECTED", "a" * 160 + "...", "b" * 160, "c"]
    assert desk.replies[0].reason == "; ".join(words)
