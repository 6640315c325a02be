# SPDX-License-Identifier: Apache-2.0
"""`motord spin` at a real terminal, on simulated drives with planted faults."""

import contextlib
import signal

import pytest
from tests.sim.daemon_stage import ROBOT, becomes_idle, wait_until
from tests.sim.person_stage import at_terminal, copied, robot_of

from motord.client import ClientError
from motord.config import load_robot

QUICK = ("--seconds", "1")
GROUND = r"Are all wheels off the ground, and is nothing in their reach\? "
SWAPPED = ("joint.left.channel=2", "joint.right.channel=1")


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    folder = tmp_path_factory.mktemp("spin")
    file = copied(folder)
    with robot_of(folder, file) as stage:
        stage.file = file
        yield stage


def spinning(stage, *words):
    return at_terminal("spin", *words, *QUICK, "--socket", stage.socket)


def fastest_rad_s(stage):
    return max(abs(joint.velocity_rad_s) for joint in stage.sim.truth().joints.values())


def rests_without_power(stage):
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")

    def disarmed():
        with contextlib.suppress(ClientError):
            return stage.state() == "idle"
        return False

    wait_until(disarmed, "disarmed")
    joints = stage.sim.truth().joints.values()
    wait_until(lambda: not any(joint.enabled for joint in joints), "no power")


def test_nothing_turns_before_a_yes(stage):
    rests_without_power(stage)
    stage.sim.reset_truth()
    with spinning(stage, "left") as screen:
        screen.answer(GROUND, "n")
        assert screen.end() == 1
    assert "nothing was turned" in screen.text
    assert stage.sim.truth().moved_max_m_s == 0.0


def test_a_correct_robot_passes(stage):
    before = stage.file.read_bytes()
    with spinning(stage, "--all") as screen:
        screen.answer(GROUND, "y")
        screen.answer("Did the left wheel turn forward", "forward")
        screen.answer("Did the right wheel turn forward", "forward")
        assert screen.end() == 0, screen.text
    assert "every wheel turns as the robot file has it" in screen.text
    assert stage.file.read_bytes() == before
    rests_without_power(stage)


@pytest.mark.parametrize("how", ["key", "Ctrl-C", "SIGTERM", "hang up", "kill -9", "e-stop"])
def test_every_ending_is_at_rest_and_without_power(stage, how):
    becomes_idle(stage)
    with at_terminal("spin", "left", "--seconds", "10", "--socket", stage.socket) as screen:
        screen.answer(GROUND, "y")
        screen.until(lambda: fastest_rad_s(stage) > 0.5, "it turns")
        match how:
            case "key":
                screen.type("x")
            case "Ctrl-C":
                screen.type("\x03")
            case "SIGTERM":
                screen.process.send_signal(signal.SIGTERM)
            case "hang up":
                screen.hang_up()
            case "kill -9":
                screen.process.kill()
            case "e-stop":
                stage.robot.estop()
        if how == "e-stop":
            stage.wait_for("estop")
            wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
            assert screen.end() == 1
            assert "emergency stop" in screen.text
            stage.robot.reset()
        elif how in ("key", "Ctrl-C", "SIGTERM"):
            assert screen.end() == 1
            assert "aborted: the robot is at rest and disarmed" in screen.text
        else:
            screen.process.wait(100.0)
    rests_without_power(stage)


@pytest.mark.parametrize("how", ["Ctrl-C", "kill -9"])
def test_spin_can_start_again_at_once(how, tmp_path):
    """The lease of the first run is still valid then, and does not block the second run."""
    with robot_of(tmp_path, copied(tmp_path), "input.socket.lease_s=5.0") as stage:
        for _ in range(2):
            with at_terminal("spin", "left", "--seconds", "10", "--socket", stage.socket) as screen:
                screen.answer(GROUND, "y")
                screen.until(lambda: fastest_rad_s(stage) > 0.5, "it turns")
                if how == "Ctrl-C":
                    screen.type("\x03")
                    assert screen.end() == 1
                screen.process.kill()
            rests_without_power(stage)


def test_a_wheel_with_a_failing_drive_is_not_judged(stage):
    becomes_idle(stage)
    with at_terminal("spin", "left", "--seconds", "10", "--socket", stage.socket) as screen:
        screen.answer(GROUND, "y")
        screen.until(lambda: fastest_rad_s(stage) > 0.5, "it turns")
        stage.sim.inject("fault:unit=1,channel=1,bit=2")
        assert screen.end() == 1
    assert "the robot stopped by itself: " in screen.text
    assert "over" in screen.text.partition("stopped by itself: ")[2]
    assert "did not turn" not in screen.text
    becomes_idle(stage)
    rests_without_power(stage)


def test_an_armed_robot_is_refused_before_the_first_question(stage):
    becomes_idle(stage)
    stage.robot.arm()
    with spinning(stage, "left") as screen:
        assert screen.end() == 1
    assert "the robot is armed" in screen.text
    assert "off the ground" not in screen.text
    stage.robot.disarm()
    rests_without_power(stage)


def test_swapped_wheels_are_found_and_put_right_in_the_file(tmp_path):
    file = copied(tmp_path)
    with robot_of(tmp_path, file, truth=SWAPPED) as stage:
        with spinning(stage, "--all") as screen:
            screen.answer(GROUND, "y")
            screen.answer("Did the left wheel turn forward", "other")
            assert stage.sim.truth().joints["right"].position_rad < -0.5
            screen.answer("Did the right wheel turn forward", "backward")
            screen.answer("Did the right wheel turn forward", "other")
            screen.answer("Did the left wheel turn forward", "backward")
            screen.answer(r"Write .*cart.toml\?", "y")
            assert screen.end() == 1
        rests_without_power(stage)
    joints = load_robot(file).joint
    assert (joints["left"].channel, joints["right"].channel) == (2, 1)


FORWARD = "wheel turn forward"


@pytest.mark.long
def test_omni_wheels_turn_one_by_one(tmp_path):
    file = copied(tmp_path, ROBOT.parent / "omni3.toml")
    with robot_of(tmp_path, file) as stage:
        with spinning(stage, "--all") as screen:
            screen.answer(GROUND, "y")
            for name in ("front_left", "rear", "front_right"):
                before = {n: j.position_rad for n, j in stage.sim.truth().joints.items()}
                screen.answer(f"Did the {name} {FORWARD}", "forward")
                after = {n: j.position_rad for n, j in stage.sim.truth().joints.items()}
                assert after[name] - before[name] > 0.5
                others = {abs(after[n] - before[n]) for n in after if n != name}
                assert max(others) < 0.1 * (after[name] - before[name])
            assert screen.end() == 0, screen.text
        stage.wait_for("idle")  # a RoboClaw does not report whether it has power
        wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")


MECANUM_SWAPPED = (
    "joint.front_left.unit=2", "joint.front_left.channel=2",
    "joint.rear_right.unit=1", "joint.rear_right.channel=1",
)  # fmt: skip


@pytest.mark.long
def test_diagonally_swapped_mecanum_wheels_are_found(tmp_path):
    """Each wheel turns twice; the person names the wheel that turned both times."""
    file = copied(tmp_path, ROBOT.parent / "mecanum4.toml")
    with robot_of(tmp_path, file, truth=MECANUM_SWAPPED) as stage:
        with spinning(stage, "--all") as screen:
            screen.answer(GROUND, "y")
            screen.wait("front_left: this base does not turn it alone")
            screen.answer(f"Did the front_left {FORWARD} both times", "other")
            screen.answer("Which wheel turned both times", "rear_right")
            screen.answer(f"Did the rear_right {FORWARD}", "backward")
            screen.answer(f"Did the front_right {FORWARD} both times", "forward")
            screen.answer(f"Did the rear_left {FORWARD} both times", "forward")
            screen.answer(f"Did the rear_right {FORWARD} both times", "other")
            screen.answer("Which wheel turned both times", "front_left")
            screen.answer(f"Did the front_left {FORWARD}", "backward")
            screen.answer(r"Write .*cart.toml\?", "y")
            assert screen.end() == 1
        rests_without_power(stage)
    joints = load_robot(file).joint
    assert (joints["front_left"].unit, joints["front_left"].channel) == (2, 2)
    assert (joints["rear_right"].unit, joints["rear_right"].channel) == (1, 1)
    assert (joints["front_left"].inverted, joints["rear_right"].inverted) == (False, True)


def test_counts_per_turn_that_are_wrong_are_named_with_their_factor(tmp_path):
    file = copied(tmp_path)
    counts = load_robot(file).profiles["zlac8015d"].counts_per_turn
    differs = 'joint.left.differs_in=["counts_per_turn"]'
    truth = (f"joint.left.counts_per_turn={2 * counts}", differs)
    with robot_of(tmp_path, file, truth=truth) as stage:
        with spinning(stage, "left") as screen:
            screen.answer(GROUND, "y")
            screen.answer("Did the left wheel turn forward", "forward")
            assert screen.end() == 1
        rests_without_power(stage)
    assert "times the commanded angle: counts_per_turn" in " ".join(screen.text.split())


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("turned-encoder:unit=1,channel=1", "its encoder counts against its motor"),
        ("unplugged-encoder:unit=1,channel=1", "did not count: look for an unplugged encoder"),
    ],
)
def test_a_wrong_encoder_stops_the_robot_and_is_explained(tmp_path, fault, words):
    file = copied(tmp_path)
    with robot_of(tmp_path, file, faults=[fault]) as stage:
        with at_terminal(
            "spin", "left", "--seconds", "4", "--speed-rad-s", "3", "--socket", stage.socket
        ) as screen:
            screen.answer(GROUND, "y")
            screen.answer("Did the left wheel turn forward", "forward")
            assert screen.end() == 1
        assert words in " ".join(screen.text.split())
        assert "the robot stopped by itself with the fault" in screen.text
        rests_without_power(stage)
