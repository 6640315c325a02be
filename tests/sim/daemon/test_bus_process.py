# SPDX-License-Identifier: Apache-2.0
"""motord-bus: what it publishes, and that its end does not disturb the robot."""

import json
import os
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families
from tests.long_cases import long_but
from tests.sim.daemon_stage import DEADLINE_S, ROBOT, running, set_off, wait_until
from tests.sim.planted import offered

FORK_FAULTS = 600
"""Page faults of the loop that one fork of the daemon would cause (docs/architecture.md)."""


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def port():
    return free_port()


@pytest.fixture(scope="module")
def stage(tmp_path_factory, port):
    settings = ("publish.prom.kind=prometheus", f"publish.prom.port={port}")
    with running(tmp_path_factory.mktemp("bus"), *settings) as stage:
        stage.wait_for("idle")
        yield stage


def scraped(port):
    """Return the figures by name and labels; None while nothing listens on the port."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10) as answer:
            text = answer.read().decode()
    except (urllib.error.URLError, ConnectionError):
        return None
    return {
        (sample.name, *sorted(set(sample.labels.values()) - {sample.labels["robot"]})): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def full(port):
    """Return the figures as soon as those of the daemon are among them."""
    return wait_until(
        lambda: found if (found := scraped(port)) and ("motord_commands_total",) in found else None,
        "figures of the daemon",
    )


def bus(stage):
    return stage.robot.status()["bus"]


def living(stage, but=None):
    """Return the process number of motord-bus, once it has reported; not the number `but`."""
    return wait_until(
        lambda: (now := bus(stage)) and now["pid"] not in (None, but) and "inputs" in now and now,
        f"motord-bus\n{stage.logged()}",
    )["pid"]


def ticks(stage):
    return stage.robot.status()["loop"]["ticks"]


def test_prometheus_reads_what_the_daemon_reports(stage, port):
    # the figures are older than the state that the daemon reports on its socket
    figures = wait_until(
        lambda: found if (found := full(port))["motord_state", "idle"] == 1.0 else None,
        "figures of an idle robot",
    )
    assert figures["motord_up",] == 1.0
    assert figures["motord_state", "moving"] == 0.0
    assert ("motord_joint_velocity_radians_per_second", "left") in figures
    assert figures["motord_line_exchanges_total", "rs485"] > 0
    assert figures["motord_ticks_total",] > 0


@pytest.mark.parametrize("path", ["/", "/secret"])
def test_nothing_but_the_figures_is_served(stage, port, path):
    full(port)
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=10)


def test_a_post_to_the_figures_is_refused(stage, port):
    full(port)
    with pytest.raises(urllib.error.HTTPError, match="405"):
        urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", data=b"x", timeout=10)


def test_it_has_no_privileges_and_bounded_memory(stage):
    pid = living(stage)
    process = Path(f"/proc/{pid}")
    status = (process / "status").read_text(encoding="ascii")
    words = dict(line.split(":\t", 1) for line in status.splitlines())
    assert {int(words[key], 16) for key in ("CapInh", "CapPrm", "CapEff", "CapAmb")} == {0}
    assert words["NoNewPrivs"] == "1"
    limits = (process / "limits").read_text(encoding="ascii")
    assert f"Max data size             {512 << 20}" in limits
    (realtime,) = (line for line in limits.splitlines() if line.startswith("Max realtime timeout"))
    assert realtime.split()[3:5] == ["50000", "2000000"]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_a_killed_motord_bus_is_restarted_and_the_loop_goes_on(stage, port, number):
    before, restarts = living(stage), bus(stage)["restarts"]
    counted, faults = ticks(stage), stage.robot.status()["loop"]["page_faults"]
    os.kill(before, number)
    assert living(stage, but=before) != before
    assert bus(stage)["restarts"] == restarts + 1
    assert stage.state() == "idle"
    assert ticks(stage) > counted
    assert stage.robot.status()["loop"]["page_faults"] - faults < FORK_FAULTS / 2
    assert number.name in stage.logged(), stage.logged()
    full(port)


TROUBLED = """
import asyncio, os, threading, time

class Adapter:
    def __init__(self, name, section, runtime):
        self.options = section.options

    async def run(self):
        while not os.path.exists(self.options["when"]):
            await asyncio.sleep(0.01)
        print("trouble begins", flush=True)
        getattr(self, self.options["what"])()
        await asyncio.Event().wait()

    def spin(self):
        while True:
            pass

    def chatter(self):
        for _ in range(50):
            try:
                os.write(1, b"\\n" * 60000)
            except BlockingIOError:
                time.sleep(0.02)

    def flood(self):
        for fd in range(64):
            if self.is_pipe(fd):
                threading.Thread(target=self.fill, args=(fd,), daemon=True).start()

    def is_pipe(self, fd):
        try:
            return os.readlink(f"/proc/self/fd/{fd}").startswith("pipe:") and not os.write(fd, b"")
        except OSError:
            return False

    def fill(self, fd):
        while True:
            try:
                os.write(fd, b"\\n" * 60000)
            except BlockingIOError:
                time.sleep(0.001)
"""
TICKS = 1500


LOGGED_MAX = 10
"""Limit of logged lines: of thousands that an adapter sends, one is logged in 10 s."""
TROUBLES = {"spin": "trouble begins", "chatter": "trouble begins", "flood": "not its figures"}
"""Text that each kind of trouble leaves in the log."""


@pytest.mark.parametrize("what", long_but(("flood",), TROUBLES))
def test_a_robot_drives_while_an_adapter_misbehaves(tmp_path, what):
    environ = offered(tmp_path, "motord.publishers", "troubled", TROUBLED, "Adapter")
    when = tmp_path / "now"
    settings = ("publish.troubled.kind=other", "publish.troubled.adapter=troubled",
                "joint.left.tries=10", "joint.right.tries=10",
                f"publish.troubled.options.what={what}",
                f"publish.troubled.options.when={json.dumps(str(when))}")  # fmt: skip
    with running(tmp_path, *settings, environ=environ) as stage:
        stage.wait_for("idle")
        living(stage)
        before = stage.robot.status()
        when.touch()
        wait_until(lambda: TROUBLES[what] in stage.logged(), TROUBLES[what])
        set_off(stage)
        wait_until(lambda: ticks(stage) >= before["loop"]["ticks"] + TICKS, "the loop goes on")
        now = stage.robot.status()
        assert "heartbeat_lost" not in now["faults"], stage.logged()
        assert now["stalls"] == before["stalls"]
        assert stage.logged().count("motord-bus sent") < LOGGED_MAX


FAILING = """
class Adapter:
    def __init__(self, name, section, runtime):
        self.lives = 0

    async def run(self):
        self.lives += 1
        raise RuntimeError(f"no camera for the {self.lives}th time")
"""


def test_a_failing_adapter_does_not_stop_the_others(tmp_path):
    port = free_port()
    environ = offered(tmp_path, "motord.publishers", "failing", FAILING, "Adapter")
    settings = ("publish.failing.kind=other", "publish.failing.adapter=failing",
                "publish.prom.kind=prometheus", f"publish.prom.port={port}")  # fmt: skip
    with running(tmp_path, *settings, environ=environ) as stage:
        pid = living(stage)

        def failures():
            return bus(stage).get("failures", {}).get("publish.failing", 0)

        wait_until(lambda: failures() >= 2, "a second failure")
        full(port)
        assert bus(stage)["restarts"] == 0
        assert bus(stage)["pid"] == pid
        assert stage.logged().count("publish.failing failed") == 1
        assert "no camera for the 1th time" in stage.logged()


def test_motord_bus_ends_with_its_daemon(tmp_path):
    settings = ("publish.prom.kind=prometheus", f"publish.prom.port={free_port()}")
    with running(tmp_path, *settings) as stage:
        pid = living(stage)
        assert stage.end(signal.SIGKILL) == -signal.SIGKILL
        wait_until(lambda: not Path(f"/proc/{pid}").exists(), "motord-bus gone")


def test_another_program_may_start_motord_bus(tmp_path):
    port = free_port()
    settings = ("publish.prom.kind=prometheus", f"publish.prom.port={port}")
    with running(tmp_path, *settings, options=("--no-bus",)) as stage:
        name = stage.robot.status()["robot"]
        assert bus(stage) is None
        words = [part for row in (f"robot.name={name}", *settings) for part in ("--set", row)]
        with subprocess.Popen(
            [sys.executable, "-m", "motord.bus", str(ROBOT), *words, "--socket", str(stage.socket)]
        ) as process:
            try:
                wait_until(lambda: full(port)["motord_up",] == 1.0, "a loop that runs")
                process.terminate()
                assert process.wait(DEADLINE_S) == 0
            finally:
                process.kill()


def test_a_robot_without_networked_buses_has_no_motord_bus(tmp_path):
    with running(tmp_path) as stage:
        assert bus(stage) is None
