# SPDX-License-Identifier: Apache-2.0
"""`motord stop-all` after a daemon was killed at full speed: simulated drives, real signals.

The drives' own watchdogs are so long that only the sent requests can stop the wheels.
"""

import json
import signal
import stat
import struct
import subprocess
import sys

import can
import pytest
import scservo_sdk
from pymodbus.client import ModbusTcpClient
from tests.relay import Relay
from tests.sim.daemon_stage import (
    DEADLINE_S,
    ROBOT,
    ROOT,
    SURE,
    becomes_idle,
    rests,
    running,
    set_off,
    wait_until,
)

from motord.tools.simulator import start_simulator
from motord_hal.can.unix_client import UnixClient

LONG = "safety.drive_watchdog_s=10"
SPEED_M_S = 0.5
ODRIVE_SETS_OFF = {
    0x0B: struct.pack("<II", 2, 1),
    0x07: struct.pack("<I", 8),
    0x0D: struct.pack("<ff", 1.0, 0.0),
}
"""Frames of CAN Simple for velocity control, closed loop and a turn a second."""

TWO_CHIPS = """
[robot]
name = "two-chips"

[base]
kind = "differential"
track_m = 0.3
wheel_radius_m = 0.05

[limits]
linear_m_s = 0.5
linear_m_s2 = 0.5
linear_deceleration_m_s2 = 1.0
angular_rad_s = 1.5
angular_rad_s2 = 3.0

[line.first]
kind = "pwm"
pwm_chip = "{folder}/broken"

[line.second]
kind = "pwm"
pwm_chip = "{folder}/left_running"

[joint.left]
line = "first"
drive = "drv8871"
unit = 1
side = "left"
full_duty_rad_s = 18.0
pins = {{ in1 = "pwm0", in2 = "pwm1" }}

[joint.right]
line = "second"
drive = "drv8871"
unit = 1
side = "right"
full_duty_rad_s = 18.0
pins = {{ in1 = "pwm0", in2 = "pwm1" }}

[publish.console]
kind = "stdout"
rate_hz = 1
"""


def stop_all(*settings, robot=ROBOT):
    """Run `motord stop-all`; return its exit status and its report of the lines."""
    command = [sys.executable, "-m", "motord", "stop-all", str(robot), "--json"]
    command += [part for setting in settings for part in ("--set", setting)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, cwd=ROOT)
    assert done.stdout, done.stderr
    return done.returncode, json.loads(done.stdout)["lines"]


def full_speed(stage):
    stage.wait_for("idle")
    set_off(stage, SPEED_M_S)


@pytest.fixture
def stage(tmp_path):
    with running(tmp_path, LONG) as stage:
        stage.port = f"line.rs485.port={json.dumps(str(tmp_path / 'rs485'))}"
        yield stage


def test_drives_of_a_killed_daemon_stop_and_lose_their_power(stage):
    full_speed(stage)
    stage.end(signal.SIGKILL)
    assert not stage.sim.truth().at_rest
    status, lines = stop_all(stage.port)
    assert (status, lines[0]["problems"], lines[0]["rest_unknown"]) == (0, [], [])
    truth = stage.sim.truth()
    assert not any(joint.enabled for joint in truth.joints.values())
    assert truth.at_rest, "it was seen at rest"


@pytest.mark.parametrize("edited", ["[robot", "", None], ids=["half saved", "empty", "removed"])
def test_stop_all_switches_off_the_running_drives_after_any_edit_of_the_robot_file(
    where_it_looks, own_file, edited
):
    with running(where_it_looks, LONG, robot=own_file) as stage:
        full_speed(stage)
        if edited is None:
            own_file.unlink()
        else:
            own_file.write_text(edited, encoding="utf-8")
        stage.end(signal.SIGKILL)
        status, lines = stop_all(robot=own_file)
        assert (status, lines[0]["problems"]) == (0, [])
        assert not any(joint.enabled for joint in stage.sim.truth().joints.values())
    assert not list(where_it_looks.glob("*.running")), "no robot is left to be stopped"


def test_a_daemon_that_ended_at_rest_leaves_no_robot_file_behind(where_it_looks, own_file):
    with running(where_it_looks, robot=own_file) as stage:
        stage.wait_for("idle")
        (kept,) = where_it_looks.glob("*.running")
        assert stat.S_IMODE(kept.stat().st_mode) == 0o600
        stage.end(signal.SIGTERM)
        assert not kept.exists()


def test_wheels_are_braked_before_the_power_goes(stage):
    full_speed(stage)
    stage.end(signal.SIGKILL)
    stop_all(stage.port)
    # without power a simulated wheel coasts for seconds
    assert all(abs(joint.velocity_rad_s) < 0.5 for joint in stage.sim.truth().joints.values())


def test_a_port_that_a_daemon_holds_is_left_alone(stage):
    full_speed(stage)
    status, lines = stop_all(stage.port)
    assert status == 3
    assert "another program has it open" in lines[0]["problems"][0]
    assert stage.robot.status()["lines"]["rs485"]["state"] == "ready"


def test_a_silent_drive_is_named_and_takes_a_bounded_time(stage):
    full_speed(stage)
    stage.end(signal.SIGKILL)
    stage.sim.inject("silence:from_s=0,for_s=60")
    status, lines = stop_all(stage.port)
    assert status == 3
    assert "left, right" in lines[0]["problems"][0]


def test_a_drive_with_lost_replies_is_still_stopped(stage):
    full_speed(stage)
    stage.end(signal.SIGKILL)
    stage.sim.inject("drop")
    status, _ = stop_all(stage.port)
    assert status == 3
    assert not any(joint.enabled for joint in stage.sim.truth().joints.values())
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")


def test_a_missing_adapter_is_reported(tmp_path):
    status, lines = stop_all(f'line.rs485.port="{tmp_path}/nothing"')
    assert status == 3
    assert "there is no such port" in lines[0]["problems"][0]


def test_can_drives_on_a_bus_that_is_a_socket_stop_too(tmp_path):
    robot = ROOT / "config/robots/odrive-two.toml"
    path = str(tmp_path / "can0")
    with start_simulator(
        robot, options=("--can", f"unix:{path}"), timeout_s=DEADLINE_S
    ) as simulator:
        with UnixClient(path) as bus:
            for node in (1, 2):
                for command, data in ODRIVE_SETS_OFF.items():
                    identifier = node << 5 | command
                    bus.send(
                        can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
                    )
            wait_until(lambda: not simulator.control.truth().at_rest, "a wheel turns")
        bus_settings = ('line.can0.interface="unix"', f"line.can0.channel={json.dumps(path)}")
        status, lines = stop_all(*bus_settings, robot=robot)
        assert (status, lines[0]["problems"]) == (0, [])
        truth = simulator.control.truth()
        assert not any(joint.enabled for joint in truth.joints.values())
        assert all(abs(joint.velocity_rad_s) < 0.5 for joint in truth.joints.values())
    status, lines = stop_all(*bus_settings, robot=robot)
    assert status == 3
    assert f"unix:{path}" in lines[0]["problems"][0]


def test_an_unexpected_error_on_one_line_does_not_spare_the_others(tmp_path):
    """The first chip's files are invalid; the second chip's bridge is left running."""
    for name, period in (("broken", "no number"), ("left_running", "50000")):
        for number in range(2):
            channel = tmp_path / name / f"pwm{number}"
            channel.mkdir(parents=True)
            for file, value in (("duty_cycle", "30000"), ("enable", "1"), ("period", period)):
                (channel / file).write_text(value)
            (channel / "polarity").write_text("normal")
    robot = tmp_path / "robot.toml"
    robot.write_text(TWO_CHIPS.format(folder=tmp_path), encoding="utf-8")
    status, (first, second) = stop_all(robot=robot)
    assert status == 3
    assert first["joints"] == ["left"]
    assert "ValueError" in first["problems"][0]
    assert (second["line"], second["joints"], second["problems"]) == ("second", ["right"], [])
    assert (second["rest_unknown"], second["rest_unmeasured"]) == ([], ["right"])
    running = tmp_path / "left_running"
    assert [int((running / f"pwm{n}/duty_cycle").read_text()[0]) for n in range(2)] == [0, 0]
    assert [int((running / f"pwm{n}/enable").read_text()) for n in range(2)] == [0, 0]


def test_a_streaming_board_gets_zero_and_stop(tmp_path):
    robot = ROOT / "config/robots/esp32.toml"
    with start_simulator(robot, link_dir=tmp_path, timeout_s=DEADLINE_S) as simulator:
        port = json.dumps(simulator.ports["board"])
        status, lines = stop_all(f"line.board.port={port}", robot=robot)
        assert (status, lines[0]["problems"]) == (0, [])
        truth = simulator.control.truth()
        assert truth.at_rest
        assert not any(joint.enabled for joint in truth.joints.values())
    status, lines = stop_all(f"line.board.port={port}", robot=robot)
    assert status == 3
    assert "cannot be opened" in lines[0]["problems"][0]


SERVO_TORQUE, SERVO_MODE, SERVO_GOAL, VELOCITY_MODE = 40, 33, 46, 1


def test_bus_servos_left_turning_stop_and_lose_their_torque(tmp_path):
    """The maker's SDK starts the servos. They have no watchdog: only stop-all can stop them."""
    robot = ROOT / "config/robots/two-bus-servos.toml"
    with start_simulator(robot, link_dir=tmp_path) as simulator:
        path = str(tmp_path / "servos")
        port = scservo_sdk.PortHandler(path)
        assert port.setBaudRate(1_000_000)
        servo = scservo_sdk.sms_sts(port)

        def joints():
            return simulator.control.truth().joints.values()

        def set_off():
            for unit in (7, 9):
                servo.write1ByteTxRx(unit, SERVO_TORQUE, 0)
                servo.write1ByteTxRx(unit, SERVO_MODE, VELOCITY_MODE)
                servo.write1ByteTxRx(unit, SERVO_TORQUE, 1)
                servo.write2ByteTxRx(unit, SERVO_GOAL, 1000)
            return all(abs(joint.velocity_rad_s) > 0.5 for joint in joints())

        wait_until(set_off, "they turn")
        port.closePort()
        status, lines = stop_all(f"line.servos.port={json.dumps(path)}", robot=robot)
        assert (status, lines[0]["problems"]) == (0, [])
        assert not any(joint.enabled for joint in joints())
        wait_until(lambda: simulator.control.truth().at_rest, "the wheels rest")


@pytest.fixture
def behind_a_gateway(tmp_path):
    """The file of the demonstration's robot with its drives behind a gateway, and that gateway: a
    relay to the simulated one."""
    robot = tmp_path / "gateway.toml"
    text = ROBOT.read_text(encoding="utf-8").replace('kind = "modbus-rtu"', 'kind = "modbus-tcp"')
    robot.write_text(text.replace('port = "/dev/ttyUSB0"\nbaudrate = 115200\n', ""), "utf-8")
    anywhere = ("line.rs485.host=127.0.0.1", "line.rs485.tcp_port=1")
    with (
        start_simulator(
            robot,
            options=("--tcp", "0", *(part for one in anywhere for part in ("--set", one))),
            timeout_s=DEADLINE_S,
        ) as simulator,
        Relay("tcp", tmp_path / "gateway", simulator.ports["rs485"]) as gateway,
    ):
        yield robot, simulator, gateway


def places(gateway):
    host, _, port = gateway.front.rpartition(":")
    return f"line.rs485.host={host}", f"line.rs485.tcp_port={port}"


def leave_running(simulator):
    """Start a wheel, as a daemon that was killed leaves it."""
    port = int(simulator.ports["rs485"].rpartition(":")[2])
    with ModbusTcpClient("127.0.0.1", port=port) as master:
        for address, value in ((0x2000, 10000), (0x200D, 3), (0x200E, 8), (0x2088, 60)):
            master.write_registers(address, [value], device_id=1)
    wait_until(lambda: not simulator.control.truth().at_rest, "a wheel turns")


@pytest.mark.parametrize("resets", [0, 1, 5])
def test_drives_behind_a_gateway_that_resets_its_first_connections_stop_too(
    behind_a_gateway, resets
):
    robot, simulator, gateway = behind_a_gateway
    leave_running(simulator)
    gateway.reset_at_accept(resets)
    status, lines = stop_all(*places(gateway), robot=robot)
    assert (status, lines[0]["problems"]) == (0, [])
    assert gateway.resets == resets
    truth = simulator.control.truth()
    assert not any(joint.enabled for joint in truth.joints.values())
    assert all(abs(joint.velocity_rad_s) < 0.5 for joint in truth.joints.values())


def test_a_gateway_that_resets_every_connection_is_tried_until_time_is_up(behind_a_gateway):
    robot, _, gateway = behind_a_gateway
    gateway.reset_at_accept(10_000)
    status, lines = stop_all(*places(gateway), robot=robot)
    assert status == 3
    assert "lost" in lines[0]["problems"][0] or "at once" in lines[0]["problems"][0]
    assert gateway.resets > 5


def test_a_gateway_that_resets_every_connection_does_not_end_the_daemon(behind_a_gateway, tmp_path):
    robot, simulator, gateway = behind_a_gateway
    ports = places(gateway)
    with running(tmp_path, *SURE, robot=robot, simulated=False, ports=ports) as stage:
        stage.sim = simulator.control
        stage.wait_for("idle")
        set_off(stage, SPEED_M_S)
        gateway.reset_at_accept(6)
        gateway.reset()
        wait_until(lambda: gateway.resets > 2, "it resets connections")
        rests(stage)
        wait_until(lambda: gateway.resets > 6, "it stops that")
        becomes_idle(stage)
        assert stage.end() == 0
        assert "a bug of motord" not in stage.logged()
