# SPDX-License-Identifier: Apache-2.0
"""While no state comes, a page shows nothing as known, and its emergency stop stays usable."""

import contextlib
import os
import signal

import pytest
from tests.browser.dashboard import held, state_of
from tests.sim.daemon_stage import wait_until

pytestmark = pytest.mark.usefixtures("idle")
SHOWN = """() => ({
    state: document.querySelector('header .chip[data-state]').dataset.state,
    word: document.querySelector('.state-word').innerText,
    next: document.querySelector('.next').innerText,
    live: document.querySelectorAll('.state .actions button:enabled').length,
    estop: document.querySelector('.estop-place .estop').disabled,
    unsure: document.querySelector('.estop-place .estop').innerText,
    facts: document.querySelector('.facts').innerText,
    rows: [...document.querySelectorAll('.rows dd')].map((one) => one.innerText),
    banner: document.querySelector('.banner')?.innerText ?? '',
    title: document.title,
})"""
"""Script that returns what a page shows at one moment."""


@contextlib.contextmanager
def bus_stands_still(robot):
    """Stop motord-bus; the daemon ends it and starts another one."""
    before = robot.stage.robot.status()["bus"]["pid"]
    os.kill(before, signal.SIGSTOP)
    yield
    wait_until(
        lambda: robot.stage.robot.status()["bus"]["pid"] not in (None, before), "another motord-bus"
    )


@contextlib.contextmanager
def daemon_stands_still(robot):
    daemon = robot.stage.daemon.pid
    os.kill(daemon, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(daemon, signal.SIGCONT)


@contextlib.contextmanager
def daemon_is_killed(robot):
    os.kill(robot.stage.daemon.pid, signal.SIGKILL)
    robot.stage.daemon.wait()
    yield
    robot.restart()


SILENCES = (bus_stands_still, daemon_stands_still, daemon_is_killed)


@pytest.mark.parametrize("silence", SILENCES, ids=lambda one: one.__name__)
@pytest.mark.parametrize("tab", ["overview", "drive"])
def test_while_no_state_comes_nothing_is_shown_as_known(robot, page, silence, tab):
    robot.set_off(page)
    page.mouse.up()
    page.evaluate(f"location.hash = '{tab}'")
    page.wait_for_selector(f".grid.{tab}")
    with silence(robot):
        wait_until(lambda: state_of(page) == "unknown", "the page shows that it does not know")
        shown = page.evaluate(SHOWN)
    assert shown["state"] == "unknown"
    assert shown["word"] == "Unknown"
    assert "may be moving" in shown["next"]
    assert shown["live"] == 0
    assert not shown["estop"]
    assert "may not arrive" in shown["unsure"]
    assert "may not arrive" in shown["banner"]
    assert shown["title"].startswith("Unknown")
    assert shown["facts"].count("not known") == 2
    assert not any(character.isdigit() for row in shown["rows"][1:3] for character in row)
    wait_until(lambda: state_of(page) != "unknown", "the page shows the state again")
    wait_until(lambda: "may not arrive" not in page.evaluate(SHOWN)["unsure"], "no more doubt")


def test_an_emergency_stop_in_the_silence_shows_it_and_arrives_later(robot, page):
    robot.set_off(page)
    with daemon_stands_still(robot):
        wait_until(lambda: state_of(page) == "unknown", "the page shows that it does not know")
        assert not held(page)
        page.keyboard.press("Space")  # the mouse holds the pad
        problem = page.locator(".estop-place .problem")
        problem.get_by_text("may not have arrived").wait_for()
    page.mouse.up()
    robot.stage.wait_for("estop")
    wait_until(lambda: problem.inner_text() == "", "it is confirmed")
    wait_until(lambda: state_of(page) == "estop", "the page shows it")
