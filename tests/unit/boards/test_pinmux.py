# SPDX-License-Identifier: Apache-2.0
"""Advice on a pin with another function than in the robot file: the step that changes it, by board,
and what uses the pin now."""

import pytest

from motord_hal.gpio.pinmux import freeing_step, mux_owner, not_muxed, pwm_owner, pwm_step

PI5 = "raspberrypi,5-model-b\0brcm,bcm2712\0"
PI4 = "raspberrypi,4-model-b\0brcm,bcm2711\0"
PI3 = "raspberrypi,3-model-b\0brcm,bcm2837\0"
NANO = "nvidia,p3450-0000\0nvidia,tegra210\0"
ORIN_NANO = "nvidia,p3768-0000+p3767-0005\0nvidia,p3767-0005\0nvidia,tegra234\0"
AGX_ORIN = "nvidia,p3737-0000+p3701-0000\0nvidia,tegra234\0"
XAVIER = "nvidia,p2972-0000\0nvidia,tegra194\0"
RK3399 = "radxa,rockpi4b\0rockchip,rk3399\0"
RP1 = "1f000d0000.gpio-pinctrl-rp1"


def tree(tmp_path, compatible):
    (tmp_path / "compatible").write_text(compatible)
    return tmp_path


def pinmux(tmp_path, *rows):
    """Make a debugfs with these rows for the pins of a Pi 5; return its folder."""
    folder = tmp_path / "debug/pinctrl" / RP1
    folder.mkdir(parents=True)
    head = ("Pinmux settings per pin", "Format: pin (name): mux_owner gpio_owner hog?")
    (folder / "pinmux-pins").write_text("\n".join((*head, *rows)) + "\n")
    return tmp_path / "debug"


@pytest.mark.parametrize(
    ("compatible", "chip", "channels", "words"),
    [
        (PI4, "fe20c000.pwm", [0, 1], "dtoverlay=pwm-2chan,pin=12,func=4,pin2=13,func2=4 to /boot"),
        (PI4, "fe20c000.pwm", [1], "For pwm1 on GPIO13 add dtoverlay=pwm,pin=13,func=4 to /boot"),
        (PI4, "fe20c000.pwm", [0, 2], "No pin of this board carries its pwm2"),
        (PI3, "3f20c000.pwm", [0], "dtoverlay=pwm,pin=12,func=4"),
        (PI4, "1f00098000.pwm", [0], "pwm_chip of this board: fe20c000.pwm. For pwm0 on GPIO12"),
        (PI5, "1f00098000.pwm", [3, 2], "pwm-2chan,pin=18,func=2,pin2=19,func2=2"),
        (PI5, "1f00098000.pwm", [0, 1, 2, 3], "GPIO19 this board needs an overlay of your own"),
        (NANO, "7000a000.pwm", [2], "Give header pin 33 to PWM with sudo /opt/nvidia/jetson-io"),
        (NANO, "7000a000.pwm", [0, 2], "Give header pin 32 and header pin 33 to PWM"),
        (ORIN_NANO, "32e0000.pwm", [0], "Give header pin 32 to PWM"),
        (ORIN_NANO, "3280000.pwm", [1], "No pin of this board carries its pwm1; there are pwm0 on"),
        (AGX_ORIN, "32c0000.pwm", [0], "Give header pin 18 to PWM"),
        (XAVIER, "3280000.pwm", [0], "Give the pins to PWM with sudo /opt/nvidia/jetson-io"),
        (RK3399, "ff420000.pwm", [0], "The board's device tree must give a pin to PWM"),
    ],
)
def test_the_step_depends_on_the_board_and_the_channels(
    tmp_path, compatible, chip, channels, words
):
    assert words in pwm_step(chip, channels, (), tree(tmp_path, compatible))


def test_a_machine_without_a_device_tree_gets_the_general_step(tmp_path):
    assert "device tree must give" in pwm_step("pwmchip0", [0], (), tmp_path / "none")


def test_a_pin_that_the_robot_file_uses_otherwise_is_not_proposed(tmp_path):
    step = pwm_step("fe20c000.pwm", [0, 1], ["GPIO12"], tree(tmp_path, PI4))
    assert "pwm-2chan,pin=18,func=2,pin2=13,func2=4" in step


@pytest.mark.parametrize(
    ("compatible", "owner", "words"),
    [
        (PI4, "spi0 CS0", "dtparam=spi=off in /boot/firmware/config.txt frees it"),
        (PI5, "onewire@4", "take dtoverlay=w1-gpio out of /boot/firmware/config.txt"),
        (PI5, "cooling_fan", "take the dtoverlay or dtparam that gives it away out of"),
        (ORIN_NANO, "spi0", "give it back with sudo /opt/nvidia/jetson-io"),
        (RK3399, "spi0", "take that driver out of the device tree"),
    ],
)
def test_the_step_that_frees_a_pin_depends_on_the_board(tmp_path, compatible, owner, words):
    assert words in freeing_step(owner, tree(tmp_path, compatible))


def test_the_driver_that_has_a_pwm_channel_is_named(tmp_path):
    rows = (
        "0: platform/1f00098000.pwm, 4 PWM devices",
        " pwm-0   (sysfs               ): requested enabled period: 50000 ns duty: 0 ns",
        " pwm-3   ((null)              ): period: 0 ns duty: 0 ns polarity: normal",
        "",
        "1: platform/1f0009c000.pwm, 4 PWM devices",
        " pwm-3   (cooling_fan         ): requested enabled period: 41566 ns duty: 12225 ns",
    )
    (tmp_path / "pwm").write_text("\n".join(rows) + "\n")
    assert pwm_owner("1f0009c000.pwm", 3, tmp_path) == "cooling_fan"
    assert pwm_owner("1f00098000.pwm", 3, tmp_path) == ""
    assert pwm_owner("1f00098000.pwm", 0, tmp_path) == ""
    assert pwm_owner("1f0009c000.pwm", 3, tmp_path / "none") == ""


def test_the_device_that_has_a_pin_is_named(tmp_path):
    debug = pinmux(
        tmp_path,
        "pin 2 (gpio2): 1f00074000.i2c (GPIO UNCLAIMED) function i2c1 group gpio2",
        "pin 5 (gpio5): (MUX UNCLAIMED) pinctrl-rp1:574",
        "pin 20 (gpio20): device 1f000a0000.i2s function i2s0 group gpio20",
        "pin 21 (gpio21): GPIO pinctrl-rp1:590",
        "pin 22 (gpio22): UNCLAIMED",
    )
    assert mux_owner("pinctrl-rp1", 2, debug) == "1f00074000.i2c"
    assert mux_owner("pinctrl-rp1", 20, debug) == "1f000a0000.i2s"
    assert [mux_owner("pinctrl-rp1", pin, debug) for pin in (5, 21, 22, 23)] == [""] * 4
    assert mux_owner("pinctrl-bcm2711", 2, debug) == ""
    assert mux_owner("pinctrl-rp1", 2, tmp_path / "none") == ""


def test_a_channel_that_has_no_pin_is_reported_with_the_step(tmp_path):
    machine = tree(tmp_path, PI5)
    debug = pinmux(
        tmp_path,
        "pin 12 (gpio12): 1f00098000.pwm (GPIO UNCLAIMED) function pwm0 group gpio12",
        "pin 13 (gpio13): (MUX UNCLAIMED) (GPIO UNCLAIMED)",
        "pin 18 (gpio18): 1f000a0000.i2s (GPIO UNCLAIMED) function i2s0 group gpio18",
    )
    step = not_muxed("1f00098000.pwm", [0, 1], machine, debug)
    assert step.startswith("the kernel has given no pin to pwm1 of 1f00098000.pwm. For pwm0 on ")
    assert "pwm-2chan,pin=12,func=4,pin2=13,func2=4" in step
    assert "no pin to pwm2 of" in not_muxed("1f00098000.pwm", [0, 2], machine, debug)


def test_no_step_is_given_for_pins_that_are_muxed_or_unknown(tmp_path):
    machine = tree(tmp_path, PI5)
    assert not_muxed("1f00098000.pwm", [0], machine, tmp_path / "none") == ""
    row = "pin 12 (gpio12): 1f00098000.pwm (GPIO UNCLAIMED) function pwm0 group gpio12"
    debug = pinmux(tmp_path, row)
    assert not_muxed("1f00098000.pwm", [0], machine, debug) == ""
    assert not_muxed("chip-of-files", [0, 1], machine, debug) == ""
