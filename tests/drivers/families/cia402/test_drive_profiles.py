"""Drives as their makers describe them: planned from an EDS, configured, enabled, refused with the object that decides.

The drives' SDO server is the canopen package's; their EDS files are made from stated facts (tests/support).
"""

import contextlib
from collections.abc import Mapping
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusConfig, Wiring
from drivers.eds.reader import Eds, EdsError, read_eds
from drivers.families.cia402 import cia301
from drivers.families.cia402.config import Cia402Config, ObjectValue
from drivers.families.cia402.drive_plan import Axis, DrivePlan
from drivers.families.cia402.host import Cia402Host
from drivers.families.cia402.node import Phase
from drivers.families.cia402.profile import plan_drives
from drivers.families.cia402.sdo import Progress, Step, Transfer
from drivers.frame import Frame
from drivers.protocols import LayoutError
from drivers.protocols.base import Command, DriveStatus, Reject, Sample
from tests.support.foreign_drive import CST_DRIVE, I16, U8, U32, Fact, ForeignDrive, eds_text

Facts = Mapping[tuple[int, int], Fact]
MS = 1_000_000


def without(*indices: int) -> dict[tuple[int, int], Fact]:
    return {key: fact for key, fact in CST_DRIVE.items() if key[0] not in indices}


def plan(facts: Facts, *, axes: int = 1, dummies: tuple[int, ...] = (), **settings: object) -> DrivePlan:
    text = eds_text(facts, dummies)
    places = [Axis(number, axes, number + 1, 1, 0.5, MS, 100) for number in range(axes)]
    drives = [Eds(text, number + 1) for number in range(axes)]
    return plan_drives(drives, places, Cia402Config.model_validate({"eds": ["made.eds"], **settings}))[0]


def written(made: DrivePlan) -> list[str]:
    return [f"{step.object_index:04X}:{step.subindex}" for step in made.steps if step.size]


class Rig:
    """A host and foreign drives; frames take no time."""

    def __init__(self, tmp_path: Path, facts: Facts = CST_DRIVE, nodes: tuple[int, ...] = (3, 9), **settings: object):
        (tmp_path / "made.eds").write_text(eds_text(facts))
        table = {"eds": ["made.eds"], "nodes": list(nodes), **settings}
        bus = BusConfig(protocol="cia402", cia402=Cia402Config.model_validate(table))
        self.host = Cia402Host(Wiring(bus, len(nodes), [0.5] * len(nodes), MS, tmp_path))
        self.drives = [ForeignDrive(facts, node) for node in nodes]
        self.heard: list[Frame] = []
        self.outcomes: list[Sample | Reject] = []
        self.sent: list[Frame] = []
        self.enable, self.force = 0, [0.0] * len(nodes)

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.outcomes = [self.host.decode(frame) for frame in self.heard]
            self.sent = self.host.encode(Command(0, self.force, self.enable, False))
            self.heard = [answer for frame in self.sent for drive in self.drives for answer in drive.on_frame(frame)]

    def bring_up(self) -> None:
        for _ in range(400):
            self.tick()
            if all(node.phase is Phase.RUNNING for node in self.host.nodes):
                self.tick(10)
                return
        raise AssertionError([(node.phase, node.problem) for node in self.host.nodes])


# the plan -------------------------------------------------------------------------------------------------------------


def test_a_cst_drive_without_sync_counter_and_dummies_gets_an_rpdo_of_its_own() -> None:
    made = plan(CST_DRIVE, axes=2)
    assert (made.usable, made.mode, made.shared, made.counter) == (True, "CST", False, False)
    assert "1019:0" not in written(made)
    assert "1014:0" not in written(made)
    assert made.emcy_id == 0x81  # read-only: taken from where the drive sends it
    assert "1801:1" in written(made)  # a second TPDO that is on by default is switched off
    assert {item.step.object_index: item.skipped for item in made.planned if item.skipped} == {
        0x1014: "is read-only",
        0x1006: "is not in the EDS",
        0x60C2: "is not in the EDS",
        0x6072: "is not in the EDS",
        **dict.fromkeys((0x1029, 0x6007, 0x605B, 0x605C, 0x605E), "is not in the EDS"),
    }
    tpdo = next(
        item.step.value for item in made.planned if item.step.object_index == 0x1800 and item.step.subindex == 1
    )
    assert tpdo == 0xC0000181  # the bit for no remote frames stays, which many drives insist on


def test_until_6076h_is_read_no_torque_is_sent_whatever_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "made.eds").write_text(eds_text(CST_DRIVE))
    table = {"eds": ["made.eds"], "nodes": [1, 2]}
    bus = BusConfig.model_validate({"protocol": "cia402", "cia402": table})
    host = Cia402Host(Wiring(bus, 2, [5.0, 5.0], MS, tmp_path))
    for tick in range(50):
        told = host.encode(Command(tick, [5.0, -5.0], 0b11, False))
        assert [frame.data[-2:] for frame in told if frame.can_id in (0x201, 0x202)] == [bytes(2)] * 2


def test_6076h_is_read_and_never_written_unless_the_rig_asks() -> None:
    assert "6076:0" not in written(plan(CST_DRIVE))
    stated = plan(CST_DRIVE, rated_torque=[0.5])
    assert stated.unit == 500
    assert Step(0x6076, 0, 500, mask=0xFFFFFFFF) in stated.steps  # a drive that says otherwise is refused
    assert "6076:0" in written(plan(CST_DRIVE, rated_torque=[0.5], write_rated_torque=True))
    read_only = plan({**CST_DRIVE, (0x6076, 0): Fact(U32, "ro")}, write_rated_torque=True)
    assert [reason.object for reason in read_only.reasons] == ["6076h:00"]


def test_interpolation_period_and_stated_objects_are_written_where_they_exist() -> None:
    facts = {**CST_DRIVE, (0x60C2, 1): Fact(U8), (0x60C2, 2): Fact(0x2), (0x1029, 1): Fact(U8)}
    made = plan(facts, write=[ObjectValue(object="1029h:01", value=1)])
    steps = {(step.object_index, step.subindex): step for step in made.steps if step.size}
    assert (steps[0x60C2, 1].value, steps[0x60C2, 2].value) == (1, 0xFD)  # 1 * 10^-3 s
    assert steps[0x1029, 1].required
    refused = plan(CST_DRIVE, write=[ObjectValue(object="1029h:01", value=1)])
    assert [reason.object for reason in refused.reasons] == ["1029h:01"]  # a key that would be ignored is an error


OPTIONS = {(0x1029, 1): 0, (0x6007, 0): 2, (0x605B, 0): 0, (0x605C, 0): 0, (0x605E, 0): 0}


def test_a_drive_is_told_to_let_go_by_itself_unless_the_rig_says_otherwise() -> None:
    facts = (
        CST_DRIVE
        | {(0x1029, 1): Fact(U8, "rw", "1")}
        | {key: Fact(I16, "rw", "1") for key in OPTIONS if key[0] > 0x2000}
    )
    made = plan(facts)
    assert OPTIONS.items() <= {(s.object_index, s.subindex): s.value for s in made.steps if s.size}.items()
    assert not any(step.required for step in made.steps if (step.object_index, step.subindex) in OPTIONS)
    stated = plan(facts, write=[ObjectValue(object="605Ch", value=1)])
    assert [s.value for s in stated.steps if s.object_index == 0x605C and s.size] == [1]
    kept = plan(facts, stop_options="keep")
    assert not OPTIONS.keys() & {(s.object_index, s.subindex) for s in kept.steps}


def test_a_drive_that_turns_signs_round_is_refused_unless_the_rig_says_so(tmp_path: Path) -> None:
    facts = CST_DRIVE | {(0x607E, 0): Fact(U8, "rw", "0")}
    assert Step(0x607E, 0, 0, mask=0xFF, width=1) in plan(facts).steps
    stated = plan(facts, write=[ObjectValue(object="607Eh", value=0x80)])
    assert [(s.size, s.value, s.proof) for s in stated.steps if s.object_index == 0x607E] == [
        (1, 0x80, False),
        (0, 0x80, True),
    ]


@pytest.mark.parametrize(
    ("facts", "decides", "says"),
    [
        ({**CST_DRIVE, (0x6502, 0): Fact(U32, "ro", "0x1ED")}, "6502h:00", "CSP, CSV, not CST"),
        ({**CST_DRIVE, (0x1000, 0): Fact(U32, "ro", "0x00020191")}, "1000h:00", "profile 401"),
        (without(0x6071), "6071h:00", "not in the EDS"),
        ({**CST_DRIVE, (0x6071, 0): Fact(I16, "rw", "0", False)}, "6071h:00", "cannot be mapped"),
        ({**CST_DRIVE, (0x6064, 0): Fact(I16, "ro", "0", True)}, "6064h:00", "16 bits"),
        ({**CST_DRIVE, (0x6060, 0): Fact(0x2, "ro", "1")}, "6060h:00", "read-only"),
        ({**CST_DRIVE, (0x1A00, 0): Fact(U8, "ro", "2")}, "1A00h:00", "TPDO 1 cannot be mapped"),
        (without(0x6076), "6076h:00", "rated_torque"),
        (without(0x1800), "1800h:01", "not in the EDS"),
    ],
)
def test_a_drive_that_cannot_be_used_is_refused_with_the_object_that_decides(
    facts: Facts, decides: str, says: str
) -> None:
    made = plan(facts)
    assert not made.usable
    assert made.mode == ""
    assert any(reason.object == decides and says in reason.text for reason in made.reasons), made.reasons


def test_a_read_only_object_that_has_the_value_is_no_obstacle() -> None:
    facts = dict(CST_DRIVE)
    for place, value in enumerate(("2", "0x60640020", "0x60410010")):
        facts[0x1A00, place] = Fact(U32 if place else U8, "const", value)
    facts[0x6060, 0] = Fact(0x2, "ro", "10")
    made = plan(facts)
    assert made.usable
    assert "1A00:0" not in written(made)


def test_drives_with_dummy_mapping_and_counter_share_one_rpdo() -> None:
    facts = dict(CST_DRIVE)
    for more in (0x1401, 0x1402):
        facts |= {(more + (k[0] - 0x1400), k[1]): f for k, f in CST_DRIVE.items() if k[0] in (0x1400, 0x1600)}
    facts |= {(0x1006, 0): Fact(U32), (0x1019, 0): Fact(U8)}
    assert (plan(facts, axes=3, dummies=(3, 6)).shared, plan(facts, axes=3, dummies=(3, 6)).counter) == (True, True)
    assert not plan(facts, axes=3).shared
    forced = plan(facts, axes=3, rpdo="shared")
    assert {reason.object for reason in forced.reasons} == {"0003h:00", "0006h:00"}


# files from the field -------------------------------------------------------------------------------------------------


def test_what_is_broken_and_not_used_is_a_warning(tmp_path: Path) -> None:
    text = eds_text(CST_DRIVE).replace("ParameterName=value 1001h 0", "stray line\nParameterName=Größe")
    text += "[2000]\nParameterName=x\nObjectType=0x7\nDataType=oops\nAccessType=rw\n"
    text += "[2001]\nAccessType=maybe\nDataType=5\n"
    text += "[2002]\nObjectType=0x8\nDataType=0x0007\nAccessType=rw\nCompactSubObj=3\nDefaultValue=7\n"
    text += "[6041]\nPDOMapping=1\n"
    path = tmp_path / "odd.eds"
    path.write_bytes(text.encode("latin-1"))
    eds = read_eds(path, 5)
    assert eds.value(0x1014) == 0x85
    assert [eds.value(0x2002, at) for at in range(4)] == [3, 7, 7, 7]
    assert {key[0] for key in eds.broken} == {0x2000, 0x2001}
    assert any("stray line" in warning for warning in eds.warnings)
    made = plan_drives([eds], [Axis(0, 1, 5, 5, None, MS, 100)], Cia402Config(eds=["odd.eds"]))[0]
    assert made.usable
    assert any("2000h" in warning for warning in made.warnings)


def test_a_broken_entry_that_is_needed_refuses_and_says_why() -> None:
    text = eds_text(without(0x6071)) + "[6071]\nObjectType=0x7\nDataType=torque\nAccessType=rw\nPDOMapping=1\n"
    made = plan_drives([Eds(text, 1)], [Axis(0, 1, 1, 1, None, MS, 100)], Cia402Config(eds=["x"]))[0]
    assert [(r.object, r.text) for r in made.reasons] == [
        ("6071h:00", "is broken in the EDS ('torque' is no number)"),
    ]


@given(st.text(max_size=400))
def test_no_text_makes_the_reader_fail_in_another_way(text: str) -> None:
    with contextlib.suppress(EdsError):
        assert Eds("[1000]\n" + text, 1).entries


# on the bus -----------------------------------------------------------------------------------------------------------


def test_a_foreign_drive_is_configured_enabled_and_gets_its_torque(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.bring_up()
    rig.enable, rig.force = 0b11, [0.1, -0.25]
    rig.tick(20)
    assert [drive.torque for drive in rig.drives] == [200, -500]  # thousandths of 0.5 N m, as 6076h says
    samples = [outcome for outcome in rig.outcomes if isinstance(outcome, Sample)]
    assert [(s.axis, s.position, s.status) for s in samples] == [
        (0, 3000, DriveStatus.ENABLED),
        (1, 9000, DriveStatus.ENABLED),
    ]
    rig.enable = 0
    rig.tick(2)
    assert [drive.torque for drive in rig.drives] == [0, 0]
    assert [frame.can_id for frame in rig.sent[:3]] == [0x203, 0x209, 0x080]
    assert rig.sent[2].data == b""  # no counter: the drives have no 1019h


def test_a_drive_whose_6076h_is_not_what_the_rig_states_is_refused(tmp_path: Path) -> None:
    rig = Rig(tmp_path, rated_torque=[0.4, 0.5])
    rig.tick(200)
    assert [node.phase for node in rig.host.nodes] == [Phase.REFUSED, Phase.RUNNING]
    assert rig.host.problems == ["node 3: 6076h = 0x1f4; expected 0x190 in the bits 0xffffffff"]


def test_a_drive_with_a_rated_torque_of_zero_is_refused(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.drives[0].node.object_dictionary[0x6076].default = 0
    rig.tick(200)
    assert rig.host.nodes[0].phase is Phase.REFUSED
    assert "6076h:00 = 0 mN m" in rig.host.problems[0]


def test_a_drive_that_boots_late_or_twice_is_configured_anew(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    late = rig.drives.pop()
    rig.tick(700)  # it is not there yet
    rig.drives.append(late)
    rig.heard += late.boot()
    rig.bring_up()
    rig.enable, rig.force = 0b11, [0.1, 0.1]
    rig.tick(20)
    rig.heard += late.boot()
    rig.tick(2)
    assert rig.host.nodes[1].phase is Phase.CONFIGURE
    rig.enable = 0
    rig.bring_up()
    rig.enable = 0b11
    rig.tick(20)
    assert late.torque == 200


def test_an_autostarting_drive_is_neither_reset_nor_started(tmp_path: Path) -> None:
    rig = Rig(tmp_path, start="autostart")
    for drive in rig.drives:
        drive.operational = True
    seen = []
    for _ in range(200):
        rig.tick()
        seen += [frame for frame in rig.sent if frame.can_id == cia301.NMT_ID]
    assert seen == []
    assert all(node.phase is Phase.RUNNING for node in rig.host.nodes)


def test_answers_to_another_client_are_service_traffic(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.bring_up()
    for index in range(0x2000, 0x2020):
        request = Frame(cia301.SDO_REQUEST_ID + 3, cia301.SDO.pack(0x40, index, 0, bytes(4)))
        answers = rig.drives[0].on_frame(request)
        assert [rig.host.decode(answer) for answer in answers] == [Reject.SERVICE]
    rig.tick(5)
    assert all(node.phase is Phase.RUNNING for node in rig.host.nodes)


@pytest.mark.parametrize(
    ("nodes", "settings", "says"),
    [
        ((3, 3), {}, "different numbers"),
        ((3, 9), {"rated_torque": [1.0]}, "rated_torque has 1 entries for 2 axes"),
        ((3, 9), {"eds": ["made.eds", "made.eds", "made.eds"]}, "eds has 3"),
        ((3, 9), {"eds": ["missing.eds"]}, "missing.eds"),
        ((3, 9), {"rated_torque": [0.001, 0.5]}, "6071h:00 can say 32.767 times"),
    ],
)
def test_a_table_that_cannot_hold_is_refused_before_any_bus(
    tmp_path: Path, nodes: tuple[int, ...], settings: dict[str, object], says: str
) -> None:
    with pytest.raises(LayoutError, match=says):
        Rig(tmp_path, nodes=nodes, **settings)


def test_the_schedule_follows_the_mapping(tmp_path: Path) -> None:
    messages = Rig(tmp_path).host.messages(MS)
    assert [(m.name, m.can_id, m.length) for m in messages if m.sender == "host"] == [
        ("command 0", 0x203, 4),
        ("command 1", 0x209, 4),
        ("sync", 0x080, 0),
        ("service", 0x609, 8),
    ]
    assert {m.can_id for m in messages if m.name.startswith("emergency")} == {0x83, 0x89}
    assert [(m.name, m.period_ns, m.deadline_ns) for m in messages if m.period_ns != MS or m.deadline_ns != MS] == [
        ("service", 2 * MS, 2 * MS),
        ("answer", 2 * MS, 100 * MS),
        *((f"{what} {axis}", 100 * MS, 100 * MS) for what in ("emergency", "heartbeat") for axis in (0, 1)),
    ]


# SDO answers ----------------------------------------------------------------------------------------------------------

READ = Step(0x6502, 0, 0, width=2)


def test_requests_are_those_of_the_standard_byte_for_byte() -> None:
    assert Transfer(READ).request() == bytes.fromhex("40 02 65 00 00 00 00 00")
    for size, command in ((1, "2f"), (2, "2b"), (3, "27"), (4, "23")):
        written = Transfer(Step(0x1017, 2, 0x5A, size)).request()
        assert written == bytes.fromhex(f"{command} 17 10 02 5a 00 00 00")
    assert Transfer(READ).abort(cia301.Abort.TIMEOUT) == bytes.fromhex("80 02 65 00 00 00 04 05")
    segmented = Transfer(READ)
    assert segmented.answer(bytes.fromhex("41 02 65 00 08 00 00 00")) is Progress.CONTINUE
    assert segmented.request() == bytes.fromhex("60 00 00 00 00 00 00 00")
    assert segmented.answer(bytes.fromhex("00 01 02 03 04 05 06 07")) is Progress.CONTINUE
    assert segmented.request() == bytes.fromhex("70 00 00 00 00 00 00 00")


@pytest.mark.parametrize(("command", "value"), [(0x43, 0x44332211), (0x4B, 0x2211), (0x4F, 0x11), (0x42, 0x2211)])
def test_expedited_answers_with_and_without_a_size(command: int, value: int) -> None:
    transfer = Transfer(READ)
    assert transfer.answer(bytes((command, 0x02, 0x65, 0, 0x11, 0x22, 0x33, 0x44))) is Progress.DONE
    assert transfer.value == value


@given(st.integers(0, 2**56 - 1), st.booleans())
def test_segmented_answers_of_any_size(value: int, size_told: bool) -> None:
    content = value.to_bytes(8, "little")
    transfer = Transfer(READ)
    initiate = bytes((0x41 if size_told else 0x40, 0x02, 0x65, 0)) + (len(content) * size_told).to_bytes(4, "little")
    assert transfer.answer(initiate) is Progress.CONTINUE
    assert transfer.request()[0] == 0x60
    assert transfer.answer(b"\0" + content[:7]) is Progress.CONTINUE
    assert transfer.request()[0] == 0x70
    assert transfer.answer(b"\0" + content[:7]) is Progress.FOREIGN  # the first segment again: wrong toggle bit
    assert transfer.answer(bytes((0x10 | (7 - 1) << 1 | 1,)) + content[7:] + bytes(6)) is Progress.DONE
    assert transfer.value == value


def test_a_string_where_a_number_is_due_is_given_up() -> None:
    transfer = Transfer(READ)
    transfer.answer(bytes((0x41, 0x02, 0x65, 0, 20, 0, 0, 0)))
    assert transfer.answer(b"\0" + b"abcdefg") is Progress.CONTINUE
    assert transfer.answer(b"\x10" + b"abcdefg") is Progress.ABORTED


def test_a_step_that_may_fail_is_noted_and_left_out(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    del rig.drives[0].node.object_dictionary.indices[0x1017]  # the drive has less than its EDS says
    rig.bring_up()
    aborted = [answer for answer in rig.host.nodes[0].answers if "aborted" in answer.text]
    assert [(a.step.object_index, a.text) for a in aborted] == [(0x1017, "aborted with 0x06020000 (no object)")]
