"""How another task reaches the control process: the same plan, bit for bit, and nothing from damaged bytes."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind, LoadedLaw, OperatorCommand
from hil.live.task_file import PIECES, TaskIntake, law_bytes, task_bytes
from hil.live.task_loading import loaded_law, loaded_task
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from tests.live.test_loop import NO_ACK, UnpoweredDrives, loop_beside
from tests.support.paths import RIGS

AXES = "task.axes=['x', 'y']"
TASKS = {
    "hold": ["task.kind=hold"],
    "circle": ["task.kind=circle", AXES, "task.radius=1e-3"],
    "point_to_point": ["task.kind=point_to_point", "task.axes=['y']", "task.target=[0.01]"],
    "lissajous": ["task.kind=lissajous", AXES, "task.radius=1e-3"],
    "waypoints": ["task.kind=waypoints", AXES, "task.waypoints=[[0.0, 0.0], [0.01, 0.02], [0.0, 0.03]]"],
    "blended": ["task.kind=waypoints", AXES, "task.waypoints=[[0.0, 0.0], [0.01, 0.02]]", "task.blend=1e-3",
                "task.repeat=true"],
    "spline": ["task.kind=spline", "task.axes=['y']", "task.waypoints=[[0.0], [0.02], [0.01]]"],
    "raster": ["task.kind=raster", AXES, "task.corner=[0.0, 0.0]", "task.size=[5e-3, 1e-3]"],
    "spiral": ["task.kind=spiral", AXES, "task.radius=1e-3", "task.repeat=true"],
}  # fmt: skip


def rig_with(name: str) -> RigConfig:
    if name == "injection":
        return load_rig(RIGS / "microscope-ideal.toml")
    return load_rig(RIGS / "paper.toml", TASKS[name])


def taken_in(path: Path, data: bytes, rig: RigConfig, number: int = 7) -> tuple[TaskIntake, int]:
    path.write_bytes(data)
    intake, pieces = TaskIntake(path, number, rig), 0
    while not intake.done:
        intake.work()
        pieces += 1
    return intake, pieces


@pytest.mark.parametrize("name", [*TASKS, "injection"])
def test_the_plan_that_arrives_is_the_plan_that_was_sent(name: str, tmp_path: Path) -> None:
    rig = rig_with(name)
    sent = loaded_task(rig)
    intake, _ = taken_in(tmp_path / "task", task_bytes(7, sent, rig), rig)
    assert intake.task is not None
    assert list(intake.task.start_ranges) == list(sent.start_ranges)
    start = [0.001 * (axis + 1) for axis in range(len(rig.axes))]
    there, here = intake.task.plan(start), sent.plan(start)
    assert (there.duration_ns, there.repeat_ns, there.repeat_from_ns, there.steady_from_ns, there.phase_names) == (
        here.duration_ns, here.repeat_ns, here.repeat_from_ns, here.steady_from_ns, here.phase_names
    )  # fmt: skip
    for time in range(0, 9_000_000_000, 37_000_000):
        assert there.phase_at(time) == here.phase_at(time)
        for axis in range(len(rig.axes)):
            assert there.at(axis, time) == here.at(axis, time)


def test_a_long_task_comes_in_small_pieces(tmp_path: Path) -> None:
    rows = [[0.01 * k, 1e-3 * (k % 2)] for k in range(2000)]
    rig = load_rig(RIGS / "paper.toml", ["task.kind=path", "task.axes=['x']", f"task.samples={rows}"])
    intake, pieces = taken_in(tmp_path / "task", task_bytes(7, loaded_task(rig), rig), rig)
    assert intake.task is not None
    assert pieces == 2 + 2000 // PIECES  # header, 1999 segments and the rest at the end, and the checksum


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_damaged_bytes_are_no_task(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    rig = rig_with("waypoints")
    good = task_bytes(7, loaded_task(rig), rig)
    place = data.draw(st.integers(0, len(good) - 1))
    bad = bytearray(good[: data.draw(st.sampled_from([place, len(good)]))])
    if len(bad) == len(good):
        bad[place] ^= data.draw(st.integers(1, 255))
    path = tmp_path_factory.getbasetemp() / "damaged"
    assert taken_in(path, bytes(bad), rig)[0].task is None


@given(st.binary(max_size=200))
@settings(max_examples=100, deadline=None)
def test_any_bytes_are_no_task(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any"
    assert taken_in(path, b"HILTASK1" + data, rig_with("hold"))[0].task is None


def test_the_task_of_another_number_or_rig_is_not_taken(tmp_path: Path) -> None:
    rig = rig_with("hold")
    data = task_bytes(7, loaded_task(rig), rig)
    assert taken_in(tmp_path / "task", data, rig, number=8)[0].task is None
    assert taken_in(tmp_path / "task", data, load_rig(RIGS / "microscope-ideal.toml"))[0].task is None
    missing = TaskIntake(tmp_path / "none", 7, rig)
    missing.work()
    assert missing.done
    assert missing.task is None


@pytest.mark.parametrize("overrides", [["law.name=structured-kalman"], ["law.name=pid", "law.gains.ki=[1.5, 2.5]"]])
def test_the_law_that_arrives_is_the_law_that_was_sent(overrides: list[str], tmp_path: Path) -> None:
    rig, made = load_rig(RIGS / "paper.toml", overrides), []
    sent = loaded_law(rig)
    (tmp_path / "law").write_bytes(law_bytes(7, sent))

    def make(law: LoadedLaw) -> bool:
        made.append(law)
        return len(made) == 3

    intake = TaskIntake(tmp_path / "law", 7, rig, make)
    for pieces in range(5):
        assert not intake.done, pieces
        intake.work()
    assert intake.done
    assert intake.task is None
    assert intake.law is not None
    assert made == [intake.law] * 3
    assert intake.law.law.effective_gains() == rig.law.effective_gains()
    assert (intake.law.law.name, intake.law.designed) == (rig.law.name, sent.designed)


def test_a_law_that_cannot_be_made_or_is_damaged_is_none(tmp_path: Path) -> None:
    rig = rig_with("hold")
    data = law_bytes(7, loaded_law(rig))

    def make(_law: LoadedLaw) -> bool:
        raise ValueError("law.gains.kp")

    for at in (*range(0, len(data), 7), len(data)):
        (tmp_path / "law").write_bytes(data[:at] + bytes([(data[at] ^ 1)]) + data[at + 1 :] if at < len(data) else data)
        intake = TaskIntake(tmp_path / "law", 7, rig, make)
        while not intake.done:
            intake.work()
        assert intake.law is intake.task is None


class Box:
    """A mailbox in which somebody has posted task 7."""

    task_posted = 7

    def __init__(self) -> None:
        self.answers: list[tuple[int, bool]] = []

    def answer_task(self, number: int, *, ready: bool) -> None:
        self.answers.append((number, ready))


@pytest.mark.replaces_methods
@pytest.mark.parametrize("name", ["circle", "waypoints"])
def test_the_loop_takes_a_task_in_piece_by_piece_while_no_axis_is_under_torque(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with loop_beside(UnpoweredDrives(NO_ACK, []), tmp_path, monkeypatch) as loop:
        rig, box = rig_with(name), Box()
        loop.parts.task_file.write_bytes(task_bytes(7, loaded_task(rig), rig))
        monkeypatch.setattr(loop, "_mailbox", box)
        loop._look_for_task()
        intake = loop._intake
        assert intake is not None
        machine = loop._cycle.supervisor.machine
        with monkeypatch.context() as moving:
            moving.setattr(machine, "state", State.ACTIVE)
            for _ in range(100):
                loop._take_task_in(intake)
            assert not intake.done
        for _ in range(100):
            if loop._intake is not None:
                loop._take_task_in(loop._intake)
        assert box.answers == [(7, True)]
        assert loop._task is intake.task is not None
        loop._look_for_task()
        assert loop._intake is None, "it is the same one"
        loop.parts.ring.close()


@pytest.mark.replaces_methods
def test_the_loop_makes_a_law_axis_by_axis_and_forgets_it_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with loop_beside(UnpoweredDrives(NO_ACK, []), tmp_path, monkeypatch) as loop:
        box, axes = Box(), loop._cycle.axes
        loop.parts.task_file.write_bytes(law_bytes(7, loaded_law(loop._cycle.rig)))
        monkeypatch.setattr(loop, "_mailbox", box)
        loop._look_for_task()
        pieces = 0
        while loop._intake is not None:
            loop._take_task_in(loop._intake)
            pieces += 1
        assert pieces == 3 + len(loop._cycle.rig.axes)  # header, checksum, gains, and a law for each axis
        assert box.answers == [(7, True)]
        law = loop._law
        assert law is not None
        assert axes.make_law(law), "nothing is left to do in the tick"
        loop._cycle.commands.handled = [(OperatorCommand(CommandKind.SET_LAW, 1, 0), True)]
        loop._after_commands()
        assert loop._law is None
        loop.parts.ring.close()
