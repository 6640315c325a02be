# SPDX-License-Identifier: Apache-2.0
"""The rosbridge server: a roslibpy program drives the robot. Clients without the token and slow
readers do not disturb it."""

import asyncio
import contextlib
import json
import shutil
import socket
import ssl
import subprocess
import sys
from pathlib import Path

import pytest
from tests.peers.light import LIGHT
from tests.peers.mqtt.mosquitto import certified, free_port
from tests.peers.tokens import TOKEN, token_file
from tests.sim.daemon_stage import DEADLINE_S, ROOT, release_sources, running, wait_until
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from motord.bus import http_server
from motord.bus.rosbridge import adapter as rosbridge
from motord.bus.runtime import Runtime
from motord.client import Refused
from motord.config import RosbridgeInput, load_robot

DEMO = ROOT / "config/robots/demo.toml"
CLIENT = Path(__file__).with_name("ros_client.py")
ROSLIBJS = ROOT / "build/node/node_modules/roslib/dist/RosLib.js"


@pytest.fixture(scope="module")
def ports():
    return free_port(), free_port()


@pytest.fixture(scope="module")
def stage(tmp_path_factory, ports):
    folder = tmp_path_factory.mktemp("rosbridge")
    settings = (
        "input.web.kind=rosbridge", f"input.web.port={ports[0]}", "input.web.stamped=false",
        f"input.web.token_file={token_file(folder)}", "input.web.rate_hz=50",
        "input.web.lease_s=1.0",
        "safety.command_timeout_s=1.0",
        "publish.tell.kind=rosbridge", f"publish.tell.port={ports[1]}", "publish.tell.rate_hz=200",
        *LIGHT, "loop.rate_hz=250",
    )  # fmt: skip
    with running(folder, *settings) as stage:
        stage.wait_for("idle")
        wait_until(lambda: bus(stage).get("inputs", {}).get("web", {}).get("lease"), "a lease")
        yield stage


def bus(stage):
    return stage.robot.status()["bus"] or {}


async def exchanged(port, *requests, until, token=None):
    """Send the requests, and return the first message for which `until` is true."""
    query = f"?token={token}" if token else ""
    async with asyncio.timeout(DEADLINE_S):
        async with connect(f"ws://127.0.0.1:{port}/{query}") as client:
            for request in requests:
                await client.send(request if isinstance(request, str) else json.dumps(request))
            async for raw in client:
                if until(answer := json.loads(raw)):
                    return answer
    return None


def is_status(answer):
    return answer["op"] == "status"


PROGRAMS = {
    "roslibpy": (sys.executable, str(CLIENT)),
    "roslibjs": ("node", str(CLIENT.with_suffix(".mjs"))),
}


@pytest.mark.parametrize("library", sorted(PROGRAMS))
def test_a_client_program_reads_arms_drives_and_stops_the_robot(stage, ports, library):
    command = [*PROGRAMS[library], f"ws://127.0.0.1:{ports[0]}/?token={TOKEN}"]
    if library == "roslibjs":
        if not (shutil.which("node") and ROSLIBJS.exists()):
            pytest.skip("apt install nodejs npm; npm install --prefix build/node roslib@2")
        command.append(str(ROSLIBJS))
    run = subprocess.run(command, capture_output=True, timeout=120)
    assert run.returncode == 0, run.stderr.decode()
    found = json.loads(run.stdout)
    assert "/odom" in found["topics"]
    assert found["odom"]["child_frame_id"] == "base_link"
    assert found["arm"] == {"success": True, "message": "armed"}
    assert found["motor_status"]["commander_priority"] == 100
    assert found["motor_status"]["commander_why"] == "in command: the only one"
    assert found["estop"] == {"success": True, "message": "estop"}
    assert found["reset"] == {"success": True, "message": "idle"}


async def test_wheels_are_commanded_by_the_joints_names(stage, ports):
    wheels = {"name": ["right", "left"], "velocity": [2.0, 2.0]}
    zero = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    message = {"op": "publish", "topic": "/joint_commands", "msg": {"header": zero, **wheels}}

    def armed():
        with contextlib.suppress(Refused):
            stage.robot.reset()
            stage.robot.arm()
        return stage.state() == "armed"

    async with asyncio.timeout(2 * DEADLINE_S):
        async with connect(f"ws://127.0.0.1:{ports[0]}/?token={TOKEN}") as client:
            while (state := stage.state()) != "moving":
                if state != "armed":
                    wait_until(armed, "armed")
                    release_sources(stage)
                await client.send(json.dumps(message))
                await asyncio.sleep(0.05)
    stage.wait_for("armed", "fault")  # "fault": latched by a busy machine
    stage.robot.disarm()


async def test_a_topic_that_is_not_an_input_is_answered_with_those_that_are(stage, ports):
    request = {"op": "publish", "topic": "/odom", "msg": {}}
    answer = await exchanged(ports[0], request, until=is_status, token=TOKEN)
    assert answer["msg"] == "'odom' is not taken; there are: cmd_vel, joint_commands"


@pytest.mark.parametrize("query", ["", "?token=", "?token=wrong-token-of-some-length"])
async def test_a_client_without_the_token_cannot_connect(stage, ports, query):
    with pytest.raises(InvalidStatus, match="401"):
        async with connect(f"ws://127.0.0.1:{ports[0]}/{query}"):
            pass


async def test_silent_strangers_make_room_for_a_client_with_the_token(tmp_path, monkeypatch):
    monkeypatch.setattr(http_server, "ANSWER_WITHIN_S", 3600.0)  # no silent client is closed
    port, count = free_port(), 3 * http_server.STRANGERS_MAX
    section = RosbridgeInput(kind="rosbridge", token_file=str(token_file(tmp_path)), port=port)
    runtime = Runtime(load_robot(DEMO), tmp_path / "no.sock")
    adapter = rosbridge.RosbridgeAdapter("web", section, runtime)
    async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
        serving = tasks.create_task(adapter.run())
        async with connect_again(f"ws://127.0.0.1:{port}/?token={TOKEN}", None) as client:
            readers, writers = zip(*[await stranger(port) for _ in range(count)], strict=True)
            for reader in readers[: count - http_server.STRANGERS_MAX]:
                with contextlib.suppress(ConnectionError):
                    assert await reader.read() == b""
            await client.send(json.dumps({"op": "fragment"}))
            assert "not served" in await client.recv()
            async with connect(f"ws://127.0.0.1:{port}/?token={TOKEN}") as another:
                await another.send(json.dumps({"op": "fragment"}))
                assert "not served" in await another.recv()
            for writer in writers:
                writer.close()
        serving.cancel()


async def stranger(port):
    return await asyncio.open_connection("127.0.0.1", port)


async def test_the_token_may_be_in_the_header(stage, ports):
    headers = {"Authorization": f"Bearer {TOKEN}"}
    async with connect(f"ws://127.0.0.1:{ports[0]}/", additional_headers=headers) as client:
        await client.send(json.dumps({"op": "subscribe", "topic": "/odom"}))
        async with asyncio.timeout(DEADLINE_S):
            assert json.loads(await client.recv())["topic"] == "/odom"


TWIST = {"linear": {"x": 0.2, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"op": "publish", "topic": "/cmd_vel", "msg": TWIST}, "only publishes"),
        ({"op": "subscribe", "topic": "/odour"}, "no topic 'odour'"),
        ({"op": "fragment"}, "not served"),
        ({"op": [[[]]], "id": [[[]]]}, "not served"),
        ("{", "JSON object"),
        ("[" * 60000, "JSON object"),
        ({"op": "fragment", "id": "\ud800"}, "JSON object"),
        ([1], "JSON object"),
    ],
)
async def test_a_publish_only_server_names_what_it_does_not_serve(stage, ports, request_, words):
    accepted = stage.robot.status()["commands"]["accepted"]
    answer = await exchanged(ports[1], request_, until=is_status)
    assert words in answer["msg"]
    assert stage.robot.status()["commands"]["accepted"] == accepted


async def test_a_service_of_a_publish_only_server_does_nothing(stage, ports):
    request = {"op": "call_service", "service": "/arm", "id": "1"}
    answer = await exchanged(ports[1], request, until=lambda one: one["op"] == "service_response")
    assert (answer["result"], answer["id"]) == (False, "1")
    assert stage.state() != "armed"


@pytest.mark.parametrize("throttle", [10**400, -1, "1", None, [[]]])
async def test_an_invalid_throttle_rate_is_ignored(stage, ports, throttle):
    request = {"op": "subscribe", "topic": "/tf", "throttle_rate": throttle}
    assert (await exchanged(ports[1], request, until=lambda one: True))["topic"] == "/tf"


@pytest.mark.parametrize(
    "message", [None, {}, {"linear": {"x": "1"}, "angular": {"z": 0}}, {"linear": 3, "angular": 1}]
)
async def test_a_message_that_is_not_a_twist_is_refused(stage, ports, message):
    request = {"op": "publish", "topic": "/cmd_vel", "msg": message}
    answer = await exchanged(ports[0], request, until=is_status, token=TOKEN)
    assert "neither a Twist" in answer["msg"]


async def test_an_emergency_stop_behind_many_calls_stops_and_every_call_is_answered(stage, ports):
    calls = [{"op": "call_service", "service": "/reset_odometry", "id": n} for n in range(60)]
    calls.append({"op": "call_service", "service": "/estop", "id": len(calls)})
    answers = {}

    def done(answer):
        assert answer["op"] == "service_response", answer
        answers[answer["id"]] = answer
        return len(answers) == len(calls)

    await exchanged(ports[0], *calls, until=done, token=TOKEN)
    assert answers[60]["values"] == {"success": True, "message": "estop"}
    assert stage.state() == "estop"
    assert all(isinstance(answer["result"], bool) for answer in answers.values())
    stage.robot.call("reset")
    stage.wait_for("idle")


async def test_a_client_gets_messages_no_faster_than_its_throttle_rate(stage, ports):
    request = {"op": "subscribe", "topic": "/odom", "throttle_rate": 200}
    stamps = []
    async with asyncio.timeout(DEADLINE_S):
        async with connect(f"ws://127.0.0.1:{ports[1]}/") as client:
            await client.send(json.dumps(request))
            async for raw in client:
                stamp = json.loads(raw)["msg"]["header"]["stamp"]
                stamps.append(stamp["sec"] + stamp["nanosec"] * 1e-9)
                if len(stamps) == 4:
                    break
    assert stamps[-1] - stamps[0] > 0.3


async def test_a_reader_that_stops_reading_loses_messages_and_disturbs_nothing_else(stage, ports):
    ticks = stage.robot.status()["loop"]["ticks"]
    url = f"ws://127.0.0.1:{ports[1]}/"
    narrow = socket.socket()
    narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # a buffer that is soon full
    narrow.connect(("127.0.0.1", ports[1]))
    tf = {"op": "subscribe", "topic": "/tf"}
    async with (
        connect(url, sock=narrow, max_queue=1, ping_interval=None, compression=None) as stuck,
        connect(url) as other,
    ):
        for topic in ("odom", "joint_states", "motor_status", "tf"):
            await stuck.send(json.dumps({"op": "subscribe", "topic": topic}))
        await other.send(json.dumps(tf))
        before = bus(stage)["publishers"]["tell"]["dropped"]
        async with asyncio.timeout(2 * DEADLINE_S):
            while bus(stage)["publishers"]["tell"]["dropped"] == before:
                for _ in range(10):
                    assert json.loads(await other.recv())["topic"] == "/tf"
            assert (await exchanged(ports[1], tf, until=lambda one: True))["topic"] == "/tf"
        stuck.transport.abort()
        with contextlib.suppress(OSError):
            await stuck.wait_closed()
    assert stage.robot.status()["loop"]["ticks"] > ticks


@pytest.mark.skipif(not shutil.which("openssl"), reason="apt install openssl")
async def test_it_serves_tls_with_the_certificate_of_the_robot_file(tmp_path):
    certified(tmp_path)
    port = free_port()
    settings = ("publish.tell.kind=rosbridge", f"publish.tell.port={port}",
                f"publish.tell.cert_file={tmp_path}/host.pem",
                f"publish.tell.key_file={tmp_path}/host.key")  # fmt: skip
    context = ssl.create_default_context(cafile=tmp_path / "ca.pem")
    with running(tmp_path, *settings, simulated=False) as stage:
        wait_until(lambda: bus(stage).get("publishers"), "the server's process")
        url = f"wss://localhost:{port}"
        async with asyncio.timeout(DEADLINE_S), connect_again(url, context) as it:
            await it.send(json.dumps({"op": "subscribe", "topic": "/diagnostics"}))
            assert json.loads(await it.recv())["topic"] == "/diagnostics"


@contextlib.asynccontextmanager
async def connect_again(url, context):
    """Connect as soon as the server listens."""
    while True:
        try:
            client = await connect(url, ssl=context)
            break
        except ConnectionRefusedError:
            await asyncio.sleep(0.05)
    try:
        yield client
    finally:
        await client.close()
