"""Any DBC file: random ones against cantools' own reading of them; pages, requests, start and stop."""

import tempfile
from pathlib import Path
from typing import Any

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusConfig
from drivers.frame import FD, REMOTE, Frame
from drivers.protocols import LayoutError, device_protocol, host_protocol
from drivers.protocols.base import Command, DriveStatus, Reject, Sample
from drivers.protocols.dbc_codec import LARGEST
from hil.cycle.state_machine import State
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from tests.support.bought_drives import shipped
from tests.support.paged_dbc import LONG_BESIDE, TEXT, bound, pair
from tests.support.random_dbc import NESTED_IN, Drawn, Message, dbc_files

MS = 1_000_000
RATED = 5.0


def ends(text: str, binding: dict[str, Any], n_axes: int = 2) -> tuple[Any, Any]:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "any.dbc").write_text(text, encoding="cp1252")
        bus = BusConfig.model_validate({"protocol": "dbc:any.dbc", "dbc": binding})
        rated = [RATED] * n_axes
        return host_protocol(bus, n_axes, rated, Path(folder), MS), device_protocol(bus, n_axes, rated, Path(folder))


def read_by_cantools(message: Message, data: bytes) -> dict[str, Any]:
    """The message alone, as the package reads it; values of the file's units. Empty for a page that is not there."""
    text = 'VERSION ""\n\nBU_: Host Drive\n\n' + message.text + "\n" + message.about
    (read,) = cantools.database.load_string(text, "dbc").messages
    try:
        return dict(read.decode(data, decode_choices=False))
    except cantools.database.DecodeError:
        assert message.multiplexed
        return {}


def as_list(outcome: Any) -> list[Sample]:
    return list(outcome) if isinstance(outcome, tuple) else [outcome] if isinstance(outcome, Sample) else []


@pytest.mark.long
@given(drawn=dbc_files(), data=st.binary(min_size=64, max_size=64))
def test_positions_are_what_cantools_reads(drawn: Drawn, data: bytes) -> None:
    host, _ = ends(drawn.text, drawn.binding, drawn.n_axes)
    for message in dict.fromkeys(message for message, _ in drawn.position):
        head = bytes((data[0] % 4,)) if not message.nested else bytes((NESTED_IN - data[0] // 128, data[1] % 8))
        payload = ((head if message.multiplexed else b"") + data)[: message.length]
        read = read_by_cantools(message, payload)
        expected = {}
        for axis, (owner, signal) in enumerate(drawn.position):
            if owner is message and signal.name in read:
                expected[axis] = 100.0 * read[signal.name]
        outcome = host.decode(Frame(message.can_id, payload, FD if message.length > 8 else 0, MS))
        if not expected:
            assert outcome is Reject.SERVICE  # a page that nobody binds
        elif all(-(2.0**53) <= counts <= 2.0**53 for counts in expected.values()):
            assert {s.axis: s.position for s in as_list(outcome)} == {
                a: pytest.approx(c, abs=1) for a, c in expected.items()
            }
        else:
            assert outcome is Reject.INVALID_VALUE


@pytest.mark.long
@given(drawn=dbc_files(), share=st.lists(st.floats(-1, 1), min_size=3, max_size=3), counts=st.integers(-900, 900))
def test_torques_are_what_cantools_reads_and_a_drive_hears(drawn: Drawn, share: list[float], counts: int) -> None:
    host, device = ends(drawn.text, drawn.binding, drawn.n_axes)
    force = [RATED * part for part in share[: drawn.n_axes]]
    frames = host.encode(Command(0, force, 0b111, False))
    assert len(frames) == len({(m.can_id, s.page) for m, s in drawn.torque})
    length_of = {m.can_id: m.length for m, _ in drawn.torque}
    assert all((len(f.data), bool(f.flags & FD)) == (length_of[f.can_id], len(f.data) > 8) for f in frames)
    heard = [device.decode_command(frame) for frame in frames]
    (command,) = [outcome for outcome in heard if isinstance(outcome, Command)]
    assert heard[-1] is command
    for axis, (message, signal) in enumerate(drawn.torque):
        told = [read_by_cantools(message, f.data) for f in frames if f.can_id == message.can_id]
        (physical,) = [values[signal.name] for values in told if signal.name in values]
        scale = drawn.binding["torque"][axis]["scale"]
        step = 1e-6 if signal.is_float else 0.51 * scale * signal.factor
        assert scale * physical == pytest.approx(force[axis], abs=step)
        assert command.force[axis] == pytest.approx(force[axis], abs=step)
    samples = [Sample(axis, 100 * (counts + axis), 0, -1, 0) for axis in range(drawn.n_axes)]
    answers = [frame for sample in samples for frame in device.frames_of(sample)]
    assert len(answers) == len({(m.can_id, s.page) for m, s in drawn.position})
    heard_samples = [sample for frame in answers for sample in as_list(host.decode(frame))]
    assert sorted(s.axis for s in heard_samples) == list(range(drawn.n_axes))


@pytest.mark.long
@given(drawn=dbc_files())
def test_what_nobody_binds_is_a_warning(drawn: Drawn) -> None:
    host, _ = ends(drawn.text, drawn.binding, drawn.n_axes)
    longer = any(message.length > 8 for message, _ in [*drawn.position, *drawn.torque])
    assert [("taken as CAN FD" in warning) for warning in host.warnings].count(True) == longer
    assert len(host.warnings) > longer if "Overlapping" in drawn.text else len(host.warnings) == longer
    if "Diagnostics" in drawn.text:
        assert "read as far as it is used" in host.warnings[-1]


@pytest.mark.long
@given(drawn=dbc_files(), damage=st.text(max_size=60))
def test_nor_does_any_rubbish_between_statements_matter(drawn: Drawn, damage: str) -> None:
    rubbish = "".join(letter for letter in damage if letter not in '"' and letter.isprintable())
    text = drawn.text + f"\n\nBO_TX_BU_ {rubbish.encode('cp1252', 'replace').decode('cp1252')}\n"
    host, _ = ends(text, drawn.binding, drawn.n_axes)
    assert len(host.encode(Command(0, [0.0] * drawn.n_axes, 0, False))) >= 1


def test_a_file_of_many_messages_is_read_as_far_as_it_is_used() -> None:
    many = "".join(
        f'BO_ {number} Message{number}: 8 X\n SG_ Signal : 0|8@1+ (1,0) [0|0] "" Y\n\n'
        for number in range(100_000, 116_000)
    )
    assert len(many) > LARGEST
    host, _ = ends(TEXT + many, bound())
    assert "read as far as it is used" in host.warnings[0]


@pytest.mark.parametrize(("broken", "told_one_by_one"), [(5, 5), (6, 5), (9, 5)])
def test_of_many_broken_messages_that_nobody_binds_the_first_are_named(broken: int, told_one_by_one: int) -> None:
    overlapping = "".join(
        f'BO_ {number} Broken{number}: 8 X\n SG_ A : 0|16@1+ (1,0) [0|0] "" Y\n SG_ B : 8|16@1+ (1,0) [0|0] "" Y\n\n'
        for number in range(900, 900 + broken)
    )
    host, _ = ends(TEXT + overlapping, bound())
    named = [warning for warning in host.warnings if "message Broken" in warning]
    assert [f"message Broken{900 + k}" in line for k, line in enumerate(named)] == [True] * told_one_by_one
    rest = [warning for warning in host.warnings if warning not in named]
    left = broken - told_one_by_one
    assert [f": {left} more messages that are not used" in line for line in rest] == [True] * (left > 0)


# pages of one identifier, as many motors have them: the first byte is the command ------------------------------------


def said(frames: list[Frame]) -> list[tuple[int, int]]:
    return [
        (frame.can_id & 0x7FF, frame.data[0] if frame.data else -1) for frame in frames if not frame.can_id & REMOTE
    ]


TORQUES = [(0x160, 161), (0x161, 161)]


def test_start_stop_periodic_and_constant_frames_go_out_when_they_are_due() -> None:
    host, _ = ends(TEXT, bound())
    off, on = Command(0, [0.0, 0.0], 0, False), Command(0, [1.0, 0.0], 0b01, False)
    first = host.encode(off)
    assert sorted(said(first)[:4]) == [(0x160, 162), (0x161, 162), (0x603, -1), (0x604, 1)]
    assert said(first)[4:] == [(0x160, 0x81), (0x161, 0x81), *TORQUES]
    assert said(host.encode(off)) == TORQUES
    assert said(host.encode(on))[-3:] == [(0x160, 0x88), *TORQUES]  # whatever a drive may have forgotten goes before
    assert said(host.encode(on)) == TORQUES
    assert said(host.encode(on)) == [(0x604, 1), *TORQUES]  # the fifth tick
    assert said(host.encode(off)) == [(0x160, 0x81), *TORQUES]


@pytest.mark.parametrize("each_its_bit", [True, False])
@pytest.mark.parametrize("enable", range(4))
def test_one_signal_enables_the_axes_bit_by_bit_or_all_of_them(each_its_bit: bool, enable: int) -> None:
    """Which of the two: values for on and off are one switch for all."""
    one = {"message": "Switch", "signal": "On", **({} if each_its_bit else {"on": 5, "off": 3})}
    host, device = ends(TEXT, bound(enable=[one], start=[], stop=[]))
    frames = host.encode(Command(0, [1.0, 1.0], enable, False))
    switched = enable if each_its_bit else 5 if enable else 3
    assert [frame.data[0] for frame in frames if frame.can_id == 1541] == [switched]
    (heard,) = [command for frame in frames if isinstance(command := device.decode_command(frame), Command)]
    assert heard.enable == (enable if each_its_bit else 0b11 * (enable > 0))


def test_a_start_without_a_signal_is_a_message_that_has_none_or_has_them_bound() -> None:
    start = [{"message": "Alive"}, {"message": "Beat"}]
    host, _ = ends(TEXT, bound(start=start, on_change=[]))
    sent = said(host.encode(Command(0, [0.0, 0.0], 0b11, False)))
    assert [frame for frame in sent if frame[0] in (0x603, 0x604)] == [(0x604, 1), (0x603, -1), (0x604, 0)]
    with pytest.raises(LayoutError, match="message Switch has signals; say which value with `signal`"):
        ends(TEXT, bound(start=[{"message": "Switch"}, start[0]], on_change=[]))


def test_a_drive_that_does_not_obey_a_start_is_told_again() -> None:
    host, device = ends(TEXT, bound())
    for tick in range(300):
        frames = host.encode(Command(tick, [0.0, 0.0], 0b11 if tick else 0, False))
        for frame in [f for axis in (0, 1) for f in device.frames_of(Sample(axis, 0, 0, -1, 0))]:
            host.decode(frame)
        assert ((0x160, 0x88) in said(frames)) is (tick in (1, 101, 201))


def test_feedback_that_is_asked_for_is_asked_last_and_triggers() -> None:
    host, device = ends(TEXT, bound(remote=["Told0", "Told1"]))
    frames = host.encode(Command(0, [0.0, 0.0], 0, False))
    assert [frame.can_id for frame in frames[-2:]] == [REMOTE | 1537, REMOTE | 1538]
    assert host.echo_id == REMOTE | 1538
    assert host.decode(frames[-1]) is Reject.OWN_ECHO
    outcomes = [device.decode_command(frame) for frame in frames]
    assert [isinstance(outcome, Command) for outcome in outcomes] == [False] * (len(frames) - 1) + [True]
    names = {message.name: message for message in host.messages(MS)}
    assert names["request of Told1"].length == 0
    assert names["Told0"].after == "request of Told0"
    seldom, _ = ends(
        TEXT, bound(periodic=[{"message": "Told1", "period_s": 0.01}], remote=["Told0", "Told1"], on_change=[])
    )
    asked = [sum(f.can_id == REMOTE | 1537 for f in seldom.encode(Command(0, [0.0, 0.0], 0, False))) for _ in range(20)]
    assert sum(asked) == 2


def test_a_page_is_read_where_its_multiplexer_says_so() -> None:
    host, _ = ends(TEXT, bound())
    page = bytes((3, 5, 0, 0)) + (1234).to_bytes(4, "little", signed=True)
    sample = host.decode(Frame(1538, page, 0, MS))
    assert (sample.axis, sample.position, sample.status) == (0, 1234, DriveStatus.ENABLED)
    assert host.decode(Frame(1538, b"\x02" + page[1:], 0, MS)) is Reject.SERVICE
    assert host.decode(Frame(1538, page[:7], 0, MS)) is Reject.WRONG_LENGTH


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"position": [{"message": "Told", "signal": "Position0"}] * 2}, "two axes with one position"),
        ({"start": pair("Asked", "Order", value=0x81)}, "start and stop are the same frame"),
        ({"stop": []}, "bind as many of one as of the other"),
        ({"start": pair("Asked", "Order", value=256)}, "allowed 0 to 255"),
        ({"start": [{"message": "Switch"}] * 2}, "say which value"),
        ({"periodic": [{"message": "Asked0.Current", "period_s": 0.01}]}, "torque, which is sent every tick"),
        ({"periodic": [{"message": "Switch", "period_s": 0.01}]}, "no signal of 'Switch' is bound"),
        ({"periodic": [{"message": "Alice", "period_s": 0.01}]}, "has no message 'Alice'; did you mean Alive"),
        ({"periodic": [{"message": "Alive", "period_s": 0.01}]}, "both on_change and periodic"),
        ({"on_change": ["Asked0"]}, "torque, which is sent every tick"),
        ({"remote": ["Asked0"]}, "no bound feedback message"),
        ({"remote": ["Told"]}, "no bound feedback message"),
        ({"feedback": "cyclic"}, "Told0 is asked for"),
        ({"enable": [{"message": "Told", "signal": "Order"}]}, "no signal 'Order'"),
    ],
)
def test_what_could_not_act_is_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(LayoutError, match=says):
        ends(TEXT, bound(**changes))


def test_a_command_on_every_page_needs_to_know_its_page() -> None:
    text = TEXT.replace("SG_ Current m161", "SG_ Current")
    with pytest.raises(LayoutError, match=r"say which page it is with a bus.dbc.constant on Order"):
        ends(text, bound(constant=[], on_change=[], periodic=[]))
    page = [*pair("Asked", "Order", value=161)]
    host, _ = ends(text, bound(constant=page, on_change=[], periodic=[]))
    assert said(host.encode(Command(0, [0.0, 0.0], 0, False)))[-2:] == TORQUES


def test_names_that_are_there_twice_cannot_be_bound() -> None:
    twice = 'BO_ 1600 Told0: 8 Drive\n SG_ Position : 7|32@0- (1,0) [0|0] "" Host\n\n'
    with pytest.raises(LayoutError, match=r"has 2 messages 'Told0'"):
        ends(TEXT + twice, bound())
    state = ' SG_ State : 8|8@1+ (1,0) [0|0] "" Host\n'
    with pytest.raises(LayoutError, match=r"message Told0 has 2 signals 'State'"):
        ends(TEXT.replace(state, state + state.replace("8|8", "16|8")), bound())


def test_a_state_beside_the_positions_of_two_pages_is_read_on_either() -> None:
    pages = """BO_ 1550 Both: 8 Drive
 SG_ Kind M : 0|8@1+ (1,0) [0|0] "" Host
 SG_ State : 8|8@1+ (1,0) [0|0] "" Host
 SG_ Count : 16|8@1+ (1,0) [0|0] "" Host
 SG_ Position0 m0 : 32|32@1- (1,0) [0|0] "" Host
 SG_ Position1 m1 : 32|32@1- (1,0) [0|0] "" Host

"""
    position = [{"message": "Both", "signal": f"Position{axis}"} for axis in (0, 1)]
    status = [{"message": "Both", "signal": "State", "enabled": [5]}] * 2
    counters: dict[str, Any] = {"feedback_counter": [{"message": "Both", "signal": "Count"}] * 2}
    counters["command_counter"] = [{"message": "Beat", "signal": "Toggle"}]
    changes = bound(position=position, status=status, remote=[], periodic=[], constant=[], on_change=["Alive"])
    host, _ = ends(TEXT + pages, {**changes, **counters})
    for axis, state, means in ((0, 5, DriveStatus.ENABLED), (1, 4, 0), (1, 5, DriveStatus.ENABLED), (0, 4, 0)):
        page = bytes((axis, state, 9 + axis, 0)) + (-7 - axis).to_bytes(4, "little", signed=True)
        (sample,) = as_list(host.decode(Frame(1550, page, 0, MS)))
        assert (sample.axis, sample.position, sample.status, sample.sequence) == (axis, -7 - axis, means, 9 + axis)


def test_a_message_longer_than_the_bus_cannot_be_bound() -> None:
    text = TEXT.replace("BO_ 1537 Told1: 8", "BO_ 1537 Told1: 12")
    classic = 'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN";\nBA_ "VFrameFormat" BO_ 1537 0;\n'
    with pytest.raises(LayoutError, match="12 bytes, which no classic frame has"):
        ends(text + classic, bound(remote=[]))
    with pytest.raises(LayoutError, match="13 bytes, which no FD frame has"):
        ends(text.replace("Told1: 12", "Told1: 13"), bound(remote=[]))
    with pytest.raises(LayoutError, match="no remote frames"):
        ends(text, bound(remote=["Told1"]))


@pytest.mark.parametrize("default", ["", 'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'])
def test_a_message_that_only_an_fd_frame_can_carry_is_one(default: str) -> None:
    text = TEXT.replace("BO_ 1537 Told1: 8", "BO_ 1537 Told1: 12")
    text += 'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN";\n' * bool(default) + default
    host, device = ends(text, bound(remote=[]))
    assert host.fd
    assert host.warnings == ["any.dbc: taken as CAN FD, as no classic frame is so long: Told1 (12 bytes)"]
    (frame,) = device.frames_of(Sample(1, 77, 0, -1, 0))
    assert (len(frame.data), frame.flags & FD) == (12, FD)
    assert (as_list(host.decode(frame))[0].position, host.decode(frame._replace(flags=0))) == (77, Reject.WRONG_FORMAT)
    lengths = {message.name: (message.length, message.fd) for message in host.messages(MS)}
    assert (lengths["Told1"], lengths["Told0"]) == ((12, True), (8, False))
    beside, _ = ends(text + LONG_BESIDE, bound(remote=[]))
    assert beside.warnings == host.warnings  # 48 bytes fit an FD frame: nothing is wrong with it


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"remote": ["Told0", "Told1"]},
        {"remote": [], "periodic": [{"message": "Beat", "period_s": 0.02}]},
        {"start": [{"message": "Switch", "signal": "On", "value": 1}], "stop": [{"message": "Switch", "signal": "On"}]},
    ],
    ids=["pages", "asked for", "in every tick", "one switch for all"],
)
def test_such_drives_do_a_task(changes: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "any.dbc").write_text(TEXT)
    rig = shipped("paper-dbc")
    rig["bus"] = {"protocol": "dbc:any.dbc", "dbc": bound(**changes)}
    rig["safety"] = rig.get("safety", {}) | {"flood_frames": 20}
    for axis in rig["axes"].values():
        axis["encoder_resolution"] = 1e-7
    run = LockstepRun(RigConfig.model_validate(rig), tmp_path)
    for _ in range(1500):
        run.tick()
    assert run.cycle.state is State.ACTIVE
    assert abs(run.true_position).max() > 1e-3
    assert run.stage.drives[0].status & DriveStatus.ENABLED
