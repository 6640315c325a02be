# SPDX-License-Identifier: Apache-2.0
"""After a stop each sender of an input is held by itself, however seldom or late its commands come:
a zero of one sender lets no other one move the robot."""

import contextlib
import json
import time

import pytest
from tests.peers.light import LIGHT
from tests.peers.mqtt.mosquitto import free_port
from tests.peers.tokens import TOKEN, token_file
from tests.sim.daemon_stage import becomes_idle, running, wait_until
from websockets.sync.client import connect

from motord.client import Refused

LEASE_S, SPARSE_S, DENSE_S = 0.5, 0.56, 0.05
VAIN_COMMANDS = 6
STILL_M = 0.005


@pytest.fixture(scope="module")
def port():
    return free_port()


@pytest.fixture(scope="module")
def stage(tmp_path_factory, port):
    folder = tmp_path_factory.mktemp("senders")
    settings = (
        "input.web.kind=rosbridge", f"input.web.port={port}", "input.web.stamped=false",
        f"input.web.token_file={token_file(folder)}", f"input.web.lease_s={LEASE_S}",
        "input.web.rate_hz=50", *LIGHT,
    )  # fmt: skip
    with running(folder, *settings) as stage:
        stage.wait_for("idle")
        wait_until(lambda: bus(stage).get("inputs", {}).get("web", {}).get("lease"), "a lease")
        yield stage


def bus(stage):
    return stage.robot.status()["bus"] or {}


class Sender:
    """One client of the rosbridge server."""

    def __init__(self, client):
        self._client = client

    def send(self, linear_m_s):
        message = {"linear": {"x": linear_m_s}, "angular": {"z": 0.0}}
        self._client.send(json.dumps({"op": "publish", "topic": "/cmd_vel", "msg": message}))


@contextlib.contextmanager
def connected(port):
    with connect(f"ws://127.0.0.1:{port}/?token={TOKEN}", close_timeout=0.1) as client:
        yield Sender(client)


@pytest.fixture
def senders(port):
    with contextlib.ExitStack() as ends:
        yield [ends.enter_context(connected(port)) for _ in range(2)]


def arms(stage):
    becomes_idle(stage)

    def attempt():
        with contextlib.suppress(Refused):
            return stage.robot.arm() == "armed"

    wait_until(attempt, "armed")


def moves(stage, sender, linear_m_s=0.2):
    """Send motion until the robot moves."""
    before_m = stage.sim.truth().distance_m

    def moved():
        sender.send(linear_m_s)
        return stage.sim.truth().distance_m > before_m + STILL_M

    wait_until(moved, "motion")


def stays(stage, sender, period_s):
    """Send motion in vain: the robot receives each command, and does not move."""
    wait_until(lambda: stage.sim.truth().at_rest, "rest")
    before_m, taken = stage.sim.truth().distance_m, stage.robot.status()["commands"]["accepted"]
    for number in range(VAIN_COMMANDS):

        def received(least=taken + number + 1):
            sender.send(0.2)
            return stage.robot.status()["commands"]["accepted"] >= least

        wait_until(received, "the command")
        time.sleep(period_s)  # a source that sends so seldom
    assert stage.sim.truth().distance_m < before_m + STILL_M
    assert stage.state() == "armed"
    assert [one["owner"] for one in stage.robot.status()["held"]] == ["web"]


@pytest.mark.parametrize("period_s", [DENSE_S, SPARSE_S], ids=["one gap", "sparse"])
def test_a_zero_of_one_client_does_not_let_another_one_move_the_robot(stage, senders, period_s):
    one, other = senders
    arms(stage)
    moves(stage, one)
    moves(stage, other)
    assert stage.robot.stop() == "armed"
    stays(stage, other, period_s)
    one.send(0.0)
    stays(stage, other, period_s)
    moves(stage, one)
    for sender in senders:
        sender.send(0.0)
    moves(stage, other)
    other.send(0.0)
    becomes_idle(stage)


def test_a_client_that_connects_anew_is_held_until_it_sends_zero(stage, port):
    arms(stage)
    with connected(port) as one:
        moves(stage, one)
    assert stage.robot.stop() == "armed"
    with connected(port) as anew:
        stays(stage, anew, DENSE_S)
        anew.send(0.0)
        moves(stage, anew)
        anew.send(0.0)
    becomes_idle(stage)
