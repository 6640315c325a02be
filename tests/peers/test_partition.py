# SPDX-License-Identifier: Apache-2.0
"""The network between motord-bus and its broker is cut, with both alive: each in a network
namespace of its own, and the cable between them pulled."""

import contextlib
import json
import shutil
import subprocess
import sys
import threading
import time

import pytest
from tests.peers.mosquitto import BROKER, certified, needs_mosquitto, stamp
from tests.peers.namespaces import THERE, cable, inside, why_not
from tests.sim.daemon_stage import DEADLINE_S, ROBOT, running, wait_until

from motord.client import Refused

pytestmark = [
    needs_mosquitto,
    pytest.mark.skipif(not shutil.which("openssl"), reason="apt install openssl"),
]
PORT = 8883
TOKEN = "a token of sixteen and more"
LEASE_S = 1.0
RATE_HZ = 20
ZENOH_LEASE_S = 11.0
"""After 10 s of silence Zenoh gives a session up."""
ZENOH = 7447
ROUTER = f"""
import signal, struct, zenoh
said = '{{mode: "router", listen: {{endpoints: ["tcp/{THERE}:{ZENOH}"]}},'
said += "scouting: {{multicast: {{enabled: false}}}}}}"
with zenoh.open(zenoh.Config.from_json5(said)) as it:
    def take(sample):
        print("%d.%09d" % struct.unpack_from("<iI", sample.payload.to_bytes(), 4), flush=True)
    kept = it.declare_subscriber("*/zenoh/odom/**", take)
    signal.pause()
"""
"""Listens, and prints the stamp of each odometry that comes."""
QUEUED_S = 1.0
"""Of samples that may reach the broker late: what was under way when the cable was plugged."""


class Lines:
    """What a program says, line by line."""

    def __init__(self, command, **options):
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **options)
        self.heard = []
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self):
        for line in self.process.stdout:
            self.heard.append((time.time(), line.rstrip("\n")))

    def last(self):
        return self.heard[-1][1] if self.heard else None

    def close(self):
        self.process.kill()
        self.process.wait()
        self._thread.join()
        self.process.stdout.close()
        if self.process.stdin:
            self.process.stdin.close()


class Network:
    """The broker's side of the cable."""

    def __init__(self, folder, wire):
        self.folder, self.wire = folder, wire
        self._options = ("-h", THERE, "-p", str(PORT), "--cafile", str(folder / "ca.pem"))

    def command(self, program, *words):
        return (*inside(self.wire.there), program, *self._options, *words)

    def listens(self):
        one = self.command("mosquitto_pub", "-t", "x", "-m", "y")
        return subprocess.run(one, capture_output=True, timeout=DEADLINE_S).returncode == 0


@contextlib.contextmanager
def closing(made):
    try:
        yield made
    finally:
        made.close()


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    if reason := why_not():
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp("broker")
    certified(folder, name=f"IP:{THERE}")
    rows = (f"listener {PORT} {THERE}", "user root", "allow_anonymous true",
            f"certfile {folder}/host.pem", f"keyfile {folder}/host.key")  # fmt: skip
    (folder / "mosquitto.conf").write_text("\n".join(rows) + "\n", encoding="utf-8")
    with cable() as wire:
        made = Network(folder, wire)
        with subprocess.Popen(
            [*inside(wire.there), BROKER, "-c", str(folder / "mosquitto.conf")],
            stderr=subprocess.DEVNULL,
        ) as process:
            try:
                wait_until(made.listens, "mosquitto")
                yield made
            finally:
                process.kill()


@pytest.fixture(scope="module")
def stage(tmp_path_factory, network):
    folder = tmp_path_factory.mktemp("robot")
    token = folder / "token"
    token.write_text(TOKEN, encoding="ascii")
    token.chmod(0o600)
    broker = ("kind=mqtt", f"host={THERE}", f"port={PORT}", "tls=true", "topic_prefix=r2",
              f"ca_file={network.folder}/ca.pem")  # fmt: skip
    settings = (
        *(f"{section}.fleet.{one}" for section in ("publish", "input") for one in broker),
        f"publish.fleet.rate_hz={RATE_HZ}", f"input.fleet.lease_s={LEASE_S}",
        f"input.fleet.token_file={token}", f"safety.command_timeout_s={LEASE_S}",
        "joint.left.tries=10", "joint.right.tries=10",
    )  # fmt: skip
    with running(folder, *settings, options=("--no-bus",)) as stage:
        stage.wait_for("idle")
        stage.settings = settings
        yield stage


@pytest.fixture(scope="module")
def bus(stage, network):
    """motord-bus on its side of the cable: a line of figures a second."""
    name = stage.robot.status()["robot"]
    words = [part for row in (f"robot.name={name}", *stage.settings) for part in ("--set", row)]
    command = [*inside(network.wire.here), sys.executable, "-m", "motord.bus", str(ROBOT), *words,
               "--socket", str(stage.socket), "--supervised"]  # fmt: skip
    with closing(Lines(command, stdin=subprocess.PIPE)) as made:
        wait_until(lambda: made.last() and figures(made)["inputs"]["fleet"]["lease"], "a lease")
        yield made


def figures(bus):
    return json.loads(bus.last())


def lost(bus):
    return figures(bus)["publishers"]["fleet"]["dropped"]


class Driving:
    """Commands given at the broker's side, cable or not, as long as it lasts."""

    def __init__(self, network):
        self._command = network.command("mosquitto_pub", "-t", "r2/cmd_vel", "-l")
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.linear_m_s = 0.0

    def _run(self):
        with subprocess.Popen(self._command, stdin=subprocess.PIPE, text=True) as writer:
            while not self._end.wait(0.1):
                twist = {"linear": {"x": self.linear_m_s}, "angular": {"z": 0.0}}
                row = {"token": TOKEN, "header": stamp(), "twist": twist}
                writer.stdin.write(json.dumps(row) + "\n")
                writer.stdin.flush()

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()


def set_off(stage, driving):
    """Armed, and obeying; a fault that a too busy machine latched on the way is reset."""

    def attempt():
        state = stage.state()
        driving.linear_m_s = 0.2 if state in ("armed", "moving") else 0.0
        with contextlib.suppress(Refused):
            if state in ("fault", "estop"):
                stage.robot.reset()
            elif state == "idle":
                stage.robot.arm()
        return state == "moving"

    wait_until(attempt, f"moving\n{stage.said()}")


def at_rest(stage):
    """Where a busy machine was a fault to the drives, too."""
    joints = stage.sim.truth().joints.values()
    return stage.state() != "moving" and all(abs(one.velocity_rad_s) < 0.05 for one in joints)


def test_a_cut_network_costs_samples_and_the_lease_and_heals_by_itself(stage, network, bus):
    status = Lines(network.command("mosquitto_sub", "-t", "r2/status"))
    odometry = Lines(network.command("mosquitto_sub", "-t", "r2/odom"))
    with closing(status), closing(odometry):
        wait_until(lambda: status.last() == "online" and odometry.heard, "the robot at the broker")
        with Driving(network) as driving:
            set_off(stage, driving)
            lost_before, ticks = lost(bus), stage.robot.status()["loop"]["ticks"]
            network.wire.pull()
            wait_until(lambda: at_rest(stage), f"rest: its lease has lapsed\n{stage.said()}")
            wait_until(lambda: not stage.robot.status()["leases"], "nobody in command")
            wait_until(lambda: status.last() == "offline", "the last will")
            wait_until(lambda: lost(bus) - lost_before > 2 * RATE_HZ, "samples that are counted")
        accepted = stage.robot.status()["commands"]["accepted"]
        assert stage.robot.status()["loop"]["ticks"] > ticks
        heard = len(odometry.heard)
        network.wire.plug()
        wait_until(lambda: status.last() == "online", "the robot at the broker again")
        wait_until(lambda: len(odometry.heard) > heard + RATE_HZ, "odometry again")
        came_s, first = odometry.heard[heard]
        sample = json.loads(first)["header"]["stamp"]
        assert came_s - sample["sec"] - sample["nanosec"] * 1e-9 < QUEUED_S, "the newest wins"
        assert stage.robot.status()["commands"]["accepted"] == accepted
        assert at_rest(stage)
        with Driving(network) as driving:
            set_off(stage, driving)
    assert bus.process.poll() is None


def test_ros_2_on_zenoh_heals_too_and_tells_the_newest(stage, network):
    pytest.importorskip("zenoh")
    router = Lines([*inside(network.wire.there), sys.executable, "-c", ROUTER])
    name = stage.robot.status()["robot"]
    rows = (f"robot.name={name}", "publish.z.kind=ros2-zenoh", "publish.z.namespace=/zenoh",
            f"publish.z.router=tcp/{THERE}:{ZENOH}", f"publish.z.rate_hz={RATE_HZ}")  # fmt: skip
    words = [part for row in rows for part in ("--set", row)]
    command = [*inside(network.wire.here), sys.executable, "-m", "motord.bus", str(ROBOT), *words,
               "--socket", str(stage.socket), "--supervised"]  # fmt: skip
    with closing(router), closing(Lines(command, stdin=subprocess.PIPE)) as bus:
        wait_until(lambda: router.heard, "odometry")
        ticks = stage.robot.status()["loop"]["ticks"]
        network.wire.pull()
        try:
            cut_s = time.time()
            wait_until(lambda: router.heard[-1][0] < time.time() - ZENOH_LEASE_S, "silence", 60.0)
            heard = len(router.heard)
        finally:
            network.wire.plug()
        wait_until(lambda: len(router.heard) > heard + RATE_HZ, "odometry again")
        assert all(float(stamp) > cut_s + QUEUED_S for _, stamp in router.heard[heard + 1 :])
        assert stage.robot.status()["loop"]["ticks"] > ticks
        assert bus.process.poll() is None
