# SPDX-License-Identifier: Apache-2.0
"""Rules between the keys of a bus: above all, what may command over a network."""

from __future__ import annotations

import stat
from collections.abc import Callable, Iterator
from importlib.util import find_spec

from motord.base.extras import how_to_install
from motord.config.finding import Finding
from motord.config.rules.recording import memory_holds_the_time_before_a_fault
from motord.config.rules.web import WEB_RULES
from motord.config.sections.bus import (
    LOOPBACK,
    BusPublish,
    FoxgloveInput,
    FoxgloveServer,
    JoystickInput,
    MqttBroker,
    PrometheusPublish,
    RclpyInput,
    Ros2Input,
    Ros2Node,
    RosbridgeInput,
    RosbridgeServer,
    WebServer,
    ZenohInput,
    ZenohNode,
)
from motord.config.sections.model import Robot
from motord.config.toml_lines import Path

LEASE_COMMANDS = 2
OTHERS = stat.S_IRWXG | stat.S_IRWXO
EVERY_INTERFACE = ("0.0.0.0", "::")  # hosts that the rules warn of
_PACKAGES = {
    "ros2": "cyclonedds",
    "ros2-zenoh": "zenoh",
    "mqtt": "aiomqtt",
    "mcap": "mcap",
    "foxglove": "foxglove",
    "joystick": "evdev",
}
TokenBus = MqttBroker | RosbridgeInput | FoxgloveInput
TlsServer = FoxgloveServer | RosbridgeServer | WebServer
AnyServer = PrometheusPublish | TlsServer


def _commands_are_encrypted(robot: Robot) -> Iterator[Finding]:
    for name, section in robot.input.items():
        if not isinstance(section, TokenBus) or section.host in LOOPBACK:
            continue
        key = "tls" if isinstance(section, MqttBroker) else "cert_file"
        if not getattr(section, key):
            cure = "tls = true" if key == "tls" else "cert_file and key_file"
            paths = (("input", name, key), ("input", name, "host"))
            text = f"commands by {section.host} would show their token to the network: {cure}"
            yield Finding(paths, text)


def _secrets_are_secret(robot: Robot) -> Iterator[Finding]:
    """Warn of secrets in files that others can read: motord-bus does not use these."""
    for table, sections in (("publish", robot.publish), ("input", robot.input)):
        for name, section in sections.items():
            for key in ("token_file", "password_file"):
                named = getattr(section, key, None)
                file = robot.path.parent / named if named is not None else None
                if file is not None and file.is_file() and file.stat().st_mode & OTHERS:
                    text = f"{file} can be read by others and is not used: chmod 600 {file}"
                    yield Finding(((table, name, key),), text, warning=True)


def _servers_on_every_interface(robot: Robot) -> Iterator[Finding]:
    for table, sections in (("publish", robot.publish), ("input", robot.input)):
        for name, section in sections.items():
            if isinstance(section, AnyServer) and section.host in EVERY_INTERFACE:
                risk = (
                    "the token is enough to command the robot"
                    if table == "input"
                    else "every user can read it"
                )
                text = (
                    f"{section.host} is every network interface of this machine, and {risk} from "
                    "there: name one address, or close the port to others in the firewall"
                )
                yield Finding(((table, name, "host"),), text, warning=True)


def _mqtt(robot: Robot) -> Iterator[tuple[Path, MqttBroker]]:
    for table, sections in (("publish", robot.publish), ("input", robot.input)):
        for name, section in sections.items():
            if isinstance(section, MqttBroker):
                yield (table, name), section


def _mqtt_credentials(robot: Robot) -> Iterator[Finding]:
    for path, section in _mqtt(robot):
        if section.password_file is not None and section.username is None:
            yield Finding(((*path, "password_file"),), "a password without username")
        if section.password_file is not None and not section.tls and section.host not in LOOPBACK:
            text = f"{section.host} would get the password unencrypted: set tls = true"
            yield Finding(((*path, "password_file"), (*path, "tls")), text)
        yield from _pair(path, section)
        for key in ("ca_file", "cert_file"):
            if getattr(section, key) is not None and not section.tls:
                yield Finding(((*path, key), (*path, "tls")), "is of no use without tls = true")


def _groups_are_sparkplugs(robot: Robot) -> Iterator[Finding]:
    for path, section in _mqtt(robot):
        if section.group is not None and section.topic_scheme != "sparkplug":
            text = 'is of no use without topic_scheme = "sparkplug"'
            yield Finding(((*path, "group"), (*path, "topic_scheme")), text)


def _rates_of_published_topics(robot: Robot) -> Iterator[Finding]:
    for name, section in robot.publish.items():
        if isinstance(section, BusPublish):
            for topic in section.topic_rate_hz:
                if topic not in section.topics:
                    path = ("publish", name, "topic_rate_hz", topic)
                    yield Finding((path,), "this topic is not published (topics)")


def _topics_of_sensors(robot: Robot) -> Iterator[Finding]:
    if robot.imu is not None:
        return
    for table, sections in (("publish", robot.publish), ("input", robot.input)):
        for name, section in sections.items():
            if not isinstance(section, BusPublish) or "topics" not in section.model_fields_set:
                continue
            if "imu" in section.topics:
                text = "imu is named, but the robot file has no [imu]: leave it out, or add it"
                yield Finding(((table, name, "topics"),), text)


def _servers(robot: Robot) -> Iterator[tuple[Path, AnyServer]]:
    for table, sections in (("publish", robot.publish), ("input", robot.input)):
        for name, section in sections.items():
            if isinstance(section, AnyServer):
                yield (table, name), section


def _one_port_a_server(robot: Robot) -> Iterator[Finding]:
    taken: dict[int, Path] = {}
    for path, section in _servers(robot):
        before = taken.setdefault(section.port, path)
        if before != path:
            text = f"port {section.port} is that of {'.'.join(map(str, before))} already"
            yield Finding(((*path, "port"), (*before, "port")), text)


def _certificates(robot: Robot) -> Iterator[Finding]:
    for path, section in _servers(robot):
        if isinstance(section, TlsServer):
            yield from _pair(path, section)


def _pair(path: Path, section: MqttBroker | TlsServer) -> Iterator[Finding]:
    if (section.cert_file is None) != (section.key_file is None):
        key = "key_file" if section.key_file is None else "cert_file"
        yield Finding(((*path, key),), "cert_file and key_file go together")


def _joystick_lives_long_enough(robot: Robot) -> Iterator[Finding]:
    for name, section in robot.input.items():
        if (
            isinstance(section, JoystickInput)
            and section.lease_s * section.rate_hz < LEASE_COMMANDS
        ):
            text = f"a lease holds fewer than {LEASE_COMMANDS} commands: a late one stops the robot"
            paths = (("input", name, "lease_s"), ("input", name, "rate_hz"))
            yield Finding(paths, text)


def _ros2_nodes(robot: Robot) -> Iterator[tuple[Path, Ros2Node]]:
    for table, sections in (("publish", robot.publish), ("input", robot.input)):
        for name, section in sections.items():
            if isinstance(section, Ros2Node):
                yield (table, name), section


def _ros2_commands_are_meant(robot: Robot) -> Iterator[Finding]:
    for path, section in _ros2_nodes(robot):
        if (
            isinstance(section, Ros2Input)
            and section.discovery != "localhost"
            and not section.trust_network
        ):
            text = "all of the domain could move the robot; if that is meant: trust_network = true"
            yield Finding(((*path, "discovery"), (*path, "trust_network")), text)


def _ros2_commands_of_this_machine(robot: Robot) -> Iterator[Finding]:
    """Warn that every user may command: DDS does not name the caller, as the kernel does on the
    local socket."""
    for path, section in _ros2_nodes(robot):
        if isinstance(section, Ros2Input) and section.discovery == "localhost":
            text = "every user of this machine can arm and drive by it: DDS does not authenticate"
            yield Finding(((*path, "kind"), (*path, "discovery")), text, warning=True)


def _bridged_commands_are_meant(robot: Robot) -> Iterator[Finding]:
    for name, section in robot.input.items():
        if isinstance(section, RclpyInput) and not section.trust_network:
            text = "all of the domain could move the robot; if that is meant: trust_network = true"
            yield Finding((("input", name, "trust_network"), ("input", name, "kind")), text)


def _ros2_domains(robot: Robot) -> Iterator[Finding]:
    domains: dict[int, tuple[Path, Ros2Node]] = {}
    for path, section in _ros2_nodes(robot):
        if section.interface is not None and section.discovery == "localhost":
            text = 'is of no use without discovery = "subnet"'
            yield Finding(((*path, "interface"), (*path, "discovery")), text)
        before, first = domains.setdefault(section.domain_id, (path, section))
        for key in ("discovery", "interface", "distribution"):
            if getattr(section, key) != getattr(first, key):
                other = ".".join(map(str, before))
                text = f"a domain has one configuration: {other} has another"
                yield Finding(((*path, key), (*before, key)), text)


def missing_packages(robot: Robot) -> Iterator[tuple[Path, str, str]]:
    """Yield for each section that needs a package which is not installed: its kind's place in the
    file, the package, and how to install it."""
    for table, sections in (("publish", robot.publish), ("input", robot.input)):
        for name, section in sections.items():
            package = _PACKAGES.get(section.kind)
            if package is not None and find_spec(package) is None:
                yield (table, name, "kind"), package, how_to_install(section.kind)


def _packages_are_there(robot: Robot) -> Iterator[Finding]:
    for path, package, how in missing_packages(robot):
        yield Finding((path,), f"is off here: it needs {package} ({how})", warning=True)


def _zenoh_nodes(robot: Robot) -> Iterator[tuple[Path, ZenohNode]]:
    for table, sections in (("publish", robot.publish), ("input", robot.input)):
        for name, section in sections.items():
            if isinstance(section, ZenohNode):
                yield (table, name), section


def _zenoh_commands_are_meant(robot: Robot) -> Iterator[Finding]:
    for path, section in _zenoh_nodes(robot):
        if not isinstance(section, ZenohInput):
            continue
        if not section.trust_router:
            text = (
                "every client of the router could move the robot: set trust_router = true if you "
                "mean that"
            )
            yield Finding(((*path, "trust_router"), (*path, "router")), text)
        if section.router_host not in LOOPBACK and not section.encrypted:
            text = f"commands by {section.router_host} would cross the network unprotected: tls/"
            yield Finding(((*path, "router"),), text)


def _zenoh_routers(robot: Robot) -> Iterator[Finding]:
    routers: dict[tuple[str, str, int], tuple[Path, ZenohNode]] = {}
    keys = ("router", "ca_file", "cert_file", "key_file")
    for path, section in _zenoh_nodes(robot):
        if (section.cert_file is None) != (section.key_file is None):
            key = "key_file" if section.key_file is None else "cert_file"
            yield Finding(((*path, key),), "cert_file and key_file go together")
        for key in keys[1:]:
            if getattr(section, key) is not None and not section.encrypted:
                yield Finding(((*path, key), (*path, "router")), "is of no use without tls/")
        node = (section.node_name, section.namespace, section.domain_id)
        before, first = routers.setdefault(node, (path, section))
        for key in (*keys, "distribution"):
            if getattr(section, key) != getattr(first, key):
                text = f"a node has one router: {'.'.join(map(str, before))} has another"
                yield Finding(((*path, key), (*before, key)), text)


def _remaps_agree(robot: Robot) -> Iterator[Finding]:
    """Check that one node has one name for a topic."""
    seen: dict[tuple[str, str, str, int, str], tuple[Path, str]] = {}
    for path, section in (*_ros2_nodes(robot), *_zenoh_nodes(robot)):
        over = "dds" if isinstance(section, Ros2Node) else "zenoh"
        for old, new in section.remap.items():
            key = (over, section.node_name, section.namespace, section.domain_id, old)
            before, first = seen.setdefault(key, (path, new))
            if first != new:
                text = f"{'.'.join(map(str, before))} gives it another name for the same node"
                yield Finding(((*path, "remap", old), (*before, "remap", old)), text)


BUS_RULES: tuple[Callable[[Robot], Iterator[Finding]], ...] = (
    _commands_are_encrypted,
    _secrets_are_secret,
    _servers_on_every_interface,
    _mqtt_credentials,
    _groups_are_sparkplugs,
    _rates_of_published_topics,
    _topics_of_sensors,
    _one_port_a_server,
    _certificates,
    _joystick_lives_long_enough,
    _ros2_commands_are_meant,
    _ros2_commands_of_this_machine,
    _bridged_commands_are_meant,
    _ros2_domains,
    _packages_are_there,
    _zenoh_commands_are_meant,
    _zenoh_routers,
    _remaps_agree,
    memory_holds_the_time_before_a_fault,
    *WEB_RULES,
)
