# SPDX-License-Identifier: Apache-2.0
"""A ROS 2 node of another make, in a process of its own: types written by hand, encoded by the DDS
library itself. It shares nothing with motord.

    ros2_peer.py DOMAIN topic NAME TYPE [late]   a line of JSON for each sample
    ros2_peer.py DOMAIN drive NAME V W [AGE_S]   20 TwistStamped a second; age "zero": the stamp 0
    ros2_peer.py DOMAIN twist NAME V W           20 Twist a second
    ros2_peer.py DOMAIN say NAME TEXT            one String, again and again
    ros2_peer.py DOMAIN call NAME TYPE [JSON]    one request, its reply as JSON
    ros2_peer.py DOMAIN endpoints                a line of JSON for each endpoint that is seen
"""

import dataclasses
import json
import sys
import time
from dataclasses import dataclass

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import (
    array,
    bounded_str,
    byte,
    float64,
    int32,
    int64,
    sequence,
    uint8,
    uint32,
    uint64,
)
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

LOCALHOST = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto"
    "</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers>"
    '<Peer address="localhost"/></Peers></Discovery></Domain></CycloneDDS>'
)
DEADLINE_S = 30.0
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
class ChangeRequest(IdlStruct, typename="lifecycle_msgs::srv::dds_::ChangeState_Request_"):
    guid: uint64
    seq: int64
    transition: Transition


@dataclass
class ChangeReply(IdlStruct, typename="lifecycle_msgs::srv::dds_::ChangeState_Response_"):
    guid: uint64
    seq: int64
    success: bool


TOPICS = {kind.__name__: kind for kind in (Odometry, JointState, String, Entities)}
SERVICES = {
    "Trigger": (TriggerRequest, TriggerReply),
    "SetParameters": (SetRequest, SetReply),
    "GetParameters": (GetRequest, GetReply),
    "GetState": (StateRequest, StateReply),
    "ChangeState": (ChangeRequest, ChangeReply),
}
RELIABLE = (
    Policy.Reliability.Reliable(duration(milliseconds=100)),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


def say(value):
    print(json.dumps(value, default=list), flush=True)


def topic(participant, name, kind, late=""):
    durability = Policy.Durability.TransientLocal if late else Policy.Durability.Volatile
    reader = DataReader(
        participant, Topic(participant, name, TOPICS[kind]), Qos(*RELIABLE, durability)
    )
    while True:
        for sample in reader.take_iter(timeout=duration(seconds=DEADLINE_S)):
            say(dataclasses.asdict(sample))


def _publish(participant, name, kind, make):
    writer = DataWriter(participant, Topic(participant, name, kind), Qos(*RELIABLE))
    while True:
        writer.write(make())
        time.sleep(0.05)


def _twist(linear_m_s, angular_rad_s):
    return Twist(Vector3(float(linear_m_s), 0.0, 0.0), Vector3(0.0, 0.0, float(angular_rad_s)))


def twist(participant, name, linear_m_s, angular_rad_s):
    _publish(participant, name, Twist, lambda: _twist(linear_m_s, angular_rad_s))


def drive(participant, name, linear_m_s, angular_rad_s, age_s="0"):
    def make():
        stamp_ns = 0 if age_s == "zero" else time.time_ns() - round(float(age_s) * 1e9)
        stamp = Time(*divmod(stamp_ns, 1_000_000_000))
        return TwistStamped(Header(stamp, ""), _twist(linear_m_s, angular_rad_s))

    _publish(participant, name, TwistStamped, make)


def _say_text(participant, name, text):
    _publish(participant, name, String, lambda: String(text))


def _built(kind, values):
    """From plain values, nested."""
    hints = {"parameters": Parameter, "value": ParameterValue, "transition": Transition}
    made = {}
    for key, value in values.items():
        inner = hints.get(key)
        if inner and isinstance(value, list):
            made[key] = [_built(inner, item) for item in value]
        else:
            made[key] = _built(inner, value) if inner else value
    return kind(**made)


def call(participant, name, kind, values="{}"):
    request, reply = SERVICES[kind]
    client = Policy.Userdata(b"clientid=1.2.3.4.5.6.7.8.9.a.b.c.d.e.f.%x;" % (time.time_ns() % 256))
    reader = DataReader(
        participant, Topic(participant, f"rr{name}Reply", reply), Qos(*RELIABLE, client)
    )
    writer = DataWriter(
        participant, Topic(participant, f"rq{name}Request", request), Qos(*RELIABLE, client)
    )
    end_s = time.monotonic() + DEADLINE_S
    while not (writer.get_matched_subscriptions() and reader.get_matched_publications()):
        assert time.monotonic() < end_s, f"nobody serves {name}"
        time.sleep(0.01)
    guid = writer.instance_handle & 0xFFFFFFFFFFFFFFFF
    writer.write(_built(request, {"guid": guid, "seq": 1, **json.loads(values)}))
    for sample in reader.take_iter(timeout=duration(seconds=DEADLINE_S)):
        if sample.guid == guid:
            say(dataclasses.asdict(sample))
            return


def endpoints(participant):
    readers = [
        BuiltinDataReader(participant, kind)
        for kind in (BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription)
    ]
    while True:
        for reader in readers:
            for found in reader.take(100):
                if found.sample_info.valid_data and found.participant_key != participant.guid:
                    data = [policy for policy in found.qos if isinstance(policy, Policy.Userdata)]
                    say(
                        {
                            "topic": found.topic_name,
                            "type": found.type_name,
                            "user_data": data[0].data.decode() if data else "",
                        }
                    )
        time.sleep(0.05)


COMMANDS = {
    "topic": topic, "drive": drive, "twist": twist, "say": _say_text, "call": call,
    "endpoints": endpoints,
}  # fmt: skip


def main():
    number, command, *words = sys.argv[1:]
    with_domain = Domain(int(number), LOCALHOST)
    COMMANDS[command](DomainParticipant(int(number)), *words)
    del with_domain  # until now: it ends with its last reference


if __name__ == "__main__":
    main()
