"""The configurations of VESCs: who is asked, when, and what comes of answers that are wrong, late, mixed or none."""

import tomllib
from typing import Any

import pytest

from drivers.config import BusConfig
from drivers.families.dbc.config import VescBinding, dbc_keys
from drivers.families.dbc.segments import cut
from drivers.families.dbc.vesc_packets import MOST_FRAMES, PROCESS_SHORT_BUFFER
from drivers.families.dbc.vesc_reader import PLACES, SIGNATURE, Place, VescReader, value_in
from drivers.frame import EXTENDED, EXTENDED_MASK, Frame
from drivers.protocols import LayoutError, host_protocol
from drivers.protocols.base import Command, DriveStatus, Reject, own_ids
from drivers.protocols.read_back import ANSWER_TICKS, MOST_ASKED
from sim_plant.drives import vesc_configuration as theirs
from tests.support.paths import RIGS

MS = 1_000_000
IDS = (0, 1)
MOTOR, APPLICATION = theirs.COMM_GET_MCCONF, theirs.COMM_GET_APPCONF
RIGHT = theirs.SET_BY_NOBODY | {"l_current_max": 0.16, "l_current_min": -0.16, "controller_id": 0, "timeout_msec": 10}
PERIOD = 2 * MS


def bus_of(**changes: Any) -> BusConfig:
    table: dict[str, Any] = tomllib.loads((RIGS / "vesc.toml").read_text())["bus"]
    table["dbc"]["vesc"] |= changes
    return BusConfig.model_validate(table)


def host_of(**changes: Any) -> Any:
    return host_protocol(bus_of(**changes), 2, [0.008, 0.008], RIGS, PERIOD)


class Bench:
    """The host of the shipped rig, asked tick by tick; its drives answer as `answers` says."""

    def __init__(self, **changes: Any) -> None:
        self.host = host_of(**changes)
        self.tick = 0
        self.asked: list[tuple[int, int]] = []  # VESC ID, number of the question
        self.values = [dict(RIGHT), dict(RIGHT)]

    def ask(self, enable: int = 0, *, reset: bool = False) -> list[Frame]:
        """Questions of one tick."""
        self.tick += 1
        frames = self.host.encode(Command(self.tick, [0.0, 0.0], enable, reset))
        return [frame for frame in frames if (frame.can_id & EXTENDED_MASK) >> 8 == PROCESS_SHORT_BUFFER]

    def answer(self, question: Frame) -> list[Frame]:
        vesc_id, number = question.can_id & 0xFF, question.data[2]
        self.asked.append((vesc_id, number))
        return theirs.answer(theirs.configuration(number, self.values[vesc_id]), vesc_id, question.data[0])

    def go(self, ticks: int) -> None:
        """Every question is answered at once, and positions come in every tick."""
        for _ in range(ticks):
            self.status(0), self.status(1)
            for question in self.ask():
                for frame in self.answer(question):
                    assert self.host.decode(frame) == ()

    def status(self, axis: int) -> int:
        """DriveStatus that comes with the axis' next position."""
        sample = self.host.decode(Frame(EXTENDED | 0x1000 | axis, bytes(8), 0, self.tick * PERIOD))
        status: int = sample.status
        return status


def test_a_drive_counts_as_in_fault_until_all_its_values_are_right() -> None:
    bench = Bench()
    bench.go(1)
    assert [bench.status(axis) for axis in IDS] == [DriveStatus.FAULT, DriveStatus.FAULT]
    bench.go(8)
    assert bench.asked == [(0, MOTOR), (1, MOTOR), (0, APPLICATION), (1, APPLICATION)]
    assert [bench.status(axis) for axis in IDS] == [0, 0]
    assert bench.host.problems == []


def test_each_drive_is_asked_in_the_name_of_an_id_of_its_own() -> None:
    bench = Bench(ask_as=17)
    first = bench.ask()
    assert first == [Frame(EXTENDED | 0x800, bytes((17, 0, MOTOR)))]
    bench.tick += 1
    for frame in bench.answer(first[0]):
        bench.host.decode(frame)
    assert bench.ask() == [Frame(EXTENDED | 0x801, bytes((18, 0, MOTOR)))]


def test_one_drive_is_asked_at_a_time_and_none_while_one_is_enabled() -> None:
    bench = Bench()
    assert len(bench.ask()) == 1
    assert [bench.ask() for _ in range(20)] == [[]] * 20, "the first has not answered"
    fresh = Bench()
    assert [fresh.ask(enable=1) for _ in range(100)] == [[]] * 100


def test_nothing_more_is_asked_of_drives_that_are_proved() -> None:
    bench = Bench()
    bench.go(9)
    del bench.asked[:]
    for _ in range(2000):
        assert bench.ask() == []
        bench.status(0), bench.status(1)


@pytest.mark.parametrize(("name", "value", "told"), [
    ("l_current_max", 0.2, "l_current_max = 0.2; expected 0.1592 to 0.161"),
    ("l_current_max", float("nan"), "l_current_max = nan; expected 0.1592 to 0.161"),
    ("l_current_min", -0.5, "l_current_min = -0.5; expected -0.161 to -0.1592"),
    ("l_current_max_scale", 5000, "l_current_max_scale = 0.5; expected 1"),
    ("timeout_msec", 1000, "timeout_msec = 1000; expected 10"),
    ("timeout_msec", 0, "timeout_msec = 0; expected 10"),
    ("timeout_brake_current", 3.0, "timeout_brake_current = 3; expected 0"),
    ("mcconf_signature", 1065524471, "signature of the motor configuration = 1065524471; expected 788332866"),
    ("appconf_signature", 486554156, "signature of the application configuration = 486554156; expected 2099347128"),
])  # fmt: skip
def test_a_difference_is_told_with_drive_name_value_and_range(name: str, value: float, told: str) -> None:
    bench = Bench()
    bench.values[1][name] = value
    bench.go(12)
    (problem,) = bench.host.problems
    assert problem.startswith(f"axis 1, VESC 1: {told}")
    assert [bench.status(axis) for axis in IDS] == [0, DriveStatus.FAULT]


def test_of_another_firmware_no_value_is_read() -> None:
    bench = Bench()
    bench.values[0] |= {"mcconf_signature": 1, "l_current_max": 99.0}
    bench.go(12)
    (problem,) = bench.host.problems
    assert "l_current_max" not in problem
    assert problem.endswith("its firmware has its values at other places than the rig file says")


def test_three_questions_without_an_answer_are_told() -> None:
    bench = Bench()
    asked = [frame.can_id & 0xFF for _ in range(200) for frame in bench.ask()]
    assert asked == [0, 1] * MOST_ASKED
    assert bench.host.problems == [
        f"axis {axis}, VESC {axis}: signature of the motor configuration was read back and gave no answer"
        for axis in IDS
    ]


def test_an_answer_is_waited_for_as_long_as_the_bus_needs_for_it() -> None:
    """81 frames of 160 bits at 1 Mbit/s are 13 ms: a slow bus, a fast loop."""
    for bitrate, period, least in ((1_000_000, PERIOD, 13), (250_000, PERIOD, 52), (1_000_000, MS // 2, 52)):
        reader = VescReader(VescBinding(motor_signature=1), IDS, bitrate, period)
        asked = [tick for tick in range(1, 1000) if reader.ask(tick)]
        assert asked[1] - asked[0] >= least + ANSWER_TICKS


def test_after_a_reset_all_is_asked_again() -> None:
    bench = Bench()
    bench.go(9)
    del bench.asked[:]
    bench.values[0]["timeout_msec"] = 500
    frames = bench.ask(reset=True)
    assert bench.status(0) == bench.status(1) == DriveStatus.FAULT
    for frame in bench.answer(frames[0]):
        bench.host.decode(frame)
    bench.go(12)
    assert set(bench.asked) == {(axis, number) for axis in IDS for number in (MOTOR, APPLICATION)}
    assert len(bench.host.problems) == 1
    assert "timeout_msec = 500" in bench.host.problems[0]


def test_a_reset_that_is_held_asks_once() -> None:
    bench = Bench()
    bench.go(9)
    for frame in bench.answer(bench.ask(reset=True)[0]):
        bench.host.decode(frame)
    for _ in range(12):
        for question in bench.ask(reset=True):
            for frame in bench.answer(question):
                bench.host.decode(frame)
    assert bench.status(0) == 0


def test_a_drive_that_was_silent_may_have_restarted_and_is_asked_again() -> None:
    bench = Bench()
    bench.go(9)
    assert [bench.status(axis) for axis in IDS] == [0, 0]
    for _ in range(60):  # of 2 ms
        bench.ask()
        bench.status(1)
    assert [bench.status(axis) for axis in IDS] == [DriveStatus.FAULT, 0]
    del bench.asked[:]
    bench.go(12)
    assert bench.asked == [(0, MOTOR), (0, APPLICATION)]
    assert bench.status(0) == 0


def test_answers_of_two_drives_that_come_together_are_not_mixed() -> None:
    """The first one's is late, so that the second has been asked already; their pieces come in turns."""
    bench = Bench()
    bench.values[1]["l_current_max"] = 0.5
    questions = []
    while len(questions) < 2:
        questions += bench.ask()
    late, prompt = (bench.answer(question) for question in questions)
    for pair in zip(late, prompt, strict=True):
        for frame in pair:
            assert bench.host.decode(frame) == ()
    assert [problem[:30] for problem in bench.host.problems] == ["axis 1, VESC 1: l_current_max "]
    bench.go(12)
    assert [bench.status(axis) for axis in IDS] == [0, DriveStatus.FAULT]


def test_a_lost_frame_costs_one_more_question_and_is_no_fault() -> None:
    bench = Bench()
    (question,) = bench.ask()
    frames = bench.answer(question)
    assert {bench.host.decode(frame) for frame in frames[:20] + frames[21:]} == {()}
    assert bench.host.problems == []
    bench.go(80)
    assert bench.asked.count((0, MOTOR)) == 2
    assert [bench.status(axis) for axis in IDS] == [0, 0]


def test_a_wrong_checksum_is_counted_as_a_damaged_frame() -> None:
    bench = Bench()
    (question,) = bench.ask()
    frames = bench.answer(question)
    end = frames[-1]
    spoilt = end._replace(data=end.data[:-1] + bytes((end.data[-1] ^ 1,)))
    assert [bench.host.decode(frame) for frame in [*frames[:-1], spoilt]] == [()] * (len(frames) - 1) + [
        Reject.BAD_CHECKSUM
    ]
    assert bench.status(0) == DriveStatus.FAULT


def test_a_foreign_drives_answer_is_of_no_use() -> None:
    bench = Bench()
    (question,) = bench.ask()
    packet = theirs.configuration(MOTOR, RIGHT | {"l_current_max": 9.0})
    outcomes = [bench.host.decode(frame) for frame in theirs.answer(packet, 77, question.data[0])]
    assert outcomes == [()] * (len(outcomes) - 1) + [Reject.SERVICE]
    bench.go(80)
    assert bench.host.problems == []
    assert [bench.status(axis) for axis in IDS] == [0, 0]


def test_frames_that_nobody_asked_for_are_counted() -> None:
    """Beyond what one late answer may still bring."""
    bench = Bench()
    bench.go(9)
    for asker, why in ((200, Reject.SERVICE), (99, Reject.UNKNOWN_ID)):
        frames = theirs.answer(theirs.configuration(MOTOR, RIGHT), 0, asker)
        outcomes = [bench.host.decode(frame) for frame in frames * 3]
        assert outcomes[-len(frames) :] == [why] * len(frames)
    assert bench.status(0) == 0


def test_a_node_that_goes_on_for_ever_is_told_after_two_answers_of_frames() -> None:
    bench = Bench()
    for _ in range(9):
        bench.ask()
    piece = Frame(EXTENDED | 0x500 | 200, bytes(8))
    longest = sum(MOST_FRAMES.values())
    assert [bench.host.decode(piece) for _ in range(500)] == [()] * 2 * longest + [Reject.SERVICE] * (500 - 2 * longest)


def test_the_rest_of_an_answer_to_an_earlier_process_is_no_flood() -> None:
    bench = Bench()
    rest = theirs.answer(theirs.configuration(MOTOR, RIGHT), 0, 200)[20:]
    assert {bench.host.decode(frame) for frame in rest[:30]} == {()}
    (question,) = bench.ask()
    assert {bench.host.decode(frame) for frame in [*rest[30:], *bench.answer(question)]} == {()}
    bench.go(8)
    assert bench.host.problems == []
    assert [bench.status(axis) for axis in IDS] == [0, 0]


def test_an_answer_to_a_question_that_was_damaged_on_its_way_is_no_flood_and_is_asked_for_again() -> None:
    bench = Bench()
    (question,) = bench.ask()
    for asker in (93, 201):
        spoilt = question._replace(data=bytes((asker,)) + question.data[1:])
        outcomes = [bench.host.decode(frame) for frame in bench.answer(spoilt)]
        assert set(outcomes[:-1]) == {()}
    bench.go(80)
    assert bench.host.problems == []
    assert [bench.status(axis) for axis in IDS] == [0, 0]


def test_who_only_listens_asks_nobody_and_calls_nobody_faulty() -> None:
    bench = Bench()
    assert bench.status(0) == 0
    frames = theirs.answer(theirs.configuration(MOTOR, RIGHT), 0, 200)
    assert bench.host.decode((frames * 3)[-1]) in ((), Reject.SERVICE)
    assert bench.host.problems == []
    assert bench.status(0) == 0


def test_a_question_of_another_tool_is_no_foreign_command() -> None:
    bench = Bench()
    question = Frame(EXTENDED | 0x800, bytes((5, 0, MOTOR)))
    assert bench.host.decode(question) is Reject.OWN_ECHO
    assert all(question.can_id not in ids for ids in own_ids(bench.host))


def test_every_frame_that_is_said_and_heard_is_among_the_messages() -> None:
    bench = Bench()
    listed = {message.can_id: message for message in bench.host.messages(PERIOD) if message.at_rest}
    (question,) = bench.ask()
    assert question.can_id in listed
    answers = theirs.answer(bytes(theirs.SIZES[MOTOR]), 0, 200)
    assert {frame.can_id for frame in answers} <= set(listed)
    assert [listed[EXTENDED | command << 8 | 200].at_rest for command in MOST_FRAMES] == list(MOST_FRAMES.values())


# what it reads --------------------------------------------------------------------------------------------------------


def test_values_stand_where_an_emulated_drive_of_its_makers_firmware_has_them() -> None:
    values: dict[str, float] = RIGHT | {"motor_type": 2, "sensor_mode": 3, "timeout_brake_current": 1.5}
    read = dict(PLACES) | {
        "mcconf_signature": SIGNATURE["motor"], "appconf_signature": SIGNATURE["application"],
    }  # fmt: skip
    numbers = {"motor": MOTOR, "application": APPLICATION}
    for name, place in read.items():
        told = theirs.configuration(numbers[place.configuration], values)[1:]
        assert value_in(told, place) == pytest.approx(values[name], rel=1e-7), name


def test_a_value_beyond_the_end_is_none() -> None:
    assert value_in(bytes(11), Place("motor", 8, "float32")) != value_in(bytes(11), Place("motor", 8, "float32"))
    assert value_in(bytes(12), Place("motor", 8, "float32")) == 0.0
    assert value_in(b"\xff\xfe", Place("motor", 0, "int16", 0.5)) == -1.0


def value(**changes: Any) -> dict[str, Any]:
    return {"value": "l_current_max", "least": 1.0, "most": 2.0} | changes


@pytest.mark.parametrize(("changes", "says"), [
    ({"ask_as": 1}, "ask_as = 1: 2 axes are asked as VESC IDs 1 to 2; 1 is a drive's"),
    ({"ask_as": 254}, "ask_as = 254: 2 axes are asked as VESC IDs 254 to 255; 254 is the greatest"),
    ({"values": [value(value="l_current_maxi")]}, r"values\[0\]: value = 'l_current_maxi' needs `at`; without it"),
    ({"values": [value(type="int16")]}, r"values\[0\].type: where l_current_max stands is known"),
    ({"values": [value(least=3.0)]}, r"values\[0\]: least = 3 is above most = 2"),
    ({"values": [value(axis=2)]}, r"values\[0\].axis = 2: 0 to 1 are there"),
    ({"motor_signature": 0}, r"values\[0\]: l_current_max is in the motor configuration, so bus.dbc.vesc.motor_sig"),
    ({"values": [], "motor_signature": 0, "application_signature": 0}, "else nothing is asked"),
])  # fmt: skip
def test_a_table_that_cannot_be_is_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(LayoutError, match=says):
        host_of(**changes)


def test_torques_that_go_to_no_vesc_are_refused() -> None:
    table: dict[str, Any] = tomllib.loads((RIGS / "odrive.toml").read_text())["bus"]
    table["dbc"]["vesc"] = {"motor_signature": 1}
    with pytest.raises(LayoutError, match="Set_Input_Torque0, which has a torque, is no CAN_PACKET_SET_CURRENT"):
        host_protocol(BusConfig.model_validate(table), 2, [0.008, 0.008], RIGS, PERIOD)


def test_a_value_of_one_axis_is_asked_of_its_drive_alone_and_a_signature_alone_is_asked_for() -> None:
    bench = Bench(values=[value(axis=1, least=9.0, most=9.0)], application_signature=0)
    bench.go(12)
    assert bench.asked[:2] == [(0, MOTOR), (1, MOTOR)]
    assert len(bench.host.problems) == 1
    assert bench.host.problems[0].startswith("axis 1, VESC 1: l_current_max = 0.16; expected 9")


def test_a_segment_asks_its_own_drives_for_their_values() -> None:
    table: dict[str, Any] = tomllib.loads((RIGS / "vesc.toml").read_text())["bus"]
    table["dbc"]["vesc"]["values"] = [value(axis=0), value(axis=1), value(least=0.0)]
    table["segments"] = [{"channel": "can0", "axes": ["x"]}, {"channel": "can1", "axes": ["y"]}]
    of_segment = cut(BusConfig.model_validate(table), 2)
    second: Any = of_segment(range(1, 2))["dbc"]
    assert [(item.axis, item.least) for item in second.vesc.values] == [(0, 1.0), (None, 0.0)]
    assert dbc_keys(bus_of()).dbc is not None
