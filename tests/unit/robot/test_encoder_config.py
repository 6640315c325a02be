# SPDX-License-Identifier: Apache-2.0
"""[joint.NAME.encoder] in a robot file: its allowed content, and the values for core and line."""

import math
from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot
from motord.config.wiring import line_specs
from motord.control import assembly
from motord.tools.unit import devices
from motord_hal.fieldbus.ports import BoardEncoder, CounterEncoder, EdgesEncoder

ROBOT = (Path(__file__).resolve().parents[3] / "config/robots/pi4-encoders.toml").read_text("utf-8")
GPIO = 'kind = "gpio"'


@pytest.fixture
def load(tmp_path):
    def read(*edits):
        text = ROBOT
        for old, new in edits:
            assert old in text
            text = text.replace(old, new, 1)
        path = tmp_path / "robot.toml"
        path.write_text(text, encoding="utf-8")
        return load_robot(path)

    return read


def rows(load, *edits):
    with pytest.raises(ConfigError) as caught:
        load(*edits)
    return [f"{row.key}: {row.text}" for row in caught.value.problems]


def sent(robot):
    profiles = robot.profiles
    (spec,) = line_specs(robot, profiles)
    return assembly.core_config(robot, profiles)["joint"], [j.encoder for j in spec.joints]


def test_core_and_line_get_the_same_angle_of_a_count_with_its_sign(load):
    (left, right), (a, b) = sent(load())
    turn = 2.0 * math.pi / (1320 * 1.0)
    assert (left["counter_bits"], right["counter_bits"]) == (64, 64)
    assert (left["rad_per_count"], a.rad_per_count) == (pytest.approx(turn),) * 2
    assert (right["rad_per_count"], b.rad_per_count) == (pytest.approx(-turn),) * 2
    assert isinstance(a, EdgesEncoder)
    assert (a.gpio_chip, a.a, a.b, a.pull) == ("pinctrl-bcm2711", "GPIO17", "GPIO27", "up")


def test_an_encoder_with_swapped_channels_counts_in_reverse(load):
    (left, _), (a, _) = sent(load((GPIO, GPIO + "\nreversed = true")))
    assert left["rad_per_count"] == a.rad_per_count < 0.0


def test_the_line_gets_a_counter_of_the_kernel(load):
    edges = GPIO + '\na = "GPIO17"\nb = "GPIO27"\npull = "up"'
    counter = 'kind = "counter"\ncounter = "44000000.timer"\ncount = 1'
    _, (a, _) = sent(load((edges, counter)))
    assert isinstance(a, CounterEncoder)
    assert (a.counter, a.count) == ("44000000.timer", 1)


EDGES = GPIO + '\na = "GPIO17"\nb = "GPIO27"\npull = "up"'
RIGHT_EDGES = GPIO + '\na = "GPIO23"\nb = "GPIO24"\npull = "up"'
BOARD = 'kind = "mcu"\nport = "/dev/ttyACM0"\nmotor = 1'
OTHER_MOTOR = BOARD.replace("motor = 1", "motor = 2")


def test_the_line_gets_a_board_that_counts_for_one_wheel_or_both(load):
    robot = load((EDGES, BOARD), (RIGHT_EDGES, OTHER_MOTOR))
    core, (a, b) = sent(robot)
    assert a == BoardEncoder(
        port="/dev/ttyACM0", baudrate=115200, motor=1, rad_per_count=core[0]["rad_per_count"]
    )
    assert (b.motor, b.rad_per_count) == (2, core[1]["rad_per_count"])
    assert [joint["counter_bits"] for joint in core] == [64, 64]
    assert "char-ttyACM" in devices(robot)


@pytest.mark.parametrize(
    ("edits", "words"),
    [
        (
            [(EDGES, BOARD), (RIGHT_EDGES, BOARD)],
            "joint.right.encoder: motor 1 of that board is counted for joint left already",
        ),
        (
            [(EDGES, BOARD), (RIGHT_EDGES, OTHER_MOTOR + "\nbaudrate = 9600")],
            "joint.right.encoder: baudrate is not that of joint left on the same port (115200)",
        ),
        (
            [
                (EDGES, BOARD),
                (
                    "[joint.left]",
                    '[line.board]\nkind = "mcu"\nport = "/dev/ttyACM0"\n\n[joint.left]',
                ),
            ],
            "joint.left.encoder: /dev/ttyACM0 is the port of line board",
        ),
        ([(EDGES, BOARD.replace("motor = 1", ""))], "joint.left.encoder.motor: is missing"),
    ],
)
def test_a_mistake_about_a_board_that_counts_is_reported(load, edits, words):
    assert any(row.startswith(words) for row in rows(load, *edits)), rows(load, *edits)


def test_with_encoders_nothing_is_reported_of_missing_counters(load):
    assert not [row for row in load().warnings if "counter" in row.text]


@pytest.mark.parametrize(
    ("edits", "words"),
    [
        (
            [('a = "GPIO17"', 'a = "GPIO27"')],
            "b: GPIO27 is taken already (joint left, encoder's a)",
        ),
        ([('a = "GPIO17"', 'a = "GPIO5"')], "a: GPIO5 is taken already (joint left, pin in1)"),
        (
            [("full_duty_rad_s = 18.0", "full_duty_rad_s = 18.0\ncounts_per_turn = 5")],
            "belongs to the encoder: set it there",
        ),
        (
            [("counts_per_turn = 1320", "")],
            "joint.left.encoder.counts_per_turn: is missing",
        ),
        (
            [(GPIO, GPIO + '\ngpio_chip = "tegra-gpio"')],
            'joint.left.encoder: the chip "tegra-gpio" has no pulls',
        ),
    ],
)
def test_what_does_not_fit_is_reported(load, edits, words):
    assert any(words in row for row in rows(load, *edits)), rows(load, *edits)


def test_a_drive_that_counts_itself_gets_no_encoder(tmp_path):
    demo = (Path(__file__).resolve().parents[3] / "config/robots/esp32.toml").read_text("utf-8")
    path = tmp_path / "robot.toml"
    section = '\n[joint.left.encoder]\nkind = "gpio"\na = "1"\nb = "2"\ncounts_per_turn = 4\n'
    path.write_text(demo + section, encoding="utf-8")
    with pytest.raises(ConfigError, match='is only for a line of kind "pwm": this one is "mcu"'):
        load_robot(path)
