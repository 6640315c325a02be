# SPDX-License-Identifier: Apache-2.0
"""A robot with simulated drives. Another ROS 2 node drives and reads it through a Zenoh router."""

import rosbags.typesys as rosbags
from tests.peers.ros2_zenoh.zenoh_rig import STORE, ask, attached
from tests.peers.ros2_zenoh.zenoh_robot_rig import armed, figures, lapsed, robot
from tests.sim.daemon_stage import wait_until

from motord.bus.messages.table import type_hash

__all__ = ["robot"]


def test_another_node_arms_the_robot_drives_it_and_reads_the_distance(robot):
    stage, driver = robot
    with armed(stage, driver):
        before_m = driver.received[-1].pose.pose.position.x
        driver.drive_until(
            lambda: driver.received[-1].pose.pose.position.x > before_m + 0.1, "a distance of 0.1 m"
        )
        assert driver.received[-1].header.frame_id == "r2/odom"


def test_the_robot_stops_when_the_other_node_stops_sending(robot):
    stage, driver = robot
    with armed(stage, driver):
        driver.drive_until(lambda: stage.state() == "moving", "moving")
        stage.wait_for("armed")


def test_a_command_moves_nothing_while_disarmed(robot):
    stage, driver = robot
    sent = figures(stage)["sent"]
    states = set()

    def many_sent():
        states.add(stage.state())
        return figures(stage)["sent"] > sent + 10

    driver.drive_until(many_sent, "commands")
    assert states == {"idle"}


def test_a_delayed_command_moves_nothing(robot):
    stage, driver = robot
    with armed(stage, driver):
        sent = figures(stage)["sent"]
        states = set()

        def many_sent():
            states.add(stage.state())
            return figures(stage)["sent"] > sent + 10

        driver.drive_until(many_sent, "old commands", age_s=10.0)
        assert states == {"armed"}


def test_an_emergency_stop_is_latched_and_arming_is_refused_with_the_reason(robot):
    stage, driver = robot
    assert driver.call("estop").success
    stage.wait_for("estop")
    refused = driver.call("arm")
    assert not refused.success
    assert "emergency stop" in refused.message
    lapsed(driver, "reset")
    stage.wait_for("idle")


def asked(driver, name, service, request, response):
    """Call a service of the node, encoded by rosbags, and return the answer. `request`: the
    definition of its type, and the values. `response`: the definition of its type."""
    package, short = service.split("/")
    key = f"5/r2/motord/{name}/{package}::srv::dds_::{short}_/{type_hash(f'{package}/srv/{short}')}"
    store = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
    store.register(rosbags.get_types_from_msg(request[0], "peer/msg/Request"))
    store.register(rosbags.get_types_from_msg(response, "peer/msg/Response"))
    message = store.types["peer/msg/Request"](**request[1])
    payload = bytes(store.serialize_cdr(message, "peer/msg/Request"))
    (reply,) = ask(driver.session, key, payload=payload, attachment=attached())
    return store.deserialize_cdr(reply.ok.payload.to_bytes(), "peer/msg/Response")


def test_limits_are_parameters_that_other_nodes_list_and_read(robot):
    _, driver = robot
    listing = ("string[] prefixes\nuint64 depth\n", {"prefixes": [], "depth": 0})
    listed = asked(
        driver, "list_parameters", "rcl_interfaces/ListParameters", listing,
        "rcl_interfaces/ListParametersResult result\n",
    )  # fmt: skip
    limits = [name for name in listed.result.names if name.startswith("limits.")]
    assert limits
    getting = ("string[] names\n", {"names": limits})
    values = asked(
        driver, "get_parameters", "rcl_interfaces/GetParameters", getting,
        "rcl_interfaces/ParameterValue[] values\n",
    ).values  # fmt: skip
    assert len(values) == len(limits)
    assert all(value.double_value > 0.0 for value in values if value.type == 3)


def test_a_type_of_the_node_is_described_by_its_hash(robot):
    _, driver = robot
    name = "nav_msgs/msg/Odometry"
    asking = {"type_name": name, "type_hash": STORE.hash_rihs01(name), "include_sources": False}
    sent = asked(
        driver, "get_type_description", "type_description_interfaces/GetTypeDescription",
        ("string type_name\nstring type_hash\nbool include_sources\n", asking),
        "bool successful\nstring failure_reason\n"
        "type_description_interfaces/TypeDescription type_description\n"
        "type_description_interfaces/TypeSource[] sources\n"
        "type_description_interfaces/KeyValue[] extra\n",
    )  # fmt: skip
    assert sent.successful
    described = sent.type_description.type_description
    assert described.type_name == name
    assert [field.name for field in described.fields] == [
        field for field, _ in STORE.fielddefs[name][1]
    ]


def test_the_life_cycle_is_inactive_while_disarmed_and_active_while_armed(robot):
    stage, driver = robot
    ending = "lifecycle_msgs/State current_state\n"
    asking = ("uint8 nothing\n", {"nothing": 0})

    def label():
        state = asked(driver, "get_state", "lifecycle_msgs/GetState", asking, ending)
        return state.current_state.label

    wait_until(lambda: label() == "inactive", "inactive")
    with armed(stage, driver):
        wait_until(lambda: label() == "active", "active")


def test_a_publisher_of_another_type_is_named_with_the_type_to_use(robot):
    stage, driver = robot
    quality = f"geometry_msgs::msg::dds_::Twist_/RIHS01_{'0' * 64}/::,10:,:,:,,"
    token = f"@ros2_lv/5/{driver.session.zid()}/0/9/MP/%/%r2/teleop/%r2%cmd_vel/{quality}"
    with driver.session.liveliness().declare_token(token):
        wait_until(
            lambda: (
                (
                    "/r2/cmd_vel: a writer of geometry_msgs/msg/Twist is not received: motord"
                    " expects geometry_msgs/msg/TwistStamped (stamped = false takes Twist)"
                )
                in stage.logged()
            ),
            "a log line on its type",
        )
