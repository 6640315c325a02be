# SPDX-License-Identifier: Apache-2.0
"""`motord spin` at a real terminal, on bases with steered wheels; the simulated person sees the
simulator's wheels."""

import math

import pytest
from tests.sim.daemon_stage import ROBOT, TRIES, becomes_idle, wait_until
from tests.sim.person_stage import at_terminal, copied, robot_of

from motord.config import load_robot

PLACES = ("front_left", "front_right", "rear_left", "rear_right")
QUICK = ("--seconds", "1")
VESC = "joint.drive.drive_watchdog_s=2.0"
"""Watchdog of the VESC, equal to the stage's safety.drive_watchdog_s."""
OFF = round(0.1 * 4096 / math.tau)
EXACT_COUNTS = 12
"""Tolerance of a zero_count: one degree."""


class Watcher:
    """A person who looks at each wheel of a robot on blocks."""

    def __init__(self, stage, driven, steering):
        self._sim, self._driven, self._steering = stage.sim, driven, steering
        self._before = {}

    def _at_rad(self):
        joints = self._sim.truth().joints
        return {name: joints[name].position_rad for name in self._driven}

    def _angle_rad(self, name):
        return self._sim.truth().joints[name].position_rad

    def _side(self, name):
        angle_rad = self._angle_rad(name)
        self._before = self._at_rad()
        return "straight" if abs(angle_rad) < 0.1 else "left" if angle_rad > 0.0 else "right"

    def _direction(self, name):
        turned_rad = self._at_rad()[name] - self._before[name]
        if name == self._driven[-1]:
            self._before = self._at_rad()
        return "none" if abs(turned_rad) < 0.2 else "forward" if turned_rad > 0.0 else "backward"

    def _stood(self):
        now, before = self._at_rad(), self._before
        self._before = now
        return min(now, key=lambda name: abs(now[name] - before[name]))

    def replies(self):
        found = {
            r"off the ground, and is nothing in their reach\? \[y/n\] ": "y",
            r"Which wheel stood\? .*?\] ": self._stood,
            r"Write \S+cart\.toml\? \[y/n\] ": "y",
        }
        for name in self._steering:
            found[rf"does the wheel of {name} point to the left .*?\[°\] "] = lambda name=name: (
                f"{math.degrees(self._angle_rad(name)):.1f}"
            )
            found[rf"Where does the wheel of {name} point now\? .*?\] "] = lambda name=name: (
                self._side(name)
            )
        for name in self._driven:
            found[rf"Did the {name} wheel turn forward\? .*?\] "] = lambda name=name: (
                self._direction(name)
            )
        return found


HELD_UP = ("no fresh set-points", "the robot stopped by itself")
"""Messages of a run that ends early because a busy machine made set-points or positions old."""


def spun(stage, driven, steering, *words):
    """Run `spin`; return exit status and text. Repeat it, up to TRIES times, if it was held up."""
    for number in range(TRIES):
        if number:
            becomes_idle(stage)
        with at_terminal("spin", *words, *QUICK, "--socket", stage.socket) as screen:
            status = screen.answers(Watcher(stage, driven, steering).replies())
            stage.wait_for("idle", "fault")
            wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
            if status == 0 or not any(why in screen.text for why in HELD_UP):
                stage.wait_for("idle")
                break
    return status, screen.text


def test_a_correct_car_passes(tmp_path):
    file = copied(tmp_path, ROBOT.parent / "ackermann-servo.toml")
    before = file.read_bytes()
    with robot_of(tmp_path, file, VESC) as stage:
        status, text = spun(stage, ["drive"], ["steering"], "--all")
    assert status == 0, text
    assert file.read_bytes() == before


def crooked(folder, name):
    """Return a copy whose last zero_count is 0.1 rad off; the simulated servos have 2048."""
    file = copied(folder, ROBOT.parent / f"{name}.toml")
    before, old, after = file.read_text("utf-8").rpartition("zero_count = 2048")
    file.write_text(f"{before}{old[:-4]}{2048 + OFF}{after}", "utf-8")
    return file


def test_steering_of_a_car_that_is_inverted_and_crooked_is_put_right(tmp_path):
    """The servo is mounted on the other side, and its horn is turned by 0.1 rad."""
    file = crooked(tmp_path, "ackermann-servo")
    with robot_of(tmp_path, file, VESC, truth=("joint.steering.inverted=true",)) as stage:
        status, text = spun(stage, ["drive"], ["steering"], "steering")
    assert status == 1, text
    joint = load_robot(file).joint["steering"]
    assert joint.inverted
    assert abs(joint.zero_count - 2048) <= EXACT_COUNTS


@pytest.mark.long
def test_swerve_modules_with_swapped_drives_are_put_right(tmp_path):
    """The front modules are swapped, rear_left is inverted, and a zero_count is 0.1 rad off."""
    file = crooked(tmp_path, "swerve4-servos")
    truth = {
        "front_left": {"unit": 3}, "front_right": {"unit": 1},
        "front_left_steering": {"unit": 4}, "front_right_steering": {"unit": 2},
        "rear_left_steering": {"inverted": True}, "rear_left": {"inverted": True},
    }  # fmt: skip
    settings = [
        f"joint.{name}.{key}={str(value).lower()}"
        for name, keys in truth.items()
        for key, value in keys.items()
    ]
    with robot_of(tmp_path, file, truth=settings) as stage:
        status, text = spun(stage, PLACES, [f"{place}_steering" for place in PLACES], "--all")
    assert status == 1, text
    before, after = load_robot(ROBOT.parent / "swerve4-servos.toml").joint, load_robot(file).joint
    for name, joint in after.items():
        expected = {key: getattr(before[name], key) for key in ("unit", "inverted")}
        expected |= truth.get(name, {})
        assert {key: getattr(joint, key) for key in expected} == expected, (name, text)
        if joint.steers:
            assert abs(joint.zero_count - 2048) <= EXACT_COUNTS, (name, text)


@pytest.mark.parametrize("how", ["key", "kill -9"])
def test_every_ending_is_at_rest_and_without_power(tmp_path, how):
    file = copied(tmp_path, ROBOT.parent / "ackermann-servo.toml")
    with robot_of(tmp_path, file, VESC) as stage:

        def joints():
            return stage.sim.truth().joints

        words = ("spin", "drive", "--seconds", "10", "--socket", stage.socket)
        with at_terminal(*words) as screen:
            screen.answer("off the ground, and is nothing in their reach", "y")
            screen.until(lambda: joints()["drive"].velocity_rad_s > 0.5, "it turns")
            if how == "key":
                screen.type("x")
                assert screen.end() == 1
                assert "aborted: the robot is at rest and disarmed" in screen.text
            else:
                screen.process.kill()
        stage.wait_for("idle")
        wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
        wait_until(lambda: not any(one.enabled for one in joints().values()), "no power")


def test_nothing_moves_before_a_yes(tmp_path):
    file = copied(tmp_path, ROBOT.parent / "ackermann-servo.toml")
    with robot_of(tmp_path, file, VESC) as stage:
        stage.sim.reset_truth()
        with at_terminal("spin", "--all", "--socket", stage.socket) as screen:
            screen.answer("off the ground, and is nothing in their reach", "n")
            assert screen.end() == 1
        assert "nothing was turned" in screen.text
        assert stage.sim.truth().moved_max_m_s == 0.0
        assert stage.sim.truth().joints["steering"].position_rad == 0.0
