"""ROS 2 messages without ROS: their fields and their type hashes (RIHS01, REP-2011). Their bytes: hil/adapters/cdr.py.

A type of a field is a basic one, `string`, or another message; with `[]` behind it
a sequence, with `[16]` an array, with `[<=1]` a sequence of at most one. Only what hil.adapters.ros2 needs is here.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any, Final

BASIC: Final = {  # struct letter; number of the type in type_description_interfaces/msg/FieldType
    "int8": ("b", 2), "uint8": ("B", 3), "uint16": ("H", 5), "int32": ("i", 6), "uint32": ("I", 7), "int64": ("q", 8),
    "float64": ("d", 11), "bool": ("?", 15), "string": ("", 17),
}  # fmt: skip
_NESTED: Final = 1
_SHAPES: Final = {"": 0, "array": 48, "bounded": 96, "sequence": 144}  # added to the number
_FIELD: Final = re.compile(r"([\w/]+)(?:\[(?:(<=)?(\d+))?\])?$")

_POINTS: Final = "trajectory_msgs/msg/JointTrajectoryPoint"
_MULTI: Final = "trajectory_msgs/msg/MultiDOFJointTrajectory"
_V3: Final = "geometry_msgs/msg/Vector3"
FOLLOW: Final = "control_msgs/action/FollowJointTrajectory"
_ENDS: Final = "name:string position:float64 velocity:float64 acceleration:float64"
_FIELDS: Final = {
    "builtin_interfaces/msg/Time": "sec:int32 nanosec:uint32",
    "builtin_interfaces/msg/Duration": "sec:int32 nanosec:uint32",
    "std_msgs/msg/Header": "stamp:builtin_interfaces/msg/Time frame_id:string",
    "sensor_msgs/msg/JointState": "header:std_msgs/msg/Header name:string[] position:float64[] velocity:float64[] "
    "effort:float64[]",
    _POINTS: "positions:float64[] velocities:float64[] accelerations:float64[] effort:float64[] "
    "time_from_start:builtin_interfaces/msg/Duration",
    "trajectory_msgs/msg/JointTrajectory": f"header:std_msgs/msg/Header joint_names:string[] points:{_POINTS}[]",
    _MULTI: f"header:std_msgs/msg/Header joint_names:string[] points:{_MULTI}Point[]",
    f"{_MULTI}Point": "transforms:geometry_msgs/msg/Transform[] velocities:geometry_msgs/msg/Twist[] "
    "accelerations:geometry_msgs/msg/Twist[] time_from_start:builtin_interfaces/msg/Duration",
    "geometry_msgs/msg/Transform": f"translation:{_V3} rotation:geometry_msgs/msg/Quaternion",
    "geometry_msgs/msg/Twist": f"linear:{_V3} angular:{_V3}",
    _V3: "x:float64 y:float64 z:float64",
    "geometry_msgs/msg/Quaternion": "x:float64 y:float64 z:float64 w:float64",
    "control_msgs/msg/JointTolerance": _ENDS,
    "control_msgs/msg/JointComponentTolerance": "joint_" + _ENDS.replace(" position", " component:uint16 position"),
    f"{FOLLOW}_Goal": f"trajectory:trajectory_msgs/msg/JointTrajectory multi_dof_trajectory:{_MULTI} "
    "path_tolerance:control_msgs/msg/JointTolerance[] "
    "component_path_tolerance:control_msgs/msg/JointComponentTolerance[] "
    "goal_tolerance:control_msgs/msg/JointTolerance[] "
    "component_goal_tolerance:control_msgs/msg/JointComponentTolerance[] "
    "goal_time_tolerance:builtin_interfaces/msg/Duration",
    f"{FOLLOW}_Result": "error_code:int32 error_string:string",
    f"{FOLLOW}_Feedback": f"header:std_msgs/msg/Header joint_names:string[] desired:{_POINTS} actual:{_POINTS} "
    f"error:{_POINTS} index:int32 multi_dof_joint_names:string[] multi_dof_desired:{_MULTI}Point "
    f"multi_dof_actual:{_MULTI}Point multi_dof_error:{_MULTI}Point multi_dof_index:int32",
    f"{FOLLOW}_FeedbackMessage": f"goal_id:unique_identifier_msgs/msg/UUID feedback:{FOLLOW}_Feedback",
    "unique_identifier_msgs/msg/UUID": "uuid:uint8[16]",
    f"{FOLLOW}_SendGoal_Request": f"goal_id:unique_identifier_msgs/msg/UUID goal:{FOLLOW}_Goal",
    f"{FOLLOW}_SendGoal_Response": "accepted:bool stamp:builtin_interfaces/msg/Time",
    f"{FOLLOW}_GetResult_Request": "goal_id:unique_identifier_msgs/msg/UUID",
    f"{FOLLOW}_GetResult_Response": f"status:int8 result:{FOLLOW}_Result",
    "action_msgs/msg/GoalInfo": "goal_id:unique_identifier_msgs/msg/UUID stamp:builtin_interfaces/msg/Time",
    "action_msgs/msg/GoalStatus": "goal_info:action_msgs/msg/GoalInfo status:int8",
    "action_msgs/msg/GoalStatusArray": "status_list:action_msgs/msg/GoalStatus[]",
    "action_msgs/srv/CancelGoal_Request": "goal_info:action_msgs/msg/GoalInfo",
    "action_msgs/srv/CancelGoal_Response": "return_code:int8 goals_canceling:action_msgs/msg/GoalInfo[]",
    "service_msgs/msg/ServiceEventInfo": "event_type:uint8 stamp:builtin_interfaces/msg/Time client_gid:uint8[16] "
    "sequence_number:int64",
}
SERVICES: Final = (f"{FOLLOW}_SendGoal", f"{FOLLOW}_GetResult", "action_msgs/srv/CancelGoal")


def parsed(fields: str) -> dict[str, tuple[str, str, int]]:
    """Of each field: type, shape, size."""
    found = {}
    for field in fields.split():
        name, _, kind = field.partition(":")
        match = _FIELD.match(kind)
        assert match is not None, field
        shape = "" if "[" not in kind else "sequence" if not match[3] else "bounded" if match[2] else "array"
        found[name] = (match[1], shape, int(match[3] or 0))
    return found


def _services() -> dict[str, str]:
    """What the types of a service consist of, by rosidl."""
    found = {}
    for name in SERVICES:
        found[f"{name}_Event"] = (
            f"info:service_msgs/msg/ServiceEventInfo request:{name}_Request[<=1] response:{name}_Response[<=1]"
        )
        found[name] = f"request_message:{name}_Request response_message:{name}_Response event_message:{name}_Event"
    return found


TYPES: Final = {name: parsed(fields) for name, fields in {**_FIELDS, **_services()}.items()}


def type_hash(name: str, types: Mapping[str, dict[str, tuple[str, str, int]]] = TYPES) -> str:
    """As rosidl computes it: SHA-256 of the description as JSON, with all that it refers to, sorted by name."""
    needed, waiting = {name}, [name]
    while waiting:
        for kind, _, _ in types[waiting.pop()].values():
            if kind not in BASIC and kind not in needed:
                needed.add(kind)
                waiting.append(kind)
    described = {kind: _description(kind, types[kind]) for kind in needed}
    text = json.dumps(
        {
            "type_description": described.pop(name),
            "referenced_type_descriptions": [described[kind] for kind in sorted(described)],
        }
    )
    return f"RIHS01_{hashlib.sha256(text.encode()).hexdigest()}"


def _description(name: str, fields: dict[str, tuple[str, str, int]]) -> dict[str, Any]:
    rows = []
    for field, (kind, shape, size) in fields.items():
        nested = "" if kind in BASIC else kind
        number = (_NESTED if nested else BASIC[kind][1]) + _SHAPES[shape]
        rows.append(
            {
                "name": field,
                "type": {"type_id": number, "capacity": size, "string_capacity": 0, "nested_type_name": nested},
            }
        )
    return {"type_name": name, "fields": rows}


def dds_name(name: str) -> str:
    """As keys have it: sensor_msgs::msg::dds_::JointState_."""
    *folders, last = name.split("/")
    return "::".join([*folders, "dds_", f"{last}_"])
