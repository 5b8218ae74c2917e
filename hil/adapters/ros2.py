"""A rig in ROS 2, through the keys of rmw_zenoh: joint states out, trajectories in. No ROS is needed here.

    with hil.motion("microscope") as mover, RosRig(mover, "tcp/127.0.0.1:7447") as ros:  # of the ROS router
        ros.spin()

Publishes /joint_states 50 times a second; serves the action FollowJointTrajectory under ACTION. A trajectory begins
where the axes stand. It is followed through its points, with the velocities that they state or differences, and is
over once the axes are in position. One at a time: another one is refused meanwhile.
"""

import hashlib
import queue
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Final

import zenoh

from hil.adapters.cdr import Message, decode, encode
from hil.adapters.ros_trajectory import Trajectory
from hil.adapters.ros_types import FOLLOW, dds_name, type_hash
from hil.cycle.goal import GoalRefusedError, MotionError
from hil.live.mapped_file import Closing
from hil.runs.mover import Mover
from hil.telemetry.session import client_config

STATES: Final = "joint_states"
ACTION: Final = "joint_trajectory_controller/follow_joint_trajectory"
PERIOD_S: Final = 0.02
ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(1, 7)  # action_msgs/msg/GoalStatus
PATH_TOLERANCE_VIOLATED: Final = -4  # control_msgs/action/FollowJointTrajectory
_CANCEL: Final = "action_msgs/srv/CancelGoal"
_STATUSES: Final = "action_msgs/msg/GoalStatusArray"
_QOS: Final = "::,10:,:,:,,"  # rmw_zenoh's word for its defaults, ten deep
_KEPT: Final = 32  # results that are still told


class RosRig(Closing):
    """A node with one publisher and one action. domain: ROS_DOMAIN_ID. name: of the node.

    Raises zenoh.ZError where no router answers at the endpoint.
    """

    def __init__(self, mover: Mover, endpoint: str, *, domain: int = 0, name: str = "hil") -> None:
        self._mover, self._domain, self._name = mover, domain, name
        self._asked: queue.SimpleQueue[tuple[Callable[[zenoh.Query, Message], None], str, zenoh.Query]]
        self._asked = queue.SimpleQueue()
        self._sequences: dict[str, int] = {}
        self._gids: dict[str, bytes] = {}
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._goal: tuple[bytes, Trajectory] | None = None
        self._results: dict[bytes, Message] = {}
        self._waiting: list[tuple[bytes, zenoh.Query]] = []  # who asked for a result that is not there yet
        with ExitStack() as undo:
            self._session = undo.enter_context(zenoh.open(client_config(endpoint)))
            self._tokens: list[zenoh.LivelinessToken] = []
            self._declare("", "NN", "")
            self._publish(STATES, "sensor_msgs/msg/JointState")
            self._publish(f"{ACTION}/_action/feedback", f"{FOLLOW}_FeedbackMessage")
            self._publish(f"{ACTION}/_action/status", _STATUSES)
            self._serve(f"{ACTION}/_action/send_goal", f"{FOLLOW}_SendGoal", self._begin)
            self._serve(f"{ACTION}/_action/get_result", f"{FOLLOW}_GetResult", self._await)
            self._serve(f"{ACTION}/_action/cancel_goal", _CANCEL, self._cancel)
            self._undo = undo.pop_all()

    # keys -------------------------------------------------------------------------------------------------------------

    def _declare(self, topic: str, kind: str, name: str) -> None:
        """Say in ROS' graph that there is such an entity; without a topic it is the node."""
        key = f"@ros2_lv/{self._domain}/{self._session.zid()}/0/{len(self._tokens)}/{kind}/%/%/{self._name}"
        if topic:
            key += f"/%{topic.replace('/', '%')}/{dds_name(name)}/{type_hash(name)}/{_QOS}"
        self._gids[topic] = hashlib.blake2b(key.encode(), digest_size=16).digest()
        self._tokens.append(self._session.liveliness().declare_token(key))

    def _publish(self, topic: str, name: str) -> None:
        key = f"{self._domain}/{topic}/{dds_name(name)}/{type_hash(name)}"
        self._publishers[topic] = self._session.declare_publisher(key)
        self._sequences[topic] = 0
        self._declare(topic, "MP", name)

    def _serve(self, topic: str, name: str, handle: Callable[[zenoh.Query, Message], None]) -> None:
        """Any hash is answered: message definitions of ROS' releases differ where it does not matter here."""
        key = f"{self._domain}/{topic}/{dds_name(name)}/*"
        self._session.declare_queryable(key, lambda query: self._asked.put((handle, name, query)), complete=True)
        self._declare(topic, "SS", name)

    def _put(self, topic: str, name: str, message: Message) -> None:
        self._sequences[topic] += 1
        gid = self._gids[topic]
        head = self._sequences[topic].to_bytes(8, "little") + time.time_ns().to_bytes(8, "little")
        self._publishers[topic].put(encode(name, message), attachment=head + bytes([len(gid)]) + gid)

    @staticmethod
    def _reply(query: zenoh.Query, name: str, message: Message) -> None:
        """To the asker; the attachment, which names the request, goes back as it came."""
        query.reply(query.key_expr, encode(name, message), attachment=query.attachment)
        query.drop()  # type: ignore[no-untyped-call]

    # the action -------------------------------------------------------------------------------------------------------

    def _begin(self, query: zenoh.Query, request: Message) -> None:
        goal_id, accepted = bytes(request["goal_id"]["uuid"]), False
        if self._goal is None and goal_id not in self._results:
            try:
                self._goal = goal_id, Trajectory(self._mover, request["goal"]["trajectory"])
                accepted = True
            except (ValueError, MotionError) as refused:
                print(f"trajectory refused: {refused}", flush=True)
        self._reply(query, f"{FOLLOW}_SendGoal_Response", {"accepted": accepted, "stamp": _stamp()})
        if accepted:
            self._tell_status(EXECUTING)

    def _await(self, query: zenoh.Query, request: Message) -> None:
        self._waiting.append((bytes(request["goal_id"]["uuid"]), query))

    def _cancel(self, query: zenoh.Query, request: Message) -> None:
        """All zeros: every goal."""
        wanted, found = bytes(request["goal_info"]["goal_id"]["uuid"]), []
        if self._goal is not None and wanted in (self._goal[0], bytes(16)):
            found.append({"goal_id": {"uuid": list(self._goal[0])}, "stamp": _stamp()})
            self._goal[1].cancel()
            self._tell_status(CANCELING)
        answer = {"return_code": 0 if found else 2, "goals_canceling": found}  # 2: no such goal
        self._reply(query, f"{_CANCEL}_Response", answer)

    def _follow(self) -> None:
        """Go on with the trajectory that is followed."""
        if self._goal is None:
            return
        goal_id, trajectory = self._goal
        try:
            if trajectory.advance():
                self._end(goal_id, CANCELED if trajectory.canceled else SUCCEEDED, 0, "")
        except (GoalRefusedError, MotionError) as error:
            self._end(goal_id, ABORTED, PATH_TOLERANCE_VIOLATED, str(error))

    def _end(self, goal_id: bytes, status: int, code: int, why: str) -> None:
        self._tell_status(status)
        self._goal = None
        self._results[goal_id] = {"status": status, "result": {"error_code": code, "error_string": why}}
        if len(self._results) > _KEPT:
            del self._results[next(iter(self._results))]

    def _tell_status(self, status: int) -> None:
        assert self._goal is not None
        info = {"goal_id": {"uuid": list(self._goal[0])}, "stamp": _stamp()}
        self._put(f"{ACTION}/_action/status", _STATUSES, {"status_list": [{"goal_info": info, "status": status}]})

    def _tell_results(self) -> None:
        """To who waits for one; of a goal that was never taken: status 0."""
        waiting, self._waiting = self._waiting, []
        for goal_id, query in waiting:
            if self._goal is not None and self._goal[0] == goal_id:
                self._waiting.append((goal_id, query))
            else:
                self._reply(query, f"{FOLLOW}_GetResult_Response", self._results.get(goal_id, {}))

    # ------------------------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """One round: what was asked, the trajectory, the joint states. Takes PERIOD_S of the rig's time.

        Raises MotionError where the rig is no longer ours to move.
        """
        while not self._asked.empty():
            handle, name, query = self._asked.get()
            try:
                handle(query, decode(f"{name}_Request", query.payload.to_bytes() if query.payload else b""))
            except ValueError as error:
                print(f"{query.key_expr}: {error}", flush=True)
                query.drop()  # type: ignore[no-untyped-call]
        self._follow()
        self._tell_results()
        look = self._mover.status()
        names = {"name": list(self._mover.axes), "position": look.position, "velocity": look.velocity}
        self._put(STATES, "sensor_msgs/msg/JointState", {"header": {"stamp": _stamp()}, **names})
        self._mover.sleep(PERIOD_S)

    def spin(self) -> None:
        """Until Ctrl-C. Raises as `step`."""
        while True:
            self.step()

    def close(self) -> None:
        """Leave ROS' graph; the rig goes on holding."""
        self._undo.close()


def _stamp() -> Message:
    now = time.time_ns()
    return {"sec": now // 1_000_000_000, "nanosec": now % 1_000_000_000}
