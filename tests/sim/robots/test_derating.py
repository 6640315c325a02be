# SPDX-License-Identifier: Apache-2.0
"""A warm drive slows the base down along the same curve, and `status` names the reason, the joint
and how long it has lasted."""

import pytest
from tests.sim.daemon_stage import wait_until
from tests.sim.person_stage import at_terminal, copied, robot_of

RANGE = "\n[joint.left.derating]\ntemperature_from_c = 15\ntemperature_to_c = 35\n"
"""Range in which the simulated windings, at first at 25 °C, leave half of the limit."""


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    folder = tmp_path_factory.mktemp("derating")
    file = copied(folder)
    file.write_text(file.read_text(encoding="utf-8") + RANGE, encoding="utf-8")
    with robot_of(folder, file) as stage:
        yield stage


def commanded(stage, linear_m_s, angular_rad_s):
    stage.robot.drive(linear_m_s, angular_rad_s)
    return stage.robot.status()


def test_the_base_is_slower_along_the_same_curve_and_status_names_the_reason(stage):
    limits = stage.robot.params_get("limits.linear_m_s")
    most_m_s = limits["limits.linear_m_s"]
    stage.robot.arm()

    def derated():
        status = commanded(stage, most_m_s, 0.4 * most_m_s)
        command, found = status.command, status.limited.get("derated")
        return (
            found is not None
            and abs(command.setpoint_linear_m_s - found.factor * most_m_s) < 1e-3
            and status
        )

    found = wait_until(derated, "at the derated speed")
    assert found.limited["derated"].joint == "left"
    assert found.limited["derated"].by == "temperature"
    assert 0.4 < found.limited["derated"].factor < 0.55
    assert found.limited["derated"].for_s > 0.0
    ratio = found.command.setpoint_angular_rad_s / found.command.setpoint_linear_m_s
    assert ratio == pytest.approx(0.4, rel=1e-3)
    commanded(stage, most_m_s, 0.0)
    with at_terminal("status", "--socket", stage.socket) as screen:
        assert screen.end() == 0
    assert "derated to " in screen.text
    assert " % by temperature of left for " in screen.text
    stage.robot.drive(0.0, 0.0)
    wait_until(lambda: stage.sim.truth().at_rest, "at rest")
    stage.robot.disarm()
