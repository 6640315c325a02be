# SPDX-License-Identifier: Apache-2.0
"""Fixtures: a robot with a dashboard, and a headless Chromium. Without one a test is skipped."""

import shutil

import pytest
from tests.browser.dashboard import (
    CHEAP_ARGUMENTS,
    CHROMIUM_ARGUMENTS,
    dashboard_of,
    installed_chromium,
)
from tests.peers.light import LOOP
from tests.sim.daemon_stage import ROBOT, SLOW


@pytest.fixture(scope="session")
def chromium():
    found = installed_chromium()
    if found is None:
        pytest.skip("no Chromium here: apt install chromium-headless-shell")
    return found


@pytest.fixture(scope="module")
def browser(chromium):
    api = pytest.importorskip("playwright.sync_api", reason="no Playwright for this machine")
    with api.sync_playwright() as playwright:
        found = playwright.chromium.launch(
            executable_path=chromium, headless=True, args=[*CHROMIUM_ARGUMENTS, *CHEAP_ARGUMENTS]
        )
        yield found
        found.close()


@pytest.fixture(scope="module")
def robot(browser, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dashboard")
    file = shutil.copy(ROBOT, folder / "robot.toml")
    with dashboard_of(browser, folder, file, *SLOW, LOOP) as dashboard:
        yield dashboard


@pytest.fixture
def idle(robot):
    robot.ready()


@pytest.fixture
def page(robot):
    """A page that has the token."""
    with robot.page() as page:
        yield page
