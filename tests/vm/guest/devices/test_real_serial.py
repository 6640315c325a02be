# SPDX-License-Identifier: Apache-2.0
"""The daemon on serial ports of the kernel's own drivers: 8250 and ftdi_sio."""

import os
from pathlib import Path

import pytest
from cable import ADAPTER_SERIAL, UART, adapter, behind, plug, pull, robot_file
from gpio_chip import gpio_chip
from shell import wait_until
from stage import daemon, granted

from motord.tools.scan import spec_of
from motord_hal.base.errors import PortError
from motord_hal.fieldbus.ports import DirectionKind, DirectionSpec
from motord_hal.serial.counters import read_counters
from motord_hal.serial.latency import ask_low_latency
from motord_hal.serial.port import open_exclusively, open_port


@pytest.fixture(autouse=True)
def plugged():
    plug()
    yield
    plug()


@pytest.mark.smoke
def test_a_robot_on_a_uart_drives_and_comes_to_rest(tmp_path, simulator):
    with (
        behind(simulator, adapter()) as sim,
        daemon(tmp_path, robot_file(tmp_path, UART), sim) as stage,
    ):
        stage.drive_on()
        granted(stage.robot.stop, "a stop", stage.logged)
        wait_until(lambda: sim.truth().at_rest, "the wheels rest")
        granted(stage.robot.disarm, "disarmed", stage.logged)
        assert stage.rests_without_power()
        assert stage.robot.status()["lines"]["rs485"]["engine"] == "rt"


@pytest.mark.parametrize("kind", ["by serial number", "by id"])
def test_a_pulled_adapter_is_found_again_and_disarmed(tmp_path, simulator, kind):
    by_id = next(p for p in os.listdir("/dev/serial/by-id") if ADAPTER_SERIAL in p)
    port = {"by serial number": f"usb:{ADAPTER_SERIAL}", "by id": f"/dev/serial/by-id/{by_id}"}
    with (
        behind(simulator, UART) as sim,
        daemon(tmp_path, robot_file(tmp_path, port[kind]), sim) as stage,
    ):
        stage.drive_on()
        before = adapter()
        other = os.open(before, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        pull()
        stage.wait_for("fault")
        wait_until(lambda: sim.truth().at_rest, "the drive's own watchdog stops the wheels")
        plug()
        assert adapter() != before  # an open file keeps the old number in use
        os.close(other)
        wait_until(lambda: stage.robot.status()["lines"]["rs485"]["state"] == "ready", "open again")
        assert stage.state() == "fault"
        assert stage.rests_without_power()
        granted(stage.robot.reset)
        stage.drive_on()


@pytest.mark.smoke
def test_the_kernel_counts_what_a_uart_received():
    fd = open_exclusively(UART)
    try:
        before = read_counters(fd)
        with open(adapter(), "wb", buffering=0) as other:
            other.write(b"abc")
        wait_until(lambda: read_counters(fd).received >= before.received + 3, "three bytes")
    finally:
        os.close(fd)


def test_opening_an_ftdi_adapter_shortens_its_latency_timer():
    timer = Path("/sys/class/tty", Path(adapter()).name, "device/latency_timer")
    timer.write_text("16")
    open_port(spec_of(adapter(), 115200, "none", DirectionSpec())).close()
    assert int(timer.read_text()) == 1


def test_the_udev_rule_shortens_the_latency_timer_of_a_plugged_adapter():
    pull()
    plug()
    timer = Path("/sys/class/tty", Path(adapter()).name, "device/latency_timer")
    wait_until(lambda: int(timer.read_text()) == 1, "udev has set the timer")


def test_a_uart_hands_bytes_on_at_once():
    fd = open_exclusively(UART)
    try:
        assert ask_low_latency(fd)
    finally:
        os.close(fd)


def test_a_uart_without_rs485_mode_is_refused_with_the_gpio_alternative():
    asked = DirectionSpec(kind=DirectionKind.KERNEL)
    with pytest.raises(PortError, match=r'not offered by this port .*direction = "gpio"'):
        open_port(spec_of(UART, 115200, "none", asked))
    os.close(open_exclusively(UART))  # the port has been closed


@pytest.mark.parametrize("talking", [1, 0], ids=["active high", "active low"])
def test_a_gpio_line_turns_the_transceiver_while_the_line_talks(tmp_path, simulator, talking):
    with gpio_chip("rs485-hat", "DE") as level_of:
        robot = robot_file(
            tmp_path, UART, direction="gpio", direction_gpio_chip="rs485-hat",
            direction_gpio_line="DE", direction_active_high=bool(talking), direction_after_s=0.005,
        )  # fmt: skip
        with behind(simulator, adapter()) as sim, daemon(tmp_path, robot, sim) as stage:
            stage.drive_on()
            wait_until(lambda: level_of("DE") == talking, "it talks")
            wait_until(lambda: level_of("DE") != talking, "it listens")
            granted(stage.robot.disarm, "disarmed", stage.logged)
            stage.process.kill()  # the kernel frees the line: its pull sets it
            wait_until(lambda: level_of("DE") == 0, "the pair is not driven")
