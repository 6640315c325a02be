# SPDX-License-Identifier: Apache-2.0
"""A callback of asyncio never returns: the C side brings the robot to rest, although a source goes
on commanding, and the supervisor gets no more notifications."""

import os
import signal
import threading
import time

from tests.sim.command_source import INPUTS, Source, free_udp_port, wheels_turn
from tests.sim.daemon_stage import ROBOT, running, wait_until
from tests.sim.supervised_daemon import PATIENCE_S, fed, notifications, supervised

HOGGED = ("-m", "tests.sim.hogged_daemon")


def test_datagrams_do_not_keep_a_robot_moving_while_asyncio_hangs(tmp_path):
    robot = tmp_path / "robot.toml"
    text = ROBOT.read_text(encoding="utf-8").split("[input.")[0]
    robot.write_text(text + INPUTS.format(port=free_udp_port()), encoding="utf-8")
    pipe = tmp_path / "hog"
    os.mkfifo(pipe)
    supervisor, environ = supervised(tmp_path)
    environ["HOG_PIPE"] = str(pipe)
    settings = ("safety.heartbeat_timeout_s=0.5", "safety.drive_watchdog_s=10.0")
    with (
        supervisor,
        running(tmp_path, *settings, robot=robot, motord=HOGGED, environ=environ) as stage,
        Source(stage) as source,
    ):
        stage.wait_for("idle")
        stage.robot.arm()
        wait_until(lambda: source.send(0.3) or wheels_turn(stage), "the wheels turn")
        wait_until(lambda: fed(supervisor), "the supervisor is notified")

        ended = threading.Event()

        def go_on():
            while not ended.wait(0.02):
                source.send(0.3)

        going_on = threading.Thread(target=go_on)
        going_on.start()
        try:
            stage.daemon.send_signal(signal.SIGUSR1)
            wait_until(lambda: stage.sim.call("truth")["at_rest"], "rest", 10.0)
            joints = lambda: stage.sim.call("truth")["joints"].values()  # noqa: E731  # one line
            wait_until(lambda: not any(j["enabled"] for j in joints()), "the power is off", 10.0)
            notifications(supervisor)  # notifications from before and during the stop
            silent_since_s = time.monotonic()
            wait_until(lambda: time.monotonic() - silent_since_s > PATIENCE_S, "the supervisor's")
            assert not fed(supervisor)
            assert stage.sim.call("truth")["at_rest"]
        finally:
            ended.set()
            going_on.join()
            stage.daemon.kill()
