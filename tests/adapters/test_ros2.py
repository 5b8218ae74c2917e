"""ROS 2 without ROS: hashes and bytes as published, keys as rmw_zenoh has them, a trajectory followed on the rig."""

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.adapters import ros_types
from hil.adapters.cdr import Message, decode, encode
from hil.adapters.ros2 import ACTION, STATES, RosRig
from hil.adapters.ros_trajectory import Trajectory
from hil.adapters.ros_types import FOLLOW, TYPES, dds_name, type_hash

JOINTS = "sensor_msgs/msg/JointState"


# types and bytes ------------------------------------------------------------------------------------------------------


def test_hashes_are_those_that_ros_prints() -> None:
    """Of `ros2 topic info -v`, and of rmw_zenoh's documentation; the last for the form that services have."""
    assert type_hash(JOINTS) == "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    statuses = "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e"
    assert type_hash("action_msgs/msg/GoalStatusArray") == statuses
    name = "example_interfaces/srv/AddTwoInts"
    parts = {
        f"{name}_Request": "a:int64 b:int64",
        f"{name}_Response": "sum:int64",
        f"{name}_Event": f"info:service_msgs/msg/ServiceEventInfo request:{name}_Request[<=1] "
        f"response:{name}_Response[<=1]",
        name: f"request_message:{name}_Request response_message:{name}_Response event_message:{name}_Event",
    }
    types = {**TYPES, **{part: ros_types.parsed(fields) for part, fields in parts.items()}}
    assert type_hash(name, types) == "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"


def test_the_bytes_are_cdr_with_its_alignment() -> None:
    message = {"header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "a"}, "name": ["x"], "position": [1.0]}
    expected = b"\0\1\0\0" + struct.pack("<iI", 1, 2) + struct.pack("<I2s2x", 2, b"a\0")
    expected += struct.pack("<II2s2x", 1, 2, b"x\0") + struct.pack("<I", 1)
    expected += bytes(4 - (len(expected) - 4) % 8 if (len(expected) - 4) % 8 else 0) + struct.pack("<d", 1.0)
    expected += struct.pack("<II", 0, 0)
    assert encode(JOINTS, message) == expected
    assert decode(JOINTS, expected)["position"] == [1.0]


def full(name: str) -> Message:
    """A message with something in every field."""
    found: Message = {}
    for number, (field, (kind, shape, size)) in enumerate(TYPES[name].items(), 1):
        one: Any = "é€" * number if kind == "string" else number % 2 if kind in ros_types.BASIC else full(kind)
        found[field] = [one] * (size if shape == "array" else 1 if shape == "bounded" else 3) if shape else one
    return found


@pytest.mark.parametrize("name", sorted(TYPES))
def test_what_is_encoded_is_decoded(name: str) -> None:
    assert decode(name, encode(name, full(name))) == full(name)


@given(st.binary(max_size=200), st.sampled_from(sorted(TYPES)))
def test_bytes_from_anybody_are_a_message_or_an_error(data: bytes, name: str) -> None:
    with contextlib.suppress(ValueError):
        decode(name, b"\0\1\0\0" + data)
    with pytest.raises(ValueError, match="no plain little-endian CDR"):
        decode(name, b"\0\0\0\0" + data)


# a trajectory ---------------------------------------------------------------------------------------------------------


def point(seconds: float, *positions: float, velocities: tuple[float, ...] = ()) -> Message:
    stamp = {"sec": int(seconds), "nanosec": round(seconds % 1 * 1e9)}
    return {"positions": list(positions), "velocities": list(velocities), "time_from_start": stamp}


def trajectory(*points: Message, names: tuple[str, ...] = ("x", "y")) -> Message:
    return {"joint_names": list(names), "points": list(points)}


def test_a_trajectory_passes_through_its_points_in_time_and_ends_in_position(mover: hil.VirtualMover) -> None:
    middle = point(0.4, 1e-3, 5e-4, velocities=(2e-3, 0.0))
    followed = Trajectory(mover, trajectory(middle, point(0.8, 2e-3, 0.0, velocities=(0.0, 0.0))))
    began = mover.now_ns()
    at_middle: list[float] = []
    while not followed.advance():
        mover.sleep(0.005)
        if mover.now_ns() - began >= 400_000_000 and not at_middle:
            at_middle = mover.status().setpoint
    assert at_middle[:2] == pytest.approx([1e-3, 5e-4], abs=2e-5)
    look = mover.status()
    assert look.setpoint[:2] == [2e-3, 0.0]
    assert look.in_position
    assert 0.8 <= (mover.now_ns() - began) * 1e-9 < 1.3


def test_velocities_that_are_not_stated_are_slopes(mover: hil.VirtualMover) -> None:
    points = [point(0.1 * k, 1e-4 * k, 0.0) for k in range(1, 8)]
    followed = Trajectory(mover, trajectory(*points))
    speeds = []
    while not followed.advance():
        mover.sleep(0.005)
        speeds.append(mover.status().velocity[0])
    assert sorted(speeds)[len(speeds) // 2] == pytest.approx(1e-3, rel=0.1)
    assert mover.status().setpoint[0] == pytest.approx(7e-4, abs=1e-15)


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (trajectory(names=("x", "w")), "joints x, w: the rig has x, y, z, theta"),
        (trajectory(names=("x", "x")), "each once"),
        (trajectory(), "no points"),
        (trajectory(point(0.0, 0.0, 0.0)), "no point after the start"),
        (trajectory(point(1.0, 0.0)), "point 0: 1 positions, 0 velocities of 2 joints"),
        (trajectory(point(1.0, float("nan"), 0.0)), "point 0: a number is not finite"),
        (trajectory(point(1.0, 0.0, 0.0), point(1.0, 0.0, 0.0)), "point 1: 1 s, after 1 s"),
        (trajectory(point(1.0, 9.0, 0.0)), "x = 9: from -0.0"),
        (trajectory(point(0.0, 1e-3, 0.0), point(1.0, 0.0, 0.0)), "x stands at .*, the trajectory begins at 0.001"),
    ],
)
def test_what_cannot_be_followed_from_here_is_refused(mover: hil.VirtualMover, message: Message, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        Trajectory(mover, message)
    assert mover.status().number == 0


# the keys -------------------------------------------------------------------------------------------------------------


class Ros:
    """A router as ROS has one, our node on it, and a client's session."""

    def __init__(self, mover: hil.VirtualMover) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        config = zenoh.Config()
        config.insert_json5("mode", '"router"')
        config.insert_json5("listen/endpoints", f'["{endpoint}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        self._router = zenoh.open(config)
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["{endpoint}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        self.client = zenoh.open(config)
        self.rig = RosRig(mover, endpoint)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()
        while len(self.tokens()) < 7:  # as a client of an action waits for its server
            time.sleep(0.01)

    def tokens(self) -> list[str]:
        """All of ROS' graph."""
        return [str(reply.ok.key_expr) for reply in self.client.liveliness().get("@ros2_lv/0/**") if reply.ok]

    def _spin(self) -> None:
        while not self._ended.is_set():
            self.rig.step()

    def call(self, topic: str, name: str, request: Message) -> tuple[Message, bytes]:
        """As a client of a service does: the response, and its attachment."""
        key = f"0/{ACTION}/_action/{topic}/{dds_name(name)}/{type_hash(name)}"
        attachment = struct.pack("<qqB16s", 7, time.time_ns(), 16, b"g" * 16)
        target = zenoh.QueryTarget.ALL_COMPLETE
        payload = encode(f"{name}_Request", request)
        (reply,) = self.client.get(key, payload=payload, attachment=attachment, target=target, timeout=30.0)
        assert reply.ok is not None
        assert reply.ok.attachment is not None
        assert reply.ok.attachment.to_bytes() == attachment
        return decode(f"{name}_Response", reply.ok.payload.to_bytes()), attachment

    def send_goal(self, uuid: bytes, message: Message) -> bool:
        request = {"goal_id": {"uuid": list(uuid)}, "goal": {"trajectory": message}}
        return bool(self.call("send_goal", f"{FOLLOW}_SendGoal", request)[0]["accepted"])

    def result(self, uuid: bytes) -> Message:
        return self.call("get_result", f"{FOLLOW}_GetResult", {"goal_id": {"uuid": list(uuid)}})[0]

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self.rig.close()
        self.client.close()  # type: ignore[no-untyped-call]
        self._router.close()  # type: ignore[no-untyped-call]


@pytest.fixture
def ros(mover: hil.VirtualMover) -> Iterator[Ros]:
    ros = Ros(mover)
    yield ros
    ros.close()


@pytest.mark.long
def test_joint_states_are_published_under_the_key_that_ros_subscribes_to(ros: Ros) -> None:
    heard = ros.client.declare_subscriber(f"0/{STATES}/{dds_name(JOINTS)}/{type_hash(JOINTS)}")
    samples = [heard.recv() for _ in range(3)]
    state = decode(JOINTS, samples[-1].payload.to_bytes())
    assert state["name"] == ["x", "y", "z", "theta"]
    assert len(state["position"]) == len(state["velocity"]) == 4
    heads = [struct.unpack("<qqB16s", sample.attachment.to_bytes()) for sample in samples]  # type: ignore[union-attr]
    first = heads[0][0]
    assert [head[0] for head in heads] == [first, first + 1, first + 2]
    assert {head[2] for head in heads} == {16}
    assert abs(heads[-1][1] - time.time_ns()) < 60_000_000_000


@pytest.mark.long
def test_a_client_finds_the_action_sends_a_goal_and_hears_its_end(ros: Ros, mover: hil.VirtualMover) -> None:
    tokens = ros.tokens()
    kinds = sorted(token.split("/")[5] for token in tokens)
    assert kinds == ["MP", "MP", "MP", "NN", "SS", "SS", "SS"]
    assert any(f"/SS/%/%/hil/%{ACTION.replace('/', '%')}%_action%send_goal/" in token for token in tokens)
    goal = b"1" * 16
    assert ros.send_goal(goal, trajectory(point(0.3, 1e-3, 0.0)))
    assert ros.result(goal) == {"status": 4, "result": {"error_code": 0, "error_string": ""}}
    assert mover.status().setpoint[:2] == [1e-3, 0.0]
    assert ros.result(b"3" * 16)["status"] == 0
    assert not ros.send_goal(b"4" * 16, trajectory(point(0.3, 9.0, 0.0)))


@pytest.mark.long
def test_a_goal_is_canceled_and_the_axes_come_to_rest(ros: Ros, mover: hil.VirtualMover) -> None:
    goal = b"1" * 16
    assert ros.send_goal(goal, trajectory(point(3000.0, 2e-2, 0.0)))
    assert not ros.send_goal(b"2" * 16, trajectory(point(0.3, 0.0, 0.0)))  # one at a time
    cancel = {"goal_info": {"goal_id": {"uuid": [0] * 16}}}
    answer, _ = ros.call("cancel_goal", "action_msgs/srv/CancelGoal", cancel)
    assert (answer["return_code"], len(answer["goals_canceling"])) == (0, 1)
    assert ros.result(goal)["status"] == 5
    assert ros.call("cancel_goal", "action_msgs/srv/CancelGoal", cancel)[0]["return_code"] == 2
    assert mover.status().setpoint[0] < 1e-2
