"""Messages that share an identifier: bits that never change tell their frames apart."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from drivers.bus_load.schedulability import analyse
from drivers.config import BusConfig
from drivers.families.dbc.words import dbc_reader
from drivers.frame import Frame
from drivers.protocols import LayoutError, device_protocol, host_protocol
from drivers.protocols.base import Command, Reject, Sample
from drivers.protocols.dbc_codec import load_dbc
from hil.cycle.state_machine import State
from hil.rig.schema import RigConfig
from hil.virtual.invariants import Invariants
from hil.virtual.lockstep import LockstepRun

MS = 1_000_000
ON, OFF, CLEAR, ZERO = (0xFFFFFFFFFFFFFF00 | last for last in (0xFC, 0xFD, 0xFB, 0xFE))
# As Damiao's documents have it: orders are seven bytes FFh and a number, in the identifier of the torque.
MIT = """BO_ 1 Mit: 8 H
 SG_ PosRef : 7|16@0+ (1,0) [0|65535] "" D
 SG_ VelRef : 23|12@0+ (1,0) [0|4095] "" D
 SG_ Kp : 27|12@0+ (1,0) [0|4095] "" D
 SG_ Kd : 47|12@0+ (1,0) [0|4095] "" D
 SG_ TauRef : 51|12@0+ (0.00488400488400488,-10) [-10|10] "Nm" D
"""
EXACT = MIT.replace("0.00488400488400488", "0.005")  # has a number for zero
ORDER = """BO_ 1 Order: 8 H
 SG_ Code : 7|64@0+ (1,0) [0|0] "" D
"""
HEAD = """VERSION ""
NS_ :
BS_:
BU_: H D
BO_ 17 Feedback: 8 D
 SG_ MotorId : 3|4@0+ (1,0) [0|15] "" H
 SG_ Err : 7|4@0+ (1,0) [0|15] "" H
 SG_ Pos : 15|16@0+ (0.000381475547417411,-12.5) [-12.5|12.5] "rad" H
 SG_ Vel : 31|12@0+ (0.0146520146520147,-30) [-30|30] "rad/s" H
 SG_ Tau : 35|12@0+ (0.00488400488400488,-10) [-10|10] "Nm" H
 SG_ TMos : 55|8@0+ (1,0) [0|255] "C" H
 SG_ TCoil : 63|8@0+ (1,0) [0|255] "C" H
"""
DAMIAO = HEAD + MIT + ORDER
BOUND: dict[str, Any] = {
    "position": [{"message": "Feedback", "signal": "Pos", "scale": 1e4}],
    "torque": [{"message": "Mit", "signal": "TauRef"}],
    "status": [{"message": "Feedback", "signal": "Err", "enabled": [1], "fault": [8, 9, 10, 11, 12, 13, 14]}],
    "constant": [
        {"message": "Mit", "signal": signal, "value": value} for signal, value in (("PosRef", 32767), ("VelRef", 2047))
    ],
    "start": [{"message": "Order", "signal": "Code", "value": ON}],
    "stop": [{"message": "Order", "signal": "Code", "value": OFF}],
}
RIG = """
name = "damiao"
rate_hz = 500
bus = { interface = "local", channel = "one", protocol = "dbc:made.dbc" }
drives = { watchdog_s = 0.05, brake = false }
law = { name = "pd-feedforward", gains = { kp = [20.0], kd = [0.5] } }
task = { kind = "hold" }
[axes.x]
kind = "rotary"
encoder_resolution = 1e-4
rated_force = 8.0
limits = { position = [-6.0, 6.0], speed = 10.0, force = 5.0, force_rate = 10000.0, following_error = 0.2 }
model = { mass = 0.01, coulomb = 0.1, viscous = 0.01 }
"""


def ends(folder: Path, text: str, n_axes: int = 1, **changes: Any) -> tuple[Any, Any]:
    (folder / "made.dbc").write_text(text)
    bus = BusConfig.model_validate({"protocol": "dbc:made.dbc", "dbc": BOUND | changes})
    rated = [8.0] * n_axes
    return host_protocol(bus, n_axes, rated, folder, MS), device_protocol(bus, n_axes, rated, folder)


def test_orders_and_torques_of_one_identifier_are_told_apart(tmp_path: Path) -> None:
    host, device = ends(tmp_path, DAMIAO)
    stop, idle = host.encode(Command(0, [0.0], 0, False))
    start, torque = host.encode(Command(1, [2.5], 1, False))
    assert {frame.can_id for frame in (stop, idle, start, torque)} == {1}
    assert (stop.data.hex(), start.data.hex()) == ("fffffffffffffffd", "fffffffffffffffc")
    assert device.decode_command(start) is Reject.SERVICE
    heard = device.decode_command(torque)
    assert (heard.enable, heard.force[0]) == (1, pytest.approx(2.5, abs=0.003))
    other = Frame(
        1, ZERO.to_bytes(8, "big")
    )  # an order that the rig does not give: as a torque it would be the greatest
    assert device.decode_command(other) is Reject.SERVICE
    assert device.decode_command(Frame(1, torque.data[:7])) is Reject.WRONG_LENGTH
    assert device.decode_command(stop) is Reject.SERVICE
    assert device.decode_command(idle).enable == 0


def test_a_reset_may_share_the_identifier_where_its_value_alone_is_sent(tmp_path: Path) -> None:
    reset = [{"message": "Order", "signal": "Code", "on": CLEAR, "off": 0}]
    host, device = ends(tmp_path, DAMIAO, reset=reset, on_change=["Order"])
    host.encode(Command(0, [0.0], 0, False))
    frames = host.encode(Command(1, [0.0], 0, True))
    assert frames[0].data.hex() == "fffffffffffffffb"
    assert [device.decode_command(frame) for frame in frames][-1].reset
    with pytest.raises(LayoutError, match="messages Mit and Order are both bound, on one identifier, 0x1: nothing"):
        ends(tmp_path, DAMIAO, reset=reset)  # in every tick, mostly as zeros


def test_a_torque_without_a_number_for_zero_needs_a_switch(tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match=r"torque: Mit has no number for 0, the nearest is -?0\.00244, and nothing"):
        ends(tmp_path, HEAD + MIT, start=[], stop=[])
    host, device = ends(tmp_path, HEAD + EXACT, start=[], stop=[])
    (idle,) = host.encode(Command(0, [0.0], 0, False))
    assert device.decode_command(idle).enable == 0


def test_the_bus_load_counts_every_frame_of_the_identifier(tmp_path: Path) -> None:
    host, _ = ends(tmp_path, DAMIAO)
    messages = host.messages(2 * MS)
    assert [message.name for message in messages] == ["Mit", "Feedback", "Order", "Order (2)"]
    assert analyse(messages, 1_000_000, 1_000_000).schedulable
    assert sum(message.sender == "host" for message in messages) == 3


def test_a_frame_is_shown_as_each_message_that_it_may_be(tmp_path: Path) -> None:
    (tmp_path / "made.dbc").write_text(DAMIAO)
    shown = dbc_reader(load_dbc(tmp_path / "made.dbc"))(Frame(1, OFF.to_bytes(8, "big")))
    assert shown.startswith("Mit: PosRef 65535, ")
    assert f" or Order: Code {OFF}" in shown


def test_a_rig_with_such_drives_holds(tmp_path: Path) -> None:
    (tmp_path / "made.dbc").write_text(DAMIAO)
    rig = tomllib.loads(RIG)
    rig["bus"]["dbc"] = BOUND
    config = RigConfig.model_validate(rig)
    seen = Invariants(config, tmp_path)
    run = LockstepRun(config, tmp_path, observer=seen.observe)
    for _ in range(600):
        run.tick()
    assert run.cycle.state is State.ACTIVE
    assert seen.ticks == 600, "and no torque before it, though no number of the signal is zero"
    assert abs(run.true_position).max() < 1e-3


FEEDBACK = """BO_ 18 First: 8 D
 SG_ Kind M : 0|8@1+ (1,0) [0|0] "" H
 SG_ Pos m1 : 8|32@1- (1,0) [0|0] "" H
BO_ 18 Second: 6 D
 SG_ Sort M : 0|8@1+ (1,0) [0|0] "" H
 SG_ Pos m2 : 8|32@1- (1,0) [0|0] "" H
 SG_ Sum m2 : 40|8@1+ (1,0) [0|0] "" H
"""
TWO: dict[str, Any] = {
    "position": [{"message": name, "signal": "Pos"} for name in ("First", "Second")],
    "torque": [{"message": f"Mit{end}", "signal": "TauRef"} for end in ("", "2")],
    "checksum": [{"message": "Second", "signal": "Sum"}],
    "checksum_algorithm": "sum8",
    "status": [],
    "constant": [],
    "start": [],
    "stop": [],
}
BOTH = HEAD + EXACT + ORDER + EXACT.replace("BO_ 1 Mit", "BO_ 2 Mit2") + FEEDBACK


def test_answers_of_one_identifier_are_told_apart_by_their_multiplexers(tmp_path: Path) -> None:
    host, device = ends(tmp_path, BOTH, 2, **TWO)
    for axis, length in ((0, 8), (1, 6)):
        (frame,) = device.frames_of(Sample(axis, 1000 + axis, 0, -1, 0))
        assert (frame.can_id, len(frame.data)) == (18, length)
        sample = host.decode(frame._replace(timestamp_ns=MS))
        assert (sample.axis, sample.position) == (axis, 1000 + axis)
    damaged = frame._replace(data=frame.data[:5] + bytes((frame.data[5] ^ 1,)))
    assert host.decode(damaged) is Reject.BAD_CHECKSUM
    assert host.decode(Frame(18, bytes(8))) is Reject.SERVICE  # a page that nobody binds
    assert host.decode(Frame(18, b"")) is Reject.WRONG_LENGTH
    assert {message.name: message.sender for message in host.messages(MS)}["Second"] == "axis 0"
    assert analyse(host.messages(MS), 1_000_000, 1_000_000).schedulable


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (" m2 :", " m1 :", "messages First and Second are both bound, on one identifier, 0x12: nothing tells them"),
        ("SG_ Sort M : 0|8", "SG_ Sort M : 48|8", "messages First and Second are both bound"),
        ("BO_ 18 Second", "BO_ 1 Second", "Mit is bound as command and Second as feedback, on one identifier, 0x1:"),
    ],
)
def test_what_nothing_tells_apart_is_refused_in_one_line(old: str, new: str, says: str, tmp_path: Path) -> None:
    text = BOTH.replace("Second: 6", "Second: 8")
    assert old in text
    with pytest.raises(LayoutError) as refusal:
        ends(tmp_path, text.replace(old, new), 2, **TWO)
    assert says in str(refusal.value)
    assert "\n" not in str(refusal.value)
