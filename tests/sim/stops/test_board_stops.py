# SPDX-License-Identifier: Apache-2.0
"""Whatever dies, the wheels of a board come to rest: the tests of test_stopping.py for the robot
esp32. motord_mcu.c stops them when no frames come; while frames come, the line stops them."""

import os
import signal

import pytest
from tests.sim.daemon_stage import ROOT, running, wait_until
from tests.sim.stops.stopping_rig import BUSY_S, HOGGED, moving, powered, seconds_to_rest

from motord.config import load_robot

ESP32 = ROOT / "config/robots/esp32.toml"
SPEED_M_S = 0.3
WATCHDOG_S = 0.5
BRAKE_S = 0.2
HEARTBEAT_S = 0.5


@pytest.fixture(scope="module")
def robot():
    return load_robot(ESP32)


def on_board(folder, *settings, **options):
    return running(folder, *settings, robot=ESP32, **options)


def test_when_the_daemon_is_killed_the_board_stops_its_wheels(tmp_path, robot):
    with on_board(tmp_path, f"safety.drive_watchdog_s={WATCHDOG_S}") as stage:
        with moving(stage, robot, SPEED_M_S):
            assert stage.robot.status()["lines"]["board"]["engine"] == "rt"
            rest_s = seconds_to_rest(stage, stage.daemon.kill)
            assert rest_s < WATCHDOG_S + BRAKE_S + BUSY_S
        wait_until(lambda: not powered(stage), "its power is off", 5.0)


def test_when_the_port_is_pulled_the_board_stops_and_comes_back_disarmed(tmp_path, robot):
    with on_board(tmp_path, f"safety.drive_watchdog_s={WATCHDOG_S}") as stage:
        with moving(stage, robot, SPEED_M_S):
            rest_s = seconds_to_rest(stage, lambda: stage.sim.pull("board"))
            assert rest_s < WATCHDOG_S + BRAKE_S + BUSY_S
            stage.wait_for("fault")
            stage.sim.plug("board")
            lines = stage.robot.status
            wait_until(lambda: lines()["lines"]["board"]["state"] == "ready", "the line again")
            assert stage.state() == "fault"
        assert stage.sim.truth().at_rest
        assert not powered(stage)


@pytest.mark.parametrize("how", ["GIL", "asyncio"])
def test_without_python_the_line_itself_brings_the_wheels_to_rest(tmp_path, robot, how):
    """The line's frames stop the wheels: the board's own watchdog would act after the bound."""
    pipe = tmp_path / "hog"
    os.mkfifo(pipe)
    settings = (f"safety.heartbeat_timeout_s={HEARTBEAT_S}", "safety.drive_watchdog_s=2.0")
    ramp_s = SPEED_M_S / robot.limits.linear_deceleration_m_s2
    environ = {"HOG_PIPE": str(pipe)}
    with on_board(tmp_path, *settings, motord=HOGGED, environ=environ) as stage:

        def hurt():
            if how == "GIL":
                pipe.write_bytes(b"now\n")
            else:
                stage.daemon.send_signal(signal.SIGUSR1)

        with moving(stage, robot, SPEED_M_S):
            assert seconds_to_rest(stage, hurt) < HEARTBEAT_S + ramp_s + BUSY_S
        wait_until(lambda: not powered(stage), "its power is off", 5.0)
        stage.daemon.kill()
