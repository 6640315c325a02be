# SPDX-License-Identifier: Apache-2.0
"""An MQTT broker and a Zenoh router, in a network namespace of their own, are unreachable for half
a minute: their cable is pulled while both run, or both are killed."""

import contextlib
import json
import shutil
import subprocess
import sys
import threading
import time

import pytest
from tests.peers.light import LIGHT
from tests.peers.mqtt.mosquitto import BROKER, certified, needs_mosquitto, stamp
from tests.peers.namespaces import THERE, cable, inside, why_not
from tests.sim.daemon_stage import DEADLINE_S, ROBOT, ROOT, obeying, running, wait_until

pytest.importorskip("zenoh", reason="needs eclipse-zenoh")
pytestmark = [
    needs_mosquitto,
    pytest.mark.skipif(not shutil.which("openssl"), reason="apt install openssl"),
]
PORT, ZENOH = 8883, 7447
TOKEN = "a token of sixteen and more"
LEASE_S = 1.0
RATE_HZ = 20
CUT_S = 30.0
"""Longer than the time-out of each connection: Zenoh 10 s, MQTT 7.5 s."""
MISSED_TICKS = 800
CALM_SAMPLES = 3 * RATE_HZ
PACE = 0.5
"""Part of their normal rates that loop and lines keep at least while the network is unreachable."""
QUEUED_S = 1.0
"""Maximum age of a sample at the broker: it may have been queued when the cable was plugged."""


class Lines:
    """A program, and each line of its output with the time of its arrival."""

    def __init__(self, command, **options):
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **options)
        self.received = []
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self):
        for line in self.process.stdout:
            self.received.append((time.time(), line.rstrip("\n")))

    def last(self):
        return self.received[-1][1] if self.received else None

    def close(self):
        self.process.kill()
        self.process.wait()
        self._thread.join()
        self.process.stdout.close()
        if self.process.stdin:
            with contextlib.suppress(BrokenPipeError):  # the program did not read the last line
                self.process.stdin.close()


class Network:
    """A broker and a router, in the namespace at the other end of the cable."""

    def __init__(self, folder, wire):
        self.folder, self.wire = folder, wire
        self._options = ("-h", THERE, "-p", str(PORT), "--cafile", str(folder / "ca.pem"))
        self._broker = self.router = None

    def start(self):
        self.close()
        there = inside(self.wire.there)
        self._broker = subprocess.Popen(
            [*there, BROKER, "-c", str(self.folder / "mosquitto.conf")], stderr=subprocess.DEVNULL
        )
        router = (
            sys.executable,
            "-m",
            "tests.peers.ros2_zenoh.zenoh_far",
            f"{THERE}:{ZENOH}",
            self.folder,
        )
        self.router = Lines([*there, *router], stdin=subprocess.PIPE, cwd=ROOT)
        wait_until(self._listens, "mosquitto")

    def kill(self):
        self._broker.kill()
        self.router.process.kill()

    def close(self):
        if self.router is not None:
            self.kill()
            self._broker.wait()
            self.router.close()

    def command(self, program, *words):
        return (*inside(self.wire.there), program, *self._options, *words)

    def _listens(self):
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
        try:
            made.start()
            yield made
        finally:
            made.close()


@pytest.fixture(scope="module")
def stage(tmp_path_factory, network):
    folder = tmp_path_factory.mktemp("robot")
    token = folder / "token"
    token.write_text(TOKEN, encoding="ascii")
    token.chmod(0o600)
    broker = ("kind=mqtt", f"host={THERE}", f"port={PORT}", "tls=true", "topic_prefix=r2",
              f"ca_file={network.folder}/ca.pem")  # fmt: skip
    zenoh = ("kind=ros2-zenoh", "namespace=/zenoh", f"router=tls/{THERE}:{ZENOH}",
             f"ca_file={network.folder}/ca.pem")  # fmt: skip
    settings = (
        *(f"{section}.fleet.{one}" for section in ("publish", "input") for one in broker),
        f"publish.fleet.rate_hz={RATE_HZ}", f"input.fleet.lease_s={LEASE_S}",
        f"input.fleet.token_file={token}", f"safety.command_timeout_s={LEASE_S}",
        *(f"{section}.z.{one}" for section in ("publish", "input") for one in zenoh),
        f"publish.z.rate_hz={RATE_HZ}", f"input.z.lease_s={LEASE_S}", "input.z.trust_router=true",
        *LIGHT,
    )  # fmt: skip
    with running(folder, *settings, options=("--no-bus",)) as stage:
        stage.wait_for("idle")
        stage.settings = settings
        yield stage


@pytest.fixture(scope="module")
def bus(stage, network):
    """motord-bus at its end of the cable. It prints a line of figures each second."""
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


def late_s(line):
    """Return the age that an odometry sample had on arrival."""
    came_s, text = line
    sample = json.loads(text)["header"]["stamp"]
    return came_s - sample["sec"] - sample["nanosec"] * 1e-9


class Pace:
    """Rates of the loop's ticks and of the lines' exchanges since this object was made."""

    def __init__(self, stage):
        self._stage = stage
        self._began = self._look()

    def _look(self):
        status = self._stage.robot.status()
        exchanges = sum(line["exchanges"] for line in status["lines"].values())
        return time.monotonic(), status["loop"]["ticks"], exchanges

    def per_s(self):
        (began_s, *before), (now_s, *after) = self._began, self._look()
        return [(b - a) / (now_s - began_s) for a, b in zip(before, after, strict=True)]

    def ticks(self):
        return self._look()[1] - self._began[1]

    def kept(self, calm_per_s):
        return all(b > PACE * a for a, b in zip(calm_per_s, self.per_s(), strict=True))


class Driving:
    """Context that sends commands by MQTT and by Zenoh from the other end of the cable."""

    def __init__(self, network):
        self._other = network.router.process.stdin
        self._command = network.command("mosquitto_pub", "-t", "r2/cmd_vel", "-l")
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.linear_m_s = 0.0

    def _run(self):
        with subprocess.Popen(self._command, stdin=subprocess.PIPE, text=True) as writer:
            try:
                while not self._end.wait(0.1):
                    self._say(writer.stdin)
            except BrokenPipeError:
                pass  # a test killed the broker
            finally:
                writer.kill()

    def _say(self, broker):
        twist = {"linear": {"x": self.linear_m_s}, "angular": {"z": 0.0}}
        row = json.dumps({"token": TOKEN, "header": stamp(), "twist": twist})
        for pipe, line in ((broker, row), (self._other, self.linear_m_s)):
            pipe.write(f"{line}\n")
            pipe.flush()

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()


def set_off(stage, driving):
    def command(may):
        driving.linear_m_s = 0.2 if may else 0.0

    obeying(stage, command)


def at_rest(stage):
    """Return whether the wheels are at rest; also after a fault that a busy machine caused."""
    joints = stage.sim.truth().joints.values()
    return stage.state() != "moving" and all(abs(one.velocity_rad_s) < 0.05 for one in joints)


def calm_per_s(stage, network, odometry):
    """Return the rates of loop and lines in 1/s while broker and router both receive odometry."""
    pace, received, sent = Pace(stage), len(odometry.received), len(network.router.received)
    wait_until(lambda: len(odometry.received) > received + CALM_SAMPLES, "odometry by MQTT")
    wait_until(lambda: len(network.router.received) > sent + CALM_SAMPLES, "odometry by Zenoh")
    return pace.per_s()


def both_command(bus):
    def sent():
        return {name: one["sent"] for name, one in figures(bus)["inputs"].items()}

    before = sent()
    wait_until(lambda: all(sent()[name] > before[name] for name in ("fleet", "z")), "commands")


def at_rest_and_free(stage):
    wait_until(lambda: at_rest(stage), f"rest: its lease has lapsed\n{stage.logged()}")
    wait_until(lambda: not stage.robot.status()["leases"], "no source in command")


def test_half_a_minute_without_a_network_loses_samples_and_the_lease_then_recovers(
    stage, network, bus
):
    status = Lines(network.command("mosquitto_sub", "-t", "r2/status"))
    odometry = Lines(network.command("mosquitto_sub", "-t", "r2/odom"))
    router = network.router
    with closing(status), closing(odometry):
        wait_until(
            lambda: status.last() == "online" and odometry.received, "the robot at the broker"
        )
        try:
            with Driving(network) as driving:
                set_off(stage, driving)
                both_command(bus)
                calm = calm_per_s(stage, network, odometry)
                lost_before, cut, cut_s = lost(bus), Pace(stage), time.time()
                network.wire.pull()
                at_rest_and_free(stage)
                wait_until(lambda: status.last() == "offline", "the last will")
                wait_until(lambda: lost(bus) - lost_before > 2 * RATE_HZ, "samples are counted")
                wait_until(lambda: time.time() - cut_s > CUT_S, "half a minute", 2 * CUT_S)
            assert cut.kept(calm)
            accepted = stage.robot.status()["commands"]["accepted"]
            received, sent = len(odometry.received), len(router.received)
        finally:
            network.wire.plug()
        wait_until(lambda: status.last() == "online", "the robot at the broker again")
        wait_until(lambda: len(odometry.received) > received + RATE_HZ, "odometry again")
        wait_until(lambda: len(router.received) > sent + RATE_HZ, "odometry by Zenoh again")
        assert late_s(odometry.received[received]) < QUEUED_S, "the newest wins"
        assert all(float(stamp) > cut_s + QUEUED_S for _, stamp in router.received[sent + 1 :])
        assert stage.robot.status()["commands"]["accepted"] == accepted
        assert at_rest(stage)
        with Driving(network) as driving:
            set_off(stage, driving)
    assert bus.process.poll() is None


def test_a_restarted_broker_and_router_are_found_again(stage, network, bus):
    try:
        with Driving(network) as driving:
            set_off(stage, driving)
            both_command(bus)
            network.kill()
            at_rest_and_free(stage)
        accepted, gone = stage.robot.status()["commands"]["accepted"], Pace(stage)
        wait_until(lambda: gone.ticks() > MISSED_TICKS, "a loop that goes on")
    finally:
        network.start()
    with closing(Lines(network.command("mosquitto_sub", "-t", "r2/odom"))) as odometry:
        calm = calm_per_s(stage, network, odometry)
        assert gone.kept(calm)
        assert stage.robot.status()["commands"]["accepted"] == accepted
        assert at_rest(stage)
        with Driving(network) as driving:
            set_off(stage, driving)
    assert bus.process.poll() is None
