# SPDX-License-Identifier: Apache-2.0
"""MQTT against Eclipse Mosquitto: publishing, commands, and the effects of a failing broker."""

import json
import math
import os
import shutil
import signal
import subprocess
import threading
import time

import cbor2
import pytest
from tests.peers.light import LIGHT
from tests.peers.mqtt.mosquitto import broker, certified, needs_mosquitto, stamp, with_password
from tests.peers.tokens import TOKEN, token_file
from tests.sim.daemon_stage import DEADLINE_S, release_sources, running, wait_until

from motord.bus.messages.topics import TOPICS

pytestmark = needs_mosquitto
LEASE_S = 1.0
ANSWER_WITHIN_S = 10.0
READER = ("mosquitto_sub", "-W", f"{DEADLINE_S:.0f}", "-v",
          "-t", "site/r2/answer", "-t", "site/r2/odom")  # fmt: skip
"""Command that prints answers and odometry. The first line shows that it is subscribed."""


@pytest.fixture(scope="module")
def stage(tmp_path_factory, peer):
    folder = tmp_path_factory.mktemp("mqtt")
    settings = (
        "publish.fleet.kind=mqtt", f"publish.fleet.port={peer.port}", "publish.fleet.rate_hz=20",
        "publish.fleet.topic_prefix=site/r2", "publish.fleet.qos=1",
        "publish.short.kind=mqtt", f"publish.short.port={peer.port}", "publish.short.encoding=cbor",
        'publish.short.topics=["odom"]', "publish.short.topic_prefix=site/short",
        "input.fleet.kind=mqtt", f"input.fleet.port={peer.port}", "input.fleet.priority=70",
        "input.fleet.topic_prefix=site/r2", f"input.fleet.token_file={token_file(folder)}",
        f"input.fleet.lease_s={LEASE_S}", f"safety.command_timeout_s={LEASE_S}",
        *LIGHT,
    )  # fmt: skip
    with running(folder, *settings) as stage:
        stage.wait_for("idle")
        ready(stage)
        yield stage


def inputs(stage):
    return (stage.robot.status()["bus"] or {}).get("inputs", {})


def ready(stage, but=None):
    """Wait until motord-bus has its lease, in another process than `but`."""
    wait_until(
        lambda: (
            stage.robot.status()["bus"]["pid"] not in (None, but)
            and inputs(stage).get("fleet", {}).get("lease")
        ),
        "a lease",
    )


def accepted(stage):
    return stage.robot.status()["commands"]["accepted"]


def called(stage, peer, method, **more):
    """Call a method through the broker and return the answer. Repeat it without an answer:
    the broker may have just lost motord-bus, as after a test that stopped the process."""
    number, asked_s = os.urandom(4).hex(), -math.inf
    with subprocess.Popen([*READER, "-p", str(peer.port)], stdout=subprocess.PIPE) as reader:
        try:
            for line in reader.stdout:  # the first message shows that the reader is subscribed
                if time.monotonic() - asked_s > ANSWER_WITHIN_S:
                    asked_s = time.monotonic()
                    call = {"token": TOKEN, "method": method, "id": number} | more
                    peer.pub("site/r2/call", call)
                topic, _, raw = line.partition(b" ")
                if topic.endswith(b"answer") and (answer := json.loads(raw))["id"] == number:
                    return answer
        finally:
            reader.kill()
    raise AssertionError(f"no answer to {method} from the broker")


def twist(linear_m_s, age_s=0.0, **more):
    command = {"linear": {"x": linear_m_s, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0.0}}
    return {"token": TOKEN, "header": stamp(age_s), "twist": command} | more


class Driving:
    """Context that commands the robot through the broker."""

    def __init__(self, peer, linear_m_s):
        self._peer, self._linear_m_s = peer, linear_m_s
        self._end = threading.Event()
        self.last_s = 0.0
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        with subprocess.Popen(
            ["mosquitto_pub", "-p", str(self._peer.port), "-t", "site/r2/cmd_vel", "-l"],
            stdin=subprocess.PIPE, stderr=subprocess.DEVNULL,
        ) as writer:  # fmt: skip
            try:
                while not self._end.wait(0.1):
                    writer.stdin.write(json.dumps(twist(self._linear_m_s)).encode() + b"\n")
                    writer.stdin.flush()
                    self.last_s = time.monotonic()
            except BrokenPipeError:
                pass
            finally:
                writer.kill()

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()


def armed(stage, peer):
    """Arm through the broker. Repeat, because a drive may be unresponsive on a busy machine."""

    def attempt():
        method = {"fault": "reset", "estop": "reset", "idle": "arm"}.get(stage.state())
        if method is not None:
            called(stage, peer, method)
        return stage.state() == "armed"

    wait_until(attempt, "armed")
    release_sources(stage)


def test_odometry_on_the_broker_is_that_of_the_daemon(stage, peer):
    message = json.loads(peer.get("site/r2/odom"))
    assert (message["header"]["frame_id"], message["child_frame_id"]) == ("odom", "base_link")
    assert len(message["pose"]["covariance"]) == 36
    x_m = stage.robot.status()["odometry"]["x_m"]
    assert message["pose"]["pose"]["position"]["x"] == pytest.approx(x_m, abs=2.0)


@pytest.mark.parametrize("topic", sorted(set(TOPICS) - {"imu"}))  # this robot has no gyro
def test_every_topic_is_published(stage, peer, topic):
    assert "header" in json.loads(peer.get(f"site/r2/{topic}")) or topic == "tf"


def test_a_late_subscriber_gets_the_description(stage, peer):
    message = json.loads(peer.get("site/r2/description", "--retained-only"))
    assert message["joints"] == ["left", "right"]
    assert message["topics"]["odom"] == {"type": "nav_msgs/msg/Odometry", "rate_hz": 20.0}


def test_cbor_carries_the_same_message(stage, peer):
    raw = peer.get("site/short/odom", "-N")
    assert cbor2.loads(raw)["child_frame_id"] == "base_link"


def test_the_broker_reports_a_killed_process_offline_and_its_successor_online(stage, peer):
    assert peer.get("site/r2/status") == b"online"
    with subprocess.Popen(
        ["mosquitto_sub", "-p", str(peer.port), "-t", "site/r2/status"], stdout=subprocess.PIPE
    ) as reader:
        assert reader.stdout.readline() == b"online\n"
        pid = stage.robot.status()["bus"]["pid"]
        os.kill(pid, signal.SIGKILL)
        assert reader.stdout.readline() == b"offline\n"
        assert reader.stdout.readline() == b"online\n"
        reader.kill()
    ready(stage, but=pid)


def test_a_client_with_the_token_drives_and_is_named(stage, peer):
    armed(stage, peer)
    with Driving(peer, 0.2):
        stage.wait_for("moving")
        wait_until(
            lambda: json.loads(peer.get("site/r2/motor_status"))["commander"] == "fleet",
            "the commander's name",
        )
        (lease,) = stage.robot.status()["leases"]
        assert (lease["owner"], lease["priority"]) == ("fleet", 70)
    stage.wait_for("armed")


def test_a_client_with_the_token_commands_wheels_by_joint_name(stage, peer):
    def moving():
        if stage.state() not in ("armed", "moving"):
            armed(stage, peer)
        wheels = {"name": ["left", "right"], "velocity": [2.0, 2.0]}
        command = {"token": TOKEN, "header": stamp()} | wheels
        peer.pub("site/r2/joint_commands", command)
        return stage.state() == "moving"

    wait_until(moving, "the wheels turn", 2 * DEADLINE_S)
    stage.wait_for("armed", "fault")  # "fault": latched by a busy machine


def refusal_of(stage, peer, topic, command):
    """Send the command until its refusal is counted. The broker drops a command while motord-bus
    reconnects, as on a busy machine."""
    refused = inputs(stage)["fleet"]["refused"]

    def attempt():
        peer.pub(f"site/r2/{topic}", command)
        return inputs(stage)["fleet"]["refused"] > refused

    wait_until(attempt, "a refusal")


def test_wheels_without_the_token_are_refused(stage, peer):
    armed(stage, peer)
    command = {"header": stamp(), "name": ["left"], "velocity": [2.0]}
    refusal_of(stage, peer, "joint_commands", command)
    assert stage.state() == "armed"


@pytest.mark.parametrize(
    "command",
    [
        twist(0.2, token="wrong"),
        twist(0.2, token=None),
        {key: value for key, value in twist(0.2).items() if key != "header"},
        twist("fast"),
        twist(0.2, twist=None),
        twist(0.2, age_s=-1e6),
        [1, 2],
        "{",
    ],
)
def test_a_malformed_command_is_refused_and_counted(stage, peer, command):
    before = accepted(stage)
    refusal_of(stage, peer, "cmd_vel", command)
    assert accepted(stage) == before


def test_a_delayed_command_is_refused_by_the_loop(stage, peer):
    armed(stage, peer)
    before = stage.robot.status()["commands"]["refused"]["age"]
    peer.pub("site/r2/cmd_vel", twist(0.2, age_s=30.0))
    wait_until(
        lambda: stage.robot.status()["commands"]["refused"]["age"] > before, "a refusal for its age"
    )
    assert stage.state() == "armed"


def test_a_retained_command_moves_nothing(stage, peer):
    armed(stage, peer)
    peer.pub("site/r2/cmd_vel", twist(0.2), "-r")
    pid = stage.robot.status()["bus"]["pid"]
    os.kill(pid, signal.SIGKILL)
    try:
        wait_until(lambda: "retained message is ignored" in stage.logged(), "the retained message")
        assert stage.state() == "armed"
    finally:
        peer.pub("site/r2/cmd_vel", "", "-r")
    ready(stage, but=pid)


@pytest.mark.parametrize("token", ["wrong", None, 7])
def test_a_call_without_the_token_does_nothing_and_gets_the_reason(stage, peer, token):
    armed(stage, peer)
    before = inputs(stage)["fleet"]["refused"]
    answer = called(stage, peer, "disarm", token=token)
    assert answer["error"] == "the token is missing or wrong"
    assert "result" not in answer
    wait_until(lambda: inputs(stage)["fleet"]["refused"] > before, "a refusal")
    assert stage.state() == "armed"


@pytest.mark.parametrize("key", ["token", "id", "method"])
def test_half_a_surrogate_pair_is_refused_and_the_input_keeps_working(stage, peer, key):
    before = inputs(stage)["fleet"]
    call = {"token": TOKEN, "method": "estop", "id": 1} | {key: "\ud800"}
    peer.pub("site/r2/call", call)
    wait_until(lambda: inputs(stage)["fleet"]["refused"] > before["refused"], "a refusal")
    assert stage.state() != "estop"
    assert called(stage, peer, "status")["result"]
    assert "input.fleet" not in stage.robot.status()["bus"]["failures"]


def test_an_unknown_call_is_answered_with_the_known_ones(stage, peer):
    assert "estop" in called(stage, peer, "params.set")["error"]


def test_an_emergency_stop_by_the_broker_is_latched(stage, peer):
    armed(stage, peer)
    assert called(stage, peer, "estop")["result"]["state"] == "estop"
    assert stage.state() == "estop"
    assert called(stage, peer, "reset")["result"] == {"state": "idle"}


def test_an_emergency_stop_behind_many_calls_stops_and_every_call_is_answered(stage, peer):
    names = [f"{os.urandom(4).hex()}-{number}" for number in range(60)]
    calls = [{"token": TOKEN, "method": "status", "id": name} for name in names[:-1]]
    calls.append({"token": TOKEN, "method": "estop", "id": names[-1]})
    with subprocess.Popen([*READER, "-p", str(peer.port)], stdout=subprocess.PIPE) as reader:
        try:
            reader.stdout.readline()  # the first message shows that it is subscribed
            subprocess.run(
                ["mosquitto_pub", "-p", str(peer.port), "-t", "site/r2/call", "-q", "1", "-l"],
                input="\n".join(map(json.dumps, calls)).encode(), check=True, timeout=30,
            )  # fmt: skip
            answers = {}
            while set(answers) != set(names):
                topic, _, raw = reader.stdout.readline().partition(b" ")
                if topic.endswith(b"answer") and (answer := json.loads(raw))["id"] in names:
                    answers[answer["id"]] = answer
        finally:
            reader.kill()
    assert answers[names[-1]]["result"]["state"] == "estop"
    assert stage.state() == "estop"
    assert any("busy" in answer.get("error", "") for answer in answers.values())
    wait_until(lambda: called(stage, peer, "reset").get("result") == {"state": "idle"}, "a reset")


def test_a_broker_that_hangs_stops_the_robot_and_is_found_again(stage, peer):
    armed(stage, peer)
    pid = stage.robot.status()["bus"]["pid"]
    try:
        with Driving(peer, 0.2) as driving:
            stage.wait_for("moving")
            peer.process.send_signal(signal.SIGSTOP)
            stage.wait_for("armed")
            wait_until(lambda: "publish.fleet: 127.0.0.1" in stage.logged(), "a line in the log")
        wait_until(lambda: time.monotonic() - driving.last_s > LEASE_S, "the lease's end")
        before = accepted(stage)
    finally:
        peer.process.send_signal(signal.SIGCONT)
    wait_until(lambda: "publish.fleet: connected again" in stage.logged(), "the connection")
    assert json.loads(peer.get("site/r2/odom"))
    assert (stage.robot.status()["bus"]["pid"], accepted(stage)) == (pid, before)
    assert stage.state() != "moving"


@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_the_lease_lapses_when_motord_bus_hangs_or_dies_while_it_commands(stage, peer, number):
    armed(stage, peer)
    pid = stage.robot.status()["bus"]["pid"]
    with Driving(peer, 0.2):
        stage.wait_for("moving")
        os.kill(pid, number)
        ticks = stage.robot.status()["loop"]["ticks"]
        stage.wait_for("armed")
        assert stage.robot.status()["loop"]["ticks"] > ticks
    if number == signal.SIGSTOP:
        os.kill(pid, signal.SIGKILL)  # the daemon would kill it later
    ready(stage, but=pid)


def test_a_restarted_broker_is_found_again(stage, peer):
    peer.stop()
    peer.start()
    assert json.loads(peer.get("site/r2/odom"))
    assert peer.get("site/r2/status") == b"online"


@pytest.mark.skipif(not shutil.which("openssl"), reason="apt install openssl")
def test_it_connects_by_tls_and_password_and_to_no_broker_of_another_authority(tmp_path):
    certified(tmp_path)
    with_password(tmp_path)
    (tmp_path / "users").chmod(0o644)
    (tmp_path / "other").mkdir()
    certified(tmp_path / "other")
    lines = (f"certfile {tmp_path}/host.pem", f"keyfile {tmp_path}/host.key",
             "allow_anonymous false", f"password_file {tmp_path}/users")  # fmt: skip
    options = ("--cafile", f"{tmp_path}/ca.pem", "-h", "localhost", "-u", "r2", "-P", "secret")
    with broker(tmp_path, *lines, options=options) as peer:
        both = [
            f"publish.{name}.{setting}"
            for name in ("good", "bad")
            for setting in ("kind=mqtt", "host=localhost", f"port={peer.port}", "tls=true",
                            "username=r2", f"password_file={tmp_path}/password",
                            f"topic_prefix={name}/r2")
        ]  # fmt: skip
        files = (f"publish.good.ca_file={tmp_path}/ca.pem",
                 f"publish.bad.ca_file={tmp_path}/other/ca.pem")  # fmt: skip
        with running(tmp_path, *both, *files, simulated=False) as stage:
            assert json.loads(peer.get("good/r2/diagnostics"))["status"]
            wait_until(lambda: "certificate verify failed" in stage.logged(), stage.logged())
