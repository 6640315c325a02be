# SPDX-License-Identifier: Apache-2.0
"""The lines of a robot file: kinds, engines, transceivers, and values for the hardware layer."""

from pathlib import Path

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from motord.config import ConfigError, load_robot
from motord.config.wiring import line_specs
from motord_hal.drives.profile import Gap
from motord_hal.fieldbus.ports import DirectionKind, DirectionSpec, Echo

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
DEMO = (ROBOTS / "demo.toml").read_text("utf-8")
SERVOS = (ROBOTS / "two-bus-servos.toml").read_text("utf-8")
SERIAL = 'kind = "modbus-rtu"\nport = "/dev/ttyUSB0"\nbaudrate = 115200\nengine = "auto"\n'
GPIO = 'direction = "gpio"\ndirection_gpio_chip = "pinctrl"\ndirection_gpio_line = "RS485_DE"\n'


@pytest.fixture
def load(tmp_path):
    def read(line=SERIAL, more="", loop="priority = 80", tail=""):
        assert SERIAL in DEMO
        text = DEMO.replace("priority = 80", loop, 1).replace(SERIAL, line + more, 1) + tail
        path = tmp_path / "robot.toml"
        path.write_text(text, encoding="utf-8")
        return load_robot(path)

    return read


def spec_of(robot):
    profiles = robot.profiles
    return line_specs(robot, profiles)[0]


def problems(load, **edits):
    with pytest.raises(ConfigError) as caught:
        load(**edits)
    return [f"{row.key}: {row.text}" for row in caught.value.problems]


def test_a_serial_line_without_settings_gets_careful_defaults(load):
    spec = spec_of(load())
    assert (spec.kind, spec.port, spec.engine) == ("modbus-rtu", "/dev/ttyUSB0", "auto")
    assert (spec.gap, spec.gap_s, spec.echo) == (None, None, Echo.AUTO)
    assert spec.direction == DirectionSpec()
    assert (spec.priority, spec.cpu) == (70, ())


def test_settings_of_a_serial_line_reach_the_hardware_layer(load):
    more = 'gap = "3.5char"\necho = "yes"\npriority = 60\ncpu = [2, 3]\n'
    delays = "direction_before_s = 1e-5\ndirection_after_s = 2e-5\ndirection_active_high = false\n"
    spec = spec_of(load(more=more + GPIO + delays))
    assert (spec.gap, spec.echo, spec.priority, spec.cpu) == (
        Gap.CHARACTERS,
        Echo.YES,
        60,
        (2, 3),
    )
    assert spec.direction == DirectionSpec(
        kind=DirectionKind.GPIO,
        active_high=False,
        before_s=1e-5,
        after_s=2e-5,
        gpio_chip="pinctrl",
        gpio_line="RS485_DE",
    )


@pytest.mark.parametrize("kind", ["modbus-tcp", "rtu-over-tcp"])
def test_a_gateway_is_a_host_and_a_port(load, kind):
    spec = spec_of(load(line=f'kind = "{kind}"\nhost = "gateway.local"\ntcp_port = 4001\n'))
    assert (spec.kind, spec.port) == (kind, "gateway.local:4001")


def test_the_line_stays_below_a_loop_of_low_priority(load):
    assert spec_of(load(loop="priority = 50")).priority == 49
    assert spec_of(load(loop="priority = 0")).priority == 0


def test_a_joint_can_have_a_rate_of_its_own(load):
    robot = load()
    assert all(joint.cycle_hz is None for joint in spec_of(robot).joints)
    left = robot.joint["left"].model_copy(update={"cycle_hz": 20.0})
    robot = robot.model_copy(update={"joint": {**robot.joint, "left": left}})
    assert [joint.cycle_hz for joint in spec_of(robot).joints] == [20.0, None]


TCP = 'kind = "modbus-tcp"\nhost = "10.0.0.7"\n'


@pytest.mark.parametrize(
    ("edits", "row"),
    [
        (
            {"line": TCP + 'engine = "rt"\n'},
            'line.rs485.engine: "rt" needs a serial port: kind "modbus-tcp" runs on "asyncio"',
        ),
        (
            {"more": 'gap = "spec"\ngap_s = 0.001\n'},
            "line.rs485.gap_s: the silence is given twice: by gap and by gap_s",
        ),
        (
            {"more": GPIO.replace('direction_gpio_chip = "pinctrl"\n', "")},
            'line.rs485.direction_gpio_chip: is missing: direction = "gpio" needs it',
        ),
        (
            {"more": 'direction_gpio_line = "17"\n'},
            'line.rs485.direction_gpio_line: is only for direction = "gpio"',
        ),
        (
            {"more": "direction_before_s = 1e-4\n"},
            'line.rs485.direction_before_s: is only for direction = "kernel" and "gpio"',
        ),
        (
            {"line": SERIAL.replace('"auto"', '"asyncio"'), "more": GPIO},
            (
                'line.rs485.direction: "gpio" needs engine "rt": the line is switched by its '
                "real-time thread"
            ),
        ),
        (
            {"more": "priority = 80\n"},
            "line.rs485.priority: 80 is not below the loop's (80)",
        ),
        (
            {"line": TCP + "tcp_port = 0\n"},
            "line.rs485.tcp_port: 0 is out of range (1 to 65535)",
        ),
        (
            {"line": TCP + "tcp_port = 502\necho = false\n"},
            (
                "line.rs485.echo: unknown key (known: baudrate, parity, stop_bits, engine, "
                "cycle_hz, host, tcp_port, kind)"
            ),
        ),
    ],
)
def test_an_invalid_line_is_refused(load, edits, row):
    assert problems(load, **edits) == [row]


def test_drives_are_on_a_line_of_their_protocol(load):
    line = SERIAL.replace("modbus-rtu", "ddsm").replace('"auto"', '"asyncio"')
    rows = problems(load, line=line)
    text = 'kind "ddsm" runs on "rt": remove "engine", or write "auto"'
    assert f"line.rs485.engine: {text}" in rows
    assert 'joint.left.drive: drive "zlac8015d" speaks modbus-rtu, its line ddsm' in rows


def test_an_input_may_take_datagrams(load):
    fast = load(tail='[input.fast]\nkind = "rt"\nudp_port = 9900\n').input["fast"]
    assert (fast.kind, fast.priority, fast.lease_s, fast.udp_port) == ("rt", 100, 0.3, 9900)
    (row,) = problems(load, tail='[input.fast]\nkind = "rt"\nudp_port = 80\n')
    assert row == "input.fast.udp_port: 80 is out of range (1024 to 65535)"


def test_a_line_gets_the_speed_below_which_a_wheel_rests(tmp_path):
    path = tmp_path / "robot.toml"
    text = DEMO.replace("[safety]", "[safety]\nrest_velocity_rad_s = 0.125", 1)
    path.write_text(text, encoding="utf-8")
    assert spec_of(load_robot(path)).rest_velocity_rad_s == 0.125


@pytest.fixture
def servos(tmp_path):
    def read(old, new):
        assert old in SERVOS
        path = tmp_path / "servos.toml"
        path.write_text(SERVOS.replace(old, new), encoding="utf-8")
        return load_robot(path)

    return read


@pytest.mark.parametrize("unit", [0, 248, 252])
def test_a_servo_may_have_any_unit_of_its_protocol(servos, unit):
    assert servos("unit = 9", f"unit = {unit}").joint["right"].unit == unit


def test_the_broadcast_unit_is_refused_for_a_servo(servos):
    with pytest.raises(ConfigError) as caught:
        servos("unit = 9", "unit = 254")
    (row,) = [str(row.text) for row in caught.value.problems if row.key == "joint.right.unit"]
    assert "254 is not an address of drive" in row
    assert "(0 to 252)" in row


def test_a_bus_takes_a_baud_rate_that_no_table_has(servos):
    assert spec_of(servos("baudrate = 1000000", "baudrate = 4500000")).baudrate == 4_500_000


def test_two_names_of_one_port_are_one_port(load, tmp_path):
    """Drives of different protocols on one wire would answer each other's frames."""
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyUSB0")
    line = SERIAL.replace("/dev/ttyUSB0", f"{tmp_path}/ttyUSB0")
    more = f"""[line.other]
kind = "ddsm"
port = "{tmp_path}/by-id"
[line.bus]
kind = "can"
interface = "slcan"
channel = "{tmp_path}/by-id"
"""
    found = problems(load, line=line, tail=more)
    assert 'line.other.port: line "rs485" has this port already' in found
    assert 'line.bus.channel: line "rs485" has this port already' in found


def test_an_adapter_is_one_port_by_its_serial_number_and_by_its_path(load, tmp_path, monkeypatch):
    (tmp_path / "ttyUSB0").touch()
    adapter = ListPortInfo(f"{tmp_path}/ttyUSB0")
    adapter.vid, adapter.pid, adapter.serial_number = 0x0403, 0x6001, "A1"
    monkeypatch.setattr(list_ports, "comports", lambda: [adapter])
    line = SERIAL.replace("/dev/ttyUSB0", f"{tmp_path}/ttyUSB0")
    other = '[line.other]\nkind = "ddsm"\nport = "usb:{}"\n'
    found = problems(load, line=line, tail=other.format("A1"))
    assert 'line.other.port: line "rs485" has this port already' in found
    assert load(line=line, tail=other.format("B2"))  # which is not plugged in


def test_a_roboclaw_has_one_of_its_eight_addresses(tmp_path):
    text = (ROBOTS / "roboclaw.toml").read_text("utf-8")
    path = tmp_path / "robot.toml"
    path.write_text(text.replace("unit = 128", "unit = 1"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"1 is not an address of drive .* \(128 to 135\)"):
        load_robot(path)
