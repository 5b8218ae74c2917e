"""Frame layouts that users bring: found in every way, tried before they are used, and trusted with nothing."""

import importlib.metadata
from pathlib import Path

import pytest

from drivers.base import call_limit, plugins
from drivers.config import LAYOUT_KIND, LAYOUTS, BusConfig
from drivers.families import layouts
from drivers.frame import ECHO, Frame
from drivers.protocols import LayoutError, device_protocol, host_protocol
from drivers.protocols.base import Command, DriveStatus, HostProtocol, Reject, Sample
from drivers.protocols.mounting import Mounting
from drivers.protocols.user_sides import UserDrives
from tests.support.wrong_layouts import MAKER, REFUSED, decode, drives, encode, layout

RATED = [5.0, 2.0]


pytestmark = pytest.mark.usefixtures("examples_are_a_package")


def bus_of(text: str = "", made: str = "Maker", **keys: object) -> BusConfig:
    return BusConfig.model_validate(
        {"protocol": f"./wrong.py:{made}", "source": MAKER.read_text() + text, **keys},
    )


def host_of(text: str = "", made: str = "Maker", **keys: object) -> HostProtocol:
    return host_protocol(bus_of(text, made, **keys), 2, RATED, Path())


def answer(counter: int, position: int = 7, stamp_ns: int = 0, axis: int = 1) -> Frame:
    sample = Sample(axis, position, int(DriveStatus.ENABLED | DriveStatus.HOMED), counter, 0)
    return device_protocol(bus_of(), 2, RATED, Path()).encode_feedback(sample)._replace(timestamp_ns=stamp_ns)


def test_both_sides_of_a_users_layout_speak_as_ours_do() -> None:
    host, drives = host_of(), device_protocol(bus_of(), 2, RATED, Path())
    frames = host.encode(Command(300, [2.5, -2.0], 0b01, True))
    assert [(frame.can_id, frame.data.hex()) for frame in frames] == [
        (0x201, "09c4032c02"), (0x202, "f830022ca7"), (0x180, "2c"),
    ]  # fmt: skip
    assert [drives.decode_command(frame) for frame in frames] == [
        Reject.SERVICE, Reject.SERVICE, Command(44, [2.5, -2.0], 1, True),
    ]  # fmt: skip
    assert (host.n_axes, host.sequence_modulus, host.checksum, host.fd, host.echo_id) == (2, 256, True, False, 0x180)
    assert host.positions == [(-(2.0**31), 2.0**31 - 1)] * 2
    assert host.problems == []


def test_a_sample_without_a_stamp_was_taken_at_the_end_of_the_frame_that_asked_for_it() -> None:
    host = host_of()
    host.encode(Command(3, [0.0, 0.0], 0, False))
    assert host.decode(Frame(0x180, b"\x03", ECHO, 5_000_000)) is Reject.OWN_ECHO
    assert host.decode(answer(3, stamp_ns=5_200_000)) == Sample(1, 7, 17, 3, 5_000_000)
    host.encode(Command(4, [0.0, 0.0], 0, False))
    later = host.decode(answer(4, stamp_ns=6_200_000, axis=0))  # no echo came: by the answer's own length
    assert isinstance(later, Sample)
    assert 6_060_000 < later.stamp_ns < 6_140_000


def test_a_mounted_drive_speaks_it_in_its_own_terms() -> None:
    mountings = [Mounting(), Mounting(direction=-1, gear=2.0, offset=100)]
    host = host_protocol(bus_of(), 2, RATED, Path(), mountings=mountings)
    host.encode(Command(3, [0.0, 0.0], 0, False))
    sample = host.decode(answer(3, stamp_ns=5_000_000))
    assert isinstance(sample, Sample)
    assert sample.position == 93
    drives = device_protocol(bus_of(), 2, RATED, Path(), mountings)
    told = [drives.decode_command(frame) for frame in host.encode(Command(4, [1.0, 1.0], 3, False))][-1]
    assert isinstance(told, Command)
    assert told.force == [1.0, 1.0]


def test_a_file_a_module_and_an_entry_point_are_the_same_layout(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = importlib.metadata.EntryPoint("maker", "examples.layouts.maker:Maker", LAYOUT_KIND.group)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry] if group == "hil.layouts" else [])
    command = Command(1, [1.0, 1.0], 3, False)
    sent = [
        host_protocol(bus, 2, RATED, Path()).encode(command)
        for bus in (bus_of(), BusConfig(protocol="examples.layouts.maker:Maker"), BusConfig(protocol="maker"))
    ]
    assert sent[0] == sent[1] == sent[2]
    assert plugins.registered(LAYOUT_KIND) == [*LAYOUTS, "maker"]


def test_ours_are_found_the_same_way_and_are_listed_once() -> None:
    for name, sides in layouts().items():
        assert LAYOUT_KIND.own(name.replace("FILE", "any.dbc")) == LAYOUTS[name] == sides.host
        assert callable(plugins.load(sides.host).encode)
        assert callable(plugins.load(sides.drives).encode_feedback)
    assert LAYOUT_KIND.own("dbc") == LAYOUT_KIND.own("stage_fd:FILE") == LAYOUT_KIND.own("maker.py:dbc") == ""


@pytest.mark.parametrize(("name", "text"), [
    ("stage_df", "the nearest is stage_fd; the frame layouts are stage_fd, stage_classic, cia402, mit, moteus, dbc:"),
    ("", "the frame layouts are stage_fd"),
])  # fmt: skip
def test_a_layout_that_is_not_known_is_refused_by_name(name: str, text: str) -> None:
    with pytest.raises(ValueError, match=r"bus\.protocol = ") as caught:
        BusConfig(protocol=name)
    assert text in str(caught.value)


@pytest.mark.parametrize(("protocol", "text"), [
    ("no.such.module:Maker", "bus.protocol = 'no.such.module:Maker': No module named 'no'"),
    ("examples.layouts.maker:Nothing", "'Nothing' is no class with host and drives"),
    ("./maker.py:Maker", "bus.source is empty; load the rig from its file"),
])  # fmt: skip
def test_a_layout_that_is_not_to_be_had_is_refused(protocol: str, text: str) -> None:
    with pytest.raises(LayoutError) as caught:
        host_protocol(BusConfig(protocol=protocol), 2, RATED, Path())
    assert text in str(caught.value)


@pytest.mark.parametrize(("keys", "text"), [
    ({"parameters": {"unit": 1}}, "it cannot be made: "),
    ({"parameters": {"torque_unit": 1e-5}}, "torque_unit = 1e-05 reaches 0.32767; axis 0: 5"),
    ({"parameters": {"torque_unit": "fine"}}, "./wrong.py:"),
])  # fmt: skip
def test_its_parameters_are_its_own_to_check(keys: dict[str, object], text: str) -> None:
    with pytest.raises(LayoutError) as caught:
        host_of(**keys)
    assert text in str(caught.value)
    assert host_of(parameters={"torque_unit": 2e-3}).encode(Command(0, [2.0, 0.0], 3, False))[0].data[:2] == b"\x03\xe8"


def test_ours_take_no_parameters() -> None:
    with pytest.raises(ValueError, match="parameters: of a frame layout of your own; protocol = 'stage_fd' takes none"):
        BusConfig(parameters={"torque_unit": 1.0})


@pytest.mark.parametrize("how", REFUSED)
def test_a_layout_that_goes_wrong_is_refused_before_it_is_used(how: str) -> None:
    text, told = REFUSED[how]
    for side in (host_protocol, device_protocol):
        with pytest.raises(LayoutError) as caught:
            side(bus_of(text, "Wrong"), 2, RATED, Path())
        assert str(caught.value).startswith("bus.protocol = './wrong.py:Wrong': ")
        assert told in str(caught.value)


@pytest.mark.parametrize("axis", range(3))
def test_each_axis_is_enabled_alone_in_the_trial(axis: int) -> None:
    text = encode(f"frames = super().encode(command._replace(enable=command.enable * (command.enable != {1 << axis})))")
    with pytest.raises(LayoutError, match=rf"host\(\) enables axes {1 << axis:#b}, and 0b0 is read"):
        host_protocol(bus_of(text, "Wrong"), 3, [5.0, 2.0, 1.0], Path())


def test_a_layout_that_does_not_return_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call_limit, "CALL_LIMIT_S", 0.3)
    call_limit.watch.disarm()  # a timer of an earlier call would look in its own time
    with pytest.raises(LayoutError, match=r"it cannot be made: .*no answer within 0\.3 s"):
        host_of(layout("    def __init__(self, wiring):\n        while True:\n            pass\n"), "Wrong")


def test_a_host_that_raises_sends_nothing_until_a_reset() -> None:
    host = host_of(encode("frames = frames if self.k != 60 else 1 / 0"), "Wrong")  # not in its trial, of 40 ticks
    command = Command(1, [1.0, 1.0], 3, False)
    sent = [len(host.encode(command)) for _ in range(65)]
    assert sent == [3] * 59 + [0] * 6
    (problem,) = host.problems
    assert problem.startswith("bus.protocol = './wrong.py:Wrong': host().encode: ./wrong.py:")
    assert problem.endswith("ZeroDivisionError: division by zero; nothing is sent until a reset")
    assert len(host.encode(command._replace(reset=True))) == 3
    assert host.problems == []
    assert len(host.encode(command)) == 3


def test_a_frame_that_it_cannot_decode_is_one_with_an_invalid_value() -> None:
    host = host_of(decode("sample.position //= 0 if sample.position == 99 else 1"), "Wrong")
    assert host.decode(answer(3, position=99)) is Reject.INVALID_VALUE
    assert isinstance(host.decode(answer(3)), Sample)
    (problem,) = host.problems
    assert "host().decode of 282#0000006384" in problem
    assert "ZeroDivisionError" in problem


def test_drives_that_raise_say_where() -> None:
    late = """
    def encode_feedback(self, sample):
        if sample.position == 99:
            raise KeyError("gone")
        return super().encode_feedback(sample)
"""
    device = device_protocol(bus_of(drives(late), "Wrong"), 2, RATED, Path())
    device.encode_feedback(Sample(0, 98, 1, 0, 0))
    with pytest.raises(LayoutError, match=r"drives\(\)\.encode_feedback: \./wrong\.py:\d+: KeyError: 'gone'"):
        device.encode_feedback(Sample(0, 99, 1, 0, 0))


SILENT = """
import struct
from hil import Command, DriveSide, Frame, FrameLayout, HostSide, Message, Reject, Sample

class Silent(FrameLayout):
    def host(self):
        return Host()
    def drives(self):
        return Drives()

class Host(HostSide):
    def encode(self, command):
        return [Frame(0x10 + axis, struct.pack("<d", command.force[axis])) for axis in (0, 1)]
    def decode(self, frame):
        axis = frame.can_id - 0x20
        if axis not in (0, 1) or len(frame.data) != 4:
            return Reject.UNKNOWN_ID
        return Sample(axis, int.from_bytes(frame.data, "little", signed=True), 0, -1, -1)
    def messages(self, period_ns):
        ids = (("host", 0x10), ("host", 0x11), ("axis 0", 0x20), ("axis 1", 0x21))
        return [Message(hex(at), at, 8, False, period_ns, period_ns, 0, sender) for sender, at in ids]

class Drives(DriveSide):
    first = 0.0
    def decode_command(self, frame):
        if frame.can_id not in (0x10, 0x11) or len(frame.data) != 8:
            return Reject.UNKNOWN_ID
        before, self.first = self.first, struct.unpack("<d", frame.data)[0]
        return Command(0, [before, self.first], 0, False) if frame.can_id == 0x11 else Reject.SERVICE
    def encode_feedback(self, sample):
        return Frame(0x20 + sample.axis, sample.position.to_bytes(4, "little", signed=True))
"""


def test_sides_that_say_nothing_of_themselves_promise_nothing() -> None:
    """No sequence, checksum, state or cause, and no stamp; positions of 32 bits, and torques that arrive exactly."""
    bus = BusConfig(protocol="./silent.py:Silent", source=SILENT)
    host, device = host_protocol(bus, 2, RATED, Path()), device_protocol(bus, 2, RATED, Path())
    assert (host.sequence_modulus, host.checksum, host.states, host.causes, host.fd) == (0, False, False, False, False)
    assert (host.echo_id, list(host.acts_ns), host.state_ns, host.problems) == (None, [], 0, [])
    assert host.positions == [(-(2.0**31), 2.0**31 - 1)] * 2
    assert isinstance(device, UserDrives)
    assert (device.sequence_modulus, device.force_resolution, device.enable_lag, device.fd) == (0, 0.0, 0, False)


def test_drives_may_answer_in_several_frames_the_position_last() -> None:
    several = """
    def encode_feedback(self, sample):
        return [Frame(0x701 + sample.axis, b"\\x05"), super().encode_feedback(sample)]
"""
    device = device_protocol(bus_of(drives(several), "Wrong"), 2, RATED, Path())
    assert [frame.can_id for frame in device.frames_of(Sample(1, 5, 1, 0, 0))] == [0x702, 0x282]  # type: ignore[attr-defined]
    assert device.encode_feedback(Sample(1, 5, 1, 0, 0)).can_id == 0x282
