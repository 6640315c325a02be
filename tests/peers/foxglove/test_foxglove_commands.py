# SPDX-License-Identifier: Apache-2.0
"""A Foxglove server that takes commands: every client may watch; one with the token drives the
robot and changes its limits."""

import asyncio
import contextlib
import json
import shutil
import ssl
import subprocess
from pathlib import Path

import pytest
from tests.peers.foxglove.foxglove_wire import wired
from tests.peers.light import LIGHT
from tests.peers.mqtt.mosquitto import certified, free_port
from tests.peers.tokens import TOKEN, token_file
from tests.sim.daemon_stage import (
    DEADLINE_S,
    ROOT,
    becomes_idle,
    release_sources,
    running,
    wait_until,
)

from motord.bus.foxglove.clients import CHANNELS_MAX

TWIST = {"linear": {"x": 0.2, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
WHEELS = {"name": ["left", "right"], "velocity": [2.0, 2.0], "position": [], "effort": []}
MODULES = ROOT / "build/node/node_modules"
LIMIT = "limits.linear_m_s"


@pytest.fixture(scope="module")
def stage(tmp_path_factory, port):
    folder = tmp_path_factory.mktemp("foxglove")
    settings = (
        "input.fox.kind=foxglove", f"input.fox.port={port}", "input.fox.stamped=false",
        f"input.fox.token_file={token_file(folder)}", "input.fox.rate_hz=50",
        "input.fox.lease_s=1.0",
        "safety.command_timeout_s=1.0", *LIGHT,
    )  # fmt: skip
    with running(folder, *settings) as stage:
        stage.wait_for("idle")
        wait_until(lambda: inputs(stage).get("lease"), "a lease")
        yield stage


def inputs(stage):
    return ((stage.robot.status()["bus"] or {}).get("inputs") or {}).get("fox", {})


async def let_in(client):
    answer = await client.call("authorize", token=TOKEN)
    assert answer == {"success": True, "message": "this connection may command until it ends"}


async def armed(client, **token):
    """Arm; repeat while a drive of a busy machine is unresponsive or another lease still lives."""
    while not (await client.call("arm", **token))["success"]:
        await client.call("reset", **token)


async def driven(stage, client, channel, message, **token):
    """Publish `message` until the robot moves; arm the robot when it is not armed."""
    while (state := stage.state()) != "moving":
        if state != "armed":
            await armed(client, **token)
            release_sources(stage)
        await client.publish(channel, message)
        await asyncio.sleep(0.05)


async def complaint(client, about, ask):
    """Return the server's warning about `about`. Repeat `ask`: warnings are rate-limited."""
    while True:
        await ask()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(1.0):
                answer = await client.received("status", lambda answer: answer["id"] == about)
                return answer["message"]


WRONG = [{}, *({"token": shown} for shown in ("wrong-token-of-some-length", 7, "\ud800"))]


@pytest.mark.parametrize("request_", WRONG)
async def test_a_service_without_the_token_does_nothing(stage, port, request_):
    becomes_idle(stage)
    refused = inputs(stage)["refused"]
    async with asyncio.timeout(DEADLINE_S), wired(port) as client:
        for service in ("arm", "authorize"):
            answer = await client.call(service, **request_)
            assert answer == {"success": False, "message": "the token is missing or wrong"}
        assert not (await client.call("arm"))["success"]
    wait_until(lambda: inputs(stage)["refused"] >= refused + 3, "the refusals")
    assert stage.state() not in ("armed", "moving")


async def test_a_token_in_a_call_is_valid_for_that_call_only(stage, port):
    async with asyncio.timeout(DEADLINE_S), wired(port) as client:
        assert (await client.call("estop", token=TOKEN)) == {"success": True, "message": "estop"}
        assert not (await client.call("reset"))["success"]
        while not (await client.call("reset", token=TOKEN))["success"]:
            await asyncio.sleep(0.05)
    stage.wait_for("idle")


@pytest.mark.parametrize(("topic", "message"), [("/cmd_vel", TWIST), ("/joint_commands", WHEELS)])
async def test_an_authorized_client_drives_and_its_lease_lapses_when_it_disconnects(
    stage, port, topic, message
):
    stage.robot.disarm()
    async with asyncio.timeout(2 * DEADLINE_S):
        while stage.state() != "armed":  # repeated if a busy machine latches a fault
            async with wired(port) as client:
                await let_in(client)
                channel = await client.advertise(topic)
                await driven(stage, client, channel, message)
                (lease,) = stage.robot.status()["leases"]
                assert lease["owner"] == "fox"
            stage.wait_for("armed", "fault")  # the lease lapsed: no source commanded zero
        async with wired(port) as client:
            await client.call("disarm", token=TOKEN)


async def test_a_message_may_carry_the_token_itself(stage, port):
    async with asyncio.timeout(2 * DEADLINE_S), wired(port) as client:
        channel = await client.advertise("/cmd_vel")
        await driven(stage, client, channel, TWIST | {"token": TOKEN}, token=TOKEN)
        await client.call("disarm", token=TOKEN)


@pytest.mark.parametrize("message", [TWIST, TWIST | {"token": "wrong"}, [1], b"{", b"[" * 60000])
async def test_a_message_without_the_token_is_refused_counted_and_reported(stage, port, message):
    before, refused = stage.robot.status()["commands"]["accepted"], inputs(stage)["refused"]
    async with asyncio.timeout(DEADLINE_S), wired(port) as client:
        channel = await client.advertise("/cmd_vel")
        answer = await complaint(client, "cmd_vel", lambda: client.publish(channel, message))
        assert "token" in answer
    wait_until(lambda: inputs(stage)["refused"] > refused, "a refusal")
    assert stage.robot.status()["commands"]["accepted"] == before


async def test_a_warning_is_removed_when_its_cause_is_gone(stage, port):
    zero = {"linear": {"x": 0.0}, "angular": {"z": 0.0}, "token": TOKEN}
    async with asyncio.timeout(DEADLINE_S), wired(port) as client:
        channel = await client.advertise("/cmd_vel")
        await complaint(client, "cmd_vel", lambda: client.publish(channel, TWIST))
        await client.publish(channel, zero)
        answer = await client.received("removeStatus")
        assert answer["statusIds"] == ["cmd_vel"]


async def test_an_unadvertised_channel_no_longer_commands(stage, port):
    accepted = stage.robot.status()["commands"]["accepted"]
    async with asyncio.timeout(DEADLINE_S), wired(port) as client:
        await let_in(client)
        channel = await client.advertise("/cmd_vel")
        await client.send("unadvertise", channelIds=[channel])
        await client.publish(channel, TWIST)
        await client.received("status", lambda answer: "nknown channel" in answer["message"])
    assert stage.robot.status()["commands"]["accepted"] == accepted


async def test_other_clients_do_not_push_out_the_one_in_command(stage, port):
    """The others open many channels, and their connections come and go."""
    zero = {"linear": {"x": 0.0}, "angular": {"z": 0.0}}

    async def obeyed():
        before = stage.robot.status()["commands"]["accepted"]
        while stage.robot.status()["commands"]["accepted"] == before:
            await client.publish(channel, zero)
            await asyncio.sleep(0.02)

    async with asyncio.timeout(2 * DEADLINE_S), wired(port) as client:
        await let_in(client)
        channel = await client.advertise("/cmd_vel")
        for _ in range(4):
            async with wired(port) as other:
                for _ in range(100):
                    await other.advertise("/cmd_vel")
                await other.call("reset_odometry")  # the server has read the channels
                for _ in range(20):
                    await let_in(other)
            await obeyed()


async def test_channels_of_strangers_leave_those_of_a_friend_alone(stage, port):
    """The friend puts the token into each message, and never calls `authorize`."""
    zero = {"linear": {"x": 0.0}, "angular": {"z": 0.0}, "token": TOKEN}

    async def obeyed():
        before = stage.robot.status()["commands"]["accepted"]
        while stage.robot.status()["commands"]["accepted"] == before:
            await friend.publish(channel, zero)
            await asyncio.sleep(0.02)

    async with asyncio.timeout(2 * DEADLINE_S), wired(port) as friend, wired(port) as stranger:
        channel = await friend.advertise("/cmd_vel")
        await obeyed()
        first = await stranger.advertise("/cmd_vel")
        for _ in range(CHANNELS_MAX + 50):
            await stranger.advertise("/cmd_vel")
        assert not (await stranger.call("stop"))["success"]  # the server has read the channels
        await obeyed()
        answer = await complaint(stranger, "publish", lambda: stranger.publish(first, TWIST))
        assert "advertise it again" in answer


@pytest.mark.parametrize(("topic", "encoding"), [("/odom", "json"), ("/cmd_vel", "cdr")])
async def test_a_channel_that_cannot_be_published_is_reported(stage, port, topic, encoding):
    async with asyncio.timeout(DEADLINE_S), wired(port) as client:
        answer = await complaint(client, "publish", lambda: client.advertise(topic, encoding))
        assert answer == "publish: taken are /cmd_vel, /joint_commands, in json"


def of(value):
    """Return a check: whether the one parameter of an answer has this value."""
    return lambda answer: [one["value"] for one in answer["parameters"]] == [value]


async def test_limits_are_read_and_changed_and_changes_reach_subscribers(stage, port):
    async with asyncio.timeout(DEADLINE_S), wired(port) as client, wired(port) as watcher:
        await let_in(client)
        while LIMIT not in (all_ := await client.parameters("getParameters", parameterNames=[])):
            await asyncio.sleep(0.05)  # motord-bus has not read the limits yet
        assert all_["base.track_m"] > 0
        await watcher.send("subscribeParameterUpdates", parameterNames=[LIMIT])
        value = all_[LIMIT] / 2
        change = [{"name": LIMIT, "value": value}]
        assert await client.parameters("setParameters", parameters=change) == {LIMIT: value}
        assert stage.robot.call("params.get", names=[LIMIT]) == {LIMIT: value}
        await watcher.received("parameterValues", of(value))
        stage.robot.call("params.set", **{LIMIT: all_[LIMIT]})  # through the local socket
        await watcher.received("parameterValues", of(all_[LIMIT]))


async def test_an_absent_limit_is_reported_as_inf_as_in_the_robot_file(stage, port):
    jerk = "limits.linear_m_s3"
    before = stage.robot.call("params.get", names=[jerk])
    stage.robot.params_set(**{jerk: None}, force=True)
    async with asyncio.timeout(DEADLINE_S), wired(port) as client:
        await let_in(client)
        change = [{"name": jerk, "value": "inf"}]
        assert await client.parameters("setParameters", parameters=change) == {jerk: "inf"}
    assert stage.robot.call("params.get", names=[jerk]) == {jerk: None}
    stage.robot.call("params.set", **before)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        (LIMIT, 1e9, "out of range"),
        (LIMIT, "fast", "not a number"),
        (LIMIT, True, "not a number"),
        (LIMIT, None, "not a number"),
        ("base.track_m", 1.0, "cannot be changed"),
        ("limits.nothing", 1.0, "no parameter"),
    ],
)
async def test_a_refused_change_changes_nothing_and_reports_the_reason(
    stage, port, name, value, words
):
    before = stage.robot.call("params.get")
    async with asyncio.timeout(DEADLINE_S), wired(port) as client:
        await let_in(client)
        change = {"name": name} | ({} if value is None else {"value": value})
        both = [{"name": "limits.angular_rad_s", "value": 0.123}, change]
        answer = await complaint(
            client, "parameters", lambda: client.send("setParameters", parameters=both)
        )
        assert words in answer
    assert stage.robot.call("params.get") == before


async def test_a_client_without_the_token_changes_no_limit(stage, port):
    before = stage.robot.call("params.get")
    async with asyncio.timeout(DEADLINE_S), wired(port) as client:
        change = [{"name": LIMIT, "value": 0.01}]
        values = await client.parameters("setParameters", parameters=change)
    assert values == {LIMIT: before[LIMIT]}
    assert stage.robot.call("params.get") == before


@pytest.mark.skipif(not shutil.which("openssl"), reason="apt install openssl")
async def test_it_serves_tls_with_the_certificate_of_the_robot_file(tmp_path):
    certified(tmp_path)
    port = free_port()
    settings = ("input.fox.kind=foxglove", f"input.fox.port={port}",
                f"input.fox.token_file={token_file(tmp_path)}",
                f"input.fox.cert_file={tmp_path}/host.pem",
                f"input.fox.key_file={tmp_path}/host.key")  # fmt: skip
    context = ssl.create_default_context(cafile=tmp_path / "ca.pem")
    with running(tmp_path, *settings, simulated=False) as stage:
        async with asyncio.timeout(DEADLINE_S), wired(port, context) as client:
            await let_in(client)
            answer = await client.call("estop")
            assert answer["success"]
            assert answer["message"].startswith("estop")  # there are no drives: rest is unknown
        assert stage.state() == "estop"


@pytest.mark.skipif(
    not (shutil.which("node") and (MODULES / "@foxglove/ws-protocol").exists()),
    reason="apt install nodejs npm; npm install --prefix build/node @foxglove/ws-protocol ws",
)
def test_foxgloves_own_client_arms_drives_stops_and_changes_a_limit(stage, port):
    program = Path(__file__).with_name("foxglove_operator.mjs")
    run = subprocess.run(
        ["node", str(program), f"ws://127.0.0.1:{port}", str(MODULES), TOKEN],
        capture_output=True, timeout=3 * DEADLINE_S,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr.decode()
    answer = json.loads(run.stdout)
    services = {"authorize", "arm", "disarm", "stop", "estop", "reset", "reset_odometry"}
    assert set(answer["services"]) == {f"/{name}" for name in services}
    assert answer["refused"] == {"success": False, "message": "the token is missing or wrong"}
    assert answer["arm"] == {"success": True, "message": "armed"}
    assert answer["moved"] is True
    assert answer["estop"] == {"success": True, "message": "estop"}
    assert answer["reset"] == {"success": True, "message": "idle"}
    assert answer["limit"] == [{"name": LIMIT, "value": 0.25, "type": "float64"}]
    assert stage.robot.call("params.get", names=[LIMIT]) == {LIMIT: 0.25}
