# SPDX-License-Identifier: Apache-2.0
"""motord-bus stands still while a program sends commands without a stamp, and goes on after the
program has ended: no command that was queued meanwhile moves the robot."""

import contextlib
import json
import os
import signal
import threading
import time

import pytest
from tests.peers.ros2.ros2_stage import (
    LEASE_S,
    NAMESPACE,
    inputs,
    no_source_commands,
    peer,
    ros2_stage,
)
from tests.sim.daemon_stage import becomes_idle, release_sources, wait_until
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from motord.client import Refused

TOKEN = "a-token-of-sixteen-and-more"
SPEED_M_S = 0.3
TWIST = {"linear": {"x": SPEED_M_S}, "angular": {"z": 0.0}}


@pytest.fixture(scope="module")
def stage(tmp_path_factory, port):
    folder = tmp_path_factory.mktemp("still")
    token = folder / "token"
    token.write_text(TOKEN, encoding="ascii")
    token.chmod(0o600)
    settings = (
        "input.ros2.stamped=false",
        "input.web.kind=rosbridge", f"input.web.port={port}", "input.web.stamped=false",
        f"input.web.token_file={token}", f"input.web.lease_s={LEASE_S}",
    )  # fmt: skip
    with ros2_stage(folder, *settings) as stage:
        wait_until(lambda: inputs(stage).get("web", {}).get("lease"), "a lease")
        yield stage


def by_dds(_):
    return peer("twist", f"rt{NAMESPACE}/cmd_vel", SPEED_M_S, 0.0)


@contextlib.contextmanager
def by_rosbridge(port):
    ended = threading.Event()
    message = json.dumps({"op": "publish", "topic": "/cmd_vel", "msg": TWIST})

    def drive():
        with contextlib.suppress(ConnectionClosed, OSError), client:
            while not ended.wait(0.05):
                client.send(message)

    client = connect(f"ws://127.0.0.1:{port}/?token={TOKEN}", close_timeout=0.1)
    driving = threading.Thread(target=drive)
    driving.start()
    try:
        yield
    finally:
        ended.set()
        driving.join()


def arms(stage):
    """Arm the robot. Reset it before, because a busy machine may have latched a fault."""
    becomes_idle(stage)

    def attempt():
        with contextlib.suppress(Refused):  # a peer that has ended may still count for a moment
            return stage.robot.arm() == "armed"

    wait_until(attempt, "armed")
    release_sources(stage)


def refused(stage, name):
    return inputs(stage).get(name, {}).get("refused", 0)


@pytest.mark.parametrize(("name", "by"), [("ros2", by_dds), ("web", by_rosbridge)])
def test_commands_queued_while_motord_bus_stood_still_move_nothing(stage, port, name, by):
    arms(stage)
    pid, before = stage.robot.status()["bus"]["pid"], refused(stage, name)
    with by(port):
        stage.wait_for("moving")
        stopped_s = time.monotonic()
        os.kill(pid, signal.SIGSTOP)
        no_source_commands(stage)
        wait_until(lambda: time.monotonic() > stopped_s + 1.3 * LEASE_S, "a long gap")
    wait_until(lambda: stage.robot.status()["at_rest"], "rest")
    accepted = stage.robot.status()["commands"]["accepted"]
    os.kill(pid, signal.SIGCONT)
    wait_until(lambda: refused(stage, name) > before, "the queued commands are refused")
    status = stage.robot.status()
    assert status["commands"]["accepted"] == accepted
    assert status["at_rest"]
    assert status["bus"]["pid"] == pid
    with by(port):
        stage.wait_for("moving")
    no_source_commands(stage)
    stage.robot.disarm()


@pytest.mark.parametrize("ahead_s", [0.0, 3600.0, -3600.0])
def test_commands_held_back_by_the_sender_move_nothing_whatever_its_clock(stage, ahead_s):
    arms(stage)
    with peer("twist", f"rt{NAMESPACE}/cmd_vel", SPEED_M_S, 0.0, ahead_s) as sender:
        stage.wait_for("moving")
        sender.say("held")
        no_source_commands(stage)
        sent = inputs(stage)["ros2"]["sent"]
        wait_until(lambda: inputs(stage).get("ros2", {}).get("sent", 0) > sent, "more of them")
        assert not stage.robot.status()["leases"]
    stage.robot.disarm()
