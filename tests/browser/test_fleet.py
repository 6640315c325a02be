# SPDX-License-Identifier: Apache-2.0
"""Two robots in one page: two daemons, and two dashboards with their rules for each other."""

import contextlib
import os
import signal

import pytest
from tests.browser.dashboard import TOKEN, Dashboard
from tests.sim.daemon_stage import ROBOT, SLOW, running, wait_until
from tests.sim.web.web_page import free_port

OTHER_TOKEN = "another-token-for-tests-987654321"


@contextlib.contextmanager
def robot_at(browser, folder, port, token, fleet, *settings):
    file = folder / "token"
    file.write_text(token, encoding="utf-8")
    file.chmod(0o600)
    listed = ", ".join(f'"http://127.0.0.1:{one}"' for one in fleet)
    web = (
        "input.web.kind=web", f"input.web.port={port}", f'input.web.token_file="{file}"',
        f"input.web.fleet=[{listed}]",
    )  # fmt: skip
    with running(folder, *SLOW, *web, *settings) as stage:
        stage.wait_for("idle")
        dashboard = Dashboard(browser, stage, port, ROBOT, folder)
        wait_until(dashboard.listens, "the dashboard listens")
        yield dashboard


@pytest.fixture
def robots(browser, tmp_path):
    """Two robots of one fleet and their three ports: the second robot has another dashboard, which
    does not list the first robot."""
    first, second, closed = ports = free_port(), free_port(), free_port()
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
    one = robot_at(browser, tmp_path / "first", first, TOKEN, (second, closed))
    two = robot_at(
        browser, tmp_path / "second", second, OTHER_TOKEN, (first,),
        "publish.closed.kind=web", f"publish.closed.port={closed}",
    )  # fmt: skip
    with one as here, two as there:
        yield here, there, ports


@pytest.fixture
def page(robots):
    here, _, (_, second, closed) = robots
    with here.page(at="fleet", fleet=(second, closed)) as page:
        yield page


def card(page, port):
    """Return the card of another robot; `port`: of its dashboard."""
    return page.locator(".robot", has=page.locator(f"a[href='http://127.0.0.1:{port}']"))


def shows(where, text):
    wait_until(lambda: text in where.inner_text(), f"the card shows {text}")


def give_token(there, token):
    there.locator("input[type=password]").fill(token)
    there.get_by_role("button", name="Connect").click()


def test_each_robot_has_its_state_its_token_and_its_emergency_stop(robots, page):
    here, there, (_, second, _) = robots
    own, other = page.locator(".robot").first, card(page, second)
    for where in (own, other):
        shows(where, "Ready, no power")
    assert other.locator(".estop").is_disabled()
    give_token(other, TOKEN)  # the token of the first robot
    shows(other, "wrong")
    assert other.locator(".estop").is_disabled()
    give_token(other, OTHER_TOKEN)
    wait_until(other.locator(".estop").is_enabled, "it may command")
    other.locator(".estop").click()
    shows(other, "Emergency stop")
    there.stage.wait_for("estop")
    assert here.stage.state() == "idle"
    there.ready()
    page.get_by_role("button", name="E-STOP for all robots").click()
    for robot in (here, there):
        robot.stage.wait_for("estop")


def test_the_emergency_stop_of_all_names_each_robot_that_it_did_not_reach(robots, page):
    here, there, (_, second, closed) = robots
    other = card(page, second)
    shows(other, "Ready, no power")
    shows(card(page, closed), "Connection lost")
    missed = page.locator(".toolbar [role=alert]")

    def press(*whys):
        page.get_by_role("button", name="E-STOP for all robots").click()
        here.stage.wait_for("estop")
        for why in whys:
            shows(missed, why)
        here.ready()

    press(f":{second}): needs its token", f":{closed}): not connected")
    assert there.stage.state() == "idle"
    give_token(other, OTHER_TOKEN)
    wait_until(other.locator(".estop").is_enabled, "it may command")
    assert "needs its token" in missed.inner_text()  # shown until the next press
    os.kill(there.stage.daemon.pid, signal.SIGSTOP)
    try:
        press(f":{second}): no answer", f":{closed}): not connected")
    finally:
        os.kill(there.stage.daemon.pid, signal.SIGCONT)
    there.stage.wait_for("estop")
    there.ready()
    press(f":{closed}): not connected")
    there.stage.wait_for("estop")
    assert f":{second}" not in missed.inner_text()


def test_a_robot_that_is_gone_is_shown_as_unknown_and_the_other_one_as_before(robots, page):
    _, there, (_, second, _) = robots
    shows(card(page, second), "Ready, no power")
    os.kill(there.stage.daemon.pid, signal.SIGKILL)
    shows(card(page, second), "Unknown")
    assert "Ready, no power" in page.locator(".robot").first.inner_text()


def test_a_dashboard_that_does_not_list_the_page_is_not_shown(robots, page):
    _, _, (_, second, closed) = robots
    shows(card(page, second), "Ready, no power")
    shows(card(page, closed), "Connection lost")
    assert "Speed" not in card(page, closed).inner_text()


def test_the_browser_refuses_connections_to_robots_that_are_not_listed(robots):
    here, _, (first, second, closed) = robots
    blocked = """address => new Promise(done => {
        document.addEventListener('securitypolicyviolation', event => done(event.blockedURI));
        const socket = new WebSocket(address);
        socket.onopen = () => done('open');
    })"""
    context = here.browser.new_context()
    page = context.new_page()
    page.goto(f"http://127.0.0.1:{second}/")
    address = f"ws://127.0.0.1:{closed}/socket"
    assert page.evaluate(blocked, address).startswith(address.removesuffix("/socket"))
    assert page.evaluate(blocked, f"ws://127.0.0.1:{first}/socket") == "open"
    context.close()
