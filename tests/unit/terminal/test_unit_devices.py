# SPDX-License-Identifier: Apache-2.0
"""The systemd drop-in of a robot file: it allows the devices that the file names, and no others."""

import json

import pytest
from click.testing import CliRunner

from motord.cli.files.unit import unit
from motord_hal.base.paths import config_dir

ROBOTS = config_dir() / "robots"


def devices(robot, *settings):
    options = [word for setting in settings for word in ("--set", setting)]
    done = CliRunner().invoke(unit, [str(ROBOTS / f"{robot}.toml"), "--json", *options])
    assert done.exit_code == 0, done.output
    (row,) = [line for line in done.stdout.splitlines() if line.startswith("{")]
    found = json.loads(row)["devices"]
    assert found[0] == "/dev/cpu_dma_latency"
    return found[1:]


@pytest.mark.parametrize(
    ("port", "wanted"),
    [
        ("/dev/ttyUSB0", ["char-ttyUSB"]),
        ("/dev/ttyAMA10", ["char-ttyAMA"]),
        ("/dev/ttyS1", ["char-ttyS"]),
        ("/dev/ttyTHS1", ["char-ttyTHS"]),
        ("/dev/serial/by-id/usb-FTDI_x", ["char-ttyUSB", "char-ttyACM"]),
        ("usb:A10K3XYZ", ["char-ttyUSB", "char-ttyACM"]),
        ("/dev/my-port", ["/dev/my-port"]),
    ],
)
def test_a_serial_port_is_allowed_by_its_kind(port, wanted):
    assert devices("demo", f"line.rs485.port={port}") == wanted


def test_a_can_interface_needs_no_device_and_an_adapter_does():
    assert devices("odrive-two") == []
    slcan = ("line.can0.interface=slcan", "line.can0.channel=/dev/ttyACM0")
    assert devices("odrive-two", *slcan) == ["char-ttyACM"]
    assert devices("odrive-two", "line.can0.interface=canalystii") == ["char-usb_device"]


def test_pins_encoders_and_a_sensor_are_allowed_and_sysfs_can_be_written():
    assert devices("pi4-encoders") == ["char-gpiochip", "char-i2c"]
    lines = CliRunner().invoke(unit, [str(ROBOTS / "pi4-encoders.toml")]).stdout.splitlines()
    assert lines[:3] == ["[Service]", "DeviceAllow=", "DeviceAllow=/dev/cpu_dma_latency rw"]
    assert lines[-1] == "ReadWritePaths=/sys/devices"


def test_a_robot_without_pins_keeps_sysfs_read_only():
    printed = CliRunner().invoke(unit, [str(ROBOTS / "demo.toml")]).stdout
    assert "ReadWritePaths" not in printed
    assert "char-gpiochip" not in printed


def test_a_joystick_is_allowed_and_readable_where_the_robot_file_has_one():
    pad = ("input.pad.kind=joystick", "input.pad.device=pad")
    assert devices("demo", *pad) == ["char-ttyUSB", "char-input"]
    options = [word for setting in pad for word in ("--set", setting)]
    printed = CliRunner().invoke(unit, [str(ROBOTS / "demo.toml"), *options]).stdout
    assert printed.splitlines()[-1] == "SupplementaryGroups=input"
    assert "input" not in CliRunner().invoke(unit, [str(ROBOTS / "demo.toml")]).stdout


def test_direction_pins_of_transceivers_and_pins_of_safety_need_their_chip():
    turned = ("direction=gpio", "direction_gpio_chip=pinctrl-rp1", "direction_gpio_line=GPIO4")
    settings = [f"line.rs485.{setting}" for setting in turned]
    assert devices("demo", *settings) == ["char-ttyUSB", "char-gpiochip"]
    contact = ("safety.estop.gpio_chip=pinctrl-rp1", "safety.estop.gpio_line=GPIO4")
    assert devices("demo", *contact) == ["char-ttyUSB", "char-gpiochip"]
