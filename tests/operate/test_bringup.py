"""Bring-up of drives: what the survey finds and says."""

from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from drivers.families.cia402 import cia301
from drivers.frame import FD, Frame
from drivers.protocols.frame_text import Reader, layout_reader
from hil.operate.bringup.report_text import as_document, show
from hil.operate.bringup.survey import Survey, SurveyReport
from hil.rig.file import load_rig
from tests.support.bringup_bench import KINDS, BringupBench, bench_of
from tests.support.paths import RIGS


def reader_of(bench: BringupBench, folder: Path) -> Reader:
    rated = [axis.rated_force for axis in bench.rig.axes.values()]
    return layout_reader(bench.rig.bus, bench.rig.axis_names, rated, folder, bench.rig.mountings)


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


@pytest.mark.parametrize("rig", sorted(RIGS.glob("*.toml")), ids=lambda rig: rig.stem)
def test_so_are_those_of_the_rigs_that_we_ship(rig: Path) -> None:
    """Answers of RobStride have the drive's state in their identifiers, and were never heard at rest."""
    report = BringupBench(load_rig(rig), RIGS).survey()
    assert report.ready, [frame for frame in report.frames if frame.problem]


def test_an_answer_that_cannot_be_read_is_told_though_its_identifier_is_another() -> None:
    """Mode 3 is none of RobStride's."""
    bench = BringupBench(load_rig(RIGS / "robstride.toml"), RIGS)
    bench.change = lambda frame: [frame._replace(can_id=frame.can_id | 3 << 22)]
    assert {frame.problem for frame in bench.survey().frames} == {"cannot be read: invalid value"}


def test_a_command_with_a_torque_in_its_identifier_is_somebody_elses() -> None:
    bench = BringupBench(load_rig(RIGS / "robstride.toml"), RIGS)
    survey = Survey(bench.host)
    at_zero = next(message.can_id for message in bench.host.protocol.messages(1_000_000) if message.sender == "host")
    bench.foreign = [Frame(at_zero ^ 0x40 << 8, bytes(8))]
    bench.run(survey)
    assert survey.report().intruder


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
