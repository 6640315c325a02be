# SPDX-License-Identifier: Apache-2.0
"""`motord init` at a real terminal, with simulated drives on the port."""

import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROBOT
from tests.sim.person_stage import at_terminal

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


def test_a_wrong_profile_is_noticed(port, tmp_path):
    file = tmp_path / "cart.toml"
    with at_terminal("init", file, "--at", port, *REST) as screen:
        screen.answer(r"Which drive profile\? \[zlac8015d\] ", "bld-305s")
        screen.answer(r"unit 1 answers as zlac8015d.* does, not as bld-305s.*\[y/n\] ", "n")
        assert screen.end() == 1
    assert not file.exists()
