# SPDX-License-Identifier: Apache-2.0
"""A node on Zenoh in the robot file: commands only where the router is declared to be trusted, and
over a network only with TLS."""

import pytest
from tests.unit.bus.bus_config_rig import errors, robot_file

from motord.config import ZenohPublish, load_robot

INPUT = '[input.z]\nkind = "ros2-zenoh"\n'
MEANT = "every client of the router could move the robot: set trust_router = true if you mean that"


def test_a_publisher_needs_no_further_settings(tmp_path):
    robot = load_robot(robot_file(tmp_path, '[publish.z]\nkind = "ros2-zenoh"\n'))
    assert robot.has_bus
    assert robot.publish["z"].router == "tcp/127.0.0.1:7447"


def test_commands_are_refused_until_the_router_is_declared_to_be_trusted(tmp_path):
    assert errors(tmp_path, INPUT) == [f"input.z.trust_router: {MEANT}"]
    assert load_robot(robot_file(tmp_path, INPUT + "trust_router = true\n")).has_bus


@pytest.mark.parametrize("host", ["robot.local", "10.0.0.7", "[fe80::1]"])
def test_commands_by_a_router_elsewhere_need_tls(tmp_path, host):
    text = f'{INPUT}trust_router = true\nrouter = "%s/{host}:7447"\n'
    bare = host.strip("[]")
    row = f"input.z.router: commands by {bare} would cross the network unprotected: tls/"
    assert errors(tmp_path, text % "tcp") == [row]
    assert load_robot(robot_file(tmp_path, text % "tls")).has_bus


@pytest.mark.parametrize(
    ("more", "row"),
    [
        ('ca_file = "c"', "publish.z.ca_file: is of no use without tls/"),
        (
            'router = "tls/h:1"\ncert_file = "c"',
            "publish.z.key_file: cert_file and key_file go together",
        ),
    ],
)
def test_what_does_not_fit_together_is_reported(tmp_path, more, row):
    assert errors(tmp_path, f'[publish.z]\nkind = "ros2-zenoh"\n{more}\n') == [row]


def test_sections_of_one_node_have_one_router(tmp_path):
    text = f'[publish.z]\nkind = "ros2-zenoh"\nrouter = "tcp/a:1"\n{INPUT}trust_router = true\n'
    assert errors(tmp_path, text) == [
        "input.z.router: a node has one router: publish.z has another"
    ]


@pytest.mark.parametrize(
    "router", ["127.0.0.1:7447", "udp/127.0.0.1:1", "tcp/h", "tcp/h:1;x", "tcp/h:1#iface=a", ""]
)
def test_a_router_that_is_no_endpoint_of_zenoh_is_refused(router):
    with pytest.raises(ValueError, match="router"):
        ZenohPublish(kind="ros2-zenoh", router=router)


@pytest.mark.parametrize(
    ("router", "host"), [("tcp/[::1]:7447", "::1"), ("tls/robot.local:1", "robot.local")]
)
def test_the_host_of_a_router_is_without_its_brackets(router, host):
    assert ZenohPublish(kind="ros2-zenoh", router=router).router_host == host
