# SPDX-License-Identifier: Apache-2.0
"""Limits on pages: which one is in force, and what a page may set without asking."""

import pytest
from tests.sim.daemon_stage import wait_until

LINEAR = "limits.linear_m_s"
pytestmark = pytest.mark.usefixtures("idle")


@pytest.fixture
def listed(robot):
    """The limit as the daemon describes it, with the robot file's value in force."""
    client = robot.stage.robot

    def restore():
        client.params_set(**{LINEAR: client.params_list()[LINEAR]["from_file"]})

    restore()
    yield client.params_list()[LINEAR]
    restore()


def in_force(robot):
    return robot.stage.robot.params_get(LINEAR)[LINEAR]


def entry(page):
    return page.get_by_label("linear_m_s, m/s", exact=True)


def button(page, name):
    return page.get_by_role("button", name=name, exact=True)


def apply(page, value):
    entry(page).fill(f"{value:g}")
    entry(page).press("Tab")
    button(page, "Apply").click()


@pytest.fixture
def parameters(robot, listed):
    with robot.page(at="parameters") as page:
        entry(page).wait_for()
        yield page


def test_a_limit_above_the_robot_file_is_set_only_when_it_is_confirmed(robot, listed, parameters):
    asks = parameters.get_by_role("alertdialog")
    value = round((listed["from_file"] + listed["maximum"]) / 2, 3)
    assert listed["from_file"] < value < listed["maximum"]
    apply(parameters, value)
    asks.wait_for()
    assert f"above the robot file's {listed['from_file']:g} m/s" in asks.inner_text()
    assert in_force(robot) == listed["from_file"]
    button(parameters, "Cancel").click()
    asks.wait_for(state="detached")
    assert in_force(robot) == listed["from_file"]
    button(parameters, "Apply").click()
    button(parameters, "Set it all the same").click()
    wait_until(lambda: in_force(robot) == value, "the limit is in force")


def test_what_is_asked_about_is_what_is_shown(robot, listed, parameters):
    apply(parameters, listed["maximum"])
    asks = parameters.get_by_role("alertdialog")
    asks.wait_for()
    entry(parameters).fill(f"{listed['from_file'] / 2:g}")
    asks.wait_for(state="detached")
    assert in_force(robot) == listed["from_file"]


def test_a_speed_that_the_wheels_cannot_do_is_refused_without_a_question(robot, listed, parameters):
    apply(parameters, 20.0)
    problem = parameters.locator(".problem", has_text="out of range")
    problem.wait_for()
    assert parameters.get_by_role("alertdialog").count() == 0
    assert in_force(robot) == listed["from_file"]
    assert f"at most {listed['maximum']} m/s" in parameters.locator("main").inner_text()


def test_the_end_of_a_slider_is_the_value_of_the_robot_file(robot, listed, parameters):
    robot.stage.robot.params_set(**{LINEAR: listed["from_file"] / 4})
    wait_until(lambda: float(entry(parameters).input_value()) < listed["from_file"], "it is shown")
    slider = parameters.locator(f"[id='{LINEAR}']")
    box = slider.bounding_box()
    slider.click(position={"x": box["width"] - 2, "y": box["height"] / 2})
    assert float(entry(parameters).input_value()) == pytest.approx(listed["from_file"], rel=0.01)
    button(parameters, "Apply").click()
    wait_until(lambda: in_force(robot) > listed["from_file"] / 2, "the limit is in force")
    assert in_force(robot) <= listed["from_file"]


def test_all_pages_and_the_pad_show_the_limit_in_force(robot, listed, parameters):
    with robot.page(at="parameters") as other, robot.page(at="drive") as driver:
        scale = driver.locator(".slider output")
        wait_until(lambda: "%: 0.40 m/s" in scale.inner_text(), "the scale of the pad")
        entry(other).wait_for()
        robot.stage.robot.params_set(**{LINEAR: 0.5})  # as a program does
        for page in (parameters, other):
            wait_until(lambda page=page: entry(page).input_value() == "0.5", "the limit in force")
        wait_until(lambda: "%: 0.20 m/s" in scale.inner_text(), "the scale of the pad")
        apply(other, 0.25)
        wait_until(lambda: entry(parameters).input_value() == "0.25", "what the other page set")
        wait_until(lambda: "%: 0.10 m/s" in scale.inner_text(), "the scale of the pad")
