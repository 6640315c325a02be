# SPDX-License-Identifier: Apache-2.0
"""A whole robot on simulated drives, driven and heard by ROS 2's ways over a real Zenoh router."""

import contextlib
import time

import pytest
import rosbags.typesys as rosbags
from tests.peers.test_ros2_zenoh import REQUEST, STORE, ask, attached, peer
from tests.peers.zenoh_router import endpoint, free_port, started
from tests.sim.daemon_stage import running, wait_until

from motord.bus.ros2.types.table import type_hash

TRIGGER = (
    "std_srvs::srv::dds_::Trigger_/"
    "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
)
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
COMMAND_KEY = (
    f"5/r2/cmd_vel/geometry_msgs::msg::dds_::TwistStamped_/{STORE.hash_rihs01(TWIST_STAMPED)}"
)
ODOM_KEY = f"5/r2/odom/nav_msgs::msg::dds_::Odometry_/{STORE.hash_rihs01('nav_msgs/msg/Odometry')}"
LEASE_S = 1.0


def command(linear_m_s, age_s=0.0):
    make = STORE.types
    sec, nanosec = divmod(time.time_ns() - round(age_s * 1e9), 1_000_000_000)
    stamp = make["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    message = make[TWIST_STAMPED](
        header=make["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
        twist=make["geometry_msgs/msg/Twist"](
            linear=make["geometry_msgs/msg/Vector3"](x=linear_m_s, y=0.0, z=0.0),
            angular=make["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0),
        ),
    )
    return bytes(STORE.serialize_cdr(message, TWIST_STAMPED))


class Driver:
    """Another node: it commands while it is asked to, and hears odometry."""

    def __init__(self, session):
        self.session = session
        self.heard = []
        self._kept = session.declare_subscriber(ODOM_KEY, self._take)

    def _take(self, sample):
        message = STORE.deserialize_cdr(sample.payload.to_bytes(), "nav_msgs/msg/Odometry")
        self.heard.append(message)

    def drive_until(self, condition, what, linear_m_s=0.3, age_s=0.0):
        def step():
            payload = command(linear_m_s, age_s)
            self.session.put(COMMAND_KEY, payload, attachment=attached())
            return condition()

        wait_until(step, what)

    def call(self, name):
        key = f"5/r2/motord/{name}/{TRIGGER}"
        (reply,) = ask(self.session, key, payload=REQUEST, attachment=attached())
        return STORE.deserialize_cdr(reply.ok.payload.to_bytes(), "peer/msg/Answer")


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """A stage, and a driver beside it."""
    port = free_port()
    where = [f"{table}.z.{key}" for table in ("publish", "input") for key in ("kind", "router")]
    values = ["ros2-zenoh", endpoint(port)] * 2
    settings = [f"{key}={value}" for key, value in zip(where, values, strict=True)]
    settings += [f"{table}.z.domain_id=5" for table in ("publish", "input")]
    settings += [f"{table}.z.namespace=/r2" for table in ("publish", "input")]
    settings += ["publish.z.rate_hz=20", "input.z.trust_router=true"]
    settings += [f"joint.{side}.reply_timeout_s=0.2" for side in ("left", "right")]
    settings += [f"input.z.lease_s={LEASE_S}", f"safety.command_timeout_s={LEASE_S}"]
    folder = tmp_path_factory.mktemp("zenoh")
    with (
        started(port) as router,
        running(folder, *settings) as stage,
        contextlib.ExitStack() as later,
    ):
        assert router.stdout.readline() == b"ready\n"
        session = later.enter_context(peer(port))
        stage.wait_for("idle")
        driver = Driver(session)
        wait_until(lambda: figures(stage).get("lease"), "a lease")
        wait_until(lambda: driver.heard, "odometry")
        yield stage, driver


def figures(stage):
    return (stage.robot.status()["bus"] or {}).get("inputs", {}).get("z", {})


def lapsed(driver, name):
    """Call it as soon as the commands of the test before have lapsed."""
    wait_until(lambda: driver.call(name).success, name)


@contextlib.contextmanager
def armed(stage, driver):
    lapsed(driver, "arm")
    try:
        yield
    finally:
        assert driver.call("stop").success
        stage.wait_for("armed")
        assert driver.call("disarm").success
        stage.wait_for("idle")


def test_another_node_arms_drives_and_hears_the_way(robot):
    stage, driver = robot
    with armed(stage, driver):
        before_m = driver.heard[-1].pose.pose.position.x
        driver.drive_until(
            lambda: driver.heard[-1].pose.pose.position.x > before_m + 0.1, "a way of 0.1 m"
        )
        assert driver.heard[-1].header.frame_id == "r2/odom"


def test_the_robot_stops_when_the_other_node_says_nothing_more(robot):
    stage, driver = robot
    with armed(stage, driver):
        driver.drive_until(lambda: stage.state() == "moving", "moving")
        stage.wait_for("armed")


def test_a_command_moves_nothing_that_is_not_armed(robot):
    stage, driver = robot
    sent = figures(stage)["sent"]
    states = set()

    def many_sent():
        states.add(stage.state())
        return figures(stage)["sent"] > sent + 10

    driver.drive_until(many_sent, "commands")
    assert states == {"idle"}


def test_a_command_that_waited_somewhere_moves_nothing(robot):
    stage, driver = robot
    with armed(stage, driver):
        sent = figures(stage)["sent"]
        states = set()

        def many_sent():
            states.add(stage.state())
            return figures(stage)["sent"] > sent + 10

        driver.drive_until(many_sent, "old commands", age_s=10.0)
        assert states == {"armed"}


def test_an_emergency_stop_is_latched_and_arming_says_why_not(robot):
    stage, driver = robot
    assert driver.call("estop").success
    stage.wait_for("estop")
    refused = driver.call("arm")
    assert not refused.success
    assert "emergency stop" in refused.message
    lapsed(driver, "reset")
    stage.wait_for("idle")


def asked(driver, name, service, request, response):
    """Call a service of the node, its messages by the other encoder: `request` is a definition and
    its values, `response` a definition."""
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
    told = asked(
        driver, "get_type_description", "type_description_interfaces/GetTypeDescription",
        ("string type_name\nstring type_hash\nbool include_sources\n", asking),
        "bool successful\nstring failure_reason\n"
        "type_description_interfaces/TypeDescription type_description\n"
        "type_description_interfaces/TypeSource[] sources\n"
        "type_description_interfaces/KeyValue[] extra\n",
    )  # fmt: skip
    assert told.successful
    described = told.type_description.type_description
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


def test_a_publisher_of_another_type_is_named_with_what_to_write(robot):
    stage, driver = robot
    said = f"geometry_msgs::msg::dds_::Twist_/RIHS01_{'0' * 64}/::,10:,:,:,,"
    token = f"@ros2_lv/5/{driver.session.zid()}/0/9/MP/%/%r2/teleop/%r2%cmd_vel/{said}"
    with driver.session.liveliness().declare_token(token):
        wait_until(
            lambda: (
                (
                    "/r2/cmd_vel: a writer of geometry_msgs/msg/Twist is not heard: we want"
                    " geometry_msgs/msg/TwistStamped (stamped = false takes Twist)"
                )
                in stage.said()
            ),
            "a word on its type",
        )
