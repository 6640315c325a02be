# SPDX-License-Identifier: Apache-2.0
"""The base from above, in a real browser."""

import contextlib
import math

import pytest
from tests.browser.dashboard import dashboard_of
from tests.sim.daemon_stage import ROOT, UNHURRIED, wait_until

from motord.client import Refused

DIRECTION = """([wheel, positions]) => import('/parts/base_view.js').then(view => view.directionOf(
    wheel, {joints: ['wheel', 'steering']},
    {joints: positions.map(position_rad => ({position_rad}))}))"""


def direction_rad(page, steered_by, *positions_rad):
    wheel = {"heading_rad": 0.25, "steered_by": steered_by}
    return page.evaluate(DIRECTION, [wheel, positions_rad])


def test_a_wheel_is_drawn_at_the_angle_of_its_steering_joint(page):
    assert direction_rad(page, None, 7.0, 0.5) == 0.25
    assert direction_rad(page, "steering", 7.0, 0.5) == 0.75
    assert math.isnan(direction_rad(page, "steering", 7.0, math.nan))
    assert math.isnan(direction_rad(page, "steering", 7.0))


COUNTED = """async () => {
    const { Link } = await import("/link.js");
    const clear = CanvasRenderingContext2D.prototype.clearRect;
    Object.assign(window, { pictures: 0, frames: 0 });
    CanvasRenderingContext2D.prototype.clearRect = function (...area) {
        window.pictures += 1;
        clear.apply(this, area);
    };
    new Link(location.origin, 20).on("frame", () => { window.frames += 1; });
}"""


def test_a_robot_is_redrawn_only_while_it_moves(robot, page):
    robot.ready()
    robot.wait_for_rest()
    page.wait_for_selector("canvas")
    page.evaluate(COUNTED)

    def pictures():
        """Return how many pictures are drawn while thirty states arrive."""
        was, frames = page.evaluate("[pictures, frames]")
        page.wait_for_function("frames => window.frames >= frames + 30", arg=frames)
        return page.evaluate("pictures") - was

    wait_until(lambda: pictures() == 0, "no state is drawn again")
    robot.set_off(page)
    assert pictures() > 0
    page.mouse.up()
    robot.wait_for_rest()
    wait_until(lambda: pictures() == 0, "no state is drawn again")
    drawn = page.evaluate("pictures")
    page.emulate_media(color_scheme="dark")
    page.wait_for_function("drawn => window.pictures > drawn", arg=drawn)


def test_a_robot_without_a_base_shows_the_angles_of_its_joints(browser, tmp_path):
    settings = (
        *UNHURRIED, "joint.pan.reply_timeout_s=0.2", "joint.tilt.reply_timeout_s=0.2",
        "joint.pan.tries=10", "joint.tilt.tries=10",
    )  # fmt: skip
    file = ROOT / "config/robots/pan-tilt.toml"
    with dashboard_of(browser, tmp_path, file, *settings) as robot, robot.page() as page:

        def shown_rad():
            with contextlib.suppress(Refused):
                state = robot.stage.state()
                if state == "fault":  # a busy machine causes faults
                    robot.stage.robot.reset()
                elif state == "idle":
                    robot.stage.robot.arm()
                robot.stage.robot.joints({"pan": 0.5, "tilt": -0.25}, lease_s=5.0)
            cells = page.locator("tbody td.position").all_inner_texts()
            return [float(text.split()[0]) for text in cells if text != "–"]

        wait_until(lambda: shown_rad() == pytest.approx([0.5, -0.25], abs=0.03), "the angles")
        dials = page.locator(".dial")
        assert dials.locator("figcaption b").all_inner_texts() == ["pan", "tilt"]
        turned = dials.first.locator(".needle").get_attribute("transform")
        assert float(turned.split("(")[1][:-1]) == pytest.approx(math.degrees(-0.5), abs=3.0)
        assert page.locator(".base-view").count() == 0
        page.evaluate("location.hash = 'drive'")
        page.wait_for_selector("main .card")
        assert page.locator(".base-view").count() == 0
