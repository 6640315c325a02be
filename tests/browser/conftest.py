# SPDX-License-Identifier: Apache-2.0
"""A robot with a dashboard, and a headless Chromium. Where either cannot be had, these tests are
skipped and say so."""

import contextlib
import shutil
import socket
import subprocess

import pytest
from tests.browser.dashboard import CHROMIUM_ARGUMENTS, TOKEN, Dashboard
from tests.sim.daemon_stage import ROBOT, SLOW, running, wait_until


@pytest.fixture(scope="session")
def chromium():
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
    if found is None:
        pytest.skip("no Chromium here: apt install chromium")
    return found


@pytest.fixture(scope="module")
def browser(chromium):
    api = pytest.importorskip("playwright.sync_api", reason="no Playwright for this machine")
    with api.sync_playwright() as playwright:
        found = playwright.chromium.launch(
            executable_path=chromium, headless=True, args=list(CHROMIUM_ARGUMENTS)
        )
        yield found
        found.close()


@pytest.fixture(scope="module")
def robot(browser, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dashboard")
    token, recordings = folder / "token", folder / "recordings"
    token.write_text(TOKEN, encoding="utf-8")
    token.chmod(0o600)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    settings = (
        "input.web.kind=web", f"input.web.port={port}", f'input.web.token_file="{token}"',
        "publish.tape.kind=mcap", f'publish.tape.folder="{recordings}"',
        "publish.tape.mode=manual", "publish.tape.journal=true",
    )  # fmt: skip
    file = shutil.copy(ROBOT, folder / "robot.toml")
    with running(folder, *SLOW, *settings, robot=file) as stage:
        stage.wait_for("idle")
        dashboard = Dashboard(browser, stage, port, file, recordings)
        wait_until(dashboard.listens, "the dashboard listens")
        yield dashboard
        with contextlib.suppress(subprocess.TimeoutExpired):
            dashboard.end()


@pytest.fixture
def page(robot):
    """A page that has the token."""
    with robot.page() as page:
        yield page
