# SPDX-License-Identifier: Apache-2.0
"""`linear.y` of every network moves a mecanum base to the left. A base that cannot move sideways
follows the rest of the command, counts it and logs it once."""

import asyncio
import contextlib
import json
import math
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.peers.foxglove.foxglove_wire import wired
from tests.peers.light import LOOP
from tests.peers.mqtt.mosquitto import broker, free_port, needs_mosquitto, stamp
from tests.peers.ros2.ros2_stage import DOMAIN, peer
from tests.peers.tokens import TOKEN, token_file
from tests.sim.daemon_stage import (
    DEADLINE_S,
    PATIENT,
    ROOT,
    TRIES,
    armed,
    running,
    wait_until,
    was_held_up,
)

from motord.client import ClientError

pytest.importorskip("cyclonedds", reason="needs cyclonedds")
pytest.importorskip("zenoh", reason="needs eclipse-zenoh")
from tests.peers.ros2_zenoh import zenoh_rig, zenoh_robot_rig, zenoh_router

pytestmark = needs_mosquitto
MECANUM, DIFFERENTIAL = "mecanum4", "demo"
ROS_CLIENT = Path(__file__).parents[1] / "rosbridge/ros_client.py"
LEASE_S = 1.0
SUCCEEDED = 4
CANNOT = "asks this base to move sideways"


def table(name, **values):
    return [f"input.{name}.{key}={json.dumps(value)}" for key, value in values.items()]


def settings(place, folder):
    token = str(token_file(folder))
    dds = {"kind": "ros2", "domain_id": DOMAIN, "lease_s": LEASE_S}
    made = [
        *table("dds", namespace="/stamped", **dds),
        *table("python", namespace="/plain", stamped=False, **dds),
        *table("z", kind="ros2-zenoh", router=zenoh_router.endpoint(place.router_port),
               domain_id=5, namespace="/r2", trust_router=True, lease_s=LEASE_S),
        *table("fleet", kind="mqtt", port=place.broker.port, topic_prefix="site/r2",
               token_file=token, lease_s=LEASE_S),
        *table("web", kind="rosbridge", port=place.web_port, stamped=False, token_file=token,
               lease_s=LEASE_S),
        *table("fox", kind="foxglove", port=place.fox_port, stamped=False, token_file=token,
               lease_s=LEASE_S),
    ]  # fmt: skip
    return [*made, f"safety.command_timeout_s={LEASE_S}", *PATIENT, LOOP]


@pytest.fixture(scope="module")
def place(request, tmp_path_factory):
    """A robot that takes commands from every network of NETWORKS at once."""
    folder = tmp_path_factory.mktemp("strafe")
    made = SimpleNamespace(router_port=free_port(), web_port=free_port(), fox_port=free_port())
    with (
        broker(folder, "allow_anonymous true") as made.broker,
        zenoh_router.started(made.router_port) as router,
    ):
        assert router.stdout.readline() == b"ready\n"
        robot = ROOT / f"config/robots/{request.param}.toml"
        joints = ["front_left", "front_right", "rear_left", "rear_right"]
        joints = joints if request.param == MECANUM else ["left", "right"]
        patient = [
            f"joint.{joint}.{setting}"
            for joint in joints
            for setting in ("reply_timeout_s=0.2", "tries=10")
        ]
        with running(folder, *settings(made, folder), *patient, robot=robot) as made.stage:
            made.stage.wait_for("idle")
            wait_until(lambda: leased(made.stage) == set(NETWORKS), "a lease of each input")
            yield made


def leased(stage):
    inputs = (stage.robot.status()["bus"] or {}).get("inputs", {})
    return {name for name, one in inputs.items() if one.get("lease")}


async def nothing():
    """Send nothing, because the peer process sends by itself."""


@contextlib.asynccontextmanager
async def by_dds(place, linear_m_s, lateral_m_s):
    """Send stamped commands, which the receiving thread in C takes."""
    with peer("plane", "rt/stamped/cmd_vel", linear_m_s, lateral_m_s):
        yield nothing


@contextlib.asynccontextmanager
async def by_dds_and_python(place, linear_m_s, lateral_m_s):
    with peer("plane", "rt/plain/cmd_vel", linear_m_s, lateral_m_s, "plain"):
        yield nothing


@contextlib.asynccontextmanager
async def by_zenoh(place, linear_m_s, lateral_m_s):
    with zenoh_rig.peer(place.router_port) as session:

        async def send():
            payload = zenoh_robot_rig.command(linear_m_s, lateral_m_s=lateral_m_s)
            session.put(zenoh_robot_rig.COMMAND_KEY, payload, attachment=zenoh_rig.attached())

        yield send


def twist(linear_m_s, lateral_m_s):
    linear = {"x": linear_m_s, "y": lateral_m_s, "z": 0.0}
    return {"linear": linear, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}


@contextlib.asynccontextmanager
async def by_mqtt(place, linear_m_s, lateral_m_s):
    async def send():
        command = {"token": TOKEN, "header": stamp(), "twist": twist(linear_m_s, lateral_m_s)}
        await asyncio.to_thread(place.broker.pub, "site/r2/cmd_vel", command)

    yield send


@contextlib.asynccontextmanager
async def by_rosbridge(place, linear_m_s, lateral_m_s):
    url = f"ws://127.0.0.1:{place.web_port}/?token={TOKEN}"
    command = [sys.executable, str(ROS_CLIENT), url, str(linear_m_s), str(lateral_m_s)]
    client = await asyncio.create_subprocess_exec(*command)
    try:
        yield nothing
    finally:
        client.kill()
        await client.wait()


@contextlib.asynccontextmanager
async def by_foxglove(place, linear_m_s, lateral_m_s):
    async with wired(place.fox_port) as client:
        assert (await client.call("authorize", token=TOKEN))["success"]
        channel = await client.advertise("/cmd_vel")

        async def send():
            await client.publish(channel, twist(linear_m_s, lateral_m_s))

        yield send


NETWORKS = {
    "dds": by_dds, "python": by_dds_and_python, "z": by_zenoh, "fleet": by_mqtt,
    "web": by_rosbridge, "fox": by_foxglove,
}  # fmt: skip


async def sent_until(stage, send, condition, what):
    """Send until `condition` holds. Arm again after a fault that a busy machine caused."""
    async with asyncio.timeout(DEADLINE_S):
        while not condition():
            with contextlib.suppress(ClientError):
                if (state := stage.state()) == "fault":
                    stage.robot.reset()
                elif state == "idle":
                    stage.robot.arm()
            await send()
            await asyncio.sleep(0.05)


@pytest.fixture
def resting(place):
    """The robot, armed, with no source in command."""
    wait_until(lambda: not place.stage.robot.status()["leases"], "the command's end")
    with armed(place.stage) as stage:
        yield stage


def shift(before, after):
    """Return the motion forward and to the left in m, in the axes of the base before it."""
    dx_m, dy_m = after.x_m - before.x_m, after.y_m - before.y_m
    cosine, sine = math.cos(before.heading_rad), math.sin(before.heading_rad)
    return dx_m * cosine + dy_m * sine, dy_m * cosine - dx_m * sine


def on(robot):
    return pytest.mark.parametrize("place", [robot], indirect=True)


@on(MECANUM)
@pytest.mark.parametrize("network", NETWORKS)
async def test_linear_y_moves_a_mecanum_base_to_the_left(place, resting, network):
    before = resting.sim.truth()
    async with NETWORKS[network](place, 0.0, 0.2) as send:
        await sent_until(
            resting, send, lambda: shift(before, resting.sim.truth())[1] > 0.1, "to the left"
        )
        (lease,) = resting.robot.status()["leases"]
    assert lease["owner"] == network
    assert (lease["linear_m_s"], lease["lateral_m_s"]) == (0.0, 0.2)
    forward_m, left_m = shift(before, resting.sim.truth())
    assert abs(forward_m) < 0.2 * left_m
    assert resting.robot.status()["commands"]["sideways"] == 0


@on(DIFFERENTIAL)
@pytest.mark.parametrize("network", NETWORKS)
async def test_a_base_that_cannot_move_sideways_follows_the_rest_and_counts_it(
    place, resting, network
):
    before, counted = resting.sim.truth(), resting.robot.status()["commands"]["sideways"]
    async with NETWORKS[network](place, 0.2, 0.2) as send:
        await sent_until(
            resting, send, lambda: shift(before, resting.sim.truth())[0] > 0.1, "forward"
        )
    forward_m, left_m = shift(before, resting.sim.truth())
    assert abs(left_m) < 0.2 * forward_m
    assert resting.robot.status()["commands"]["sideways"] > counted
    assert resting.logged().count(CANNOT) == 1  # one line for all networks together


SLOW_M_S = 0.1
"""Low enough that the overshoot on a busy machine stays within the tolerance."""


def asked(direction_rad, distance_m=0.3):
    goal = {"distance_m": distance_m, "speed_m_s": SLOW_M_S, "tolerance_m": 0.0, "timeout_s": 0.0}
    words = json.dumps(goal | {"direction_rad": direction_rad})
    return peer("act", "/stamped/drive_distance", "DriveDistance", words)


def carried_out(stage, direction_rad):
    """Return the pose before, the result and the feedback of the action; repeat it if held up."""
    for _ in range(TRIES):
        with armed(stage), asked(direction_rad) as client:
            before = stage.sim.truth()
            assert client.find(lambda answer: "accepted" in answer, "an answer")["accepted"]
            sent = client.find(lambda answer: "status" in answer, "a result")
            if not was_held_up(sent["result"]["message"]):
                break
    return before, sent, [answer["feedback"] for answer in client.received if "feedback" in answer]


@on(MECANUM)
@pytest.mark.parametrize("direction_rad", [math.pi / 2, -2.5])
def test_the_action_drives_a_distance_in_any_direction(place, resting, direction_rad):
    before, sent, feedback = carried_out(resting, direction_rad)
    assert (sent["status"], sent["result"]["message"]) == (SUCCEEDED, "")
    assert sent["result"]["distance_m"] == pytest.approx(0.3, abs=0.011)
    assert max(answer["speed_m_s"] for answer in feedback) > 0.05
    forward_m, left_m = shift(before, resting.sim.truth())
    assert forward_m == pytest.approx(0.3 * math.cos(direction_rad), abs=0.05)
    assert left_m == pytest.approx(0.3 * math.sin(direction_rad), abs=0.05)


@on(DIFFERENTIAL)
@pytest.mark.parametrize("direction_rad", [math.pi / 2, math.nan])
def test_the_action_refuses_a_direction_that_the_base_cannot_take(place, resting, direction_rad):
    before = resting.sim.truth()
    with asked(direction_rad) as client:
        assert not client.find(lambda answer: "accepted" in answer, "an answer")["accepted"]
    assert resting.sim.truth().x_m == before.x_m
    words = "cannot move sideways: turn it" if direction_rad < math.inf else "a finite number"
    wait_until(lambda: words in resting.logged(), words)
