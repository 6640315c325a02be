# SPDX-License-Identifier: Apache-2.0
"""`motord doctor` on a running daemon with simulated drives, and on one that it starts itself."""

import json
import subprocess
import sys

import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROBOT, ROOT, running, wait_until
from tests.sim.pseudo_terminal import at_terminal

from motord.tools.simulator import start_simulator

PORT = "line.rs485.port"


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("doctor")) as stage:
        stage.wait_for("idle")
        yield stage


def doctor(*words):
    done = subprocess.run(
        [sys.executable, "-m", "motord", "doctor", *words, "--json"],
        capture_output=True, text=True, cwd=ROOT, timeout=DEADLINE_S,
    )  # fmt: skip
    assert "Traceback" not in done.stderr
    found = json.loads(done.stdout)
    return done.returncode, {row["check"]: row for row in found["findings"]}


def test_a_healthy_daemon_passes_every_check(stage):
    status, found = doctor("--socket", str(stage.socket))
    assert found["joint left"]["verdict"] == found["5 devices"]["verdict"] == "ok"
    # on a busy machine a thread may stand still for a moment, which the daemon counts
    stalled = any(stage.robot.status()["stalls"].values())
    assert found["1 process and threads"]["verdict"] == ("warn" if stalled else "ok")
    assert found["2 topics"]["verdict"] == "ok"
    assert "3 rate of line rs485" in found
    assert status == 0


def test_the_topics_of_a_bus_have_the_rates_of_the_robot_file(tmp_path):
    publish = (
        "publish.tape.kind=mcap", f"publish.tape.folder={json.dumps(str(tmp_path / 'tape'))}",
        "publish.tape.rate_hz=10", "publish.tape.free_min_mb=0",
    )  # fmt: skip
    with running(tmp_path, *publish) as stage:
        stage.wait_for("idle")
        wait_until(lambda: "at_s" in (stage.robot.status()["bus"] or {}), "motord-bus reports")

        def judged():
            _, found = doctor("--socket", str(stage.socket))
            rates = {
                check: row for check, row in found.items() if check.startswith("3 rate of tape")
            }
            moving = [row for row in rates.values() if "has had no message" not in row["text"]]
            return moving and {row["verdict"] for row in moving} == {"ok"} and rates

        rates = wait_until(judged, "every topic at its rate")  # a busy machine needs some tries
    assert "3 rate of tape/odom" in rates


def test_a_dead_drive_and_a_second_program_on_the_port_are_named(stage):
    port = stage.robot.status()["lines"]["rs485"]["port"]
    stage.sim.inject("silence:unit=1,for_s=1000")
    words = "import sys, time; held = open(sys.argv[1], 'rb', 0); print(1, flush=True); input()"
    # holds the port open like a terminal program; the port's lock keeps out all but root
    other = subprocess.Popen(
        [sys.executable, "-c", words, port], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        held = bool(other.stdout.readline())
        wait_until(lambda: "ready" not in _drives(stage), "the drive is missed")
        status, found = doctor("--socket", str(stage.socket))
    finally:
        other.communicate(b"\n")
        stage.sim.clear_faults_script()
    assert status == 3
    assert "does not answer" in found["joint left"]["text"]
    assert not held or f"pid {other.pid}" in found["5 devices"]["text"]


def _drives(stage):
    return [joint["drive"] for joint in stage.robot.status()["joints"].values()]


def test_without_a_daemon_doctor_starts_a_disarmed_one_and_ends_it(tmp_path):
    with start_simulator(ROBOT, link_dir=tmp_path, timeout_s=DEADLINE_S) as simulator:
        settings = [part for each in simulator.settings for part in ("--set", each)]
        settings += ["--set", f"robot.name=doctor{tmp_path.stat().st_ino}"]
        status, found = doctor(str(ROBOT), *settings)
        assert found["line.rs485"]["verdict"] == "ok"
        assert found["joint left"]["verdict"] == found["joint right"]["verdict"] == "ok"
        assert found["state"]["text"] == "idle"
        assert status == 0
        assert simulator.control.truth().at_rest


def test_a_repair_is_made_only_after_a_yes(tmp_path):
    governor = tmp_path / "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"
    governor.parent.mkdir(parents=True)
    governor.write_text("powersave\n")
    for answer, after in (("n", "powersave"), ("y", "performance")):
        with at_terminal("doctor", "--root", str(tmp_path), "--fix") as terminal:
            terminal.wait_for("Do it?")
            assert governor.read_text().strip() == "powersave"
            terminal.type(f"{answer}\n")
            terminal.exit_status()
        assert governor.read_text().strip() == after


def test_missing_hardware_is_exit_status_3_and_no_daemon_is_started(tmp_path):
    status, found = doctor(str(ROBOT), "--set", f"{PORT}={tmp_path / 'nothing'}")
    assert status == 3
    assert found["line.rs485"]["verdict"] == "fail"
    assert found["drives"]["text"].startswith("not checked")
