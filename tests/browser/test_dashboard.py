# SPDX-License-Identifier: Apache-2.0
"""The dashboard in a real browser, with a simulated robot behind it."""

import os
import re
import signal
from urllib.parse import urlsplit

import pytest
from tests.browser.axe import axe_violations
from tests.browser.dashboard import TOKEN, held, press_key, press_pad, state_of
from tests.browser.link_proxy import LinkProxy
from tests.sim.daemon_stage import wait_until
from tests.sim.tools.journal_copy import flipped, rewritten

ESTOP = ".estop-place .estop"
TABS = ("overview", "drive", "plots", "lines", "parameters", "file", "commission", "log", "fleet")
pytestmark = pytest.mark.usefixtures("idle")


def shows(page, *states):
    wait_until(lambda: state_of(page) in states, f"the page shows {states}")


def button(page, name):
    return page.get_by_role("button", name=name, exact=True)


def arm(robot, page):
    """Arm by the button, again where a drive answered late on a busy machine."""

    def attempt():
        state = state_of(page)
        if state == "idle":
            button(page, "Arm").first.click()
        elif state == "fault":
            robot.ready()
        return state == "armed"

    wait_until(attempt, "the page shows armed")


def test_the_page_shows_the_robot_and_its_buttons_arm_and_disarm_it(robot, page):
    shows(page, "idle")
    assert page.locator("tbody th").all_inner_texts() == ["left", "right"]
    arm(robot, page)
    assert robot.stage.state() == "armed"
    button(page, "Disarm").first.click()
    shows(page, "idle")
    assert page.locator("canvas").first.evaluate("canvas => canvas.width") > 100


def test_every_page_of_the_dashboard_opens(robot, page):
    for tab in TABS:
        page.evaluate(f"location.hash = '{tab}'")
        page.wait_for_selector(f"nav a[href='#{tab}'][aria-current]")
        page.wait_for_selector("main .card")


def test_plots_move_and_pause(robot, page):
    page.evaluate("location.hash = 'plots'")
    plot = page.locator("[data-plot=voltage] canvas")
    picture = "canvas => canvas.toDataURL()"
    first = plot.evaluate(picture)
    wait_until(lambda: plot.evaluate(picture) != first, "the plot moves")
    with page.expect_download() as found:
        button(page, "Export CSV").click()
    head, *rows = found.value.path().read_text(encoding="utf-8").splitlines()
    assert head.startswith("stamp_s,linear_m_s,")
    assert "left.voltage_v" in head
    assert all(row.count(",") == head.count(",") for row in rows)
    assert rows


@pytest.mark.parametrize("hold", [press_pad, press_key])
def test_a_held_pad_or_key_drives_the_robot_and_its_release_stops_it(robot, page, hold):
    robot.set_off(page, hold)
    assert robot.stage.sim.truth().x_m != 0.0
    page.mouse.up()
    page.keyboard.up("KeyW")
    robot.wait_for_rest()
    assert robot.stage.state() in ("armed", "moving", "stopping")


HIDE = """() => {
    Object.defineProperty(document, 'hidden', {value: true, configurable: true});
    document.dispatchEvent(new Event('visibilitychange'));
}"""


def freeze(page):
    """Stop the processes of all pages, like a suspend of the computer."""
    session = page.context.browser.new_browser_cdp_session()
    found = session.send("SystemInfo.getProcessInfo")["processInfo"]
    FROZEN.extend(row["id"] for row in found if row["type"] == "renderer")
    for process in FROZEN:
        os.kill(process, signal.SIGSTOP)


FROZEN = []


@pytest.fixture
def thawed():
    yield
    while FROZEN:
        os.kill(FROZEN.pop(), signal.SIGCONT)


ENDINGS = {
    "the focus is lost": lambda page: page.evaluate("window.dispatchEvent(new Event('blur'))"),
    "the page is hidden": lambda page: page.evaluate(HIDE),
    "another page is shown": lambda page: page.evaluate("location.hash = 'overview'"),
    "the page is closed": lambda page: page.close(),
    "the page is left": lambda page: page.goto("about:blank"),
    "the page is frozen": freeze,
}


@pytest.mark.parametrize("ending", ENDINGS.values(), ids=ENDINGS)
def test_leaving_or_losing_the_page_stops_the_wheels_while_the_pad_is_held(
    robot, page, thawed, ending
):
    robot.set_off(page)
    ending(page)
    robot.wait_for_rest()
    leases = robot.stage.robot.status()["leases"]
    assert all(lease["linear_m_s"] == 0.0 for lease in leases)


@pytest.mark.parametrize("hold", [press_pad, press_key])
def test_a_cut_link_stops_the_wheels_and_its_return_does_not_resume_a_hold(robot, hold):
    with LinkProxy(robot.port) as link, robot.page(port=link.port) as page:
        robot.set_off(page, hold)
        link.cut = True
        robot.wait_for_rest()
        wait_until(lambda: not held(page), "the page has released")
        link.cut = False
        wait_until(lambda: page.locator(".chip.connected").count() == 1, "connected")
        page.mouse.move(300, 300)
        if hold is press_key:
            page.keyboard.down("KeyW")  # a held key repeats
        assert not held(page)
        robot.wait_for_rest()
        page.mouse.up()
        robot.set_off(page, hold)  # a new press drives


def test_a_slow_lossy_link_still_drives_and_stops(robot):
    link = LinkProxy(robot.port, delay_s=0.15, stalls=0.01, stall_s=0.1)
    with link, robot.page(port=link.port) as page:
        robot.set_off(page)
        page.mouse.up()
        robot.wait_for_rest()


def test_an_emergency_stop_by_one_page_stops_what_another_drives(robot, page):
    with robot.page() as other:
        shows(other, "idle")
        robot.set_off(page)
        other.keyboard.press("Space")
        robot.wait_for_rest()
        for one in (page, other):
            shows(one, "estop")
        assert "by page" in " ".join(robot.stage.robot.status()["why"])
    page.mouse.up()
    button(page, "Reset").click()
    shows(page, "idle")


def test_every_page_has_the_emergency_stop_button(robot, page):
    for tab in ("plots", "fleet"):
        page.evaluate(f"location.hash = '{tab}'")
        page.locator(ESTOP).click()
        shows(page, "estop")
        robot.ready()
        shows(page, "idle")


GAMEPADS = """window.pads = [null];
window.looks = 0;
navigator.getGamepads = () => {
    window.looks += 1;
    return window.pads;
};
window.plug = (pressed, ahead = pressed) => {
    window.pads = [null, {
        index: 1, id: 'pad of the test', connected: true, axes: [0, ahead ? -0.6 : 0, 0, 0],
        buttons: Array.from({length: 17}, (_, n) => ({pressed: pressed && n === 4, value: 0})),
    }];
};"""
"""Script that replaces the browser's gamepad interface, so that no gamepad is needed."""


def looked(page):
    """Wait until the page has read its gamepads."""
    seen = page.evaluate("window.looks")
    page.wait_for_function("seen => window.looks > seen + 1", arg=seen)


def press_gamepad(page):
    """Hold the gamepad's dead-man button, and move its stick straight ahead."""
    for pressed, ahead in ((False, False), (True, False)):
        page.evaluate("([pressed, ahead]) => plug(pressed, ahead)", [pressed, ahead])
        looked(page)
    page.evaluate("plug(true)")


GAMEPAD_ENDINGS = {
    "its button is released": "plug(false)",
    "it is unplugged": "window.pads = [null]",
    "its slot stays, disconnected": "window.pads[1].connected = false",
    "another one takes its place": "window.pads[1] = {...window.pads[1], id: 'another one'}",
    "the focus is lost": "window.dispatchEvent(new Event('blur'))",
    "the page is hidden": f"({HIDE})()",
}


@pytest.mark.parametrize("ending", GAMEPAD_ENDINGS.values(), ids=GAMEPAD_ENDINGS)
def test_a_gamepad_drives_again_only_after_its_button_was_released(robot, page, ending):
    page.evaluate(GAMEPADS)
    robot.set_off(page, press_gamepad)
    page.evaluate(ending)
    robot.wait_for_rest()
    assert not held(page)
    page.evaluate("delete document.hidden")
    if ending != "plug(false)":
        page.evaluate("plug(true)")  # the gamepad or page is back, with the button held
        looked(page)
        assert not held(page)
        assert robot.rests()
    robot.set_off(page, press_gamepad)


def test_a_gamepad_begins_with_its_stick_in_the_middle(robot, page):
    page.evaluate(GAMEPADS)
    page.evaluate("location.hash = 'drive'")
    page.wait_for_selector(".pad")
    robot.stage.robot.arm()
    for pressed in (False, True):
        page.evaluate("pressed => plug(pressed, true)", pressed)
        looked(page)
    assert not held(page)
    page.evaluate("plug(true, false)")
    wait_until(lambda: held(page), "it holds once the stick is in the middle")
    assert robot.rests()


def test_a_second_page_does_not_drive_while_the_first_one_does(robot, page):
    with robot.page(at="drive") as other:
        other.wait_for_selector(".pad")
        robot.set_off(page)

        def refused():
            if not held(page):
                press_pad(page)
            press_pad(other)
            return "is driving" in other.locator(".notice").inner_text()

        wait_until(refused, "the second page is refused")
        robot.set_off(page)
        page.mouse.up()
        other.mouse.up()
        robot.wait_for_rest()


def test_a_page_without_the_token_watches_and_commands_once_it_is_entered(robot):
    with robot.page(token=None) as page:
        shows(page, "idle")
        assert button(page, "Arm").first.is_disabled()
        assert page.locator(ESTOP).is_disabled()
        button(page, "Enter the token to command").click()
        page.get_by_label("Token of this robot").fill("a-wrong-token-0123456789")
        button(page, "Connect").click()
        wait_until(lambda: "wrong" in page.locator(".token").inner_text(), "the token is wrong")
        page.get_by_label("Token of this robot").fill(TOKEN)
        button(page, "Connect").click()
        page.wait_for_selector(".estop-place .estop:enabled")
        arm(robot, page)


def test_a_page_of_another_site_gets_no_connection(robot):
    opened = """address => new Promise(done => {
        const socket = new WebSocket(address);
        socket.onopen = () => done('open');
        socket.onerror = () => done('refused');
    })"""
    with LinkProxy(robot.port) as site:
        context = robot.browser.new_context(bypass_csp=True)
        page = context.new_page()
        page.goto(f"http://127.0.0.1:{site.port}/icon.svg")
        assert page.evaluate(opened, f"ws://127.0.0.1:{robot.port}/socket") == "refused"
        assert page.evaluate(opened, f"ws://127.0.0.1:{site.port}/socket") == "open"
        context.close()


def test_a_killed_daemon_is_seen_and_found_again(robot, page):
    shows(page, "idle")
    os.kill(robot.stage.daemon.pid, signal.SIGKILL)
    robot.stage.daemon.wait()
    page.wait_for_selector(".banner.bad")
    shows(page, "unknown")
    robot.restart()
    shows(page, "idle")
    page.wait_for_selector(".banner.bad", state="detached")
    robot.set_off(page)
    page.mouse.up()
    robot.wait_for_rest()


def test_a_limit_is_changed_and_saved_in_the_robot_file(robot, page):
    page.evaluate("location.hash = 'parameters'")
    entry = page.get_by_label("linear_m_s, m/s")
    entry.fill("0.7")
    entry.press("Enter")
    page.locator("h2").first.click()
    button(page, "Apply").click()
    wait_until(
        lambda: robot.stage.robot.params_get("limits.linear_m_s")["limits.linear_m_s"] == 0.7,
        "the limit is in force",
    )
    button(page, "Save to the robot file…").click()
    difference = page.locator(".difference")
    wait_until(lambda: "\n+linear_m_s = 0.7\n" in difference.inner_text(), "the difference")
    assert "linear_m_s = 1.0" in robot.file.read_text(encoding="utf-8")
    button(page, "Write").click()
    wait_until(lambda: "Written" in difference.inner_text(), "the file is written")
    assert "linear_m_s = 0.7" in robot.file.read_text(encoding="utf-8")


def test_a_register_is_read(robot, page):
    page.evaluate("location.hash = 'lines'")
    button(page, "Read bus_voltage").first.click()
    cell = page.locator("tr", has=button(page, "Read bus_voltage")).first.locator("td").first
    wait_until(lambda: cell.inner_text() == "36", "the register's value")


def test_exchanges_are_traced_only_while_they_are_shown(robot, page):
    page.evaluate("location.hash = 'lines'")
    button(page, "Show live").click()
    rows = page.locator(".exchanges tbody tr")
    wait_until(lambda: rows.count() > 10, "exchanges")
    assert any(
        text.startswith(("read", "write")) for text in rows.first.locator("td").all_inner_texts()
    )
    wait_until(lambda: len(robot.children("trace")) == 1, "one process traces")
    page.evaluate(HIDE)
    wait_until(lambda: not robot.children("trace"), "none traces for a hidden page")


def test_a_recording_is_started_stopped_downloaded_once_and_replayed(robot, page):
    page.evaluate("location.hash = 'log'")
    page.wait_for_selector(".recorder button")
    if button(page, "Stop recording").count():  # an earlier run of this test has left it
        button(page, "Stop recording").click()
    button(page, "Start recording").click()
    files = page.locator(".recordings li", has_text="-manual.mcap")
    wait_until(lambda: "being written" in files.first.inner_text(), "the recording")
    robot.set_off(page)
    page.mouse.up()
    robot.wait_for_rest()
    page.evaluate("location.hash = 'log'")
    button(page, "Stop recording").click()
    wait_until(lambda: "being written" not in files.first.inner_text(), "the file is whole")
    files.first.get_by_role("button", name="Replay").click()
    files.first.locator(".good").wait_for()
    assert "Bit-identical" in files.first.inner_text()
    with page.expect_download() as found:
        files.first.get_by_role("button", name="Download").click()
    assert found.value.path().read_bytes().startswith(b"\x89MCAP0\r\n")
    path = urlsplit(found.value.url).path
    assert page.request.get(f"http://127.0.0.1:{robot.port}{path}").status == 404

    rewritten(found.value.path(), robot.recordings / "flipped.mcap", flipped)
    other = page.locator(".recordings li", has_text="flipped.mcap")
    other.get_by_role("button", name="Replay").click()
    other.locator(".differences tbody tr").first.wait_for()
    assert re.search(r"\d+ ticks? differs?\.", other.inner_text())


def test_the_log_shows_what_happened(robot, page):
    arm(robot, page)
    page.evaluate("location.hash = 'log'")
    events = page.locator(".events")
    wait_until(lambda: "armed (arm, was idle)" in events.inner_text(), "the event")
    page.get_by_role("searchbox").fill("arm, was idle")
    wait_until(
        lambda: all("arm, was idle" in row for row in events.locator("li").all_inner_texts()),
        "the filter",
    )


@pytest.mark.parametrize("width", [390, 1280])
def test_axe_finds_nothing(robot, width):
    with robot.page(viewport={"width": width, "height": 844}) as page:
        for tab in TABS:
            page.emulate_media(color_scheme="light")
            page.evaluate(f"location.hash = '{tab}'")
            page.wait_for_selector("main .card")
            if tab == "lines":
                button(page, "Show live").click()
                page.wait_for_selector(".exchanges tbody tr")
            assert axe_violations(page) == [], tab
            page.emulate_media(color_scheme="dark")  # only the colours differ: one rule is enough
            assert axe_violations(page, "color-contrast") == [], (tab, "dark")


TAB_CHOSEN_EARLY = """(() => {
    const soon = window.requestAnimationFrame.bind(window);
    window.requestAnimationFrame = (then) => soon(() => {
        location.hash = "plots";
        setTimeout(() => then(performance.now()), 20);
    });
})()"""
"""Script that chooses a tab between the page's first drawing and its next step."""


def test_a_tab_chosen_right_after_the_first_drawing_is_shown(robot):
    context = robot.browser.new_context()
    try:
        page = context.new_page()
        page.add_init_script(TAB_CHOSEN_EARLY)
        page.goto(f"http://127.0.0.1:{robot.port}/")
        page.wait_for_selector('nav a[href="#plots"][aria-current="page"]')
    finally:
        context.close()


def test_a_tab_that_fails_to_load_shows_why_and_opens_when_chosen_again(robot, page):
    scripts = "**/tabs/log.js"
    page.route(scripts, lambda route: route.abort("connectionrefused"))
    page.evaluate("location.hash = 'log'")
    page.get_by_role("alert").filter(has_text="Log cannot be loaded").wait_for()
    page.unroute(scripts)
    page.evaluate("location.hash = 'overview'")
    page.wait_for_selector("main .card")
    page.evaluate("location.hash = 'log'")
    page.wait_for_selector(".grid.log .card")


SPACE_EARLY = """new MutationObserver((_, observer) => {
    if (document.querySelector('.estop-place') === null) return;
    observer.disconnect();
    window.dispatchEvent(new KeyboardEvent('keydown', {code: 'Space'}));
}).observe(document, {childList: true, subtree: true})"""
"""Script that presses the space bar right after the first drawing, once the button exists."""


def test_the_space_bar_works_right_after_the_first_drawing(robot):
    with robot.page() as page, page.add_init_script(SPACE_EARLY):
        page.reload()
        robot.stage.wait_for("estop")  # sent once there is a connection
