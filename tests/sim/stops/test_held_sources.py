# SPDX-License-Identifier: Apache-2.0
"""After a stop, and before arming, a source is held however seldom or late its commands come, on
each input for programs of this machine."""

import contextlib
import itertools
import json
import subprocess
import sys

import pytest
from tests.sim.command_source import free_udp_port
from tests.sim.daemon_stage import (
    DEADLINE_S,
    ROOT,
    becomes_idle,
    release_sources,
    running,
    wait_until,
)
from tests.sim.uncertain_source import (
    BASE,
    DENSE_S,
    GOAL_RAD,
    JOINTS,
    SPARSE_S,
    Sending,
    lapsed,
    settings,
)

from motord.client import Refused

COMMANDS = 8
"""Commands that a source sends in vain after the stop: they would move the robot by now."""
LATE = ("sparse", "one gap")
STILL_M_S, STILL_RAD = 0.01, 0.005


@pytest.fixture(scope="module", params=["demo", "pan-tilt"])
def stage(request, tmp_path_factory):
    robot = ROOT / f"config/robots/{request.param}.toml"
    more = settings(free_udp_port())
    patient = [
        f"joint.{name}.{setting}"
        for name in (("left", "right") if request.param == "demo" else ("pan", "tilt"))
        for setting in ("tries=10", "reply_timeout_s=0.2")
    ]
    with running(tmp_path_factory.mktemp("held"), *more, *patient, robot=robot) as stage:
        stage.sources = BASE if request.param == "demo" else JOINTS
        stage.wait_for("idle")
        yield stage


def made(stage, name):
    """Return a source of this kind; skip for a robot that is not commanded so."""
    if name not in stage.sources:
        pytest.skip("this robot is not commanded so")
    becomes_idle(stage)
    with contextlib.suppress(Refused):
        stage.robot.release("program")
    if name in JOINTS:
        _leave_the_goal(stage)
    return stage.sources[name](stage)


def _leave_the_goal(stage):
    """Move the joints away from where the sources send them, and disarm."""
    armed_in_a_pause(stage)

    def away():
        stage.robot.joints({"pan": -GOAL_RAD, "tilt": -GOAL_RAD})
        return all(position_rad < 0.0 for position_rad in place(stage))

    wait_until(away, "away from the goal")
    stage.robot.joints({})
    stage.robot.release()
    becomes_idle(stage)


def place(stage):
    return [joint.position_rad for joint in stage.sim.truth().joints.values()]


def moves(stage, before):
    return any(abs(now - then) > STILL_RAD for now, then in zip(place(stage), before, strict=True))


def owners(stage):
    return [one["owner"] for one in stage.robot.status()["held"]]


def armed_in_a_pause(stage):
    """Arm as soon as no command is alive: until then arming is refused. The pause is short."""

    def attempt():
        for _ in range(100):
            with contextlib.suppress(Refused):
                return stage.robot.arm() == "armed"
        return False

    wait_until(attempt, "armed")


def stays(stage, sending, before):
    """Check that the next commands move nothing, and that `status` names their source, perhaps
    beside one of a test before."""
    sent = sending.sent
    wait_until(lambda: sending.sent >= sent + COMMANDS, "commands in vain")
    assert not moves(stage, before)
    assert stage.state() == "armed"
    assert sending.source.owner in owners(stage)


INPUTS = [*BASE, *JOINTS]
CASES = list(itertools.product(INPUTS, LATE))
MOVING = [case for case in CASES if case[0] != "drive, each on a new connection"]
"""A lease ends with its connection, so that one command a connection moves nothing."""
pytestmark = pytest.mark.long


@pytest.mark.parametrize("case", MOVING, ids="-".join)
def test_a_source_is_held_after_a_stop(stage, case):
    name, late = case
    source = made(stage, name)
    armed_in_a_pause(stage)
    release_sources(stage)
    before = place(stage)
    with Sending(source, SPARSE_S if late == "sparse" else DENSE_S) as sending:
        wait_until(lambda: moves(stage, before), "motion")
        if late == "one gap":
            sending.period_s = None
            wait_until(lambda: lapsed(stage), "the gap")
        assert stage.robot.stop() == "armed"
        rests(stage)
        before = place(stage)
        sending.period_s = sending.period_s or DENSE_S
        stays(stage, sending, before)
        sending.send_zero()
        wait_until(lambda: source.owner not in owners(stage), "a zero lets it go on")
        if name not in JOINTS:  # these are at their goal, perhaps
            wait_until(lambda: moves(stage, before), "motion after a zero")
    becomes_idle(stage)


@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_a_source_is_held_when_the_robot_is_armed(stage, case):
    name, late = case
    source = made(stage, name)
    rests(stage)
    before = place(stage)
    with Sending(source, SPARSE_S if late == "sparse" else DENSE_S) as sending:
        wait_until(lambda: sending.sent > 3, "commands before arming")
        if late == "one gap":
            sending.period_s = None
            wait_until(lambda: lapsed(stage), "the gap")
        armed_in_a_pause(stage)
        sending.period_s = sending.period_s or DENSE_S
        stays(stage, sending, before)
        source.release()
    becomes_idle(stage)


def rests(stage):
    wait_until(lambda: stage.sim.truth().at_rest, "rest")


def motord(stage, *words):
    command = [sys.executable, "-m", "motord", *words, "--socket", str(stage.socket)]
    return subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=DEADLINE_S, check=False
    )


def test_stop_status_and_the_log_name_the_held_source_and_arming_again_releases_it(stage):
    name = next(iter(stage.sources))
    source = made(stage, name)
    armed_in_a_pause(stage)
    release_sources(stage)
    before = place(stage)
    with Sending(source, SPARSE_S) as sending:
        wait_until(lambda: moves(stage, before), "motion")
        done = motord(stage, "stop")
        assert (done.returncode, done.stdout) == (0, "armed\n")
        assert "program (newest command" in done.stderr
        assert "sends zero once" in done.stderr
        assert "motord arm" in done.stderr
        (one,) = json.loads(motord(stage, "stop", "--json").stdout)["held"]
        assert one["owner"] == "program"
        assert "program (newest command" in motord(stage, "status").stdout
        wait_until(lambda: "held: program" in stage.logged(), "the log")
        wait_until(
            lambda: "program sends a command every 0.5" in stage.logged(), "a source too seldom"
        )
        rests(stage)
        before = place(stage)
        stage.robot.arm()  # a program
        stays(stage, sending, before)
        done = motord(stage, "arm")
        assert (done.returncode, done.stdout) == (0, "armed\n")
        assert "not held any more: program" in done.stderr
        wait_until(lambda: not owners(stage), "nobody is held")
    becomes_idle(stage)


def test_a_program_that_is_started_anew_moves_the_robot_five_seconds_after_the_one_before(stage):
    if "drive" not in stage.sources:
        pytest.skip("this robot has no base")
    becomes_idle(stage)
    armed_in_a_pause(stage)
    words = ("drive", "0.2", "0", "--seconds", "0.5")
    assert motord(stage, *words).returncode == 0
    with subprocess.Popen(
        [sys.executable, "-m", "motord", "drive", "0.2", "0", "--socket", str(stage.socket)],
        cwd=ROOT, stderr=subprocess.DEVNULL,
    ) as driving:  # fmt: skip
        before = place(stage)
        wait_until(lambda: moves(stage, before), "motion")
        assert stage.robot.stop() == "armed"
        assert driving.wait(DEADLINE_S) == 1  # held: it ends with the reason
    assert motord(stage, *words).returncode == 1  # it may be the next one of a loop
    wait_until(lambda: not owners(stage), "nobody is held")
    assert motord(stage, *words).returncode == 0
    becomes_idle(stage)
