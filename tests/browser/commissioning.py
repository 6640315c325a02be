# SPDX-License-Identifier: Apache-2.0
"""A simulated person who commissions a robot on its dashboard: reads the page, measures the
simulator's truth, and answers."""

import contextlib
import math
import re

from tests.sim.daemon_stage import wait_until

from motord.client import ClientError

ENDED = ".ended"
STOP_ABANDONED = "document.querySelector('.why') && document.querySelector('.halt')?.click()"
"""Script that presses Stop where a note shows that this page does not conduct the procedure."""
BUTTONS = ("Yes", "No", "Forward", "Backward", "No wheel turned", "Another wheel", "Normal")
RADIUS_M, TRACK_M = 0.0825, 0.45
TRUE_LEFT_M, TRUE_RIGHT_M, TRUE_TRACK_M = 1.03 * RADIUS_M, 1.02 * RADIUS_M, 0.96 * TRACK_M
TRUTH = (
    f"joint.left.wheel_radius_m={TRUE_LEFT_M}", f"joint.right.wheel_radius_m={TRUE_RIGHT_M}",
    f"base.track_m={TRUE_TRACK_M}",
)  # fmt: skip


def truth(*settings):
    return [part for setting in settings for part in ("--set", setting)]


def open_page(page, title):
    """Open the form of the procedure with this title."""
    page.evaluate("location.hash = 'commission'")
    form = page.get_by_role("button", name=title, exact=True)
    another = page.get_by_role("button", name="Another procedure", exact=True)

    def listed():
        """Close what is shown of the last procedure; return whether this one is listed. On a busy
        machine the last one may end only now, or still have an open question."""
        page.evaluate(STOP_ABANDONED)
        if another.count():
            another.click()
        return form.count()

    wait_until(listed, f"{title} is listed")
    form.click()


def fill(page, **values):
    """Fill in fields by their labels (with _ for a space)."""
    for label, value in values.items():
        page.get_by_label(label.replace("_", " ")).fill(str(value))


def begin(page):
    page.get_by_role("button", name="Begin", exact=True).click()


def answers(page, replies):
    """Answer each question until the end; return the text of the end. `replies`: pattern of a
    question → a button's name, a number, or a function that returns one of these."""
    while True:
        wait_until(
            lambda: page.locator(ENDED).count() or asked_text(page), "a question, or the end"
        )
        if page.locator(ENDED).count():
            return page.locator(f"{ENDED} .asks").inner_text()
        if question := asked_text(page):  # empty: the question was closed meanwhile
            known = [one for pattern, one in replies.items() if re.search(pattern, question)]
            assert known, question
            give(page, known[0]() if callable(known[0]) else known[0])


def asked_text(page):
    """Return the text of the open question; empty without one."""
    return page.evaluate("document.querySelector('.question.open .asks')?.innerText ?? ''")


def give(page, reply):
    if reply in BUTTONS:
        page.locator(".question").get_by_role("button", name=reply, exact=True).click()
        return
    page.locator(".question input").fill(str(reply))
    page.locator(".question").get_by_role("button", name="Answer", exact=True).click()


def rests_disarmed(stage):
    def safe():
        with contextlib.suppress(ClientError):
            return stage.sim.truth().at_rest and stage.state() == "idle"
        return False

    wait_until(safe, "at rest and disarmed")


def rests_without_power(stage):
    rests_disarmed(stage)

    def off():
        return not any(joint.enabled for joint in stage.sim.truth().joints.values())

    wait_until(off, "without power")


class Floor:
    """Measures the simulated robot like a person with a tape and marks on the floor."""

    def __init__(self, robot):
        self._sim = robot.stage.sim

    def back_on_mark(self):
        self._sim.reset_truth()
        return "Yes"

    def replies(self):
        return {
            "stand on its mark|room all around": self.back_on_mark,
            "in front of the mark": lambda: f"{self._sim.truth().x_m:.3f}",
            "to the left of the line": lambda: f"{self._sim.truth().y_m:.3f}",
            "By how many degrees": lambda: self.degrees(),
            "Write .*cart.toml": "Yes",
        }

    def degrees(self):
        return f"{round(2 * math.degrees(self._sim.truth().heading_rad)) / 2:g}"
