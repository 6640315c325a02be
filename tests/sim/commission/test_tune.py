# SPDX-License-Identifier: Apache-2.0
"""`motord tune` at a real terminal: the simulated wheel is identified and follows better with its
new gains. Every ending leaves the robot at rest; gains that are not written are put back."""

import contextlib
import json
import re
import signal
import threading

import pytest
from tests.sim.daemon_stage import HELD_TORQUE, ROOT, becomes_idle, patient_on_can, wait_until
from tests.sim.person_stage import at_terminal, copied, robot_of

from motord.config import load_robot

FORWARD_ONLY = ROOT / "config/robots/forward-only.toml"
HEAVY = ("left.coulomb_n_m=1.2", "right.coulomb_n_m=1.2")
"""Friction with which the wheels begin to turn at a duty of 15 %; the file has 6 %."""
STALL_N_M, FULL_RAD_S, INERTIA_KG_M2, VISCOUS = 8.0, 18.0, 0.07, 0.02
REPLIES = {r"Is the path clear\? \[y/n\] ": "y", r"Write \S+cart\.toml\? \[y/n\] ": "y"}
GAIN = "joint.left.speed_loop.gain_s_per_rad"
TUNED_TRIES = 4


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tune")
    file = copied(folder, FORWARD_ONLY)
    with robot_of(folder, file, wheels=HEAVY) as stage:
        stage.file = file
        yield stage


@pytest.fixture(autouse=True)
def as_it_was(stage):
    """Undo what the test before wrote or set."""
    becomes_idle(stage)
    copied(stage.file.parent, FORWARD_ONLY)
    gains = [name for name in stage.robot.params_list() if ".speed_loop." in name]
    stage.robot.params_set(**dict.fromkeys(gains, 0.0))


def tuned(stage, *words, write="y"):
    """Run `tune`; return its exit status and its output. Repeat it, up to TUNED_TRIES times, if the
    computer was held up, so that nothing was written."""
    replies = REPLIES | {r"Write \S+cart\.toml\? \[y/n\] ": write}
    for _ in range(TUNED_TRIES):
        with at_terminal("tune", *words, "--socket", stage.socket) as screen:
            status, text = screen.answers(replies), screen.text
        if status == 0 or "held up for too much of the time" not in text:
            break
    return status, text


def at_rest_with_its_gains(stage, before):
    wait_until(lambda: stage.state() == "idle", "disarmed")
    wait_until(lambda: stage.sim.truth().at_rest, "at rest")
    assert stage.file.read_bytes() == before
    wait_until(lambda: stage.robot.params_get(GAIN) == {GAIN: 0.0}, "its gains are put back")


def test_nothing_moves_without_a_yes(stage):
    before, place = stage.file.read_bytes(), stage.sim.truth().distance_m
    with at_terminal("tune", "left", "--socket", stage.socket) as screen:
        screen.answer(r"with at most 0.3 m/s; .*Is the path clear\? ", "n")
        assert screen.end() == 1
    assert "nothing was driven" in screen.text
    assert stage.sim.truth().distance_m == place
    at_rest_with_its_gains(stage, before)


@pytest.mark.parametrize("how", ["key", "Ctrl-C", "SIGTERM", "SIGHUP", "kill -9", "e-stop"])
def test_every_ending_is_at_rest_with_the_old_gains(stage, how):
    before, place = stage.file.read_bytes(), stage.sim.truth().distance_m
    with at_terminal("tune", "left", "--step-s", "4", "--socket", stage.socket) as screen:
        screen.answer("Is the path clear", "y")
        screen.until(lambda: stage.sim.truth().distance_m > place + 0.02, "it drives")
        match how:
            case "key":
                screen.type("q")
            case "Ctrl-C":
                screen.type("\x03")
            case "SIGTERM" | "SIGHUP":
                screen.process.send_signal(getattr(signal, how))
            case "kill -9":
                screen.process.kill()
            case "e-stop":
                stage.robot.estop()
        if how == "e-stop":
            stage.wait_for("estop")
            wait_until(lambda: stage.sim.truth().at_rest, "at rest")
            assert screen.end() == 1
            assert "emergency stop" in screen.text
            stage.robot.reset()
        elif how == "kill -9":
            screen.process.wait(100.0)
        else:
            assert screen.end() == 1
            assert "aborted: the robot is at rest and disarmed" in screen.text
    at_rest_with_its_gains(stage, before)


def test_exceeding_a_bound_stops_it(stage):
    before = stage.file.read_bytes()
    status, text = tuned(stage, "left", "--current-max-a", "0.5")
    assert status == 1
    assert re.search(r"left: \d+\.\d+ A are more than --current-max-a allows", text)
    at_rest_with_its_gains(stage, before)


def test_gains_that_are_not_written_are_put_back(stage):
    before = stage.file.read_bytes()
    status, text = tuned(stage, "left", write="n")
    assert status == 0, text
    assert "nothing was written" in text
    at_rest_with_its_gains(stage, before)


@pytest.mark.long
def test_a_wheel_is_identified_and_follows_better_with_the_new_gains(stage, tmp_path):
    plot = tmp_path / "left.png"
    status, text = tuned(stage, "left", "--plot", str(plot), "--json")
    assert status == 0, text
    found = json.loads(text[text.index("\n{") :])
    plant = found["plant"]
    assert plant["acceleration_u_s2_per_rad"] == pytest.approx(INERTIA_KG_M2 / STALL_N_M, rel=0.25)
    viscous = 1.0 / FULL_RAD_S + VISCOUS / STALL_N_M
    assert plant["viscous_u_s_per_rad"] == pytest.approx(viscous, rel=0.08)
    assert plant["static_u"] == pytest.approx(1.2 / STALL_N_M, abs=0.02)
    assert found["after"]["error_rad_s"] < 0.7 * found["before"]["error_rad_s"]
    assert found["after"]["off_rad_s"] < 0.3 * found["before"]["off_rad_s"]
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert re.search(r"before [▁-█]{60}\n +after [▁-█]{60}", text)
    loop = load_robot(stage.file).joint["left"].speed_loop
    assert loop.gain_s_per_rad == found["gains"]["gain_s_per_rad"] > 0.0
    assert stage.robot.params_get(GAIN)[GAIN] == loop.gain_s_per_rad
    assert stage.state() == "idle"


@contextlib.contextmanager
def held_up(process):
    """Stop the process for 0.5 s, then continue it for 0.1 s, until the end of the block."""
    over = threading.Event()

    def hold() -> None:
        while not over.is_set():
            process.send_signal(signal.SIGSTOP)
            over.wait(0.5)
            process.send_signal(signal.SIGCONT)
            over.wait(0.1)

    holding = threading.Thread(target=hold)
    holding.start()
    try:
        yield
    finally:
        over.set()
        holding.join()


def test_steps_that_a_busy_computer_missed_are_driven_again_after_a_question(stage):
    before = stage.file.read_bytes()
    with at_terminal("tune", "left", "--socket", stage.socket) as screen:
        screen.answer("Is the path clear", "y")
        with held_up(screen.process):
            screen.wait(r"saw only \d+% of these steps")
        place = stage.sim.truth().distance_m
        screen.answer("Is the path clear", "y")
        screen.until(lambda: stage.sim.truth().distance_m > place + 0.02, "it drives again")
        screen.type("q")
        assert screen.end() == 1
    at_rest_with_its_gains(stage, before)


def test_a_drive_with_its_own_speed_loop_is_named(tmp_path):
    file = copied(tmp_path)
    with robot_of(tmp_path, file) as stage:
        with at_terminal("tune", "left", "--socket", stage.socket) as screen:
            assert screen.end() == 1
        assert 'drive "zlac8015d" holds the speed of the wheel by itself' in screen.text
        assert "Traceback" not in screen.text
        with at_terminal("tune", "lift", "--socket", stage.socket) as screen:
            assert screen.end() == 1
        assert 'no joint "lift": known are left, right' in screen.text


@pytest.mark.long
def test_a_torque_drive_gets_feed_forward_too(tmp_path):
    file = patient_on_can(tmp_path, "cia402-torque", "cia402-torque")
    slack = (("gain_n_m_s_per_rad = 1.0", "gain_n_m_s_per_rad = 0.3"),)
    copied(tmp_path, file, slack)
    with robot_of(tmp_path, file, *HELD_TORQUE) as stage:
        status, text = tuned(stage, "left", "--aggressiveness", "gentle", "--json")
        assert status == 0, text
        found = json.loads(text[text.index("\n{") :])
    gains = found["gains"]
    assert gains["inertia_kg_m2"] == pytest.approx(INERTIA_KG_M2, rel=0.3)
    assert gains["static_n_m"] == pytest.approx(0.3, rel=0.3)
    assert found["after"]["error_rad_s"] < found["before"]["error_rad_s"]
    loop = load_robot(file).joint["left"].speed_loop
    assert loop.inertia_kg_m2 == gains["inertia_kg_m2"]
    assert loop.torque_max_n_m == 3.0
