"""Bring-up of drives: what the survey finds and says, and that a jog has torque while a key is held, and never else."""

from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from drivers.families.cia402 import cia301
from drivers.frame import FD, Frame
from drivers.protocols.base import DriveStatus
from drivers.protocols.frame_text import Reader, layout_reader
from hil.operate.bringup.jog import NEGATIVE, POSITIVE, Jog, jog_settings
from hil.operate.bringup.report_text import as_document, show
from hil.operate.bringup.survey import Survey, SurveyReport
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from tests.support.bought_drives import RIGS_OF, write_files
from tests.support.bringup_bench import BringupBench
from tests.support.paths import RIGS

KINDS = ["cia402", "moteus", "odrive", "vesc"]


def bench_of(kind: str, folder: Path, **plant: object) -> BringupBench:
    write_files(folder)
    rig = RIGS_OF[kind]()
    rig["plant"]["drive"] |= plant
    return BringupBench(RigConfig.model_validate(rig), folder)


def reader_of(bench: BringupBench, folder: Path) -> Reader:
    rated = [axis.rated_force for axis in bench.rig.axes.values()]
    return layout_reader(bench.rig.bus, bench.rig.axis_names, rated, folder, bench.rig.mountings)


class Keys:
    """A keyboard: `held` repeats at 30 Hz while it is set."""

    def __init__(self, bench: BringupBench) -> None:
        self._bench = bench
        self._next_ns = 0
        self.held = ""

    def __call__(self) -> str:
        if not self.held or self._bench.now_ns < self._next_ns:
            return ""
        self._next_ns = self._bench.now_ns + 33_000_000
        return self.held


# the survey -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_drives_as_the_rig_file_says_are_ready(kind: str, tmp_path: Path) -> None:
    bench = bench_of(kind, tmp_path)
    report = bench.survey()
    assert report.ready, as_document(report, reader_of(bench, tmp_path))
    assert report.unknown == ([] if kind != "vesc" else report.unknown)
    assert [axis.position for axis in report.axes] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert max(bench.stage.applied_force) == min(bench.stage.applied_force) == 0.0
    assert not bench.host.any_enabled or kind == "vesc"  # one that tells no state counts as enabled when told to be


@pytest.mark.parametrize(("kind", "instead", "told"), [
    ("odrive", {"controller.config.control_mode": 3}, "axis 1: TxSdo1.Control_Mode = 3; expected 1"),
    ("vesc", {"l_current_max": 0.5}, "axis 1, VESC 1: l_current_max = 0.5; expected 0.1592 to 0.161"),
    ("vesc", {"mcconf_signature": 1470992211}, "axis 1, VESC 1: signature of the motor configuration = 1470992211"),
])  # fmt: skip
def test_a_drive_that_is_set_otherwise_is_told(kind: str, instead: dict[str, float], told: str, tmp_path: Path) -> None:
    report = bench_of(kind, tmp_path, instead=instead).survey()
    assert not report.ready
    assert report.axes[1].problem.startswith(told)


@pytest.mark.parametrize("name", ["paper", "microscope"])
def test_so_are_the_projects_own(name: str) -> None:
    bench = BringupBench(load_rig(RIGS / f"{name}.toml"), RIGS)
    assert bench.survey().ready


@pytest.mark.parametrize("kind", ["paper", "moteus", "odrive", "cia402"])
def test_a_computer_that_is_slow_is_said_to_be_and_no_drive_is_blamed(kind: str, tmp_path: Path) -> None:
    bench = BringupBench(load_rig(RIGS / "paper.toml"), RIGS) if kind == "paper" else bench_of(kind, tmp_path)
    bench.slow = 2
    report = bench.survey()
    assert report.pace == pytest.approx(2.0)
    assert report.ready, [frame.problem for frame in report.frames]
    assert "this computer was slow: ticks took 2 times their period" in shown(report)


def test_a_drive_that_answers_every_other_command_is(tmp_path: Path) -> None:
    bench = BringupBench(load_rig(RIGS / "paper.toml"), RIGS)
    answers = iter(range(1_000_000))
    feedback = 0x101
    bench.change = lambda frame: [frame] if frame.can_id != feedback or next(answers) % 2 else []
    report = bench.survey()
    assert {frame.expected.can_id: frame.problem for frame in report.frames}[feedback].startswith(
        "every 2 ms; expected"
    )
    assert report.pace == pytest.approx(1.0)
    assert "slow" not in shown(report)


@pytest.mark.parametrize("kind", ["paper", "moteus"])
def test_a_frame_of_can_fd_is_told_as_one(kind: str, tmp_path: Path) -> None:
    bench = BringupBench(load_rig(RIGS / "paper.toml"), RIGS) if kind == "paper" else bench_of(kind, tmp_path)
    unknown = Frame(0x7A5, bytes(16), FD)
    bench.foreign = [unknown]
    bench.change = lambda frame: [frame, unknown]
    report = bench.survey()
    document = as_document(report, reader_of(bench, tmp_path))
    (first, *_) = document["frames"]
    assert first["text"].startswith("x: position"), first
    assert [last for _, last in report.unknown] == [unknown]


def shown(report: SurveyReport) -> str:
    """For people."""
    console = Console(record=True, width=200)
    show(report, lambda frame: "", console)
    return console.export_text()


def test_a_survey_tells_identity_steps_and_states_of_canopen_drives(tmp_path: Path) -> None:
    bench = bench_of("cia402", tmp_path)
    report = bench.survey()
    assert [(n.identity.node_id, n.axis, n.identity.vendor, n.state) for n in report.nodes] == [
        (3, "x", 0xFB, "OPERATIONAL"),
        (9, "y", 0xFB, "OPERATIONAL"),
    ]
    assert all(node.boot_ups >= 1 for node in report.nodes)
    steps = {step.object: step for step in report.axes[0].steps}
    assert steps["6060h:00"].answer == "done"
    assert steps["6076h:00"].answer == "is 0x1388"
    assert steps["1006h:00"].answer == "not made: is not in the EDS"
    assert report.axes[0].state == "SWITCHED_ON"
    document = as_document(report, reader_of(bench, tmp_path))
    (feedback,) = [frame for frame in document["frames"] if frame["name"] == "feedback 0"]
    assert (feedback["expected"]["bytes"], feedback["problem"]) == (6, "")
    assert feedback["text"].startswith("x: position")


def test_a_node_says_its_name_by_segments() -> None:
    rig = load_rig(RIGS / "paper.toml", ["bus.protocol=cia402"])
    report = BringupBench(rig, RIGS).survey()
    assert report.nodes[0].identity.name == "Emulated servo drive, CiA 402 cyclic synchronous torque"
    assert report.nodes[0].identity.error_register == 0


@pytest.mark.parametrize(
    ("plant", "said"),
    [
        ({"aborts": ["6060h"]}, "6060h:00 aborted with 0x08000000"),
        ({"missing": ["6060h"]}, "6060h:00 aborted with 0x06020000 (no object)"),
    ],
)
def test_a_step_that_is_refused_is_told_with_object_and_answer(
    plant: dict[str, object], said: str, tmp_path: Path
) -> None:
    report = bench_of("cia402", tmp_path, **plant).survey()
    assert not report.ready
    assert said in report.axes[0].problem
    (step,) = [step for step in report.axes[0].steps if step.object == "6060h:00"]
    assert step.answer in said
    assert "not reached" in [step.answer for step in report.axes[0].steps]


def test_a_drive_that_is_not_there_is_told_by_its_number(tmp_path: Path) -> None:
    bench = bench_of("cia402", tmp_path)
    bench.change = lambda frame: [] if frame.can_id & 0x7F == 9 else [frame]
    report = bench.survey()
    assert report.missing == [9]
    assert "node 9: no answer to 1000h:00" in report.axes[1].problem
    assert report.axes[0].problem == ""
    assert [frame.problem for frame in report.frames if frame.expected.name == "feedback 1"] == ["never heard"]


def test_emergencies_are_told_in_words(tmp_path: Path) -> None:
    bench = bench_of("cia402", tmp_path)
    bench.foreign = [Frame(0x083, bytes.fromhex("3081 11 0000000001"))]
    report = bench.survey()
    assert report.emergencies == [
        "node 3: emergency 8130h: heartbeat or life guarding: the host fell silent; "
        "error register generic, communication; maker's bytes 00 00 00 00 01"
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_sent_where_somebody_else_commands(kind: str, tmp_path: Path) -> None:
    bench = bench_of(kind, tmp_path)
    other = bench_of(kind, tmp_path).host.zero()
    survey = Survey(bench.host)
    sent = []
    while not survey.done:
        bench.foreign = other
        bench.tick(survey)
        sent += bench.sent
    report = survey.report()
    assert (sent, report.ready, bool(report.intruder)) == ([], False, True)


def shortened(frame: Frame) -> list[Frame]:
    return [frame._replace(data=frame.data[:-1])]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (shortened, "7 bytes; expected 8"),
        (lambda frame: [], "never heard"),
        (lambda frame: [frame] * 3, "expected every 2 ms"),
    ],
)
def test_frames_that_are_not_as_the_rig_file_says_stand_beside_what_it_says(
    change: Callable[[Frame], list[Frame]], said: str, tmp_path: Path
) -> None:
    bench = bench_of("odrive", tmp_path)
    estimates = 0x009
    bench.change = lambda frame: change(frame) if frame.can_id == estimates else [frame]
    report = bench.survey()
    assert not report.ready
    problems = {frame.expected.can_id: frame.problem for frame in report.frames}
    assert said in problems.pop(estimates)
    assert set(problems.values()) == {""}


def test_a_dbc_drives_state_is_told_by_signal_name(tmp_path: Path) -> None:
    bench = bench_of("odrive", tmp_path)
    document = as_document(bench.survey(), reader_of(bench, tmp_path))
    (heartbeat,) = [frame for frame in document["frames"] if frame["id"] == "001"]
    assert heartbeat["text"].startswith("Heartbeat0: Axis_Error 0, Axis_State 1,")


# the jog --------------------------------------------------------------------------------------------------------------


class Jogged:
    """A bench after a survey, with a jog of axis x under way and all that it sent since."""

    def __init__(self, kind: str, folder: Path, **plant: object) -> None:
        self.bench = bench_of(kind, folder, **plant)
        assert self.bench.survey().ready
        self.keys = Keys(self.bench)
        self.jog = Jog(self.bench.host, jog_settings(self.bench.rig, "x", None, None, None), self.keys)
        self.torques: list[float] = []

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.bench.tick(self.jog)
            self.torques.append(self.bench.stage.applied_force[0])


@pytest.fixture(params=KINDS)
def jogged(request: pytest.FixtureRequest, tmp_path: Path) -> Jogged:
    return Jogged(request.param, tmp_path)


@pytest.mark.parametrize(("key", "sign"), [(POSITIVE, 1), (NEGATIVE, -1)])
def test_an_axis_moves_while_its_key_is_held_and_the_others_do_not(jogged: Jogged, key: str, sign: int) -> None:
    jogged.tick(50)
    assert set(jogged.torques) == {0.0}
    assert not jogged.bench.host.any_enabled
    jogged.keys.held = key
    while not jogged.jog.done and jogged.jog.farthest < 1e-3:
        jogged.tick()
    assert sign * jogged.jog.moved > 0.9e-3
    assert jogged.bench.stage.applied_force[1] == 0.0
    force = jogged.jog.settings.force
    assert max(abs(torque) for torque in jogged.torques) <= force * (1 + 2e-3)  # one step of what the layout carries
    assert jogged.jog.was_enabled or "vesc" in jogged.bench.rig.bus.protocol


def test_torque_is_zero_within_a_period_of_the_time_out(jogged: Jogged) -> None:
    jogged.keys.held = POSITIVE
    jogged.tick(60)
    assert abs(jogged.torques[-1]) > 0.0
    jogged.keys.held = ""
    pressed_ns = jogged.jog._pressed_ns
    timeout_ns = round(jogged.jog.settings.key_timeout_s * 1e9)
    while jogged.jog.held:
        jogged.tick()
    assert jogged.bench.now_ns - pressed_ns <= timeout_ns + jogged.bench.rig.period_ns
    assert jogged.jog.force == 0.0
    assert jogged.torques[-1] == 0.0
    jogged.tick(40)
    assert DriveStatus.ENABLED not in jogged.bench.host.status(0)


def test_any_other_key_ends_it_at_once(jogged: Jogged) -> None:
    jogged.keys.held = POSITIVE
    jogged.tick(60)
    jogged.keys.held = " "
    jogged.tick(40)
    assert jogged.jog.ended == "another key"
    assert jogged.torques[-1] == 0.0


def test_it_never_goes_beyond_speed_and_distance(jogged: Jogged) -> None:
    jogged.keys.held = POSITIVE
    fastest = 0.0
    for _ in range(10_000):
        if jogged.jog.done:
            break
        jogged.tick()
        fastest = max(fastest, abs(float(jogged.bench.stage.velocity[0])))
    settings = jogged.jog.settings
    assert "it has moved" in jogged.jog.ended
    assert settings.distance < jogged.jog.moved < 1.1 * settings.distance
    assert fastest < 2.0 * settings.speed
    assert jogged.torques[-1] == 0.0


def test_a_position_that_stays_away_ends_it(jogged: Jogged) -> None:
    jogged.keys.held = POSITIVE
    jogged.tick(60)
    jogged.bench.change = lambda frame: []
    ticks = 0
    while not jogged.jog.done:
        jogged.tick()
        ticks += 1
    assert "no position from the drive" in jogged.jog.ended
    assert ticks * jogged.bench.rig.period_ns < 0.1e9
    assert jogged.torques[-1] == 0.0


def test_a_drive_that_latches_a_fault_ends_it(tmp_path: Path) -> None:
    jogged = Jogged("cia402", tmp_path)
    jogged.keys.held = POSITIVE
    jogged.tick(60)
    jogged.bench.stage.drives[0].fail()
    jogged.tick(5)
    assert "fault" in jogged.jog.ended or "emergency" in jogged.jog.ended
    assert jogged.torques[-1] == 0.0


def test_a_drive_that_never_enables_is_told_of(tmp_path: Path) -> None:
    jogged = Jogged("cia402", tmp_path, enable_delay_s=1.0)
    jogged.keys.held = POSITIVE
    jogged.tick(300)
    assert not jogged.jog.was_enabled
    assert set(jogged.torques) == {0.0}


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (("z", None, None, None), "the rig has x, y"),
        (("x", 50.0, None, None), "at most axes.x.limits.force"),
        (("x", 0.0, None, None), "above 0"),
        (("x", None, 4.0, None), "at most half of axes.x.limits.speed"),
        (("x", None, None, 9.0), "at most the travel"),
    ],
)
def test_what_the_rig_does_not_bear_is_refused_before_a_bus_is_opened(
    asked: tuple[str, float | None, float | None, float | None], said: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=said):
        jog_settings(bench_of("odrive", tmp_path).rig, *asked)


def test_a_rig_without_a_push_needs_a_force() -> None:
    with pytest.raises(ValueError, match="state the greatest force"):
        jog_settings(load_rig(RIGS / "paper.toml"), "x", None, None, None)


def test_an_unfinished_survey_reports_what_it_had_come_to(tmp_path: Path) -> None:
    bench = bench_of("cia402", tmp_path)
    survey = Survey(bench.host)
    for _ in range(10):
        bench.tick(survey)
    report: SurveyReport = survey.report()
    assert (report.ready, report.missing, report.frames) == (False, [], [])


def test_node_numbers_of_the_bus_that_are_not_the_rigs_are_shown(tmp_path: Path) -> None:
    bench = bench_of("cia402", tmp_path)
    survey = Survey(bench.host)
    while not survey.done:
        bench.tick(survey)
        for frame in bench.sent:
            if frame.can_id == cia301.SDO_REQUEST_ID + 20 and frame.data[0] == 0x40:
                bench.foreign.append(Frame(cia301.SDO_RESPONSE_ID + 20, b"\x80" + frame.data[1:4] + bytes(4)))
    assert [(n.identity.node_id, n.axis) for n in survey.report().nodes] == [(3, "x"), (9, "y"), (20, "")]
