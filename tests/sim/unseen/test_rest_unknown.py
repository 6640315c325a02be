# SPDX-License-Identifier: Apache-2.0
"""A drive without a watchdog does not answer any more, and its wheels turn on: nothing that motord
shows, answers or logs says that they are at rest."""

import json
import re
import signal
import subprocess
import sys

import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROOT, running, wait_until
from tests.sim.stops.stopping_rig import moving, slowest_wheel_rad_s

from motord.api.state_page import StatePage
from motord.config import load_robot

FAULT = 3
WORDS = "motord cannot see whether left and right turn: keep away, cut the power"
TURNS_RAD_S = 1.0


@pytest.fixture(scope="module")
def robot_file(tmp_path_factory):
    """A copy of the demonstration's robot whose drives have no watchdog."""
    folder = tmp_path_factory.mktemp("robot")
    drive = (ROOT / "config/drives/zlac8015d.toml").read_text(encoding="utf-8")
    drive = re.sub(r"\n\[watchdog\]\n(?:.+\n)+", "\n", drive)
    drive = re.sub(r"\nname = .*", '\nname = "watchless"\nwatchdog_note = "it has none"', drive)
    (folder / "watchless.toml").write_text(drive, encoding="utf-8")
    text = (ROOT / "config/robots/demo.toml").read_text(encoding="utf-8")
    file = folder / "cart.toml"
    file.write_text(text.replace('drive = "zlac8015d"', 'drive = "./watchless.toml"'), "utf-8")
    return file


@pytest.fixture(params=["silence:for_s=1e6", "pull"])
def lost(tmp_path, robot_file, request):
    """A daemon whose line is lost for ever while the wheels turn; they turn on."""
    patient = ("safety.heartbeat_timeout_s=5.0", "safety.feedback_timeout_s=0.5")
    with running(tmp_path, *patient, robot=robot_file) as stage:
        with moving(stage, load_robot(robot_file)):
            if request.param == "pull":
                stage.sim.pull("rs485")
            else:
                stage.sim.inject(request.param)
            stage.wait_for("fault")
        wait_until(lambda: all(each.stale for each in stage.robot.status().joints.values()), "old")
        wait_until(lambda: not page_of(stage).enabled, "the core's power-off")
        assert slowest_wheel_rad_s(stage) > TURNS_RAD_S
        yield stage


def page_of(stage):
    with StatePage.open(stage.robot.status().robot) as page:
        return wait_until(page.read, "a snapshot")


def motord(stage, *arguments):
    return subprocess.run(
        [sys.executable, "-m", "motord", *arguments, "--socket", str(stage.socket)],
        capture_output=True, text=True, timeout=DEADLINE_S, cwd=ROOT, check=False,
    )  # fmt: skip


def test_status_and_state_page_show_that_rest_is_unknown_and_since_when(lost):
    found, shown = lost.robot.status(), page_of(lost)
    assert (found.rest, found.at_rest) == ("unknown", False)
    assert list(found.rest_unknown_s) == ["left", "right"]
    assert all(seconds > 0.0 for seconds in found.rest_unknown_s.values())
    assert (shown.rest, shown.at_rest) == ("unknown", False)
    assert all(0 < since_ns < shown.stamp_ns for since_ns in shown.rest_unknown_since_ns[:2])


def test_what_a_silent_drive_measured_last_is_not_shown(lost):
    found = lost.robot.status()
    for joint in found.joints.values():
        assert joint.stale
        assert (joint.velocity_rad_s, joint.position_rad, joint.enabled) == (None, None, None)
        assert (joint.voltage_v, joint.current_a, joint.temperature_c) == (None, None, None)
    assert (found.odometry.linear_m_s, found.odometry.angular_rad_s) == (None, None)


@pytest.mark.parametrize("command", ["estop", "stop", "disarm"])
def test_no_stop_ends_with_status_0_while_rest_is_unknown(lost, command):
    done = motord(lost, command)
    assert (done.returncode, WORDS in done.stderr) == (FAULT, True), done
    done = motord(lost, command, "--json")
    assert done.returncode == FAULT, done
    shown = json.loads(done.stdout)
    assert WORDS in shown.get("error", "") or list(shown["rest_unknown_s"]) == ["left", "right"]


def test_the_status_command_warns(lost):
    done = motord(lost, "status")
    assert (done.returncode, WORDS in done.stdout) == (FAULT, True), done
    assert lost.logged().count(WORDS) == 1, lost.logged()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_daemon_ends_with_status_3_and_does_not_claim_rest(lost, number):
    lost.robot.close()
    assert lost.end(number) == FAULT
    last = lost.logged().splitlines()[-1]
    assert "at rest" not in lost.logged().split("ending:")[1], lost.logged()
    assert WORDS in last, last
    assert slowest_wheel_rad_s(lost) > TURNS_RAD_S
