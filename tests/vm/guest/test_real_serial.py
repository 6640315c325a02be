# SPDX-License-Identifier: Apache-2.0
"""The daemon on serial ports of the kernel's own drivers: 8250 and ftdi_sio."""

import os

import pytest
from cable import ADAPTER_SERIAL, UART, adapter, daemon, drive_on, plug, pull, robot_file
from cable import simulated_drive
from daemon_stage import wait_until

from motord_hal.serial.counters import read_counters
from motord_hal.serial.port import open_exclusively


@pytest.fixture(autouse=True)
def plugged():
    plug()
    yield
    plug()


def rests_without_power(sim):
    truth = sim.truth()
    return truth.at_rest and not any(joint.enabled for joint in truth.joints.values())


def test_a_robot_on_a_uart_drives_and_comes_to_rest(tmp_path):
    with (
        simulated_drive(tmp_path, adapter()) as sim,
        daemon(tmp_path, robot_file(tmp_path, UART), sim) as stage,
    ):
        drive_on(stage)
        stage.robot.stop()
        wait_until(lambda: sim.truth().at_rest, "the wheels rest")
        stage.robot.disarm()
        assert rests_without_power(sim)
        assert stage.robot.status()["lines"]["rs485"]["engine"] == "rt"


@pytest.mark.parametrize("kind", ["by serial number", "by id"])
def test_an_adapter_that_was_pulled_is_found_again_and_the_drives_are_disarmed(tmp_path, kind):
    by_id = next(p for p in os.listdir("/dev/serial/by-id") if ADAPTER_SERIAL in p)
    port = {"by serial number": f"usb:{ADAPTER_SERIAL}", "by id": f"/dev/serial/by-id/{by_id}"}
    with (
        simulated_drive(tmp_path, UART) as sim,
        daemon(tmp_path, robot_file(tmp_path, port[kind]), sim) as stage,
    ):
        drive_on(stage)
        before = adapter()
        pull()
        stage.wait_for("fault")
        wait_until(lambda: sim.truth().at_rest, "the drive's own watchdog stops the wheels")
        plug()
        assert adapter() != before, "the old number is still held: this test shows nothing"
        wait_until(lambda: stage.robot.status()["lines"]["rs485"]["state"] == "ready", "open again")
        assert stage.state() == "fault"
        assert rests_without_power(sim)
        stage.robot.reset()
        drive_on(stage)


def test_the_kernel_counts_what_a_uart_received():
    fd = open_exclusively(UART)
    try:
        before = read_counters(fd)
        with open(adapter(), "wb", buffering=0) as other:
            other.write(b"abc")
        wait_until(lambda: read_counters(fd).received >= before.received + 3, "three bytes")
    finally:
        os.close(fd)
