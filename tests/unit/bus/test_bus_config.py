# SPDX-License-Identifier: Apache-2.0
"""Buses in a robot file: mistakes that are refused, and the rates of topics."""

import pytest
from tests.unit.bus.bus_config_rig import DEMO, errors, robot_file

from motord.config import MqttPublish, load_robot

BROKER = '[input.fleet]\nkind = "mqtt"\n'


def test_a_networked_input_without_a_token_is_refused(tmp_path):
    (row,) = errors(tmp_path, BROKER)
    assert row.startswith("input.fleet.token_file")


def test_commands_from_another_machine_without_tls_are_refused(tmp_path):
    text = BROKER + 'host = "broker.example"\ntoken_file = "token"\n'
    assert errors(tmp_path, text) == [
        (
            "input.fleet.tls: commands by broker.example would show their token to the network:"
            " tls = true"
        )
    ]


@pytest.mark.parametrize("more", ['host = "broker.example"\ntls = true\n', 'host = "127.0.0.1"\n'])
def test_commands_with_a_token_by_tls_or_from_this_machine_are_taken(tmp_path, more):
    robot = load_robot(robot_file(tmp_path, BROKER + 'token_file = "token"\n' + more))
    assert robot.has_bus


@pytest.mark.parametrize(
    ("more", "row"),
    [
        ('password_file = "p"', "publish.fleet.password_file: a password without username"),
        (
            'password_file = "p"\nusername = "u"\nhost = "broker.example"',
            (
                "publish.fleet.password_file: broker.example would get the password unencrypted:"
                " set tls = true"
            ),
        ),
        (
            'tls = true\ncert_file = "c"',
            "publish.fleet.key_file: cert_file and key_file go together",
        ),
        ('ca_file = "c"', "publish.fleet.ca_file: is of no use without tls = true"),
        (
            'topics = ["tf"]\ntopic_rate_hz = { odom = 5 }',
            "publish.fleet.topic_rate_hz.odom: this topic is not published (topics)",
        ),
    ],
)
def test_what_does_not_fit_together_is_reported(tmp_path, more, row):
    assert errors(tmp_path, f'[publish.fleet]\nkind = "mqtt"\n{more}\n') == [row]


@pytest.mark.parametrize(("more", "count"), [("", 1), ('cert_file = "c"\nkey_file = "k"\n', 0)])
def test_a_rosbridge_for_commands_of_other_machines_needs_a_certificate(tmp_path, more, count):
    text = '[input.web]\nkind = "rosbridge"\ntoken_file = "token"\nhost = "0.0.0.0"\n' + more
    if count:
        assert len(errors(tmp_path, text)) == count
    else:
        assert load_robot(robot_file(tmp_path, text)).has_bus


def test_two_servers_at_one_port_are_refused(tmp_path):
    text = '[publish.one]\nkind = "prometheus"\n[publish.two]\nkind = "prometheus"\n'
    assert errors(tmp_path, text) == ["publish.two.port: port 9464 is that of publish.one already"]


def test_slow_topics_are_slow_unless_they_have_a_rate_of_their_own():
    section = MqttPublish(kind="mqtt", rate_hz=50.0, topic_rate_hz={"diagnostics": 5.0})
    rates = section.rates_hz()
    assert (rates["odom"], rates["battery_state"], rates["diagnostics"]) == (50.0, 1.0, 5.0)


def test_no_topic_is_faster_than_asked_for():
    assert set(MqttPublish(kind="mqtt", rate_hz=0.5).rates_hz().values()) == {0.5}


def test_a_robot_without_networked_buses_has_no_second_process(tmp_path):
    assert not load_robot(robot_file(tmp_path, '[publish.net]\nkind = "udp"\n')).has_bus
    assert load_robot(robot_file(tmp_path, '[publish.net]\nkind = "mqtt"\n')).has_bus


def test_a_robot_keeps_its_overrides():
    assert load_robot(DEMO, ["robot.name=r2"]).overrides == ("robot.name=r2",)


@pytest.mark.parametrize("kind", ["mqtt", "foxglove"])
def test_a_package_that_is_not_installed_is_a_warning_with_its_cure(tmp_path, monkeypatch, kind):
    path = robot_file(tmp_path, f'[publish.net]\nkind = "{kind}"\n')
    assert [row for row in load_robot(path).warnings if "pip install" in row.text] == []
    monkeypatch.setattr("motord.config.rules.bus.find_spec", lambda name: None)
    (row,) = [row for row in load_robot(path).warnings if "pip install" in row.text]
    package = {"mqtt": "aiomqtt", "foxglove": "foxglove-sdk"}[kind]
    assert (row.key, package in row.text) == ("publish.net.kind", True)


def test_a_bridge_node_needs_trust_network_and_starts_no_second_process(tmp_path):
    text = '[input.ros]\nkind = "ros2-rclpy"\n'
    (row,) = errors(tmp_path, text)
    assert row.startswith("input.ros.trust_network: all of the domain could move the robot")
    assert not load_robot(robot_file(tmp_path, text + "trust_network = true\n")).has_bus


KINDS_WITH_HOST = ("udp", "mqtt", "prometheus", "rosbridge", "foxglove")


@pytest.mark.parametrize("kind", KINDS_WITH_HOST)
@pytest.mark.parametrize(
    "host",
    ["", "broker..example", ".example", "a b", "a/b", "[::1]", "x" * 64, "::1..2", "a." * 130],
)
def test_an_invalid_host_is_refused(tmp_path, kind, host):
    (row,) = errors(tmp_path, f'[publish.net]\nkind = "{kind}"\nhost = "{host}"\n')
    too_long = "at most 253" if len(host) > 253 else "neither the name of a machine nor an address"
    assert row.startswith("publish.net.host: ")
    assert too_long in row


@pytest.mark.parametrize(
    "host",
    ["localhost", "127.0.0.1", "0.0.0.0", "::", "::1", "fe80::1%eth0", "::ffff:10.0.0.1",
     "broker.example", "broker.example.", "xn--bcher-kva.example", "my_broker-2", "x" * 63],
)  # fmt: skip
def test_a_valid_host_is_taken(tmp_path, host):
    text = f'[publish.net]\nkind = "udp"\nhost = "{host}"\n'
    assert load_robot(robot_file(tmp_path, text)).publish["net"].host == host


@pytest.mark.parametrize("router", ["tcp/a..b:7447", "tls/.b:7447", "tcp/:7447"])
def test_an_invalid_router_is_refused(tmp_path, router):
    (row,) = errors(tmp_path, f'[publish.net]\nkind = "ros2-zenoh"\nrouter = "{router}"\n')
    assert row == f'publish.net.router: "{router}" is neither tcp/HOST:PORT nor tls/HOST:PORT'


def test_a_group_needs_the_sparkplug_scheme(tmp_path):
    text = '[publish.fleet]\nkind = "mqtt"\ngroup = "site"\n'
    (row,) = errors(tmp_path, text)
    assert row == 'publish.fleet.group: is of no use without topic_scheme = "sparkplug"'
    path = robot_file(tmp_path, text + 'topic_scheme = "sparkplug"\n')
    assert load_robot(path).publish["fleet"].group == "site"


@pytest.mark.parametrize(("more", "count"), [("", 1), ('cert_file = "c"\nkey_file = "k"\n', 0)])
def test_a_foxglove_server_for_commands_of_other_machines_needs_a_certificate(
    tmp_path, more, count
):
    text = '[input.view]\nkind = "foxglove"\nhost = "0.0.0.0"\ntoken_file = "token"\n' + more
    if count:
        (row,) = errors(tmp_path, text)
        assert row.startswith("input.view.cert_file: commands by 0.0.0.0 would show their token")
    else:
        assert load_robot(robot_file(tmp_path, text)).has_bus


def test_a_foxglove_server_that_takes_commands_needs_a_token(tmp_path):
    (row,) = errors(tmp_path, '[input.view]\nkind = "foxglove"\n')
    assert row.startswith("input.view.token_file")


FLIGHT = '[publish.tape]\nkind = "mcap"\nmode = "fault"\nfolder = "tape"\n'


@pytest.mark.parametrize(
    ("more", "warned"),
    [("", 0), ("before_s = 600\n", 0), ("before_s = 600\nrate_hz = 500\n", 1),
     ("before_s = 600\nrate_hz = 60\n", 0),
     ("before_s = 600\njournal = true\nrate_hz = 60\n", 1)],
)  # fmt: skip
def test_a_flight_recorder_that_exceeds_its_memory_is_warned_of(tmp_path, more, warned):
    found = load_robot(robot_file(tmp_path, FLIGHT + more)).warnings
    rows = [row.text for row in found if row.key == "publish.tape.before_s"]
    assert len(rows) == warned
    assert all("memory holds" in row for row in rows)


def warnings(robot):
    return [f"{row.key}: {row.text}" for row in robot.warnings]


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604])
def test_a_token_file_that_others_can_read_is_warned_of(tmp_path, mode):
    token = tmp_path / "token"
    token.write_text("0123456789abcdef", encoding="utf-8")
    file = robot_file(tmp_path, BROKER + 'token_file = "token"\n')
    token.chmod(mode)
    (row,) = warnings(load_robot(file))
    assert row == (
        f"input.fleet.token_file: {token} can be read by others and is not used: chmod 600 {token}"
    )
    token.chmod(0o600)
    assert warnings(load_robot(file)) == []


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_a_server_at_every_interface_is_warned_of(tmp_path, host):
    text = f'[publish.figures]\nkind = "prometheus"\nhost = "{host}"\n'
    (row,) = warnings(load_robot(robot_file(tmp_path, text)))
    assert row.startswith(f"publish.figures.host: {host} is every network interface")
    assert warnings(load_robot(robot_file(tmp_path, text.replace(host, "192.168.0.7")))) == []
