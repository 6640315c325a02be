# SPDX-License-Identifier: Apache-2.0
"""Every kind of line x a peer that resets its connections, under a daemon that drives: the daemon
lives, the robot's other line stays open, the wheels come to rest; and `motord stop-all` tries such
a line again."""

import contextlib
import json
import signal

import pytest
from tests.long_cases import long_but
from tests.relay import TO_PEER, TO_PROGRAM, Relay
from tests.shipped import shipped_profile
from tests.sim.daemon_stage import DEADLINE_S, becomes_idle, rests, running, set_off, wait_until
from tests.sim.stops.test_stop_all import stop_all

from motord.tools.simulator import start_simulator

DRIVES = {
    "modbus-rtu": "zlac8015d",
    "modbus-tcp": "zlac8015d",
    "rtu-over-tcp": "zlac8015d",
    "can": "odrive-0.6",
    "roboclaw": "roboclaw",
    "feetech": "sts3215",
    "dynamixel": "xm430",
    "ddsm": "ddsm115",
    "mcu": "mcu-velocity",
    "hoverboard": "hoverboard",
}
"""A drive for each kind of line that has a peer and measures speed."""
FEW = ("modbus-rtu", "modbus-tcp", "can")
ROBOT = """
[robot]
name = "two-lines"

[base]
kind = "differential"
track_m = 0.5
wheel_radius_m = 0.1

[limits]
linear_m_s = 0.3
linear_m_s2 = 0.5
linear_deceleration_m_s2 = 1.0
angular_rad_s = 0.5
angular_rad_s2 = 1.0

[input.socket]
kind = "socket"
lease_s = 1.0

[line.first]
kind = "{kind}"
{first}

[line.second]
kind = "{other}"
{second}

[joint.left]
line = "first"
drive = "{drive}"
unit = {unit}
side = "left"
tries = 10

[joint.right]
line = "second"
drive = "zlac8015d"
unit = 1
side = "right"
tries = 10
"""
SPEED_M_S, TURNING_RAD_S = 0.2, 1.0


def resets_some(relay):
    """Reset the connection, then new ones at accept, and after some bytes in both directions."""
    relay.reset_at_accept(3)
    relay.reset()
    wait_until(lambda: relay.resets > 3, "it resets at accept")
    for direction in (TO_PEER, TO_PROGRAM):
        for count in (1, 7, 30):
            before = relay.resets
            relay.reset_after(count, direction)
            wait_until(lambda before=before: relay.resets > before, "it resets at a byte")
    relay.pass_all()


@pytest.fixture(params=long_but(FEW, DRIVES))
def kind(request):
    return request.param


@pytest.fixture
def robot(kind, tmp_path):
    tcp = "tcp" in kind
    at = 'host = "127.0.0.1"\ntcp_port = {}' if tcp else 'port = "/dev/null{}"'
    first = 'interface = "unix"\nchannel = "/dev/null1"' if kind == "can" else at.format(1)
    other = kind if tcp else "modbus-rtu"
    unit = shipped_profile(DRIVES[kind]).unit if kind == "roboclaw" else 1
    text = ROBOT.format(
        kind=kind, other=other, first=first, second=at.format(2), drive=DRIVES[kind], unit=unit
    )
    file = tmp_path / "robot.toml"
    file.write_text(text, encoding="utf-8")
    return file


def options_of(kind, folder):
    if "tcp" in kind:
        return ("--tcp" if kind == "modbus-tcp" else "--rtu-over-tcp", "0")
    return ("--can", f"unix:{folder}/bus") if kind == "can" else ()


@pytest.fixture
def simulated(kind, robot, tmp_path):
    """The simulator, the relay before its first line, and settings with which a daemon uses it."""
    medium = "tcp" if "tcp" in kind else "unix" if kind == "can" else "pty"
    options = options_of(kind, tmp_path)
    with start_simulator(
        robot, link_dir=tmp_path, options=options, timeout_s=DEADLINE_S
    ) as simulator:
        back = simulator.ports["first"].removeprefix("unix:")
        with Relay(medium, tmp_path / "front", back) as relay:
            if medium == "tcp":
                places = {"tcp_port": int(relay.front.rpartition(":")[2])}
            else:
                places = {"channel" if medium == "unix" else "port": relay.front}
            settings = [
                *(one for one in simulator.settings if not one.startswith("line.first.")),
                *(f"line.first.{key}={json.dumps(value)}" for key, value in places.items()),
            ]
            yield simulator, relay, settings


@contextlib.contextmanager
def driving(simulated, robot, folder, *more):
    simulator, _, settings = simulated
    with running(folder, *more, robot=robot, simulated=False, ports=settings) as stage:
        stage.sim = simulator.control
        stage.wait_for("idle")
        set_off(stage, SPEED_M_S, TURNING_RAD_S)
        yield stage


def test_a_peer_that_resets_costs_its_line_and_no_more(simulated, robot, tmp_path):
    relay = simulated[1]
    with driving(simulated, robot, tmp_path) as stage:
        resets_some(relay)
        rests(stage)
        becomes_idle(stage)
        assert stage.robot.status()["lines"]["second"]["reopened"] == 0
        assert "a bug of motord" not in stage.logged()
        assert stage.end() == 0


def test_stop_all_tries_a_line_that_resets_again(simulated, robot, tmp_path):
    simulator, relay, settings = simulated
    with driving(simulated, robot, tmp_path, "safety.drive_watchdog_s=2") as stage:
        stage.end(signal.SIGKILL)
    relay.reset_at_accept(3)
    status, lines = stop_all(*settings, robot=robot)
    assert [line["problems"] for line in lines] == [[], []], status
    assert relay.resets >= 3
    wait_until(lambda: simulator.control.truth().at_rest, "the wheels rest")
