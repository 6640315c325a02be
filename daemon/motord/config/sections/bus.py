# SPDX-License-Identifier: Apache-2.0
"""Buses of the robot file: where the state goes, and where commands come from. One class for each
kind."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from motord.config.sections.section import Field, Section, number

Topic = Literal[
    "odom",
    "tf",
    "joint_states",
    "imu",
    "battery_state",
    "diagnostics",
    "motor_status",
    "loop_statistics",
]
SLOW_HZ = 1.0
SLOW: frozenset[Topic] = frozenset(("battery_state", "diagnostics", "loop_statistics"))
"""Topics that change slowly: at most SLOW_HZ where no rate of their own is given."""
ALL_TOPICS: tuple[Topic, ...] = (
    *("odom", "tf", "joint_states", "imu", "battery_state"),
    *("diagnostics", "motor_status", "loop_statistics"),
)
_NAME = r"[A-Za-z0-9_-]{1,63}(\.[A-Za-z0-9_-]{1,63})*\.?"
_IPV6 = r"[0-9A-Fa-f]{0,4}:[0-9A-Fa-f:]{1,40}(\.[0-9]{1,3}){0,3}(%[A-Za-z0-9_-]{1,15})?"
HOST = rf"^({_NAME}|{_IPV6})$"
"""Pattern of a name or an address; names for which getaddrinfo raises UnicodeError are refused."""
ROUTER = rf"^(tcp|tls)/(\[[0-9A-Fa-f:]+\]|{_NAME}):[0-9]{{1,5}}$"
LOOPBACK = ("127.0.0.1", "::1", "localhost")


class Publish(Section):
    """A destination of the robot's state."""

    rate_hz: float = number("messages a second at most", 0.01, 1000, "Hz", 10.0)


class StdoutPublish(Publish):
    """A line of JSON for each snapshot on standard output."""

    kind: Literal["stdout"]


class UdpPublish(Publish):
    """A datagram of JSON for each snapshot."""

    kind: Literal["udp"]
    host: str = Field(default="127.0.0.1", pattern=HOST, max_length=253)
    """The receiver; this machine by default."""
    port: int = number("UDP port", 1, 65535, "1", 9870)


class BusPublish(Publish):
    """A destination to which the second process publishes, topic by topic."""

    topics: tuple[Topic, ...] = Field(default=ALL_TOPICS, strict=False)
    """Topics that are published; all by default."""
    topic_rate_hz: dict[Topic, Annotated[float, Field(ge=0.01, le=1000)]] = Field(
        default_factory=dict
    )
    """Rates of single topics, in Hz. A topic without one has rate_hz, but battery_state,
    diagnostics and loop_statistics then have at most 1 Hz."""

    def rates_hz(self) -> dict[str, float]:
        """Return the rate of each topic that is published."""
        slow_hz = min(self.rate_hz, SLOW_HZ)
        return {
            topic: self.topic_rate_hz.get(topic, slow_hz if topic in SLOW else self.rate_hz)
            for topic in self.topics
        }


class BusInput(Section):
    """An input whose commands come by the second process."""

    priority: int = number("the higher one commands", 0, 1000, "1", 100)
    lease_s: float = number("lifetime of a command", 0.02, 5, "s", 0.3)
    rate_max_hz: float | None = number(
        "commands that come more often are refused, but for zero", 1, 10000, "Hz", None
    )


class StampedInput(BusInput):
    """An input whose commands have a stamp."""

    stamped: bool = True
    """Whether every command must contain the time at which it was given, so that a delayed command
    is recognized by its age. Both clocks have to agree; false: what arrives counts as new."""


class TokenInput(StampedInput):
    """An input from a network, whose commands need the token."""

    token_file: str = Field(min_length=1)
    """File with the token that every command has to show; at least 16 characters, readable by the
    daemon's user alone. A path that is not absolute is beside the robot file."""


class MqttBroker(Section):
    """Address of the broker, and motord's account there."""

    host: str = Field(default="127.0.0.1", pattern=HOST, max_length=253)
    """The broker's name or address."""
    port: int | None = number("TCP port; 8883 with TLS, else 1883", 1, 65535, "1", None)
    tls: bool = False
    """Whether the connection is encrypted and the broker's certificate is checked."""
    ca_file: str | None = None
    """Certificates of the authority against which the broker's certificate is checked; by default
    the system's."""
    cert_file: str | None = None
    """motord's own certificate, for a broker that requires one."""
    key_file: str | None = None
    """Key of cert_file."""
    username: str | None = None
    """Name of motord's account at the broker."""
    password_file: str | None = None
    """File with the account's password, readable by the daemon's user alone."""
    topic_prefix: str | None = Field(default=None, pattern=r"^[^+#\s/][^+#\s]*[^+#\s/]$")
    """Beginning of every topic; by default motord/ROBOT, and spBv1.0 with Sparkplug's names."""
    topic_scheme: Literal["plain", "sparkplug"] = "plain"
    """Names of topics: "plain" is PREFIX/odom, "sparkplug" is PREFIX/GROUP/DDATA/ROBOT/odom with
    births and deaths. The messages are the same."""
    group: str | None = Field(default=None, pattern=r"^[^+#\s/]+$")
    """Sparkplug's group; motord by default."""
    encoding: Literal["json", "cbor"] = "json"
    """Encoding of the messages."""


class MqttPublish(BusPublish, MqttBroker):
    """Topics on an MQTT broker."""

    kind: Literal["mqtt"]
    qos: int = number("quality of service of the messages", 0, 1, "1", 0)


class MqttInput(TokenInput, MqttBroker):
    """Commands from an MQTT broker."""

    kind: Literal["mqtt"]


class PrometheusPublish(Publish):
    """Figures for Prometheus: GET /metrics. They are those of the moment of the request."""

    kind: Literal["prometheus"]
    host: str = Field(default="127.0.0.1", pattern=HOST, max_length=253)
    """Address to listen at; this machine only by default."""
    port: int = number("TCP port", 1, 65535, "1", 9464)


class McapPublish(BusPublish):
    """Recordings in MCAP files, for Foxglove and every program that reads them."""

    kind: Literal["mcap"]
    folder: str = Field(min_length=1)
    """Folder of the files; it is made if it does not exist. A path that is not absolute is beside
    the robot file."""
    mode: Literal["all", "fault", "manual"] = "all"
    """What is recorded: all; or the newest in memory, which is written when a fault is latched; or
    only from start to stop on the dashboard."""
    file_s: float = number("a new file after this time (not in mode fault)", 1, 86400, "s", 600.0)
    before_s: float = number("what a fault's file holds from before it", 1, 600, "s", 60.0)
    after_s: float = number("what a fault's file holds from after it", 0, 60, "s", 5.0)
    total_max_mb: int = number(
        "the oldest files are deleted when all together are larger", 1, 10_000_000, "MB", 1000
    )
    journal: bool = False
    """Record also the core's input and output of every tick, for `motord replay`."""
    free_min_mb: int = number(
        "nothing is written when less of the disk is free", 0, 10_000_000, "MB", 200
    )


class Server(BusPublish):
    """A server of the second process."""

    host: str = Field(default="127.0.0.1", pattern=HOST, max_length=253)
    """Address to listen at; this machine only by default."""
    cert_file: str | None = None
    """motord's certificate, for TLS (wss)."""
    key_file: str | None = None
    """Key of cert_file."""


class FoxgloveServer(Server):
    """A WebSocket to which Foxglove connects."""

    port: int = number("TCP port", 1, 65535, "1", 8765)


class FoxglovePublish(FoxgloveServer):
    """A WebSocket to which Foxglove connects, and that only sends."""

    kind: Literal["foxglove"]


class FoxgloveInput(TokenInput, FoxgloveServer):
    """A WebSocket to which Foxglove connects: it publishes to every client, and takes commands from
    those that give the token to its service authorize or in the command itself."""

    kind: Literal["foxglove"]


class RosbridgeServer(Server):
    """A WebSocket that speaks the protocol of rosbridge: roslibjs, roslibpy, and ROS 1 worlds."""

    port: int = number("TCP port", 1, 65535, "1", 9090)


class RosbridgePublish(RosbridgeServer):
    """A rosbridge that only sends."""

    kind: Literal["rosbridge"]


class RosbridgeInput(TokenInput, RosbridgeServer):
    """A rosbridge that sends, and takes commands from clients that connect with the token:
    ws://HOST:PORT/?token=..."""

    kind: Literal["rosbridge"]


_DASHBOARD = rf"^https?://({_NAME}|\[[0-9A-Fa-f:.]{{2,45}}\])(:[0-9]{{1,5}})?$"


class WebServer(Section):
    """The dashboard: a page that this robot serves to browsers."""

    host: str = Field(default="127.0.0.1", pattern=HOST, max_length=253)
    """Address to listen at; this machine only by default."""
    port: int = number("TCP port", 1, 65535, "1", 8088)
    rate_hz: float = number("states a second for each page at most", 1, 100, "Hz", 50.0)
    token_file: str | None = Field(default=None, min_length=1)
    """File with the token that a page has to show; at least 16 characters, readable by the daemon's
    user alone. A path that is not absolute is beside the robot file. Pages of this machine may
    watch without it."""
    cert_file: str | None = None
    """motord's certificate, for TLS (https)."""
    key_file: str | None = None
    """Key of cert_file."""
    behind_proxy: bool = False
    """A reverse proxy encrypts what leaves the protected network: TLS is not needed here."""
    fleet: tuple[Annotated[str, Field(pattern=_DASHBOARD, max_length=280)], ...] = Field(
        default=(), strict=False
    )
    """Addresses of other dashboards, as browsers show them (https://r2.example:8088): this page
    shows their robots too, and their pages may connect here."""


class WebPublish(WebServer, Publish):
    """A dashboard that only shows the robot."""

    kind: Literal["web"]


class WebInput(WebServer, BusInput):
    """A dashboard that shows the robot, and takes commands from pages that have shown the token."""

    kind: Literal["web"]
    lease_s: float = number(
        "a pad that sends nothing for this long is released", 0.1, 0.3, "s", 0.3
    )
    trust_loopback: bool = False
    """Pages on this machine may command without a token, and so may every user of it. Set it to
    confirm that this is meant."""


class JoystickInput(BusInput):
    """A joystick or gamepad at this machine. It commands as long as its dead-man button is held."""

    kind: Literal["joystick"]
    device: str = Field(min_length=1)
    """Device file (/dev/input/by-id/...-event-joystick), or a part of the joystick's name."""
    dead_man: str = Field(default="BTN_TL", pattern=r"^BTN_[A-Z0-9_]+$")
    """Button to be held, by the kernel's name."""
    estop_button: str | None = Field(default=None, pattern=r"^BTN_[A-Z0-9_]+$")
    """Button that is an emergency stop, whatever source commands and whatever else is held."""
    linear_axis: str = Field(default="ABS_Y", pattern=r"^ABS_[A-Z0-9_]+$")
    """Axis of the speed: away from you is forward."""
    angular_axis: str = Field(default="ABS_X", pattern=r"^ABS_[A-Z0-9_]+$")
    """Axis of the turn rate: to the left turns left."""
    lateral_axis: str | None = Field(default=None, pattern=r"^ABS_[A-Z0-9_]+$")
    """Axis of the speed sideways, on a base that moves so: to the left moves to the left."""
    linear_m_s: float = number("speed at the end of the axis", 0.001, 50, "m/s", 0.3)
    lateral_m_s: float = number("speed at the end of lateral_axis", 0.001, 50, "m/s", 0.3)
    angular_rad_s: float = number("turn rate at the end of the axis", 0.001, 100, "rad/s", 0.6)
    dead_zone: float = number("part of the axis around its middle that is zero", 0, 0.9, "1", 0.1)
    rate_hz: float = number("commands a second", 1, 200, "Hz", 20.0)


_ROS_NAME = r"^(~/|/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*$"
RosName = Annotated[str, Field(pattern=_ROS_NAME, max_length=200)]


class RosNode(Section):
    """The ROS 2 node. Sections with the same settings are one node."""

    domain_id: int = number("ROS_DOMAIN_ID of the nodes that are to see motord", 0, 232, "1", 0)
    namespace: str = Field(default="/", pattern=r"^/([A-Za-z]\w*(/[A-Za-z]\w*)*)?$")
    """Prefix of the name of every topic and service."""
    node_name: str = Field(default="motord", pattern=r"^[A-Za-z]\w*$")
    """Name of the node."""
    distribution: Literal["humble", "jazzy"] = "jazzy"
    """ROS 2 distribution of the nodes that are to see this one: Humble has another graph, and over
    Zenoh other keys. Iron and later are as Jazzy."""
    remap: dict[RosName, RosName] = Field(default_factory=dict)
    """Topics and services of this section that have another name: cmd_vel = "/cmd_vel_safe". Names
    as everywhere in ROS 2: below the namespace, below the node (~/), or as they are (/)."""


class Ros2Node(RosNode):
    """A node on DDS."""

    discovery: Literal["localhost", "subnet"] = "localhost"
    """Where other nodes see this one: on this machine (run them with
    ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST), or in the networks to which the machine is
    connected."""
    interface: str | None = Field(default=None, pattern=r"^[A-Za-z0-9_.:-]{1,15}$")
    """The one network interface to use, by name (discovery subnet); by default the DDS library
    chooses."""


class ZenohNode(RosNode):
    """A node on Zenoh, as those with RMW_IMPLEMENTATION=rmw_zenoh_cpp."""

    router: str = Field(default="tcp/127.0.0.1:7447", pattern=ROUTER)
    """Where the router (rmw_zenohd) is: tcp/HOST:PORT, or tls/HOST:PORT."""
    ca_file: str | None = None
    """Certificates of the authority against which the router's certificate is checked (tls)."""
    cert_file: str | None = None
    """motord's own certificate, for a router that requires one (tls)."""
    key_file: str | None = None
    """Key of cert_file."""

    @property
    def router_host(self) -> str:
        """Host of `router`."""
        return self.router.partition("/")[2].rpartition(":")[0].strip("[]")

    @property
    def encrypted(self) -> bool:
        """Whether the connection to the router is encrypted."""
        return self.router.startswith("tls/")


class RosTopics(BusPublish, RosNode):
    """Topics of a ROS 2 node. No ROS is needed here."""

    namespaced_tf: bool = False
    """tf and tf_static are below the namespace, for listeners that remap /tf to tf. Otherwise they
    are /tf and /tf_static, where tf2 listens."""
    frame_prefix: str | None = Field(default=None, pattern=r"^([A-Za-z][A-Za-z0-9_/]*)?$")
    """Prefix of each frame name, as "r2/" for r2/odom and r2/base_link. By default it is the
    namespace, or nothing with namespaced_tf."""
    urdf_file: str | None = None
    """Robot description that is published; by default one made from the robot file. A path that is
    not absolute is beside the robot file."""

    def prefix_of_frames(self) -> str:
        """Return `frame_prefix`, or the prefix that follows from the namespace."""
        if self.frame_prefix is not None:
            return self.frame_prefix
        space = self.namespace.strip("/")
        return f"{space}/" if space and not self.namespaced_tf else ""


class Ros2Publish(RosTopics, Ros2Node):
    """Topics of a ROS 2 node, on DDS."""

    kind: Literal["ros2"]


class ZenohPublish(RosTopics, ZenohNode):
    """Topics of a ROS 2 node, on Zenoh."""

    kind: Literal["ros2-zenoh"]


class ActionInput(BusInput):
    """An input with the actions that move the robot."""

    goal_lease_s: float | None = number(
        "a goal ends when its client has not published its id on ~/goal_alive for this long; not "
        "given: it goes on without its client",
        0.1,
        60,
        "s",
        None,
    )


class Ros2Input(ActionInput, StampedInput, Ros2Node):
    """Commands from ROS 2 nodes: cmd_vel (a TwistStamped; stamped = false: a Twist),
    joint_commands, the actions drive_distance, rotate and calibrate, and the services arm, disarm,
    stop, estop, reset, reset_odometry, parameters and life cycle."""

    kind: Literal["ros2"]
    trust_network: bool = False
    """DDS does not authenticate: with discovery subnet, all that reach the domain may move the
    robot. Set it to confirm that this is meant."""


class ZenohInput(ActionInput, StampedInput, ZenohNode):
    """Commands as with kind ros2, from ROS 2 nodes on Zenoh, whose service calls reach motord,
    too."""

    kind: Literal["ros2-zenoh"]
    trust_router: bool = False
    """Every client that the router admits may move the robot, even if the router is on this
    machine: it listens to the network by default. Set it to confirm that this is meant."""


class RclpyInput(ActionInput):
    """Commands by the bridge node of motord.ros2_rclpy, which is started where ROS 2 is installed;
    motord-bus has no part in it."""

    kind: Literal["ros2-rclpy"]
    trust_network: bool = False
    """ROS 2 does not authenticate: all that reach the bridge's domain may move the robot. Set
    it to confirm that this is meant."""


class OtherPublish(BusPublish):
    """A kind that another package brings: its entry point in the group motord.publishers."""

    kind: Literal["other"]
    adapter: str = Field(min_length=1)
    """Name of the entry point."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Options of the adapter, which checks them itself."""


class OtherInput(BusInput):
    """A kind that another package brings: its entry point in the group motord.inputs."""

    kind: Literal["other"]
    adapter: str = Field(min_length=1)
    """Name of the entry point."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Options of the adapter, which checks them itself."""
