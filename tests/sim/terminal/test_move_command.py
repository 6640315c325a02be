# SPDX-License-Identifier: Apache-2.0
"""`motord move` and `motord turn` with a whole daemon on simulated drives."""

import contextlib
import json
import math
import signal
import subprocess
import sys

import pytest
from tests.sim.daemon_stage import (
    DEADLINE_S,
    ROOT,
    SURE,
    TRIES,
    in_time,
    running,
    wait_until,
    was_held_up,
)

from motord.api.motion import Goal
from motord.client import ClientError, MoveFailed


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("move"), *SURE) as stage:
        stage.wait_for("idle")
        yield stage


@contextlib.contextmanager
def command(stage, *words):
    process = subprocess.Popen(
        [sys.executable, "-m", "motord", *words, "--json", "--socket", str(stage.socket)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def ended(process):
    out, err = process.communicate(timeout=DEADLINE_S)
    found = json.loads(out)  # one object for every ending
    return process.returncode, found, found.get("error", err)


def wait_for_motion(stage):
    wait_until(lambda: not stage.sim.truth().at_rest, "the wheels turn")


def ended_in_time(stage, *words):
    """Return the truth before and the result; repeat where it was held up, up to TRIES times."""
    for _ in range(TRIES):
        before = stage.sim.truth()
        with command(stage, *words) as process:
            code, sent, err = ended(process)
        if code == 0 or not was_held_up(err):
            break
    assert (code, err) == (0, "")
    return before, sent


def test_a_speed_above_the_limit_is_refused_with_the_range(armed):
    before = armed.sim.truth()
    for words, why in (
        (("move", "0.05", "--speed-m-s", "9"), "the speed = 9 is beyond its range, 0 to 1 m/s"),
        (("turn", "0.1", "--speed-rad-s", "90"), "the speed = 90 is beyond its range, 0 to "),
    ):
        with command(armed, *words) as process:
            status, _, text = ended(process)
        assert status != 0
        assert why in text
    assert armed.sim.truth().distance_m == before.distance_m


def test_a_distance_and_a_turn_are_driven(armed):
    before, sent = ended_in_time(armed, "move", "0.3")
    assert sent["end"] == "succeeded"
    assert sent["distance_m"] == pytest.approx(0.3, abs=0.011)
    after = armed.sim.truth()
    assert math.hypot(after.x_m - before.x_m, after.y_m - before.y_m) == pytest.approx(
        0.3, abs=0.03
    )
    _, sent = ended_in_time(armed, "turn", "-0.5", "--speed-rad-s", "0.4")
    assert sent["angle_rad"] == pytest.approx(-0.5, abs=0.021)
    assert armed.robot.status()["leases"] == []


def test_an_interrupted_move_comes_to_rest_and_reports_it(armed):
    with command(armed, "move", "20") as process:
        wait_for_motion(armed)
        process.send_signal(signal.SIGINT)
        code, sent, err = ended(process)
    assert "canceled" in err
    assert (code, sent["end"]) == (130, "canceled")
    assert armed.sim.truth().at_rest


def test_a_killed_move_leaves_the_robot_at_rest(armed):
    with command(armed, "move", "20") as process:
        wait_for_motion(armed)
        process.kill()
        wait_until(lambda: armed.sim.truth().at_rest, "the wheels rest")


def test_an_emergency_stop_ends_it_with_the_exit_status_of_a_fault(armed):
    with command(armed, "move", "20") as process:
        wait_for_motion(armed)
        armed.robot.estop()
        code, sent, err = ended(process)
    assert "estop" in err or "emergency stop" in err
    assert (code, sent["end"]) == (3, "aborted")


def test_a_move_does_not_take_the_command_from_another_source(armed):
    def holding():
        return armed.robot.drive(0.0, 0.1, lease_s=5.0)["in_command"]

    wait_until(holding, "the command")
    with command(armed, "move", "0.3") as process:
        code, sent, err = ended(process)
    armed.robot.release()
    assert (code, sent) == (1, {"error": err, "exit_status": 1})
    assert "is in command" in err


@pytest.mark.parametrize(
    ("words", "code", "why"),
    [
        (("move", "0"), 2, "out of range"),
        (("turn", "nan"), 2, "finite"),
        (("move", "0.3"), 1, "arm"),
    ],
)
def test_an_impossible_move_moves_nothing(stage, words, code, why):
    def idle():
        with contextlib.suppress(ClientError):
            stage.robot.reset()
        return stage.state() == "idle"

    wait_until(idle, "idle")
    with command(stage, *words) as process:
        returned, sent, err = ended(process)
    assert (returned, sent) == (code, {"error": err, "exit_status": code})
    assert why in err
    assert stage.sim.truth().at_rest


def test_a_program_drives_a_distance_and_turns_right_after_its_own_commands(armed):
    def driven():
        before = armed.sim.truth()
        armed.robot.drive(0.0, 0.0)
        return before, armed.robot.move(0.3)

    before, moved = in_time(driven)
    assert (moved.end.value, moved.why) == ("succeeded", "")
    assert moved.distance_m == pytest.approx(0.3, abs=0.011)
    after = armed.sim.truth()
    assert math.hypot(after.x_m - before.x_m, after.y_m - before.y_m) == pytest.approx(
        0.3, abs=0.03
    )
    turned = in_time(lambda: armed.robot.turn(-0.4))
    assert turned.angle_rad == pytest.approx(-0.4, abs=0.021)
    assert armed.robot.status()["leases"] == []


def test_a_program_gets_the_reason_why_its_move_failed(armed):
    with pytest.raises(MoveFailed, match="fault is latched: estop") as failed:
        armed.robot.carry_out(
            Goal(axis="linear", distance_u=20.0),
            watch=lambda motion, _: motion.distance_u > 0.02 and armed.robot.estop(),
        )
    assert failed.value.moved.distance_m == pytest.approx(0.1, abs=0.1)
    assert failed.value.latched
    with pytest.raises(ValueError, match="more than 0"):
        armed.robot.move(1.0, speed_m_s=0.0)
