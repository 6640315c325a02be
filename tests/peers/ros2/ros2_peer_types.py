# SPDX-License-Identifier: Apache-2.0
"""Message types of ROS 2 for ros2_peer.py, written by hand. The DDS library encodes them."""

from dataclasses import dataclass
from types import SimpleNamespace

from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl.types import (
    array,
    bounded_str,
    byte,
    float64,
    int8,
    int32,
    int64,
    sequence,
    uint8,
    uint32,
    uint64,
)
from tests.peers.ros2.ros2_peer_descriptions import DescribeReply, DescribeRequest

GEOMETRY = "geometry_msgs::msg::dds_::"


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


@dataclass
class Vector3(IdlStruct, typename=GEOMETRY + "Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Point(IdlStruct, typename=GEOMETRY + "Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename=GEOMETRY + "Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename=GEOMETRY + "Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename=GEOMETRY + "PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class Twist(IdlStruct, typename=GEOMETRY + "Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistStamped(IdlStruct, typename=GEOMETRY + "TwistStamped_"):
    header: Header
    twist: Twist


@dataclass
class TwistWithCovariance(IdlStruct, typename=GEOMETRY + "TwistWithCovariance_"):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class Transform(IdlStruct, typename=GEOMETRY + "Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename=GEOMETRY + "TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: array[uint8, 16]


@dataclass
class NodeEntities(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: bounded_str[256]
    node_name: bounded_str[256]
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]


@dataclass
class Entities(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid: Gid
    node_entities_info_seq: sequence[NodeEntities]


@dataclass
class Log(IdlStruct, typename="rcl_interfaces::msg::dds_::Log_"):
    stamp: Time
    level: uint8
    name: str
    msg: str
    file: str
    function: str
    line: uint32


@dataclass
class HumbleGid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: array[uint8, 24]


@dataclass
class HumbleNode(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: bounded_str[256]
    node_name: bounded_str[256]
    reader_gid_seq: sequence[HumbleGid]
    writer_gid_seq: sequence[HumbleGid]


@dataclass
class HumbleEntities(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid: HumbleGid
    node_entities_info_seq: sequence[HumbleNode]


@dataclass
class TriggerRequest(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    guid: uint64
    seq: int64
    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class TriggerReply(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    guid: uint64
    seq: int64
    success: bool
    message: str


@dataclass
class SetBoolRequest(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Request_"):
    guid: uint64
    seq: int64
    data: bool


@dataclass
class SetBoolReply(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Response_"):
    guid: uint64
    seq: int64
    success: bool
    message: str


@dataclass
class ParameterValue(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterValue_"):
    type: uint8 = 0
    bool_value: bool = False
    integer_value: int64 = 0
    double_value: float64 = 0.0
    string_value: str = ""
    byte_array_value: sequence[byte] = ()
    bool_array_value: sequence[bool] = ()
    integer_array_value: sequence[int64] = ()
    double_array_value: sequence[float64] = ()
    string_array_value: sequence[str] = ()


@dataclass
class Parameter(IdlStruct, typename="rcl_interfaces::msg::dds_::Parameter_"):
    name: str
    value: ParameterValue


@dataclass
class SetResult(IdlStruct, typename="rcl_interfaces::msg::dds_::SetParametersResult_"):
    successful: bool
    reason: str


@dataclass
class SetRequest(IdlStruct, typename="rcl_interfaces::srv::dds_::SetParameters_Request_"):
    guid: uint64
    seq: int64
    parameters: sequence[Parameter]


@dataclass
class SetReply(IdlStruct, typename="rcl_interfaces::srv::dds_::SetParameters_Response_"):
    guid: uint64
    seq: int64
    results: sequence[SetResult]


@dataclass
class GetRequest(IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameters_Request_"):
    guid: uint64
    seq: int64
    names: sequence[str]


@dataclass
class GetReply(IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameters_Response_"):
    guid: uint64
    seq: int64
    values: sequence[ParameterValue]


@dataclass
class State(IdlStruct, typename="lifecycle_msgs::msg::dds_::State_"):
    id: uint8
    label: str


@dataclass
class Transition(IdlStruct, typename="lifecycle_msgs::msg::dds_::Transition_"):
    id: uint8
    label: str


@dataclass
class StateRequest(IdlStruct, typename="lifecycle_msgs::srv::dds_::GetState_Request_"):
    guid: uint64
    seq: int64
    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class StateReply(IdlStruct, typename="lifecycle_msgs::srv::dds_::GetState_Response_"):
    guid: uint64
    seq: int64
    current_state: State


@dataclass
class TransitionEvent(IdlStruct, typename="lifecycle_msgs::msg::dds_::TransitionEvent_"):
    timestamp: uint64
    transition: Transition
    start_state: State
    goal_state: State


@dataclass
class ParameterEvent(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterEvent_"):
    stamp: Time
    node: str
    new_parameters: sequence[Parameter]
    changed_parameters: sequence[Parameter]
    deleted_parameters: sequence[Parameter]


@dataclass
class ChangeRequest(IdlStruct, typename="lifecycle_msgs::srv::dds_::ChangeState_Request_"):
    guid: uint64
    seq: int64
    transition: Transition


@dataclass
class ChangeReply(IdlStruct, typename="lifecycle_msgs::srv::dds_::ChangeState_Response_"):
    guid: uint64
    seq: int64
    success: bool


@dataclass
class Uuid(IdlStruct, typename="unique_identifier_msgs::msg::dds_::UUID_"):
    uuid: array[uint8, 16]


@dataclass
class GoalInfo(IdlStruct, typename="action_msgs::msg::dds_::GoalInfo_"):
    goal_id: Uuid
    stamp: Time


@dataclass
class GoalStatus(IdlStruct, typename="action_msgs::msg::dds_::GoalStatus_"):
    goal_info: GoalInfo
    status: int8


@dataclass
class GoalStatusArray(IdlStruct, typename="action_msgs::msg::dds_::GoalStatusArray_"):
    status_list: sequence[GoalStatus]


@dataclass
class CancelRequest(IdlStruct, typename="action_msgs::srv::dds_::CancelGoal_Request_"):
    guid: uint64
    seq: int64
    goal_info: GoalInfo


@dataclass
class CancelReply(IdlStruct, typename="action_msgs::srv::dds_::CancelGoal_Response_"):
    guid: uint64
    seq: int64
    return_code: int8
    goals_canceling: sequence[GoalInfo]


def _action(name, goal, result, feedback):
    """Return the message types of an action whose goal, result and feedback have these fields."""

    def made(ending, fields):
        return make_idl_struct(name + ending, f"motord_msgs::action::dds_::{name}{ending}_", fields)

    header = {"guid": uint64, "seq": int64}
    parts = {
        part: made(f"_{part.capitalize()}", dict(zip(keys.split(), kinds, strict=True)))
        for part, (keys, kinds) in {"goal": goal, "result": result, "feedback": feedback}.items()
    }
    return SimpleNamespace(
        goal=parts["goal"],
        send=made("_SendGoal_Request", header | {"goal_id": Uuid, "goal": parts["goal"]}),
        sent=made("_SendGoal_Response", header | {"accepted": bool, "stamp": Time}),
        ask=made("_GetResult_Request", header | {"goal_id": Uuid}),
        outcome=made("_GetResult_Response", header | {"status": int8, "result": parts["result"]}),
        feedback=made("_FeedbackMessage", {"goal_id": Uuid, "feedback": parts["feedback"]}),
    )


@dataclass
class MotorStatus(IdlStruct, typename="motord_msgs::msg::dds_::MotorStatus_"):
    header: Header
    state: str
    armed: bool
    at_rest: bool
    rest: str
    rest_unknown: sequence[str]
    rest_unknown_s: sequence[float64]
    rest_unmeasured: sequence[str]
    faults: sequence[str]
    why: sequence[str]
    reasons: sequence[str]
    commander: str
    commander_priority: int32
    commander_why: str
    command_age_s: float64
    setpoint_linear_m_s: float64
    setpoint_angular_rad_s: float64
    setpoint_lateral_m_s: float64
    slip_m_s: float64
    name: sequence[str]
    setpoint_rad_s: sequence[float64]
    duty: sequence[float64]
    current_a: sequence[float64]
    voltage_v: sequence[float64]
    temperature_c: sequence[float64]
    feedback_age_s: sequence[float64]
    drive_faults: sequence[uint32]
    stale: sequence[bool]


ACTIONS = {
    "DriveDistance": _action(
        "DriveDistance",
        ("distance_m speed_m_s tolerance_m timeout_s direction_rad", [float64] * 5),
        ("distance_m turned_rad duration_s message", [float64, float64, float64, str]),
        ("distance_m remaining_m speed_m_s", [float64] * 3),
    ),
    "Rotate": _action(
        "Rotate",
        ("angle_rad speed_rad_s tolerance_rad timeout_s", [float64] * 4),
        ("angle_rad moved_m duration_s message", [float64, float64, float64, str]),
        ("angle_rad remaining_rad speed_rad_s", [float64] * 3),
    ),
    "Calibrate": _action(
        "Calibrate",
        ("quantity true_distance_m true_angle_rad timeout_s", [str] + [float64] * 3),
        (
            "factor wheel_radius_m track_m distance_m angle_rad message",
            [float64, float64, float64, float64, float64, str],
        ),
        ("distance_m angle_rad at_rest", [float64, float64, bool]),
    ),
}
TOPICS = {
    kind.__name__: kind
    for kind in (
        Odometry,
        JointState,
        String,
        TFMessage,
        Entities,
        HumbleEntities,
        MotorStatus,
        Log,
        GoalStatusArray,
        TransitionEvent,
        ParameterEvent,
    )
}
SERVICES = {
    "Trigger": (TriggerRequest, TriggerReply),
    "SetBool": (SetBoolRequest, SetBoolReply),
    "SetParameters": (SetRequest, SetReply),
    "GetParameters": (GetRequest, GetReply),
    "GetState": (StateRequest, StateReply),
    "ChangeState": (ChangeRequest, ChangeReply),
    "GetTypeDescription": (DescribeRequest, DescribeReply),
}
