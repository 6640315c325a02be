# SPDX-License-Identifier: Apache-2.0
"""Boards in a robot file: the allowed content of a line, and the values for the hardware layer."""

from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot
from motord.config.wiring import line_specs
from motord_hal.fieldbus.open_line import engine_of

ESP32 = (Path(__file__).resolve().parents[3] / "config/robots/esp32.toml").read_text("utf-8")


@pytest.fixture
def load(tmp_path):
    def read(**edits):
        text = ESP32
        for right, wrong in edits.values():
            assert right in text
            text = text.replace(right, wrong)
        path = tmp_path / "robot.toml"
        path.write_text(text, encoding="utf-8")
        return load_robot(path)

    return read


def rows(load, **edits):
    with pytest.raises(ConfigError) as caught:
        load(**edits)
    return [f"{row.key}: {row.text}" for row in caught.value.problems]


def test_a_board_s_line_reaches_the_hardware_layer(load):
    robot = load()
    profiles = robot.profiles
    (spec,) = line_specs(robot, profiles)
    assert (spec.kind, spec.port, spec.cycle_hz) == ("mcu", "/dev/ttyUSB0", 100.0)
    assert spec.watchdog_s == 0.25
    assert engine_of(spec) == "rt"
    assert not robot.warnings


def test_a_board_s_line_runs_on_the_real_time_engine_alone(load):
    found = rows(load, engine=('kind = "mcu"', 'kind = "mcu"\nengine = "asyncio"'))
    (row,) = [row for row in found if row.startswith("line.")]
    assert 'kind "mcu" runs on "rt": remove "engine", or write "auto"' in row


def test_a_drive_of_another_protocol_is_refused(load):
    found = rows(load, drive=("mcu-velocity", "zlac8015d"))
    assert any("speaks modbus-rtu, its line mcu" in row for row in found)


def test_a_second_board_on_a_line_is_refused(load):
    found = rows(load, unit=("channel = 2", "unit = 2\nchannel = 1"))
    assert found == ['joint.right.unit: line "board" has one board: joint left is on unit 1']


def test_a_rate_that_the_wire_does_not_carry_is_an_error(load):
    (row,) = rows(load, rate=("cycle_hz = 100", "cycle_hz = 400"))
    assert row.startswith("line.board.cycle_hz: line board: 1 drive at 400 Hz need 189 %")
    assert "baudrate = 230400" in row
