# SPDX-License-Identifier: Apache-2.0
"""The guided set-up, with values from options and from answers."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from motord.cli import cli
from motord.commission.person import Failed
from motord.commission.setup.hardware import Place, place_of, places
from motord.commission.setup.procedure import Given, set_up, unit_and_channel
from motord.commission.setup.robot_text import robot_text
from motord.config import load_robot

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
WHOLE = Given(
    name="cart", place="simulated", drive="zlac8015d", base="differential", wheel_radius_m=0.08,
    track_m=0.4, linear_m_s=0.5, angular_rad_s=1.0, gear_ratio=1.0, left=(1, 1), right=(1, 2),
)  # fmt: skip


class Answering:
    """A person who gives these answers, in their order."""

    def __init__(self, *answers):
        self.answers, self.questions, self.shown = list(answers), [], []

    def _next(self, question):
        self.questions.append(question)
        return self.answers.pop(0)

    def show(self, text):
        self.shown.append(text)

    def progress(self, text):
        pass

    def confirm(self, question):
        return self._next(question)

    def choose(self, question, answers):
        answer = self._next(question)
        assert answer in answers
        return answer

    def number(self, question, unit, low, high):
        answer = self._next(question)
        assert low <= answer <= high
        return answer

    def text(self, question, default):
        return self._next(question) or default

    def aborted(self):
        return False


def written(given, person=None, file=Path("cart.toml")):
    return robot_text(set_up(person or Answering(), given, file), file)


def test_options_answer_every_question():
    text, robot = written(WHOLE)
    assert (robot.robot.name, robot.base.track_m, robot.limits.linear_m_s) == ("cart", 0.4, 0.5)
    assert (robot.joint["right"].channel, robot.joint["right"].inverted) == (2, True)
    assert not robot.publish
    assert text.startswith("#:schema file:///")


def test_the_schema_that_the_file_names_is_there():
    text, _ = written(WHOLE)
    place = Path(text.splitlines()[0].removeprefix("#:schema file://"))
    assert json.loads(place.read_text("utf-8"))["title"]


@pytest.mark.parametrize(
    "drive",
    ["zlac8015d", "bld-305s", "odrive-0.6", "vesc", "cia402", "ddsm115", "mcu-velocity",
     "roboclaw", "rmd", "moteus", "sts3215"],
)  # fmt: skip
def test_every_kind_of_line_makes_a_file_that_passes_the_check(drive):
    given = replace(WHOLE, drive=drive, left=(1, 1), right=(2, 1), counts_per_turn=4096)
    if drive in ("zlac8015d", "mcu-velocity", "roboclaw"):
        given = replace(given, right=(1, 2))
    if drive == "roboclaw":
        given = replace(given, left=(128, 1), right=(128, 2))
    if drive in ("odrive-0.6", "moteus", "bld-305s"):
        given = replace(given, counts_per_turn=None)
    _, robot = written(given)
    assert robot.joint["left"].drive == drive


def test_a_slow_line_gets_a_rate_that_it_carries():
    fast, slow = (
        written(replace(WHOLE, drive="bld-305s", right=(2, 1), baudrate=baudrate))[1]
        for baudrate in (115200, 9600)
    )
    assert slow.line["main"].cycle_hz < fast.line["main"].cycle_hz
    assert slow.safety.feedback_timeout_s >= 2.0 / slow.line["main"].cycle_hz


def test_an_implausible_radius_is_questioned():
    person = Answering(*(0.85, False, 0.085))
    _, robot = written(replace(WHOLE, wheel_radius_m=None), person)
    assert person.questions[1] == "0.85 m: a wheel of 1.7 m across?"
    assert robot.base.wheel_radius_m == 0.085


def test_a_mecanum_base_has_four_wheels_by_place_and_a_speed_sideways():
    given = replace(WHOLE, base="mecanum", wheelbase_m=0.35, lateral_m_s=0.3, left=None, right=None)
    text, robot = written(given, Answering("", "", "2.1", "2.2"))
    assert (robot.base.kind, robot.base.wheelbase_m, robot.base.rollers) == ("mecanum", 0.35, "x")
    found = {name: (j.place, j.unit, j.channel, j.inverted) for name, j in robot.joint.items()}
    assert found == {
        "front_left": ("front-left", 1, 1, False), "front_right": ("front-right", 1, 2, True),
        "rear_left": ("rear-left", 2, 1, False), "rear_right": ("rear-right", 2, 2, True),
    }  # fmt: skip
    assert robot.limits.lateral_m_s == 0.3
    assert "from the front axle to the rear one" in text


@pytest.mark.parametrize("count", [3, 4, 5])
def test_an_omni_base_has_its_wheels_around_it(count):
    units = {f"wheel_{n + 1}": (n + 1, 1) for n in range(count)}
    given = replace(WHOLE, base="omni", drive="odrive-0.6", radius_m=0.15, wheel_count=count,
                    lateral_m_s=0.3, addresses=units, left=None, right=None)  # fmt: skip
    person = Answering()
    _, robot = written(given, person)
    angles_rad = [joint.angle_rad for joint in robot.joint.values()]
    assert angles_rad == pytest.approx([(n + 0.5) * 2 * math.pi / count for n in range(count)])
    assert [joint.unit for joint in robot.joint.values()] == list(range(1, count + 1))
    assert person.questions == []


def test_a_wheel_that_the_base_lacks_is_refused():
    with pytest.raises(Failed, match=r"--unit middle=.*this base has left, right"):
        written(replace(WHOLE, addresses={"middle": (1, 1)}))


def test_a_drive_on_pins_is_refused_with_its_example():
    with pytest.raises(Failed, match="pi5-bts7960"):
        set_up(Answering(), replace(WHOLE, place="pwmchip0", drive="bts7960", full_duty_rad_s=9.0),
               Path("cart.toml"))  # fmt: skip


def test_a_drive_of_another_protocol_is_refused():
    with pytest.raises(Failed, match='drive "zlac8015d" speaks modbus-rtu, which is not for can'):
        set_up(Answering(), replace(WHOLE, place="can0"), Path("cart.toml"))


def test_a_misspelt_drive_gets_a_suggestion():
    with pytest.raises(Failed, match=r'did you mean "zlac8015d"'):
        set_up(Answering(), replace(WHOLE, drive="zlac8015"), Path("cart.toml"))


@pytest.mark.parametrize("text", ["", "left", "1.x", "-1"])
def test_an_invalid_unit_is_refused(text):
    with pytest.raises(Failed, match="is not a unit and channel"):
        unit_and_channel(text)


def test_places_of_a_machine_are_listed_by_kind(tmp_path):
    for file, text in {
        "sys/class/net/can0/type": "280", "sys/class/net/can0/operstate": "down",
        "sys/class/net/eth0/type": "1", "sys/class/pwm/pwmchip2/npwm": "4", "dev/ttyAMA0": "",
    }.items():  # fmt: skip
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text)
    found = [place for place in places(tmp_path) if "USB" not in place.name]
    assert [(place.kind, place.name) for place in found] == [
        ("serial", "/dev/ttyAMA0"), ("can", "can0"), ("pwm", "pwmchip2"),
    ]  # fmt: skip
    assert "down" in found[1].about


@pytest.mark.parametrize(
    ("name", "kind"), [("/dev/ttyUSB0", "serial"), ("usb:A1", "serial"), ("can0", "can"),
                       ("unix:/tmp/bus", "can"), ("pwmchip0", "pwm")]
)  # fmt: skip
def test_a_named_place_has_a_kind(name, kind):
    assert place_of(name) == Place(kind, name, "")


def test_the_command_takes_all_answers_as_options_and_does_not_overwrite(tmp_path):
    file = tmp_path / "cart.toml"
    words = [
        "init", str(file), "--at", "simulated", "--drive", "zlac8015d", "--base", "differential",
        "--wheel-radius-m", "0.08", "--track-m", "0.4", "--linear-m-s", "0.5",
        "--angular-rad-s", "1", "--gear-ratio", "1", "--left", "1.1", "--right", "1.2",
        "--name", "cart",
    ]  # fmt: skip
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    assert load_robot(file).robot.name == "cart"
    assert "top speed" in done.stdout
    again = CliRunner().invoke(cli, words)
    assert again.exit_code == 1
    assert "is there already" in again.stderr


def test_a_missing_answer_without_a_terminal_names_the_cure(tmp_path):
    done = CliRunner().invoke(cli, ["init", str(tmp_path / "cart.toml"), "--at", "simulated",
                                    "--drive", "zlac8015d"], input="")  # fmt: skip
    assert done.exit_code == 1
    assert "give it as an option" in done.stderr


@pytest.mark.parametrize(
    ("place", "drive", "example"),
    [("pwmchip0", "bts7960", "pi5-bts7960"), ("pwmchip0", "tb6612fng", "pi4-encoders"),
     ("pwmchip0", "servo-pulse", "ackermann-servo-pwm"),
     ("simulated", "cia402-torque", "cia402-torque")],
)  # fmt: skip
def test_a_drive_that_needs_more_answers_is_refused_first_and_its_example_named(
    place, drive, example
):
    person = Answering()
    with pytest.raises(Failed, match=f"motord robots {example} > cart.toml"):
        set_up(person, Given(place=place, drive=drive, scan=False), Path("cart.toml"))
    assert not person.questions
    joints = load_robot(ROBOTS / f"{example}.toml").joint.values()
    assert drive in [joint.drive for joint in joints]


# ------------------------------------------------------------------------------- steered wheels
CAR = replace(
    WHOLE, drive="vesc", base="ackermann", wheelbase_m=0.32, track_m=0.24, left=None, right=None,
    steered="front", driven="axle", steering_count=1, steering_drive="sts3215-position",
    steering_max_rad=0.5, steering_rad_s=4.0, steering_gear_ratio=1.0,
    addresses={"drive": (1, 1), "steering": (1, 1)},
)  # fmt: skip
SWERVE = replace(
    CAR, drive="sts3215", base="swerve", lateral_m_s=0.2, wheelbase_m=0.3, steering_max_rad=1.6,
    addresses={}, steered=None, driven=None, steering_count=None, wheel_count=4,
)  # fmt: skip


def test_options_answer_every_question_about_a_car_whose_servo_has_a_port_of_its_own():
    text, robot = written(CAR)
    assert (robot.base.kind, robot.base.steered) == ("ackermann", "front")
    assert {name: line.kind for name, line in robot.line.items()} == {
        "main": "can", "steering": "feetech",
    }  # fmt: skip
    steering = robot.joint["steering"]
    assert (steering.steers, steering.place, steering.line) == (True, "front", "steering")
    assert (steering.position_min_rad, steering.position_max_rad) == (-0.5, 0.5)
    assert steering.zero_count == 2048
    assert robot.joint["drive"].place == "rear"
    assert "motord spin --all measures it" in text


@pytest.mark.parametrize(
    ("driven", "count", "places"),
    [("axle", 2, {"drive": "rear", "left_steering": "front-left"}),
     ("pair", 1, {"left": "rear-left", "right": "rear-right", "steering": "front"}),
     ("steered", 1, {"drive": "front", "steering": "front"}),
     ("steered", 2, {"left": "front-left", "right_steering": "front-right"})],
)  # fmt: skip
def test_a_tricycle_is_driven_and_steered_as_it_was_answered(driven, count, places):
    person = Answering(driven, str(count), *[""] * 4)
    given = replace(CAR, drive="sts3215", base="tricycle", driven=None, steering_count=None,
                    addresses={})  # fmt: skip
    _, robot = written(given, person)
    found = {name: joint.place for name, joint in robot.joint.items()}
    assert found.items() >= places.items()
    units = [joint.unit for joint in robot.joint.values()]
    assert units == list(range(1, len(units) + 1))


def test_modules_of_a_swerve_base_have_two_joints_each_on_one_line():
    _, robot = written(SWERVE, Answering(*[""] * 8))
    assert list(robot.line) == ["main"]
    assert [joint.unit for joint in robot.joint.values()] == list(range(1, 9))
    assert robot.joint["rear_left_steering"].place == robot.joint["rear_left"].place
    assert robot.limits.lateral_m_s == 0.2


@pytest.mark.parametrize(
    ("count", "places"),
    [(2, ["front-left", "rear-right"]), (3, ["front", "rear-left", "rear-right"])],
)
def test_a_swerve_base_may_have_two_or_three_modules(count, places):
    person = Answering(str(count), *[""] * 2 * count)
    _, robot = written(replace(SWERVE, wheel_count=None), person)
    joints = list(robot.joint.values())
    assert [joint.place for joint in joints if not joint.steers] == places
    assert [joint.place for joint in joints if joint.steers] == places
    assert "where your modules are elsewhere" in person.shown[-1]
    with pytest.raises(Failed, match="a swerve base has 2 to 4 modules, not 5"):
        written(replace(SWERVE, wheel_count=5), Answering())


def test_an_implausible_range_of_steering_is_questioned():
    person = Answering(*(3.0, False, 0.6))
    _, robot = written(replace(CAR, steering_max_rad=None), person)
    assert person.questions[1] == "3 rad: 172 degrees to each side?"
    assert robot.joint["steering"].position_max_rad == 0.6


@pytest.mark.parametrize(
    ("changed", "words"),
    [({"steering_drive": "vesc"}, "takes no positions"),
     ({"steering_drive": "rc-servo", "steering_place": "pwmchip0"}, "is on pins"),
     ({"drive": "sts3215-position"}, "takes positions"),
     ({"addresses": {"front": (1, 1)}}, "no such joint")],
)  # fmt: skip
def test_a_drive_in_the_wrong_place_is_refused(changed, words):
    with pytest.raises(Failed, match=words):
        written(replace(CAR, **changed), Answering(*[""] * 4))
