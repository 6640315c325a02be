# SPDX-License-Identifier: Apache-2.0
"""ROS 2 on DDS, with a participant in another process that follows rmw_cyclonedds."""

import hashlib
import json
import signal

import pytest
from tests.peers.ros2.ros2_stage import (
    LEASE_S,
    NAMESPACE,
    called,
    inputs,
    no_source_commands,
    peer,
    ros2_stage,
)
from tests.sim.daemon_stage import wait_until

from motord.bus.messages.table import type_hash

pytest.importorskip("cyclonedds", reason="needs cyclonedds")
pytestmark = pytest.mark.usefixtures("settled")


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with ros2_stage(tmp_path_factory.mktemp("ros2")) as stage:
        yield stage


def released(stage):
    """Reset through the service. Repeat it, because a busy machine may delay a stop request."""
    wait_until(lambda: called("reset")["success"] and stage.state() == "idle", "idle")


def test_odometry_follows_the_commands_of_another_node(armed):
    with (
        peer("topic", f"rt{NAMESPACE}/odom", "Odometry") as ear,
        peer("drive", f"rt{NAMESPACE}/cmd_vel", 0.3, 0.2),
    ):
        moved = ear.find(lambda sample: sample["twist"]["twist"]["linear"]["x"] > 0.1, "motion")
    assert moved["header"]["frame_id"] == "r2/odom"
    assert moved["child_frame_id"] == "r2/base_link"
    assert moved["twist"]["twist"]["angular"]["z"] > 0.0
    commanding = armed.robot.status()["commands"]
    assert commanding["accepted"] > 0


def wheel_speeds(stage):
    joints = stage.sim.truth().joints
    return {name: joint.velocity_rad_s for name, joint in joints.items()}


def test_wheels_turn_as_another_node_commands_and_rest_when_it_leaves(armed):
    with peer("joints", f"rt{NAMESPACE}/joint_commands", "right=1.0", "left=2.0"):
        wait_until(
            lambda: wheel_speeds(armed) == pytest.approx({"left": 2.0, "right": 1.0}, abs=0.2),
            "the wheels' speeds",
        )
    wait_until(lambda: armed.sim.truth().at_rest, "the wheels rest")


@pytest.mark.parametrize("words", [("left=2.0", "tail=1.0"), ("left=nan",), ("left=2.0", "3600")])
def test_joint_commands_that_are_unknown_not_finite_or_old_move_nothing(armed, words):
    before, x_m = sent(armed) + refused(armed), armed.sim.truth().x_m
    with peer("joints", f"rt{NAMESPACE}/joint_commands", *words):
        wait_until(lambda: sent(armed) + refused(armed) > before + 10, "commands")
    assert armed.sim.truth().x_m == x_m


def test_a_joint_command_moves_nothing_while_disarmed(stage):
    before = sent(stage)
    with peer("joints", f"rt{NAMESPACE}/joint_commands", "left=2.0"):
        wait_until(lambda: sent(stage) > before + 10, "commands")
        assert stage.state() == "idle"
    no_source_commands(stage)


def test_the_robot_stops_when_the_other_node_leaves(armed):
    with peer("drive", f"rt{NAMESPACE}/cmd_vel", 0.3, 0.0):
        armed.wait_for("moving")
    wait_until(lambda: armed.sim.truth().at_rest, "the wheels rest")
    armed.wait_for("armed")


def test_a_command_moves_nothing_while_disarmed(stage):
    accepted = inputs(stage)["ros2"]["sent"]
    with peer("drive", f"rt{NAMESPACE}/cmd_vel", 0.3, 0.0):
        wait_until(lambda: inputs(stage)["ros2"]["sent"] > accepted + 10, "commands")
        assert stage.state() == "idle"
    no_source_commands(stage)


def test_services_answer_with_the_daemons_state_or_refusal(stage):
    answer = called("disarm")
    assert answer["success"]
    assert answer["message"] in ("idle", "configuring")
    assert called("estop")["success"]
    stage.wait_for("estop")
    refused = called("arm")
    assert not refused["success"]
    assert "emergency stop" in refused["message"]
    assert called("reset")["success"]
    stage.wait_for("idle")


def test_the_set_armed_service_arms_and_disarms(stage):
    wait_until(lambda: called("set_armed", "SetBool", data=True)["success"], "armed")
    stage.wait_for("armed")
    assert called("set_armed", "SetBool", data=False)["success"]
    stage.wait_for("idle")


@pytest.mark.parametrize("how", [(), ("best",)], ids=["reliable", "best effort"])
def test_the_estop_topic_stops_as_the_service_does(stage, how):
    with peer("say", f"rt{NAMESPACE}/motord/estop", "a person is too close", *how):
        stage.wait_for("estop")
    assert "estop: a writer is not served" not in stage.logged()
    released(stage)


def test_the_node_that_stopped_the_robot_is_named_with_its_reason(stage):
    reason = "input.ros2: by /watcher: 'a person is too close' (process "

    def found():
        return any(why.startswith(reason) for why in stage.robot.status()["why"])

    with peer("say", f"rt{NAMESPACE}/motord/estop", "a person is too close", "best", "watcher"):
        wait_until(found, "the reason")
        with peer("topic", f"rt{NAMESPACE}/motor_status", "MotorStatus") as ear:
            ear.find(lambda sent: any(why.startswith(reason) for why in sent["why"]), "the reason")
    assert f"emergency stop: {reason}" in stage.logged()
    released(stage)
    assert called("estop")["success"]
    assert stage.robot.status()["why"][0].startswith("input.ros2: by endpoint ")
    assert called("reset")["success"]
    stage.wait_for("idle")


def test_errors_are_on_rosout_for_a_late_subscriber_too(stage):
    assert called("estop")["success"]
    with peer("topic", "rt/rosout", "Log", "late") as ear:
        # the history begins with warnings of earlier tests
        error = ear.find(
            lambda log: (
                log["level"] == 40
                and (log["msg"].startswith("estop: ") or "by endpoint" in log["msg"])
            ),
            "the error",
        )
    assert error["name"] == "r2.motord"
    assert called("reset")["success"]
    stage.wait_for("idle")


def test_two_rival_writers_are_named_with_their_rates(armed):
    topic = f"rt{NAMESPACE}/cmd_vel"

    def rivals():
        return inputs(armed)["ros2"]["rivals"].get("cmd_vel", ())

    with peer("drive", topic, 0.1, 0.0, 0, "planner"), peer("drive", topic, 0.0, 0.3, 0, "panel"):
        wait_until(
            lambda: (
                {row["from"] for row in rivals() if row["rate_hz"] > 0.0} == {"/planner", "/panel"}
            ),
            "the rivals",
        )
    assert "command against each other" in armed.logged()
    wait_until(lambda: not inputs(armed)["ros2"]["rivals"], "the end of the contest")


def test_a_late_subscriber_gets_the_robot_description(stage):
    with peer("topic", f"rt{NAMESPACE}/robot_description", "String", "late") as ear:
        sent = ear.find(lambda _: True, "the description")
    assert sent["data"].startswith("<robot name=")
    with peer("topic", f"rt{NAMESPACE}/joint_states", "JointState") as ear:
        names = ear.find(lambda _: True, "joints")["name"]
    assert names
    assert all(f'<joint name="{name}" type="continuous"' in sent["data"] for name in names)


def test_a_late_subscriber_gets_the_static_frames(stage):
    with peer("topic", "rt/tf_static", "TFMessage", "late") as ear:
        sent = ear.find(lambda _: True, "the frames")
    (frame,) = sent["transforms"]
    assert frame["header"]["frame_id"] == "r2/base_link"
    assert frame["child_frame_id"] == "r2/base_footprint"


def test_transforms_are_on_the_shared_topic_with_the_robots_own_frames(stage):
    with peer("topic", "rt/tf", "TFMessage") as ear:
        (frame,) = ear.find(lambda _: True, "a transform")["transforms"]
    assert frame["header"]["frame_id"] == "r2/odom"
    assert frame["child_frame_id"] == "r2/base_link"


def test_the_graph_shows_one_node_with_all_its_endpoints(stage):
    with peer("topic", "ros_discovery_info", "Entities", "late") as ear:
        # The node of an earlier test may still be in the domain until its last reference goes.
        (node,) = ear.find(
            lambda found: [
                node
                for node in found["node_entities_info_seq"]
                if node["node_namespace"] == NAMESPACE
            ],
            "the graph",
        )["node_entities_info_seq"]
    assert node["node_name"] == "motord"
    assert len(node["writer_gid_seq"]) > 10
    assert len(node["reader_gid_seq"]) > 5


def test_every_endpoint_shows_its_type_and_its_hash(stage):
    with peer("endpoints") as eye:
        odom = eye.find(lambda found: found["topic"] == f"rt{NAMESPACE}/odom", "odom")
        arm = eye.find(
            lambda found: (
                found["topic"].endswith("motord/armRequest")
                and not found["user_data"].startswith("clientid=")  # not an endpoint of a client
            ),
            "arm",
        )
    assert odom["type"] == "nav_msgs::msg::dds_::Odometry_"
    assert odom["user_data"] == f"typehash={type_hash('nav_msgs/msg/Odometry')};"
    assert arm["type"] == "std_srvs::srv::dds_::Trigger_Request_"
    assert arm["user_data"].startswith("serviceid=")


def describe(type_hash, **more):
    asked = {"type_name": "", "type_hash": type_hash, "include_type_sources": True, **more}
    return called("get_type_description", "GetTypeDescription", **asked)


def hash_of(description):
    """Compute the hash of a TypeDescription by REP-2011."""
    described = json.loads(json.dumps(description))
    for one in (described["type_description"], *described["referenced_type_descriptions"]):
        for field in one["fields"]:
            del field["default_value"]
    text = json.dumps(described, separators=(", ", ": ")).encode()
    return f"RIHS01_{hashlib.sha256(text).hexdigest()}"


def test_each_type_of_the_node_is_described_by_its_hash(stage):
    for topic in ("odom", "motor_status", "cmd_vel"):
        with peer("endpoints") as eye:
            found = eye.find(
                lambda found, name=f"rt{NAMESPACE}/{topic}": found["topic"] == name, topic
            )
        shown = found["user_data"].removeprefix("typehash=").rstrip(";")
        sent = describe(shown)
        assert (sent["successful"], sent["failure_reason"]) == (True, "")
        described = sent["type_description"]
        assert described["type_description"]["type_name"].split("/")[-1] in found["type"]
        assert hash_of(described) == shown
        texts = {one["type_name"]: one["raw_file_contents"] for one in sent["type_sources"]}
        assert "builtin_interfaces/Time stamp" in texts["std_msgs/msg/Header"]


def test_a_type_that_the_node_does_not_use_is_not_described(stage):
    imu = describe(type_hash("sensor_msgs/msg/Imu"))
    assert not imu["successful"]
    assert "no type of this node" in imu["failure_reason"]
    assert not describe("RIHS01_ÿ\n" + "x" * 1000)["successful"]
    spare = describe(type_hash("nav_msgs/msg/Odometry"), include_type_sources=False)
    assert (spare["successful"], spare["type_sources"]) == (True, [])


def parameter(name, value, kind=3):
    return {"name": name, "value": {"type": kind, "double_value": value}}


def test_a_limit_is_a_parameter_and_is_changed(stage):
    name = "limits.linear_m_s"
    (before,) = called("get_parameters", "GetParameters", names=[name])["values"]
    assert (before["type"], before["double_value"]) == (3, 1.0)
    (answer,) = called("set_parameters", "SetParameters", parameters=[parameter(name, 0.8)])[
        "results"
    ]
    assert answer == {"successful": True, "reason": ""}
    assert stage.robot.call("params.get", names=[name]) == {name: 0.8}
    called("set_parameters", "SetParameters", parameters=[parameter(name, 1.0)])


def test_parameter_events_report_changes_and_no_refused_ones(stage):
    with peer("topic", "rt/parameter_events", "ParameterEvent") as ear:

        def sent():
            called(
                "set_parameters",
                "SetParameters",
                parameters=[parameter("limits.linear_m_s", 1e9), parameter("limits.linear_m_s", 1)],
            )
            return ear.received

        wait_until(sent, "an event")
        assert ear.received[0]["node"] == f"{NAMESPACE}/motord"
        (changed,) = ear.received[0]["changed_parameters"]
        assert (changed["name"], changed["value"]["double_value"]) == ("limits.linear_m_s", 1.0)


def test_transitions_are_published_as_events(stage):
    with peer("topic", f"rt{NAMESPACE}/motord/transition_event", "TransitionEvent") as ear:

        def sent(label):
            return next((row for row in ear.received if row["transition"]["label"] == label), None)

        def armed_again():
            called("disarm")
            called("arm")
            return sent("activate")

        activated = wait_until(armed_again, "an event")
        assert activated["start_state"] == {"id": 2, "label": "inactive"}
        assert activated["goal_state"] == {"id": 3, "label": "active"}
        assert called("estop")["success"]
        wait_until(lambda: sent("transition_error"), "the error")


def test_a_parameter_is_refused_with_the_reason(stage):
    asked = [
        parameter("limits.linear_m_s", 1e9),
        parameter("limits.linear_m_s", 0.5, kind=2),
        parameter("base.track_m", 0.5),
        parameter("limits.nonsense", 0.5),
    ]
    results = called("set_parameters", "SetParameters", parameters=asked)["results"]
    assert not any(result["successful"] for result in results)
    large, integer, fixed, unknown = (result["reason"] for result in results)
    assert "1.2375" in large  # what the wheels can do
    assert "double" in integer
    assert "robot file" in fixed
    assert "no parameter" in unknown


def test_a_managed_node_is_armed_and_disarmed_by_its_transitions(stage):
    assert called("get_state", "GetState")["current_state"] == {"id": 2, "label": "inactive"}
    assert called("change_state", "ChangeState", transition={"id": 3, "label": ""})["success"]
    stage.wait_for("armed")
    assert not called("change_state", "ChangeState", transition={"id": 1, "label": ""})["success"]
    assert called("change_state", "ChangeState", transition={"id": 0, "label": "deactivate"})[
        "success"
    ]
    stage.wait_for("idle")


def test_no_transition_leads_out_of_an_emergency_stop(stage):
    assert called("estop")["success"]
    stage.wait_for("estop")
    wait_until(
        lambda: called("get_state", "GetState")["current_state"]["label"] == "errorprocessing",
        "the state of an error",
    )
    for number in range(1, 9):
        assert not called("change_state", "ChangeState", transition={"id": number, "label": ""})[
            "success"
        ]
    assert stage.state() == "estop"
    assert called("reset")["success"]
    stage.wait_for("idle")


def sent(stage):
    return inputs(stage)["ros2"]["sent"]


def refused(stage):
    return inputs(stage)["ros2"]["refused"]


@pytest.mark.parametrize(
    ("speed_m_s", "counted"),
    [("nan", "not_finite"), ("-inf", "not_finite"), ("1e308", "out_of_range"),
     ("-10.5", "out_of_range")],
)  # fmt: skip
def test_absurd_commands_move_nothing_and_are_counted_with_their_sender(armed, speed_m_s, counted):
    def count():
        return armed.robot.status()["commands"]["refused"][counted]

    before, x_m = count(), armed.sim.truth().x_m
    with peer("drive", f"rt{NAMESPACE}/cmd_vel", speed_m_s, 0.0, 0, "broken"):
        wait_until(lambda: count() > before + 10, "refusals")
        # The name of the node may arrive later than its first command.
        wait_until(lambda: "input.ros2: /broken requests " in armed.logged(), "its name")
    assert armed.sim.truth().x_m == x_m


def test_old_commands_move_nothing(armed):
    x_m = armed.sim.truth().x_m
    before = armed.robot.status()["commands"]["refused"]["age"]
    with peer("drive", f"rt{NAMESPACE}/cmd_vel", 0.3, 0.0, LEASE_S + 1.0):
        wait_until(
            lambda: armed.robot.status()["commands"]["refused"]["age"] > before + 10, "refusals"
        )
    assert armed.sim.truth().x_m == x_m


@pytest.mark.parametrize("age_s", ["zero", "-3600"])
def test_commands_with_an_unusable_stamp_are_refused_at_once(armed, age_s):
    before, x_m = refused(armed), armed.sim.truth().x_m
    with peer("drive", f"rt{NAMESPACE}/cmd_vel", 0.3, 0.0, age_s):
        wait_until(lambda: refused(armed) > before + 10, "refusals")
    assert armed.sim.truth().x_m == x_m


def test_a_reader_that_requests_more_than_is_offered_is_named(stage):
    row = f"rt{NAMESPACE}/odom: a reader is not served: it does not match the durability"
    with peer("topic", f"rt{NAMESPACE}/odom", "Odometry", "late"):
        wait_until(lambda: row in stage.logged(), "a log line on durability")


def test_a_writer_of_another_type_is_named_with_the_type_to_use(stage):
    row = (
        f"rt{NAMESPACE}/cmd_vel: a writer of geometry_msgs/msg/Twist is not received:"
        " motord expects geometry_msgs/msg/TwistStamped (stamped = false takes Twist)"
    )
    with peer("twist", f"rt{NAMESPACE}/cmd_vel", 0.3, 0.0):
        wait_until(lambda: row in stage.logged(), "a log line on its type")


def test_a_reader_of_another_type_is_named(stage):
    with peer("topic", f"rt{NAMESPACE}/odom", "JointState"):
        row = f"rt{NAMESPACE}/odom: a reader of sensor_msgs/msg/JointState receives nothing"
        wait_until(lambda: row in stage.logged(), "a log line on its type")


def test_a_reader_that_hangs_does_not_disturb_the_others(stage):
    topic = ("topic", f"rt{NAMESPACE}/odom", "Odometry")
    with peer(*topic) as hung, peer(*topic) as ear:
        hung.find(lambda _: True, "a sample")
        hung.process.send_signal(signal.SIGSTOP)
        ear.find(lambda _: True, "a sample")
        before = len(ear.received)
        wait_until(lambda: len(ear.received) > before + 100, "samples")
