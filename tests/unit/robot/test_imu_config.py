# SPDX-License-Identifier: Apache-2.0
"""[imu] in a robot file: its allowed content, and the values for core and line."""

from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot
from motord.config.wiring import line_specs
from motord.control import assembly
from motord.realtime.loop import Loop, LoopSettings
from motord_hal.fieldbus.ports import Mounting
from motord_hal.sim.boards.text_talk import TextTalk
from motord_hal.sim.gyro import SimulatedGyro
from motord_hal.sim.plant import Contact, Plant, Wheel, WheelModel
from motord_hal.sim.rs485.content import NamedContent

ROBOT = (Path(__file__).resolve().parents[3] / "config/robots/esp32-imu.toml").read_text("utf-8")
OF_LINE = 'source = "line"\nline = "board"\n'
CHIP = 'source = "lsm6ds3"\nbus = "/dev/i2c-1"\n'
TEXT = 'kind = "ascii"\ntemplate = "{left},{right}\\n"\nfeedback = "{left_count} {right_count}'


@pytest.fixture
def load(tmp_path):
    def read(*edits):
        text = ROBOT
        for old, new in edits:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "robot.toml"
        path.write_text(text, encoding="utf-8")
        return load_robot(path)

    return read


def rows(load, *edits):
    with pytest.raises(ConfigError) as caught:
        load(*edits)
    return [f"{row.key}: {row.text}" for row in caught.value.problems]


def test_the_core_and_the_line_get_the_settings_of_a_boards_sensor(load):
    robot = load(('up = "z"', 'up = "-y"'))
    profiles = robot.profiles
    (spec,) = line_specs(robot, profiles)
    assert spec.imu == Mounting(up="-y", forward="x")
    gyro = assembly.core_config(robot, profiles)["gyro"]
    assert gyro["used"] == 1
    assert gyro["timeout_s"] == 0.1
    assert gyro["still_variance_rad2_s2"] == pytest.approx(1e-4)


def test_the_line_gets_no_settings_of_a_chip(load):
    robot = load((OF_LINE, CHIP))
    profiles = robot.profiles
    assert line_specs(robot, profiles)[0].imu is None
    assert assembly.core_config(robot, profiles)["gyro"]["used"] == 1


def test_the_core_takes_the_gyro_as_the_file_gives_it_by_default(load):
    robot = load()
    Loop(assembly.core_config(robot, robot.profiles),
         LoopSettings(rate_hz=100.0, priority=0))  # fmt: skip


@pytest.mark.parametrize(
    ("edits", "row"),
    [
        (
            [('forward = "x"', 'forward = "-z"')],
            "imu.forward: forward and up are the same axis of the sensor (z)",
        ),
        (
            [('line = "board"\nup', 'line = "bord"\nup')],
            'imu.line: there is no line "bord" (known: board)',
        ),
        (
            [('forward = "x"', 'forward = "x"\ntimeout_s = 0.02')],
            "imu.timeout_s: too short for 100 samples a second (at least 0.025 s)",
        ),
        (
            [(OF_LINE, CHIP + "rate_hz = 200\n"), ("[base]", "[loop]\nrate_hz = 100\n[base]")],
            "imu.rate_hz: 200 samples a second are more than the loop can take (100 a second)",
        ),
    ],
)
def test_what_does_not_fit_is_reported(load, edits, row):
    assert row in rows(load, *edits)


def test_a_line_of_drives_carries_no_gyro(tmp_path):
    demo = (Path(__file__).resolve().parents[3] / "config/robots/demo.toml").read_text("utf-8")
    path = tmp_path / "robot.toml"
    path.write_text(demo + '\n[imu]\nsource = "line"\nline = "rs485"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match="carries no gyro"):
        load_robot(path)


def text_robot(feedback, up="z"):
    drive = ('drive = "mcu-velocity"', 'drive = "ascii-velocity"')
    line = ('kind = "mcu"', f'{TEXT}{feedback}\\n"')
    return drive, line, ('up = "z"', f'up = "{up}"'), ("cycle_hz = 100", "cycle_hz = 50")


def test_a_line_of_text_has_to_report_the_rate_about_z(load):
    found = rows(load, *text_robot(""))
    assert any("the template of the feedback has no {gyro_z_rad_s}" in row for row in found)
    found = rows(load, *text_robot(" {gyro_z_rad_s}", up="y"))
    assert any("a line of text has the rate about z alone" in row for row in found)
    assert load(*text_robot(" {gyro_z_rad_s}", up="-z")).imu.up == "-z"


def test_a_simulated_board_reports_the_rate_in_its_line_of_text(load):
    robot = load(*text_robot(" {gyro_z_rad_s}"))
    (spec,) = line_specs(robot, robot.profiles)
    plant = Plant(
        {"left": Wheel(WheelModel()), "right": Wheel(WheelModel())},
        {side: Contact(side=side, wheel_radius_m=0.05) for side in ("left", "right")},
        0.2,
    )
    gyro = SimulatedGyro(plant, spec.imu, seed=3)
    sent = TextTalk(spec, gyro).feedback(NamedContent(spec.joints[0].profile), 0.0)
    assert float(sent.split()[2]) == pytest.approx(gyro.bias_rad_s[2], abs=0.02)


def test_a_simulated_gyro_reports_the_plants_turn_with_its_offset_in_the_sensors_axes():
    wheels = {"left": Wheel(WheelModel()), "right": Wheel(WheelModel())}
    contacts = {side: Contact(side=side, wheel_radius_m=0.05) for side in wheels}
    plant = Plant(wheels, contacts, 0.2)
    gyro = SimulatedGyro(plant, Mounting(up="-x", forward="y"), seed=5)
    wheels["right"].turn(8.0)
    wheels["left"].turn(-8.0)
    plant.step(2.0)
    gyro.measure()
    before_rad = plant.yaw_rad
    plant.reset_truth()
    plant.step(1.0)
    sample = gyro.measure()
    turned_rad_s = plant.yaw_rad - before_rad
    assert turned_rad_s == pytest.approx(4.0, rel=0.05)
    assert -sample.angular_rad_s[0] == pytest.approx(turned_rad_s + gyro.bias_rad_s[2], abs=1e-3)
    assert sample.acceleration_m_s2[0] == pytest.approx(-9.8, abs=0.2)
    assert SimulatedGyro(plant, Mounting(), 5).bias_rad_s == gyro.bias_rad_s
    assert SimulatedGyro(plant, Mounting(), 6).bias_rad_s != gyro.bias_rad_s
