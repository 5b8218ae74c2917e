"""The axes of one rig on two CAN segments, in exact virtual time: who hears what, and what a lost segment does."""

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from drivers.frame import Frame, on_segment, segment_of
from drivers.protocols.base import Reject
from drivers.wire.faults import FaultKind, WireFault
from drivers.wire.segments import WireSegments
from drivers.wire.wire import Wire
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind, CycleResult, Tick
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.studies.fault_campaign.matrix import displaced, plan_chunks, run_chunk
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from tests.support.paths import RIGS
from tests.support.two_segments import TWO, TWO_PAIRS

MakeRun = Callable[..., LockstepRun]
CIA402 = ("bus.protocol=cia402",)


def rig_of(name: str, *overrides: str) -> RigConfig:
    return load_rig(RIGS / f"{name}.toml", overrides)


def run_until(run: LockstepRun, state: State, limit: int = 3000) -> int:
    """Ticks until that state."""
    begun = run.index
    while run.cycle.state is not state:
        run.tick()
        assert run.index - begun < limit, (run.cycle.state.name, run.cycle.fault.name, run.cycle.problems)
    return run.index - begun


def wires(run: LockstepRun) -> list[Wire]:
    assert isinstance(run.wire, WireSegments)
    return run.wire.wires


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("paper", TWO),
        ("paper", (*TWO, "bus.protocol=stage_classic")),
        ("paper-dbc", TWO),
        ("moteus", TWO),
        ("odrive", TWO),
        ("vesc", TWO),
        ("microscope-ideal", TWO_PAIRS),
        ("microscope-ideal", (*TWO_PAIRS, *CIA402)),
    ],
)
def test_a_task_runs_as_on_one_segment(lockstep: MakeRun, name: str, overrides: tuple[str, ...]) -> None:
    """On two segments frames wait less for each other: the motion is the same but for that."""
    one = [override for override in overrides if "segments" not in override]
    runs = [lockstep(rig_of(name, *sets)) for sets in (one, overrides)]
    for run in runs:
        run_until(run, State.ACTIVE)
        for _ in range(300):
            run.tick()
        assert (run.cycle.state, run.cycle.fault) == (State.ACTIVE, Fault.NONE)
    far = [axis.limits.position[1] - axis.limits.position[0] for axis in runs[0].rig.axes.values()]
    for position, other, width in zip(runs[0].stage.position, runs[1].stage.position, far, strict=True):
        assert abs(position - other) < 0.02 * width


@pytest.mark.parametrize("overrides", [(), CIA402])
def test_the_frames_of_the_axes_are_on_their_segments_alone(overrides: tuple[str, ...]) -> None:
    heard: list[dict[str, set[int]]] = [{}, {}]
    run = LockstepRun(rig_of("microscope-ideal", *TWO_PAIRS, *overrides), RIGS)
    for seen, wire in zip(heard, wires(run), strict=True):
        wire.observer = lambda _from, _to, sender, frame, _sent, seen=seen: seen.setdefault(sender, set()).add(
            frame.can_id
        )
    run_until(run, State.ACTIVE)
    assert [sorted(senders) for senders in heard] == [["host", "x", "y"], ["host", "theta", "z"]]
    said = [{can_id for sender, ids in senders.items() if sender != "host" for can_id in ids} for senders in heard]
    assert not said[0] & said[1]
    if overrides:  # SYNC, NMT and the master's heartbeat go to all; what is for a node where that is
        common = heard[0]["host"] & heard[1]["host"]
        assert common == {0x000, 0x080, 0x77F}
        assert {0x601, 0x602} <= heard[0]["host"]
        assert {0x603, 0x604} <= heard[1]["host"]


def test_the_same_bytes_every_time() -> None:
    def trace(*more: str) -> str:
        run = LockstepRun(rig_of("paper", *TWO, "wire.drop_probability=0.002", "wire.jitter=2e-5", *more), RIGS)
        for _ in range(600):
            run.tick()
        return run.trace_sha256

    assert trace() == trace() != trace("wire.seed=2")


@pytest.mark.requirement(id="SR-6.4")
@pytest.mark.parametrize(
    ("kind", "fault", "axis_named"),
    [
        (FaultKind.DROP, Fault.ENCODER_LOST, True),
        (FaultKind.CORRUPT, Fault.BUS_OFF, False),
        (FaultKind.DOWN, Fault.INTERFACE_DOWN, False),
        (FaultKind.NO_ACK, Fault.NO_ACK, False),
    ],
)
@pytest.mark.parametrize("lost", [0, 1])
def test_a_segment_lost_stops_every_axis(
    lockstep: MakeRun, kind: FaultKind, fault: Fault, axis_named: bool, lost: int
) -> None:
    run = lockstep(rig_of("microscope-ideal", *TWO_PAIRS))
    run_until(run, State.ACTIVE)
    for _ in range(300):
        run.tick()
    wires(run)[lost].inject(WireFault(kind, from_ns=run.wire.now_ns))
    run_until(run, State.FAULT, limit=60)
    assert run.cycle.fault is fault
    if axis_named:
        gone = (0, 1) if lost == 0 else (2, 3)
        assert [axis for axis, age in enumerate(run.cycle.inbox.age) if age > 5] == list(gone)
    for _ in range(15):  # the drives' own watchdogs, where nothing is sent any more
        run.tick()
    assert run.stage.applied_force == [0.0] * 4


def test_a_segment_that_is_back_is_used_again_after_a_reset() -> None:
    plan = {400: (CommandKind.RESET,), 600: (CommandKind.ACTIVATE,)}

    def operator(run: LockstepRun, index: int) -> Sequence[CommandKind]:
        return plan.get(index, ())

    run = LockstepRun(rig_of("paper", *TWO), RIGS, operator=operator)
    now = run.wire.now_ns
    wires(run)[1].inject(WireFault(FaultKind.DOWN, from_ns=now + 200_000_000, until_ns=now + 300_000_000))
    while run.index < 390:
        run.tick()
    assert (run.cycle.state, run.cycle.fault) == (State.FAULT, Fault.INTERFACE_DOWN)
    run_until(run, State.ACTIVE, limit=400)


def test_an_answer_on_the_wrong_segment_is_nobodys() -> None:
    run = LockstepRun(rig_of("paper", *TWO), RIGS)
    run_until(run, State.READY)
    answer = next(frame for frame in run.received if segment_of(frame) == 0)
    assert not isinstance(run.cycle.protocol.decode(answer), Reject)
    assert run.cycle.protocol.decode(on_segment(answer, 1)) is Reject.UNKNOWN_ID
    assert run.cycle.protocol.decode(on_segment(answer, 3)) is Reject.UNKNOWN_ID


def test_cables_in_each_others_sockets_never_come_to_torque() -> None:
    run = LockstepRun(rig_of("paper", *TWO), RIGS)
    one, other = run.stage.on_frame, {0: 1, 1: 0}

    def crossed(frame: Frame) -> list[Frame]:
        answers = one(on_segment(frame, other[segment_of(frame)]))
        return [on_segment(answer, other[segment_of(answer)]) for answer in answers]

    run.stage = CrossedStage(run.stage, crossed)  # type: ignore[assignment]
    for node, wire in zip(("y", "x"), wires(run), strict=True):
        run._axis_nodes[node] = wire.attach(f"crossed {node}", None, fifo=False)
    for _ in range(500):
        run.tick()
        assert run.stage.applied_force == [0.0, 0.0]
    assert run.cycle.state in (State.CONNECTED, State.FAULT)
    assert run.cycle.inbox.rejects[Reject.UNKNOWN_ID] > 100


class CrossedStage:
    """An emulated stage behind something that changes its frames."""

    def __init__(self, stage: object, on_frame: Callable[[Frame], list[Frame]]) -> None:
        self._stage, self.on_frame = stage, on_frame

    def __getattr__(self, name: str) -> object:
        return getattr(self._stage, name)


@pytest.mark.parametrize(("name", "overrides"), [("paper", TWO), ("moteus", TWO)])
def test_a_recording_replays_to_the_same_frames(tmp_path: Path, name: str, overrides: tuple[str, ...]) -> None:
    rig, segments = rig_of(name, *overrides), set()
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, RIGS / f"{name}.toml")

    def observe(tick: Tick, frames: Sequence[Frame], result: CycleResult) -> None:
        recorder.observe(tick, frames, result)
        segments.update(segment_of(frame) for frame in (*frames, *result.frames))

    run = LockstepRun(rig, RIGS, observer=observe)
    for _ in range(500):
        run.tick()
    recorder.close()
    replayed = replay_run(tmp_path / "run.mcap")
    assert segments == {0, 1}
    assert (replayed.ticks, replayed.different) == (500, 0)


CAMPAIGN = [("paper", TWO), ("moteus", TWO), ("microscope-ideal", (*TWO_PAIRS, *CIA402))]


@pytest.mark.long
@pytest.mark.parametrize(("name", "overrides"), CAMPAIGN)
def test_faults_in_motion(filterpy_loaded: None, name: str, overrides: tuple[str, ...]) -> None:
    rig = displaced(rig_of(name, *overrides))
    chunk = [chunk for chunk in plan_chunks(rig, RIGS, stride=9) if chunk.point.state is State.ACTIVE][1]
    cells = run_chunk(chunk)
    assert len(cells) > 5
    assert [cell for cell in cells if not cell.passed] == []


@pytest.mark.slow
@pytest.mark.parametrize(("name", "overrides"), CAMPAIGN)
def test_a_slice_of_the_campaign(filterpy_loaded: None, name: str, overrides: tuple[str, ...]) -> None:
    rig = displaced(rig_of(name, *overrides))
    cells = [cell for chunk in plan_chunks(rig, RIGS, stride=15) for cell in run_chunk(chunk)]
    assert len(cells) > 50
    assert [cell for cell in cells if not cell.passed] == []
