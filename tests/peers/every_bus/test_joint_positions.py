# SPDX-License-Identifier: Apache-2.0
"""Joint positions that a bus commands to a robot without a base, and those that it publishes."""

import asyncio
import json

import pytest
from tests.peers.tokens import TOKEN, token_file
from tests.sim.daemon_stage import DEADLINE_S, ROOT, armed, rests, running, wait_until
from websockets.asyncio.client import connect

GOAL_RAD = {"pan": 0.6, "tilt": -0.3}
ZERO = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}


@pytest.fixture(scope="module")
def stage(tmp_path_factory, port):
    folder = tmp_path_factory.mktemp("positions")
    settings = (
        "input.web.kind=rosbridge", f"input.web.port={port}", "input.web.stamped=false",
        f"input.web.token_file={token_file(folder)}", "input.web.rate_hz=50",
        "input.web.lease_s=1.0", "safety.command_timeout_s=1.0",
        *(f"joint.{name}.{setting}" for name in GOAL_RAD
          for setting in ("tries=10", "reply_timeout_s=0.2")),
    )  # fmt: skip
    with running(folder, *settings, robot=ROOT / "config/robots/pan-tilt.toml") as stage:
        stage.wait_for("idle")
        wait_until(lambda: web(stage).get("lease"), "a lease")
        yield stage


def web(stage):
    return (stage.robot.status()["bus"] or {}).get("inputs", {}).get("web", {})


def near(stage):
    joints = stage.sim.truth().joints
    return all(abs(joints[name].position_rad - goal) < 0.03 for name, goal in GOAL_RAD.items())


async def test_a_joint_state_moves_the_joints_to_its_positions(stage, port):
    message = {"header": ZERO, "name": list(GOAL_RAD), "position": list(GOAL_RAD.values())}
    request = {"op": "publish", "topic": "/joint_commands", "msg": message}
    with armed(stage):
        async with asyncio.timeout(DEADLINE_S):
            async with connect(f"ws://127.0.0.1:{port}/?token={TOKEN}") as client:
                while not near(stage):
                    await client.send(json.dumps(request))
                    await asyncio.sleep(0.05)
                await client.send(json.dumps({"op": "subscribe", "topic": "/joint_states"}))
                async for raw in client:
                    if (answer := json.loads(raw)).get("topic") == "/joint_states":
                        break
    shown = dict(zip(answer["msg"]["name"], answer["msg"]["position"], strict=True))
    assert shown == pytest.approx(GOAL_RAD, abs=0.1)  # it may still be moving


async def test_a_twist_over_the_bus_moves_nothing_and_is_counted(stage, port):
    rests(stage)
    before = {name: joint.position_rad for name, joint in stage.sim.truth().joints.items()}
    refused = web(stage)["refused"]
    twist = {"linear": {"x": 0.2, "y": 0.0}, "angular": {"z": 0.0}}
    request = {"op": "publish", "topic": "/cmd_vel", "msg": twist}
    with armed(stage):
        async with asyncio.timeout(DEADLINE_S):
            async with connect(f"ws://127.0.0.1:{port}/?token={TOKEN}") as client:
                while web(stage)["refused"] <= refused:
                    await client.send(json.dumps(request))
                    await asyncio.sleep(0.05)
        after = {name: joint.position_rad for name, joint in stage.sim.truth().joints.items()}
    assert after == pytest.approx(before, abs=0.01)
