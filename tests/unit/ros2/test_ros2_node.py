# SPDX-License-Identifier: Apache-2.0
"""Names, frames, settings and parameters of motord's ROS 2 node, without a network."""

import asyncio
from pathlib import Path
from types import SimpleNamespace
from xml.etree.ElementTree import fromstring

import pytest

from motord.bus.ros2 import names
from motord.client import ClientError
from motord.config import ConfigError, load_robot

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"


@pytest.mark.parametrize(
    ("namespace", "name", "full"),
    [
        ("/", "odom", "/odom"),
        ("/r2", "odom", "/r2/odom"),
        ("/r2", "/diagnostics", "/diagnostics"),
        ("/", "~/arm", "/motord/arm"),
        ("/fleet/r2", "~/arm", "/fleet/r2/motord/arm"),
    ],
)
def test_names_are_below_the_namespace(namespace, name, full):
    assert names.full_name(namespace, "motord", name) == full


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("cmd_vel", "/cmd_vel_safe"), ("odom", "/r2/wheels/odom"), ("~/stop", "/r2/stop"),
        ("/diagnostics", "/r2/diagnostics"), ("/tf", "/tf"), ("stop", "/r2/stop"),
    ],
)  # fmt: skip
def test_a_name_may_be_remapped(name, full):
    rules = {
        "/r2/cmd_vel": "/cmd_vel_safe", "odom": "wheels/odom", "~/stop": "stop",
        "/diagnostics": "diagnostics",
    }  # fmt: skip
    assert names.remapped("/r2", "motord", name, rules) == full


def test_a_node_has_one_name_for_a_topic():
    both = ("input.ros2.kind=ros2", "publish.ros2.kind=ros2")
    robot(*both, "publish.ros2.remap.odom=/a", "input.ros2.remap.cmd_vel=/b")
    with pytest.raises(ConfigError, match="another name"):
        robot(*both, "publish.ros2.remap.tf=/a", "input.ros2.remap.tf=/b")
    with pytest.raises(ConfigError, match="remap"):
        robot(*both, "publish.ros2.remap.tf=//a")


@pytest.mark.parametrize(
    ("settings", "prefix", "topic"),
    [
        ((), "", "/tf"),
        (("namespace=/fleet/r2",), "fleet/r2/", "/tf"),
        (("namespace=/r2", "frame_prefix=left_"), "left_", "/tf"),
        (("namespace=/r2", 'frame_prefix=""'), "", "/tf"),
        (("namespace=/r2", "namespaced_tf=true"), "", "tf"),
        (("namespace=/r2", "namespaced_tf=true", "frame_prefix=r2/"), "r2/", "tf"),
    ],
)
def test_frames_in_a_namespace_are_kept_apart_by_prefix_or_by_topic(settings, prefix, topic):
    from motord.bus.ros2.publisher import robot_topic

    section = robot("publish.ros2.kind=ros2", *(f"publish.ros2.{one}" for one in settings)).publish[
        "ros2"
    ]
    assert section.prefix_of_frames() == prefix
    assert robot_topic("tf", section) == topic
    assert robot_topic("tf_static", section) == f"{topic}_static"
    assert robot_topic("odom", section) == "odom"


@pytest.mark.parametrize("prefix", ["/r2", "r2 ", "räder/"])
def test_a_prefix_makes_names_that_tf2_takes(prefix):
    with pytest.raises(ConfigError, match="frame_prefix"):
        robot("publish.ros2.kind=ros2", f"publish.ros2.frame_prefix={prefix}")


def test_names_on_dds_have_the_prefixes_of_ros():
    assert names.topic("/odom") == "rt/odom"
    assert names.request("/motord/arm") == "rq/motord/armRequest"
    assert names.reply("/motord/arm") == "rr/motord/armReply"
    assert names.dds_type("nav_msgs/msg/Odometry") == "nav_msgs::msg::dds_::Odometry_"


def robot(*settings):
    return load_robot(DEMO, settings)


def test_the_description_has_a_joint_for_each_wheel_where_the_robot_file_puts_it():
    from motord.bus.ros2.urdf import urdf

    made = robot("joint.left.wheel_radius_m=0.1", 'joint.left.differs_in=["wheel_radius_m"]')
    root = fromstring(urdf(made))
    joints = {
        joint.get("name"): joint
        for joint in root.findall("joint")
        if joint.get("type") == "continuous"
    }
    assert set(joints) == set(made.joint)
    place = [float(word) for word in joints["left"].find("origin").get("xyz").split()]
    assert place == [0.0, 0.225, 0.1]
    links = {link.get("name") for link in root.findall("link")}
    for joint in joints.values():
        assert joint.find("parent").get("link") == "base_link"
        assert joint.find("child").get("link") in links
        assert joint.find("axis").get("xyz") == "0 1 0"


def test_commands_from_a_network_need_trust_network():
    with pytest.raises(ConfigError, match="trust_network"):
        robot("input.ros2.kind=ros2", "input.ros2.discovery=subnet")
    robot("input.ros2.kind=ros2", "input.ros2.discovery=subnet", "input.ros2.trust_network=true")
    robot("input.ros2.kind=ros2")


def test_every_user_of_the_machine_may_command_over_dds_and_that_is_reported():
    def refused(*settings):
        found = robot("publish.ros2.kind=ros2", *settings).warnings
        return [row.key for row in found if "every user of this machine" in row.text]

    beyond = [f"{table}.ros2.discovery=subnet" for table in ("publish", "input")]
    assert refused() == []
    assert refused("input.ros2.kind=ros2") == ["input.ros2.kind"]
    assert refused("input.ros2.kind=ros2", "input.ros2.trust_network=true", *beyond) == []


def test_a_domain_has_one_configuration():
    with pytest.raises(ConfigError, match="a domain has one configuration"):
        robot("input.ros2.kind=ros2", "publish.ros2.kind=ros2", "publish.ros2.discovery=subnet")
    with pytest.raises(ConfigError, match="a domain has one configuration"):
        robot("input.ros2.kind=ros2", "publish.ros2.kind=ros2", "publish.ros2.distribution=humble")
    with pytest.raises(ConfigError, match="of no use"):
        robot("publish.ros2.kind=ros2", "publish.ros2.interface=eth0")


@pytest.mark.parametrize("kind", ["publish.one.kind=ros2", "publish.one.kind=foxglove"])
def test_a_robot_without_imu_offers_none_on_any_bus(kind):
    from motord.bus.runtime import of_this_robot

    made = robot(kind)
    assert "imu" not in of_this_robot(made.publish["one"], made).topics
    assert "imu" not in of_this_robot(made.publish["one"], made).rates_hz()
    with pytest.raises(ConfigError, match=r"\[imu\]"):
        robot(kind, 'publish.one.topics=["odom", "imu"]')


class Daemon:
    """A daemon that records the requests to it and answers with parameters, or not at all."""

    def __init__(self, answers=True):
        self.asked = []
        self._answers = answers

    async def call(self, method, **params):
        self.asked.append((method, params))
        if not self._answers:
            raise ClientError("no daemon is there")
        about = {"unit": "m/s", "minimum": 0.001, "description": "speed"}
        return {
            "limits.linear_m_s": {**about, "value": 0.5, "maximum": 50},
            "limits.linear_m_s3": {**about, "value": None, "maximum": None},
            "drive.left.voltage": {**about, "value": None, "maximum": 1},
        }


published = []
"""Parameter events that the node has published."""


def asked(service, daemon, **request):
    pytest.importorskip("cyclonedds", reason="needs cyclonedds")
    from motord.bus.ros2.services.parameters import Parameters

    served = {}
    parameters = Parameters(robot(), daemon.call)
    parameters.serve(
        SimpleNamespace(
            serve=lambda name, kind, answer, depth: served.update({name: answer}),
            full=lambda name: f"/r2/motord/{name[2:]}",
            publisher=lambda name, kind, quality: SimpleNamespace(publish=published.append),
        )
    )
    return asyncio.run(served[f"~/{service}"](SimpleNamespace(**request)))


def test_parameters_are_the_limits_and_what_cannot_be_changed():
    found = asked("list_parameters", Daemon(), prefixes=(), depth=0).result
    assert found.names == [
        "limits.linear_m_s", "limits.linear_m_s3", "base.track_m", "base.wheel_radius_m",
    ]  # fmt: skip
    assert found.prefixes == ["base", "limits"]
    below = asked("list_parameters", Daemon(), prefixes=("base",), depth=1).result
    assert below.names == ["base.track_m", "base.wheel_radius_m"]
    assert asked("list_parameters", Daemon(), prefixes=(), depth=1).result.names == []


def test_an_absent_limit_is_infinity():
    (value,) = asked("get_parameters", Daemon(), names=["limits.linear_m_s3"]).values
    assert value.double_value == float("inf")
    daemon = Daemon()
    change = SimpleNamespace(
        name="limits.linear_m_s3", value=SimpleNamespace(type=3, double_value=float("inf"))
    )
    (result,) = asked("set_parameters", daemon, parameters=[change]).results
    assert result.successful
    assert daemon.asked[-1] == ("params.set", {"limits.linear_m_s3": None})
    assert published[-1].changed_parameters == [change]


@pytest.mark.parametrize("value", [float("nan"), float("-inf")])
def test_an_invalid_limit_is_not_passed_on(value):
    daemon = Daemon()
    change = SimpleNamespace(
        name="limits.linear_m_s", value=SimpleNamespace(type=3, double_value=value)
    )
    assert not asked("set_parameters_atomically", daemon, parameters=[change]).result.successful
    assert not daemon.asked


def test_without_the_daemon_there_are_no_limits_and_no_crash():
    assert asked("get_parameters", Daemon(answers=False), names=["limits.linear_m_s"]).values[
        0
    ].type == 0  # fmt: skip
    described = asked("describe_parameters", Daemon(answers=False), names=["base.track_m"])
    assert described.descriptors[0].read_only


def test_a_range_is_described():
    names_ = ["limits.linear_m_s", "nonsense"]
    (descriptor,) = asked("describe_parameters", Daemon(), names=names_).descriptors
    (span,) = descriptor.floating_point_range
    assert (span.from_value, span.to_value) == (0.001, 50)
    assert descriptor.description == "speed [m/s]"
