# SPDX-License-Identifier: Apache-2.0
"""`motord init` at a real terminal, with simulated drives on the port."""

import re

import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROBOT, armed
from tests.sim.person_stage import at_terminal, robot_of
from tests.walk import ANSWERS

from motord.config import load_robot
from motord.tools.simulator import start_simulator

REST = (
    "--base", "differential", "--linear-m-s", "0.5", "--angular-rad-s", "1", "--gear-ratio", "1",
)  # fmt: skip


@pytest.fixture(scope="module")
def port(tmp_path_factory):
    folder = tmp_path_factory.mktemp("init")
    with start_simulator(ROBOT, link_dir=folder, timeout_s=DEADLINE_S):
        yield folder / "rs485"


def test_the_drive_is_found_and_the_file_is_written(port, tmp_path):
    file = tmp_path / "cart.toml"
    with at_terminal("init", file, "--at", port, *REST) as screen:
        screen.wait(r"unit 1 at 115200 none: zlac8015d")
        screen.answer(r"Which drive profile\? \[zlac8015d\] ", "")
        screen.answer(r"robot's name\? \[cart\] ", "")
        screen.answer("Radius of a loaded wheel", "0.85")
        screen.answer(r"a wheel of 1.7 m across\?", "n")
        screen.answer("Radius of a loaded wheel", "0.0825")
        screen.answer("Distance from the middle", "0.45")
        screen.answer("Unit and channel of the left wheel", "")
        screen.answer("Unit and channel of the right wheel", "")
        screen.wait("Next: motord run")
        assert screen.end() == 0
    robot = load_robot(file)
    assert (robot.line["main"].port, robot.line["main"].baudrate) == (str(port), 115200)
    assert robot.joint["left"].drive == "zlac8015d"
    assert not robot.publish


def test_the_recorded_walk_answers_each_question(port, tmp_path):
    with at_terminal("init", tmp_path / "cart.toml", "--at", port) as screen:
        assert screen.answers(ANSWERS) == 0
    assert load_robot(tmp_path / "cart.toml").base.kind == "differential"


def test_drives_on_a_can_bus_are_found_and_a_mecanum_base_is_written(tmp_path):
    four = tmp_path / "four.toml"
    text = (ROBOT.parent / "mecanum4.toml").read_text(encoding="utf-8")
    begin, end = text.index("[line."), text.index("[joint.")
    line = f'[line.bus]\nkind = "can"\ninterface = "unix"\nchannel = "{tmp_path}/bus"\n\n'
    text = text[:begin] + line + text[end:]
    for number, name in enumerate(("front_left", "front_right", "rear_left", "rear_right"), 11):
        place = name.replace("_", "-")
        text = re.sub(
            rf'(\[joint.{name}\]\n)line = .*\n.*\n.*\n.*\nplace = "{place}"',
            rf'\1line = "bus"\ndrive = "odrive-0.6"\nunit = {number}\nplace = "{place}"', text,
        )  # fmt: skip
    four.write_text(text, encoding="utf-8")
    file = tmp_path / "cart.toml"
    with (
        start_simulator(four, link_dir=tmp_path / "ports", timeout_s=DEADLINE_S),
        at_terminal("init", file, "--at", f"unix:{tmp_path}/bus", "--name", "cart") as screen,
    ):
        screen.wait(r"node 11: ODrive, firmware 0.6.*: odrive-0.6")
        screen.answer(r"Which drive profile\? \[odrive-0.6\] ", "")
        screen.answer(r"Which base\?", "mecanum")
        screen.answer("Radius of a loaded wheel", "0.08")
        screen.answer("Distance from the middle of a left", "0.4")
        screen.answer("front axle to the rear one", "0.35")
        screen.answer(r"Top speed\?", "0.5")
        screen.answer(r"Top speed sideways\?", "0.3")
        screen.answer("Fastest turn", "1")
        screen.answer("Motor turns for a wheel turn", "1")
        screen.answer(r"front left wheel.*\[11.1\] ", "")
        screen.answer(r"front right wheel.*\[12.1\] ", "")
        screen.answer(r"rear left wheel.*\[13.1\] ", "14")
        screen.answer(r"rear right wheel.*\[14.1\] ", "13")
        screen.wait("Next: motord run")
        assert screen.end() == 0
    robot = load_robot(file)
    assert robot.base.kind == "mecanum"
    assert robot.line["main"].address == f"unix:{tmp_path}/bus"
    assert [joint.unit for joint in robot.joint.values()] == [11, 12, 14, 13]


def test_a_simulated_can_robot_runs_on_the_bus_that_its_file_names(tmp_path):
    file = tmp_path / "cart.toml"
    words = ("--at", "simulated", "--drive", "odrive-0.6", "--name", "cart", "--left", "1",
             "--right", "2", "--wheel-radius-m", "0.08", "--track-m", "0.4", *REST)  # fmt: skip
    with at_terminal("init", file, *words) as screen:
        screen.wait(r"motord simulate \S+ --link-dir (\S+)")
        assert screen.end() == 0
    address = load_robot(file).line["main"].address
    with (
        start_simulator(file, link_dir=file.with_suffix(".ports"), timeout_s=DEADLINE_S),
        at_terminal("scan", address) as screen,
    ):
        screen.wait("node 1: ODrive")
        screen.wait("node 2: ODrive")
        assert screen.end() == 0


def test_a_roboclaw_is_found(tmp_path):
    claw = ROBOT.parent / "roboclaw.toml"
    with start_simulator(claw, link_dir=tmp_path, timeout_s=DEADLINE_S) as simulator:
        (port,) = simulator.ports.values()
        with at_terminal("scan", port, "--baudrate", "115200", "--parity", "none") as screen:
            screen.wait("unit 128 at 115200 baud.*RoboClaw")
            screen.wait("roboclaw: 1 of 1")
            assert screen.end() == 0


def test_a_wrong_profile_is_noticed(port, tmp_path):
    file = tmp_path / "cart.toml"
    with at_terminal("init", file, "--at", port, *REST) as screen:
        screen.answer(r"Which drive profile\? \[zlac8015d\] ", "bld-305s")
        screen.answer(r"unit 1 answers as zlac8015d.* does, not as bld-305s.*\[y/n\] ", "n")
        assert screen.end() == 1
    assert not file.exists()


def test_a_swerve_base_on_simulated_servos_is_configured_and_arms(tmp_path):
    file = tmp_path / "cart.toml"
    words = ("init", file, "--at", "simulated", "--drive", "sts3215", "--name", "cart")
    with at_terminal(*words) as screen:
        screen.answer(r"Which base\?", "swerve")
        screen.answer("Radius of a loaded wheel", "0.05")
        screen.answer("Distance from the middle of a left", "0.3")
        screen.answer("front axle to the rear one", "0.3")
        screen.answer(r"Top speed\?", "0.2")
        screen.answer(r"Top speed sideways\?", "0.2")
        screen.answer("Fastest turn", "0.8")
        screen.answer("Motor turns for a wheel turn", "1")
        screen.answer(r"Which one\? \[sts3215-position\] ", "")
        screen.answer("How many modules", "3")
        screen.answer("How far does a wheel steer", "1")
        screen.answer("57 degrees to each side", "n")
        screen.answer("How far does a wheel steer", "1.6")
        screen.answer("How fast does it steer", "4")
        screen.answer("about the vertical", "1")
        for unit in range(1, 7):
            screen.answer(rf"\[{unit}\.1\] ", "")
        screen.wait("Next: motord run .*calibrate straight")
        assert screen.end() == 0
    with robot_of(tmp_path, file) as stage, armed(stage):
        assert stage.robot.status()["armed"]
