# SPDX-License-Identifier: Apache-2.0
"""Commissioning in a real browser: the simulated robot differs from its file, and the page finds
the differences. Every procedure ends at rest and without power."""

import math
import re

import pytest
from tests.browser.axe import axe_violations
from tests.browser.commissioning import (
    TRUE_LEFT_M,
    TRUE_RIGHT_M,
    TRUE_TRACK_M,
    TRUTH,
    Floor,
    answers,
    asked_text,
    begin,
    fill,
    give,
    open_page,
    rests_disarmed,
    rests_without_power,
    truth,
)
from tests.browser.dashboard import dashboard_of, press_pad, state_of
from tests.browser.link_proxy import LinkProxy
from tests.sim.daemon_stage import ROOT, SURE, TRIES, wait_until, was_held_up
from tests.sim.person_stage import copied

from motord.config import load_robot

PINS = ROOT / "config/robots/pi5-bts7960.toml"
SPIN, RADII, TRACK = "First turn of each wheel", "Wheel radii", "Track"
GAINS, GYRO = "Gains of a wheel", "Gyro"
DEAD_BAND, FEED_FORWARD = "Dead band", "Dead band and feed-forward"
GROUND, TURNED = "Are all wheels off the ground", "Did the (left|right) wheel turn forward"


def wheels(*settings):
    return [part for setting in settings for part in ("--wheel", setting)]


@pytest.fixture(scope="module")
def robot(browser, tmp_path_factory):
    """A robot whose wheels are larger and closer to each other than in its file."""
    folder = tmp_path_factory.mktemp("commission")
    with dashboard_of(
        browser, folder, copied(folder), *SURE, sim_options=truth(*TRUTH)
    ) as dashboard:
        yield dashboard


@pytest.fixture(autouse=True)
def idle(request):
    if "robot" in request.fixturenames:
        request.getfixturevalue("robot").ready()


def wheels_turn(robot):
    wait_until(lambda: max(robot.speeds_rad_s()) > 0.5, "a wheel turns")


def spinning(robot, page):
    """Begin a spin in which the left wheel turns longer than the test lasts."""
    open_page(page, SPIN)
    page.get_by_label("Wheels").select_option("left")
    fill(page, Time_for_each_wheel=10)
    begin(page)
    wait_until(lambda: GROUND in asked_text(page), "the question")
    give(page, "Yes")
    wheels_turn(robot)


def test_a_reversed_encoder_is_found_and_put_right_in_the_file(browser, tmp_path):
    patient = [("[joint.left]", "[safety]\nfeedback_timeout_s = 2.0\n\n[joint.left]")]
    file = copied(tmp_path, PINS, patient)
    planted = ["turned-encoder:unit=1,channel=1"]
    with dashboard_of(browser, tmp_path, file, faults=planted) as robot, robot.page() as page:
        open_page(page, SPIN)
        begin(page)
        text = answers(page, {GROUND: "Yes", TURNED: "Forward", "Write .*cart.toml": "Yes"})
        assert "left: its encoder counts against its motor: reversed is changed" in text
        assert "is written" in page.locator(".ended").inner_text()
        assert "Restart the daemon" in page.locator(".ended").inner_text()
        assert page.locator(".picture rect").count() > 3
        rests_disarmed(robot.stage)  # pins of a bridge have no power switch
    joints = load_robot(file).joint
    assert (joints["left"].encoder.reversed, joints["right"].encoder.reversed) == (True, False)


def test_swapped_wheels_are_found_and_put_right_in_the_file(browser, tmp_path):
    file = copied(tmp_path)
    swapped = truth("joint.left.channel=2", "joint.right.channel=1")
    with (
        dashboard_of(browser, tmp_path, file, *SURE, sim_options=swapped) as robot,
        robot.page() as page,
    ):

        def seen():
            """Answer as a person who sees the other wheel turn; alone it turns backward, because it
            is mounted on the other side."""
            other = page.locator(".question").get_by_role("button", name="Another wheel")
            return "Another wheel" if other.count() else "Backward"

        open_page(page, SPIN)
        begin(page)
        text = answers(page, {GROUND: "Yes", TURNED: seen, "Write .*cart.toml": "Yes"})
        assert "left" in text
        assert "is written" in page.locator(".ended").inner_text()
        rests_without_power(robot.stage)
    joints = load_robot(file).joint
    assert (joints["left"].channel, joints["right"].channel) == (2, 1)


@pytest.mark.parametrize(
    ("title", "fields"),
    [
        (RADII, {"Length_of_the_line": 1.5, "Top_speed": 0.8}),
        (TRACK, {"Turns_on_the_spot": 1, "Fastest_turn": 2.0}),
    ],
)
def test_a_calibration_recovers_what_was_planted(browser, tmp_path, title, fields):
    file = copied(tmp_path)
    with (
        dashboard_of(browser, tmp_path, file, *SURE, sim_options=truth(*TRUTH)) as robot,
        robot.page() as page,
    ):
        for _ in range(TRIES):
            open_page(page, title)
            fill(page, **fields)
            begin(page)
            answers(page, Floor(robot).replies())
            shown = page.locator(".ended").inner_text()
            if not was_held_up(shown):
                break
        assert "is written" in shown, shown
        assert "after" in shown
        assert page.locator(".picture svg").count() >= 2
        rests_without_power(robot.stage)
    found = load_robot(file)
    if title == RADII:
        assert found.wheel_radius_m("left") == pytest.approx(TRUE_LEFT_M, rel=0.003)
        assert found.wheel_radius_m("right") == pytest.approx(TRUE_RIGHT_M, rel=0.003)
    else:  # the radii of the file are used, which are too small
        assert found.base.track_m == pytest.approx(TRUE_TRACK_M / 1.025, rel=0.005)
    assert len(list(tmp_path.glob("*.bak"))) == 1


def rubbing(browser, folder, was):
    """Return the robot file and dashboard of duty drives whose motors stall at 8 N·m and rub with
    0.48 N·m: they begin to turn at 6 %. `was`: the dead band in the file."""
    replaced = [("duty_dead_band = 0.06", f"duty_dead_band = {was}")]
    file = copied(folder, ROOT / "config/robots/forward-only.toml", replaced)
    rubs = wheels("left.coulomb_n_m=0.48", "right.coulomb_n_m=0.48")
    return file, dashboard_of(browser, folder, file, *SURE, sim_options=rubs)


@pytest.mark.parametrize(("title", "speed_too"), [(DEAD_BAND, False), (FEED_FORWARD, True)])
def test_the_dead_band_and_the_speed_at_full_duty_are_recovered(
    browser, tmp_path, title, speed_too
):
    file, served = rubbing(browser, tmp_path, was=0.02)
    before = load_robot(file).joint
    with served as robot, robot.page() as page:
        for _ in range(TRIES):
            open_page(page, title)
            fill(page, Top_speed=0.5)
            begin(page)
            answers(page, {"Is the path clear": "Yes", "Write .*cart.toml": "Yes"})
            shown = page.locator(".ended").inner_text()
            if not was_held_up(shown):
                break
        assert "is written" in shown, shown
        assert page.locator(".ended .picture svg").count() >= 2
        rests_disarmed(robot.stage)
    for name, joint in load_robot(file).joint.items():
        assert joint.duty_dead_band == pytest.approx(0.06, rel=0.05)
        # 8 N·m · (duty − 0.06) = (8 / 18 + 0.02) N·m·s/rad · speed
        true_rad_s = 8.0 * 0.94 / (8.0 / 18.0 + 0.02)
        expected = true_rad_s if speed_too else before[name].full_duty_rad_s
        assert joint.full_duty_rad_s == pytest.approx(expected, rel=0.02 if speed_too else 1e-9)


def test_a_drive_that_holds_its_speed_has_no_dead_band_and_moves_nothing(robot):
    before = robot.file.read_bytes()
    with robot.page() as page:
        open_page(page, DEAD_BAND)
        begin(page)
        wait_until(lambda: page.locator(".ended").count(), "the end")
        assert "holds the wheel's speed by itself" in page.locator(".ended").inner_text()
        rests_without_power(robot.stage)
    assert robot.file.read_bytes() == before


def test_the_scale_of_a_gyro_is_measured_and_its_variance_written(browser, tmp_path):
    file = copied(tmp_path, ROOT / "config/robots/esp32-imu.toml")
    planted = ("--gyro-scale", "1.03", "--seed", "5")
    patient = (
        *SURE, "imu.timeout_s=1.0", "joint.left.reply_timeout_s=1.0",
        "joint.right.reply_timeout_s=1.0", "loop.rate_hz=250",
    )  # fmt: skip
    with (
        dashboard_of(browser, tmp_path, file, *patient, sim_options=planted) as robot,
        robot.page() as page,
    ):

        def used():
            return (robot.stage.robot.status()["imu"] or {}).get("state") == "used"

        for _ in range(TRIES):
            wait_until(used, "the zero of the gyro")
            open_page(page, GYRO)
            fill(page, Turns_on_the_spot=2, Fastest_turn=2.0)
            begin(page)
            answers(page, Floor(robot).replies())
            shown = page.locator(".ended").inner_text()
            if not was_held_up(shown):
                break
        assert "is written" in shown, shown
        rests_disarmed(robot.stage)
    scale = float(re.search(r"scale ([.\d]+)", shown)[1])
    assert scale == pytest.approx(1.0 / 1.03, abs=2 * 0.5 / 720 + 1e-3)  # read to half a degree
    variance = load_robot(file).imu.turn_variance_rad2_per_rad
    assert variance == pytest.approx((scale - 1.0) ** 2 * math.tau, rel=0.1)


def test_the_gains_of_a_wheel_are_found_shown_and_kept(browser, tmp_path):
    file = copied(tmp_path, ROOT / "config/robots/forward-only.toml")
    heavy = wheels("left.coulomb_n_m=1.2", "right.coulomb_n_m=1.2")
    with (
        dashboard_of(browser, tmp_path, file, *SURE, sim_options=heavy) as robot,
        robot.page() as page,
    ):
        open_page(page, GAINS)
        begin(page)
        replies = {"How fast": "Normal", "Is the path clear": "Yes", "Write .*cart.toml": "Yes"}
        assert answers(page, replies) == "measured"
        assert "before" in page.locator(".ended .picture").first.inner_text()
        assert page.locator(".ended .picture polyline").count() == 3
        rests_disarmed(robot.stage)
        gain = "joint.left.speed_loop.gain_s_per_rad"
        in_force = robot.stage.robot.params_get(gain)[gain]
    loop = load_robot(file).joint["left"].speed_loop
    assert loop.gain_s_per_rad == in_force > 0.0


HIDE = """() => {
    Object.defineProperty(document, 'hidden', {value: true, configurable: true});
    document.dispatchEvent(new Event('visibilitychange'));
}"""
ENDINGS = {
    "the stop button": lambda page: page.locator(".halt").click(),
    "a key": lambda page: page.keyboard.press("x"),
    "the focus is lost": lambda page: page.evaluate("window.dispatchEvent(new Event('blur'))"),
    "the page is hidden": lambda page: page.evaluate(HIDE),
    "another page is shown": lambda page: page.evaluate("location.hash = 'overview'"),
    "the page is closed": lambda page: page.close(),
}


@pytest.mark.parametrize("ending", ENDINGS.values(), ids=ENDINGS)
def test_each_end_of_a_procedure_ends_at_rest_and_without_power(robot, ending):
    before = robot.file.read_bytes()
    with robot.page() as page:
        spinning(robot, page)
        ending(page)
        rests_without_power(robot.stage)
    assert robot.file.read_bytes() == before


TAKEN = {
    "a menu": lambda page: page.locator("h1").click(button="right"),
    "a drag": lambda page: page.evaluate("window.dispatchEvent(new Event('dragstart'))"),
}


@pytest.mark.parametrize("taken", TAKEN.values(), ids=TAKEN)
def test_a_menu_or_a_drag_stops_a_procedure(robot, page, taken):
    spinning(robot, page)
    taken(page)
    wait_until(lambda: page.locator(".ended").count(), "the end, not the next question")
    assert "stopped on a page" in page.locator(".ended").inner_text()
    rests_without_power(robot.stage)


def test_a_cut_link_ends_a_procedure_at_rest_and_without_power(robot):
    with LinkProxy(robot.port) as link, robot.page(port=link.port) as page:
        spinning(robot, page)
        link.cut = True
        rests_without_power(robot.stage)
        link.cut = False
        wait_until(lambda: page.locator(".ended").count(), "the end")
        assert "silent" in page.locator(".ended").inner_text()


def test_a_filled_in_form_is_kept_while_the_link_is_lost(robot):
    with LinkProxy(robot.port) as link, robot.page(port=link.port) as page:
        open_page(page, SPIN)
        fill(page, Time_for_each_wheel=7)
        start = page.get_by_role("button", name="Begin", exact=True)
        link.cut = True
        link.drop()
        wait_until(lambda: start.count() and start.is_disabled(), "Begin is disabled")
        link.cut = False
        wait_until(start.is_enabled, "Begin is enabled again")
        assert page.get_by_label("Time for each wheel").input_value() == "7"


def test_the_emergency_stop_ends_a_procedure(robot):
    with robot.page() as page:
        spinning(robot, page)
        page.keyboard.press("Space")
        wait_until(lambda: robot.stage.state() == "estop", "the emergency stop")
        robot.wait_for_rest()
        wait_until(lambda: page.locator(".ended").count(), "the end")
        assert "emergency stop" in page.locator(".ended").inner_text()


def test_another_page_shows_a_running_procedure_and_can_only_stop_it(robot):
    with robot.page() as page, robot.page(at="drive") as other:
        spinning(robot, page)
        wait_until(
            lambda: "First turn of each wheel is running" in other.locator(".banner").inner_text(),
            "the other page shows it",
        )
        press_pad(other)
        wait_until(lambda: "is running" in other.locator(".notice").inner_text(), "it is refused")
        other.mouse.up()
        wait_until(lambda: state_of(other) == "moving", "the page shows that the wheel still turns")
        other.evaluate("location.hash = 'commission'")
        other.locator(".halt").click()
        rests_without_power(robot.stage)


def test_a_page_without_the_token_shows_only_that_a_procedure_runs(robot):
    with robot.page() as page, robot.page(token=None) as other:
        spinning(robot, page)
        wait_until(lambda: "is running" in other.locator(".banner").inner_text(), "it is shown")
        other.evaluate("location.hash = 'commission'")
        other.wait_for_selector("main .card")
        assert "needs the token" in other.locator("main").inner_text()
        assert other.locator(".halt").count() == 0
        page.locator(".halt").click()
        rests_without_power(robot.stage)


def test_axe_finds_nothing_in_a_question_and_a_result(robot):
    with robot.page() as page:
        open_page(page, SPIN)
        page.get_by_label("Wheels").select_option("left")
        begin(page)
        wait_until(lambda: GROUND in asked_text(page), "the question")
        assert axe_violations(page) == []
        answers(page, {GROUND: "Yes", TURNED: "Forward"})
        assert page.locator(".picture rect").count() > 1
        assert axe_violations(page) == []
    rests_without_power(robot.stage)


def test_a_question_outlives_its_page_and_another_page_answers_it(robot):
    with robot.page() as page:
        open_page(page, SPIN)
        begin(page)
        wait_until(lambda: GROUND in asked_text(page), "the question")
    with robot.page(at="commission") as page:
        page.get_by_role("button", name="Continue on this page").click()
        wait_until(lambda: asked_text(page), "it may answer")
        give(page, "No")
        wait_until(lambda: page.locator(".ended").count(), "the end")
        assert "nothing was turned" in page.locator(".ended").inner_text()
    rests_without_power(robot.stage)
