# SPDX-License-Identifier: Apache-2.0
"""A daemon that monitors its battery through the simulated drives."""

import contextlib
import json
import subprocess

import pytest
from tests.sim.daemon_stage import running, set_off, wait_until

from motord.client import Refused

DRIVES = ("battery.source=drives", "battery.settle_s=0.0", "battery.silent_s=0.5")
FULL = (*DRIVES, "battery.low_v=3.0", "battery.critical_v=2.0")
EMPTY = (*DRIVES, "battery.low_v=900.0", "battery.critical_v=800.0")
STOPS = "safety.on_battery_critical=stop"
REGISTERS = {
    "voltage": "bus_voltage",
    "current": "current_1",
    "temperature": "temperature_1",
}


def level(stage):
    return stage.robot.status()["battery"]["state"]


def test_a_robot_without_the_section_has_no_battery(tmp_path):
    with running(tmp_path) as stage:
        assert stage.robot.status()["battery"] is None


def test_a_battery_is_reported_and_published_and_unknown_without_its_drives(tmp_path):
    settings = (*FULL, "publish.console.kind=stdout", "publish.console.rate_hz=20")
    with running(tmp_path, *settings, stdout=subprocess.PIPE) as stage, stage.daemon.stdout:
        wait_until(lambda: level(stage) == "normal", "a measure")
        battery = stage.robot.status()["battery"]
        assert battery["voltage_v"] > 3.0
        assert (battery["current_a"], battery["temperature_c"]) == (None, None)

        def published():
            found = json.loads(stage.daemon.stdout.readline())
            return found["battery"]["state"] == "normal"

        wait_until(published, "a snapshot with the battery")
        stage.sim.pull()
        wait_until(lambda: level(stage) == "unknown", "unknown")
        assert stage.robot.status()["battery"]["voltage_v"] is None
        wait_until(lambda: "the battery is unknown" in stage.logged(), "the log line")
        stage.sim.plug()
        wait_until(lambda: level(stage) == "normal", "normal again")


def test_drive_registers_supply_the_batterys_current_and_temperature(tmp_path):
    named = [f"battery.{key}_from=left.{name}" for key, name in REGISTERS.items()]
    with running(tmp_path, *FULL, *named) as stage:

        def measured():
            battery = stage.robot.status()["battery"]
            return None not in (battery["current_a"], battery["temperature_c"])

        wait_until(measured, "all three")
        battery = stage.robot.status()["battery"]
        asked = stage.robot.params_get("drive.left.temperature_1", "drive.left.bus_voltage")
        assert battery["temperature_c"] == pytest.approx(asked["drive.left.temperature_1"], abs=2.0)
        assert battery["voltage_v"] == pytest.approx(asked["drive.left.bus_voltage"], abs=0.5)
        stage.wait_for("idle")
        set_off(stage)
        wait_until(lambda: stage.robot.status()["battery"]["current_a"] < 0.0, "a discharge")
        stage.sim.pull()
        wait_until(lambda: level(stage) == "unknown", "unknown")
        assert stage.robot.status()["battery"]["temperature_c"] is None


def test_a_critical_battery_is_reported_and_by_default_does_not_stop_the_robot(
    tmp_path,
):
    with running(tmp_path, *EMPTY) as stage:
        wait_until(lambda: level(stage) == "critical", "critical")
        wait_until(lambda: "the battery is critical" in stage.logged(), "the log line")
        stage.wait_for("idle")
        set_off(stage)


def test_a_critical_battery_prevents_arming_where_the_file_sets_stop(tmp_path):
    with running(tmp_path, *EMPTY, STOPS) as stage:
        wait_until(lambda: level(stage) == "critical", "critical")
        stage.wait_for("idle")
        with pytest.raises(Refused, match="battery is critical: charge it"):
            stage.robot.arm()


def test_a_moving_robot_comes_to_rest_when_its_battery_becomes_critical(tmp_path):
    """The simulated 36 V fall below the critical voltage as soon as a motor draws current."""
    weak = ("battery.low_v=35.997", "battery.critical_v=35.995", "battery.hysteresis_v=0.0")
    with running(tmp_path, *DRIVES, *weak, STOPS) as stage:
        wait_until(lambda: level(stage) == "normal", "a measure")
        stage.wait_for("idle")
        stage.robot.arm()

        def stopped():
            with contextlib.suppress(Refused):
                stage.robot.drive(0.4, 0.0)
            return stage.state() == "fault"

        wait_until(stopped, "the fault")
        assert "battery is critical" in stage.robot.status()["why"][0]
        wait_until(lambda: stage.robot.status()["at_rest"], "rest")


def test_a_missing_sensor_is_reported_once_and_the_battery_is_unknown(tmp_path):
    missing = ("battery.source=ina226", f"battery.bus={tmp_path / 'i2c'}", *FULL[1:])
    with running(tmp_path, *missing, STOPS) as stage:
        wait_until(lambda: "the battery is unknown" in stage.logged(), "the log line")
        assert stage.logged().count("there is no such I2C bus") == 1
        assert level(stage) == "unknown"
        stage.wait_for("idle")
        stage.robot.arm()
