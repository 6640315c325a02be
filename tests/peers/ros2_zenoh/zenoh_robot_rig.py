# SPDX-License-Identifier: Apache-2.0
"""A running robot on Zenoh, and another node that drives it."""

import contextlib
import time

import pytest
from tests.peers.light import LIGHT
from tests.peers.ros2_zenoh.zenoh_rig import REQUEST, STORE, ask, attached, peer
from tests.peers.ros2_zenoh.zenoh_router import endpoint, free_port, started
from tests.sim.daemon_stage import release_sources, running, wait_until

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


def command(linear_m_s, age_s=0.0, lateral_m_s=0.0):
    make = STORE.types
    sec, nanosec = divmod(time.time_ns() - round(age_s * 1e9), 1_000_000_000)
    stamp = make["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    message = make[TWIST_STAMPED](
        header=make["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
        twist=make["geometry_msgs/msg/Twist"](
            linear=make["geometry_msgs/msg/Vector3"](x=linear_m_s, y=lateral_m_s, z=0.0),
            angular=make["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0),
        ),
    )
    return bytes(STORE.serialize_cdr(message, TWIST_STAMPED))


class Driver:
    """A node that receives odometry, and sends commands and calls when a test calls its methods."""

    def __init__(self, session):
        self.session = session
        self.received = []
        self._kept = session.declare_subscriber(ODOM_KEY, self._take)

    def _take(self, sample):
        message = STORE.deserialize_cdr(sample.payload.to_bytes(), "nav_msgs/msg/Odometry")
        self.received.append(message)

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
    """The stage of a running robot, and a driver."""
    port = free_port()
    where = [f"{table}.z.{key}" for table in ("publish", "input") for key in ("kind", "router")]
    values = ["ros2-zenoh", endpoint(port)] * 2
    settings = [f"{key}={value}" for key, value in zip(where, values, strict=True)]
    settings += [f"{table}.z.domain_id=5" for table in ("publish", "input")]
    settings += [f"{table}.z.namespace=/r2" for table in ("publish", "input")]
    settings += ["publish.z.rate_hz=20", "input.z.trust_router=true"]
    settings += [f"input.z.lease_s={LEASE_S}", f"safety.command_timeout_s={LEASE_S}"]
    folder = tmp_path_factory.mktemp("zenoh")
    with (
        started(port) as router,
        running(folder, *settings, *LIGHT) as stage,
        contextlib.ExitStack() as later,
    ):
        assert router.stdout.readline() == b"ready\n"
        session = later.enter_context(peer(port))
        stage.wait_for("idle")
        driver = Driver(session)
        wait_until(lambda: figures(stage).get("lease"), "a lease")
        wait_until(lambda: driver.received, "odometry")
        yield stage, driver


def figures(stage):
    return (stage.robot.status()["bus"] or {}).get("inputs", {}).get("z", {})


def lapsed(driver, name):
    """Call the service `name` until it succeeds: commands of the last test have to lapse first."""
    wait_until(lambda: driver.call(name).success, name)


@contextlib.contextmanager
def armed(stage, driver):
    lapsed(driver, "arm")
    release_sources(stage)
    try:
        yield
    finally:
        assert driver.call("stop").success
        stage.wait_for("armed")
        assert driver.call("disarm").success
        stage.wait_for("idle")
