"""Drives that any DBC file describes, and sampling instants under layouts that carry none."""

import struct
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusConfig
from drivers.families.dbc.config import SignalBinding
from drivers.families.dbc.page import BoundMessage
from drivers.frame import ECHO, Frame
from drivers.protocols import LayoutError, device_protocol, host_protocol
from drivers.protocols.base import Command, Reject, Sample
from tests.support.paths import RIGS, ROOT

RATED = [5.3, 20.0, 0.04, 1.0]
FRACTIONS = st.lists(st.floats(-1, 1), min_size=4, max_size=4)


# any DBC --------------------------------------------------------------------------------------------------------------


def dbc_bus(**changes: Any) -> BusConfig:
    document = tomllib.loads((RIGS / "paper-dbc.toml").read_text())["bus"]
    document["dbc"] |= changes
    return BusConfig.model_validate(document)


def signals(message: str, signal: str, **more: Any) -> list[dict[str, Any]]:
    return [{"message": f"{message}{drive}", "signal": signal, **more} for drive in "AB"]


@pytest.mark.long
@given(fractions=FRACTIONS, enable=st.integers(0, 3), sequence=st.integers(0, 99), counts=st.integers(-(2**30), 2**30))
def test_a_bound_dbc_carries_a_rig(fractions: list[float], enable: int, sequence: int, counts: int) -> None:
    bus = dbc_bus()
    host, device = host_protocol(bus, 2, [5.0, 5.0], RIGS), device_protocol(bus, 2, [5.0, 5.0], RIGS)
    force = [5.0 * fraction for fraction in fractions[:2]]
    first, last = host.encode(Command(sequence, force, enable, sequence % 2 == 0))
    assert device.decode_command(first) is Reject.SERVICE  # half a command
    command = device.decode_command(last)
    assert isinstance(command, Command)
    assert (command.sequence, command.enable, command.reset) == (sequence % 16, enable, sequence % 2 == 0)
    for axis in range(2):
        told = force[axis] if enable >> axis & 1 else 0.0
        assert abs(command.force[axis] - told) <= 0.5001 * 0.01 * 0.05
    answer = device.encode_feedback(Sample(1, counts, 0b10001, sequence, 0))
    heard = host.decode(answer)
    assert isinstance(heard, Sample)
    assert replace(heard, stamp_ns=0) == Sample(1, counts, 0b10001, sequence % 16, 0)


def test_the_drives_side_knows_how_coarse_its_torque_is() -> None:
    bus = dbc_bus()
    host, device = host_protocol(bus, 2, [5.0, 4.0], RIGS), device_protocol(bus, 2, [5.0, 4.0], RIGS)
    worst = 0.0
    for step in range(1000):
        force = [4.9873e-3 * step, 3.9914e-3 * step]
        *_, command = [device.decode_command(frame) for frame in host.encode(Command(step, force, 3, False))]
        worst = max(worst, *(abs(a - b) / rated for a, b, rated in zip(command.force, force, [5.0, 4.0], strict=True)))
    assert 0.8 * device.force_resolution < worst <= 1.0001 * device.force_resolution


def test_an_integer_signal_is_cut_at_the_ends_of_its_range() -> None:
    message = cantools.database.load_file(ROOT / "drivers/families/stage/stage_classic.dbc").get_message_by_name(
        "Command"
    )
    bound = BoundMessage(message, "sum8")
    ends = {"torque_0": (-2048, 2047), "sequence": (0, 31), "reset": (0, 1), "checksum": (0, 255)}
    for signal, (low, high) in ends.items():
        place = bound.place(SignalBinding(message="Command", signal=signal))
        assert [place.raw(value) for value in (-1e9, 1e9)] == [low, high]


def test_the_example_dbc_means_what_cantools_reads() -> None:
    database = cantools.database.load_file(RIGS / "example_drive.dbc")
    host = host_protocol(dbc_bus(), 2, [5.0, 5.0], RIGS)
    frames = host.encode(Command(18, [2.5, -5.0], 3, False))
    told = [database.decode_message(frame.can_id, frame.data) for frame in frames]
    assert [item["TorqueDemand"] for item in told] == [50.0, -100.0]  # % of 5 N
    assert [item["AliveCounter"] for item in told] == [2, 2]


# sampling instants under layouts that carry none ----------------------------------------------------------------------


def tick(host: Any, answers: list[Frame], start: int, held_up: int = 0, echo: bool = False) -> list[int]:
    """One tick that starts at `start`: what the host takes for the instants of the samples; answers come at 0.4 ms."""
    sent = host.encode(Command(0, [0.0, 0.0], 0, False))
    trigger = next(frame for frame in sent if frame.can_id == host.echo_id)
    if echo:
        seen = trigger._replace(flags=trigger.flags | ECHO, timestamp_ns=start + 150_000)
        assert host.decode(seen) is Reject.OWN_ECHO
    stamped = [a._replace(timestamp_ns=start + 400_000 + held_up + 100_000 * n) for n, a in enumerate(answers)]
    return [host.decode(answer).stamp_ns for answer in stamped]


@pytest.fixture(params=["cia402", "dbc"])
def unstamped(request: pytest.FixtureRequest) -> tuple[Any, list[Frame]]:
    """A host, and an answer of each of its two drives."""
    if request.param == "cia402":
        bus = BusConfig(protocol="cia402")
        return host_protocol(bus, 2, RATED[:2], ROOT), [Frame(0x181 + n, struct.pack("<iH", 7, 0x0237)) for n in (0, 1)]
    device = device_protocol(dbc_bus(), 2, [5.0, 5.0], RIGS)
    answers = [device.encode_feedback(Sample(n, 7, 0, 0, 0)) for n in (0, 1)]
    return host_protocol(dbc_bus(), 2, [5.0, 5.0], RIGS), answers


def test_the_echo_of_the_trigger_is_the_sampling_instant(unstamped: tuple[Any, list[Frame]]) -> None:
    host, answers = unstamped
    for start, held_up in ((10**9, 0), (10**9 + 1_000_000, 300_000), (10**9 + 5_300_000, 0)):
        assert tick(host, answers, start, held_up, echo=True) == [start + 150_000] * 2


def test_without_an_echo_it_is_told_from_the_answer_that_was_not_held_up(unstamped: tuple[Any, list[Frame]]) -> None:
    host, answers = unstamped
    usual = {tick(host, answers, 10**9 + k * 1_000_000)[1] - k * 1_000_000 for k in range(50)}
    assert len(usual) == 1
    (instant,) = usual
    assert 10**9 + 200_000 < instant < 10**9 + 350_000  # an answer takes some 100 us of 1 Mbit/s
    late = tick(host, answers, 10**9 + 50_000_000, held_up=300_000)
    assert all(0 <= stamp - instant - 50_000_000 <= 1_000 for stamp in late)
    assert tick(host, answers, 10**9 + 51_000_000, held_up=20_000) == [instant + 51_020_000] * 2


def test_a_command_with_a_lost_part_is_not_obeyed() -> None:
    bus = dbc_bus()
    host, device = host_protocol(bus, 2, [5.0, 5.0], RIGS), device_protocol(bus, 2, [5.0, 5.0], RIGS)
    first, last = host.encode(Command(1, [1.0, 1.0], 3, False))
    assert device.decode_command(last) is Reject.STALE
    assert device.decode_command(first) is Reject.SERVICE
    following = host.encode(Command(2, [0.0, 0.0], 3, False))
    assert device.decode_command(following[1]) is Reject.STALE  # the parts are of two commands


@pytest.mark.parametrize(
    ("changes", "explanation"),
    [
        ({"position": signals("MotorFedback", "ShaftPosition", scale=10)}, "did you mean MotorFeedbackA"),
        ({"position": signals("MotorFeedback", "ShaftPos", scale=10)}, "did you mean MotorFeedbackA.ShaftPosition"),
        ({"torque": signals("TorqueDemand", "TorqueDemand", scale=0.001)}, "check its scale"),
        ({"torque": signals("TorqueDemand", "TorqueDemand")[:1]}, "1 signals for 2 axes"),
        ({"position": [signals("MotorFeedback", "ShaftPosition")[0]] * 2}, "message"),
        (
            {"enable": signals("TorqueDemand", "DriveMode") + signals("TorqueDemand", "DriveMode")[:1]},
            "enable has 3 signals for 2",
        ),
        ({"start": [{"message": "TorqueDemandA"}] * 3}, "start has 3 frames for 2 axes; it may also have one or none"),
        ({"stop": [{"message": "TorqueDemandA"}] * 4}, "stop has 4 frames for 2 axes"),
        ({"status": signals("MotorFeedback", "StateBits")[:1]}, "status has 1 signals for 2 axes; it may also be left"),
        ({"command_counter": []}, "both or neither"),
        ({"feedback_counter": signals("MotorFeedback", "StateBits")}, "different lengths"),
        ({"checksum": signals("TorqueDemand", "AliveCounter")}, "not one whole byte"),
        ({"status": signals("MotorFeedback", "ShaftPosition")}, "not an unsigned integer"),
        ({"torque": signals("MotorFeedback", "ShaftPosition")}, "both as command and as feedback"),
    ],
)
def test_a_wrong_binding_is_explained(changes: dict[str, Any], explanation: str) -> None:
    with pytest.raises(LayoutError, match=explanation):
        host_protocol(dbc_bus(**changes), 2, [5.0, 5.0], RIGS)


def test_all_wrong_names_are_told_at_once() -> None:
    changes = {"torque": signals("Torque", "Demand"), "position": signals("Feedback", "Shaft")}
    with pytest.raises(LayoutError) as refusal:
        host_protocol(dbc_bus(**changes), 2, [5.0, 5.0], RIGS)
    assert str(refusal.value).count("has no message") == 4


def test_a_file_that_is_no_dbc_is_named(tmp_path: Path) -> None:
    (tmp_path / "bad.dbc").write_text("BO_ nonsense")
    for name in ("bad.dbc", "missing.dbc"):
        bus = dbc_bus().model_copy(update={"protocol": f"dbc:{name}"})
        with pytest.raises(LayoutError, match=name):
            host_protocol(bus, 2, [5.0, 5.0], tmp_path)
