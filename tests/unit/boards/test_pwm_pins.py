# SPDX-License-Identifier: Apache-2.0
"""Pins of motor bridges: names in a robot file, the search for chips, reports of problems."""

import asyncio
import errno
import os
from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot
from motord.config.drives.load import find_profile, load_profile
from motord_hal.base.errors import PortError, ProfileError
from motord_hal.fieldbus.ports import JointSpec, LineSpec, PinsSpec
from motord_hal.gpio.lines import Wanted, request_outputs
from motord_hal.gpio.pinmux import freeing_step, pwm_step
from motord_hal.pwm.pins import open_pins, places_of, split_for_rest
from motord_hal.pwm.sysfs import _why, find_chip, open_channel

ROBOT = (Path(__file__).resolve().parents[3] / "config/robots/pi5-bts7960.toml").read_text("utf-8")
BTS = (Path(__file__).resolve().parents[3] / "config/drives/bts7960.toml").read_text("utf-8")
FORWARD = '[bridge.forward]\nrpwm = "duty"\nlpwm = "low"\n'
OFF, DUTY = (0.0, 0.0), (0.0, 1.0)
BRAKE = '[bridge.brake]\nrpwm = "low"\nlpwm = "low"\n'
LEFT = 'pins = { rpwm = "pwm0", lpwm = "pwm1", r_en = "GPIO5", l_en = "GPIO6" }'

RS485 = """[line.rs485]
kind = "modbus-rtu"
port = "/dev/ttyAMA0"
direction = "gpio"
direction_gpio_chip = "pinctrl-rp1"
direction_gpio_line = "GPIO24"
"""


def joint(drive, **pins):
    return JointSpec(index=0, name="left", profile=find_profile(drive), unit=1, pins=pins)


def line_of(robot_joint):
    return LineSpec(
        index=0, name="pins", kind="pwm", port="", baudrate=115200, parity="none", stop_bits=1,
        cycle_hz=200.0, gap_s=None, engine="auto", joints=(robot_joint,), watchdog_s=0.5,
        pins=PinsSpec(pwm_chip="no-such.pwm"),
    )  # fmt: skip


def pwm_tree(tmp_path, *devices):
    """Make /sys/class/pwm, whose chips are links into the folders of `devices`; return its path."""
    root = tmp_path / "class"
    root.mkdir()
    for number, device in enumerate(devices):
        chip = tmp_path / "devices" / device / "pwm" / f"pwmchip{number}"
        chip.mkdir(parents=True)
        (chip / "device").symlink_to(tmp_path / "devices" / device)
        (chip / "npwm").write_text("2\n")
        (root / f"pwmchip{number}").symlink_to(chip)
    return root


# ------------------------------------------------------------------------------------- the places
def test_a_pin_is_a_channel_or_a_line_and_may_be_active_low():
    first, second = places_of(0, joint("drv8871", in1="pwm3", in2="!pwm0"))
    assert (first.channel, first.inverted) == (3, False)
    assert (second.channel, second.inverted) == (0, True)
    places = places_of(0, joint("three-wire", pwm="pwm0", in1="GPIO17", in2="27", fault="!4"))
    assert [(p.pin, p.gpio, p.inverted) for p in places[1:]] == [
        ("in1", "GPIO17", False),
        ("in2", "27", False),
        ("fault", "4", True),
    ]


@pytest.mark.parametrize(
    ("drive", "pins", "words"),
    [
        ("drv8871", {"in1": "pwm0"}, "pin in2 of drv8871 is not given"),
        ("drv8871", {"in1": "pwm0", "in2": "GPIO4"}, "GPIO4 is a GPIO line: motors are not driven"),
        ("drv8871", {"in1": "pwm0", "in3": "pwm1"}, "drv8871 has no pin in3"),
        ("drv8871", {"in1": "pwm0", "in2": "pwm1", "fault": "pwm2"}, "fault is an input"),
        ("drv8871", {"in1": "pwm0", "in2": "pwm1", "pump": "pwm2"}, "pump is no PWM"),
        ("drv8871", {"in1": "pwm0", "in2": "!"}, "in2 has no channel or line"),
    ],
)
def test_what_a_bridge_cannot_do_with_its_pins_is_reported(drive, pins, words):
    with pytest.raises(ValueError, match=words):
        places_of(0, joint(drive, **pins))


def test_enable_pins_that_are_wired_high_may_be_left_out():
    assert len(places_of(0, joint("bts7960", rpwm="pwm0", lpwm="pwm1"))) == 2
    assert len(places_of(0, joint("tb6612fng", pwm="pwm0", in1="1", in2="2"))) == 3


@pytest.mark.parametrize(
    ("driven", "alone", "together"),
    [(set(), ["in1", "in2", "stby", "pump"], []), ({0}, ["stby", "pump"], [["in1", "in2"]])],
)
def test_lines_rest_one_by_one_unless_that_could_turn_a_driven_motor(driven, alone, together):
    bridge = joint("tb6612fng", pwm="pwm0", in1="1", in2="2", stby="3", pump="4")
    lines = [place for place in places_of(0, bridge) if place.channel is None]
    first, groups = split_for_rest(line_of(bridge), lines, driven)
    assert [place.pin for place in first] == alone
    assert [[place.pin for place in group] for group in groups] == together


# --------------------------------------------------------------------------------------- the chips
def test_a_pwm_chip_is_found_by_its_device_whatever_its_number(tmp_path):
    root = pwm_tree(tmp_path, "soc/fan.pwm", "soc/1f00098000.pwm")
    assert find_chip("1f00098000.pwm", root).name == "pwmchip1"
    assert find_chip("pwmchip0", root).name == "pwmchip0"


def test_no_chip_and_too_many_chips_are_reported_with_what_is_there(tmp_path):
    root = pwm_tree(tmp_path, "soc/fan.pwm", "soc/1f00098000.pwm")
    with pytest.raises(PortError, match=r'2 PWM chips fit "soc".*pwmchip0 \(fan.pwm\)'):
        find_chip("soc", root)
    with pytest.raises(PortError, match=r'no PWM chip "fe20c000\.pwm"; there: pwmchip0'):
        find_chip("fe20c000.pwm", root)


def test_a_chip_that_is_not_there_is_reported_with_joint_pin_and_step():
    spec = line_of(joint("drv8871", in1="pwm0", in2="pwm1"))
    with pytest.raises(PortError) as caught:
        asyncio.run(open_pins(spec))
    assert str(caught.value).startswith('joint left, pin in1: no PWM chip "no-such.pwm"; there: ')
    assert str(caught.value).endswith(pwm_step("no-such.pwm", [0, 1]))


def test_a_channel_that_the_kernel_has_is_reported_with_what_frees_it(tmp_path):
    chip = find_chip("pwmchip0", pwm_tree(tmp_path, "soc/1f00098000.pwm"))
    busy = OSError(errno.EBUSY, os.strerror(errno.EBUSY))
    assert _why(busy, chip, 0).startswith("a driver of the kernel has it (a fan, a backlight): ")
    assert _why(busy, chip, 0).endswith(freeing_step(""))


def test_a_channel_that_is_not_there_is_reported_with_the_chip(tmp_path):
    root = pwm_tree(tmp_path, "soc/1f00098000.pwm")
    chip = find_chip("pwmchip0", root)
    chip.chmod(0o555)
    with pytest.raises(PortError, match=r"PWM channel 5 of .*pwmchip0 \(1f00098000.pwm\)"):
        asyncio.run(open_channel(chip, 5, 50_000, 0))
    assert not os.path.lexists(chip / "pwm5")


def test_a_chip_that_vanishes_while_its_error_is_made_is_reported_as_gone(tmp_path):
    chip = find_chip("pwmchip0", pwm_tree(tmp_path, "soc/1f00098000.pwm"))
    no_device = OSError(errno.ENODEV, os.strerror(errno.ENODEV))
    assert _why(no_device, chip, 5) == "the chip has 2 channels, from 0 on"
    (chip / "npwm").unlink()
    assert _why(no_device, chip, 5) == "the chip is gone"


def test_an_absent_gpio_chip_is_reported(tmp_path):
    with pytest.raises(PortError, match='no GPIO chip "pinctrl-rp1"; there: none'):
        request_outputs("pinctrl-rp1", [Wanted(line="4", purpose="a test")], "x", tmp_path)


# ---------------------------------------------------------------------------------------- profiles
@pytest.mark.parametrize(
    ("right", "wrong", "words"),
    [
        ('rpwm = "duty"', 'rpwm = "dutty"', 'did you mean "duty"'),
        ('rpwm = "duty"', "rpwm = { base = 0.5, slope = 0.6 }", "not within 0 and 1"),
        ('[bridge.brake]\nrpwm = "low"\n', "[bridge.brake]\n", 'pin "rpwm" has no level in brake'),
        ("pwm_hz = 20000", "pwm_hz = 90000", "not within pwm_min_hz and pwm_max_hz"),
        ('protocol = "pwm"', 'protocol = "ascii"', "if and only if"),
        (
            FORWARD,
            FORWARD.replace('"low"', '"inverse"'),
            r"bridge\.forward.* written one after the",
        ),
        (
            BRAKE,
            BRAKE.replace('"low"', '"high"'),
            r'bridge\.brake.*"rpwm" and "lpwm" are both above',
        ),
    ],
)
def test_a_mistake_in_a_bridge_is_reported(tmp_path, right, wrong, words):
    assert right in BTS
    path = tmp_path / "bts7960.toml"
    path.write_text(BTS.replace(right, wrong, 1), encoding="utf-8")
    with pytest.raises(ProfileError, match=words):
        load_profile(path)


def test_with_a_pwm_pin_for_each_direction_one_failed_write_gives_no_power():
    levels = find_profile("drv8871").bridge.levels
    assert levels["in1"] == {**dict.fromkeys(("coast", "brake", "reverse"), OFF), "forward": DUTY}
    assert levels["in2"] == {**dict.fromkeys(("coast", "brake", "forward"), OFF), "reverse": DUTY}


# -------------------------------------------------------------------------------------- robot files
def test_two_lines_cannot_have_the_same_channel_of_a_chip(tmp_path):
    chip = 'pwm_chip = "1f00098000.pwm"'
    other = f'[line.more]\nkind = "pwm"\n{chip}\ngpio_chip = "other"\n'
    left, right = ROBOT.split("[joint.right]")
    right = right.replace('line = "pins"', 'line = "more"').replace('"pwm2"', '"pwm0"')
    path = tmp_path / "robot.toml"
    path.write_text(f"{left}{other}[joint.right]{right}", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    assert [problem.text for problem in caught.value.problems] == [
        "pin rpwm: pwm0 is taken already (joint left, pin rpwm)"
    ]


@pytest.mark.parametrize(
    ("right", "wrong", "row"),
    [
        (LEFT, 'pins = { rpwm = "pwm0" }', "joint.left.pins: pin lpwm of bts7960 is not given"),
        ('r_en = "GPIO16"', 'r_en = "GPIO5"', "joint.right.pins: pin r_en: GPIO5 is taken already"),
        (
            "[joint.left]",
            '[safety.estop]\ngpio_chip = "pinctrl-rp1"\ngpio_line = "GPIO5"\n[joint.left]',
            "safety.estop.gpio_line: GPIO5 is taken already (joint left, pin r_en)",
        ),
        (
            "[joint.left]",
            '[safety.watchdog]\ngpio_chip = "pinctrl-rp1"\ngpio_line = "GPIO17"\n[joint.left]',
            "safety.watchdog.gpio_line: GPIO17 is taken already (joint left, encoder's a)",
        ),
        (
            'a = "GPIO23"',
            'a = "GPIO6"',
            "joint.right.encoder: a: GPIO6 is taken already (joint left, pin l_en)",
        ),
        (
            "[joint.left]",
            f"{RS485}[joint.left]",
            "line.rs485.direction_gpio_line: GPIO24 is taken already (joint right, encoder's b)",
        ),
        ('pwm_chip = "1f00098000.pwm"\n', "", "line.pins.pwm_chip: is missing: joint left, pin"),
        ('kind = "pwm"', 'kind = "pwm"\npwm_hz = 90000', "line.pins.pwm_hz: 90000 Hz is out of"),
        ('drive = "bts7960"', 'drive = "zlac8015d"', "joint.left.drive: drive"),
    ],
)
def test_mistakes_about_pins_in_a_robot_file_are_reported(tmp_path, right, wrong, row):
    assert right in ROBOT
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT.replace(right, wrong, 1), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    found = [f"{problem.key}: {problem.text}" for problem in caught.value.problems]
    assert any(problem.startswith(row) for problem in found), found
