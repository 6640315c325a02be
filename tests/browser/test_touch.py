# SPDX-License-Identifier: Apache-2.0
"""The pad under thumbs, with real touch events."""

import pytest
from tests.browser.dashboard import held, state_of
from tests.browser.touch import Fingers
from tests.sim.daemon_stage import wait_until

PHONE = {"width": 390, "height": 844}
AHEAD_PX = 120.0
HELD_STILL = (".pad", "nav a", ".slider input", ".state .actions button", ".estop-place .estop")
"""Controls whose use changes the state."""
pytestmark = pytest.mark.usefixtures("idle")


@pytest.fixture(params=[PHONE, {"width": 1280, "height": 800}], ids=["phone", "desktop"])
def sized(robot, request):
    """A page of drive, on a phone and on a computer."""
    with robot.page(at="drive", viewport=request.param) as page:
        page.wait_for_selector(".pad")
        yield page


@pytest.fixture
def phone(robot):
    with robot.page(at="drive", viewport=PHONE) as page:
        page.wait_for_selector(".pad")
        yield page


@pytest.fixture
def fingers(phone):
    found = Fingers(phone)
    yield found
    found.end()


def middle(page):
    box = page.locator(".pad").bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def requested(page):
    """Return the speeds that the page requests: m/s and rad/s."""
    text = page.locator("dt", has_text="Requested").locator("xpath=../dd").inner_text()
    linear, angular = text.split(", ")
    return float(linear.split()[0]), float(angular.split()[0])


def places(page):
    return {
        selector: [one.bounding_box() for one in page.locator(selector).all()]
        for selector in HELD_STILL
    }


def hold_ahead(fingers, finger=0):
    """Return a function that presses the middle of the pad and moves the thumb ahead."""

    def hold(page):
        x, y = middle(page)
        fingers.lift(finger)
        fingers.press(finger, x, y)
        fingers.move(finger, x, y - AHEAD_PX)

    return hold


def test_no_control_moves_in_a_drive(robot, sized):
    before = places(sized)
    robot.set_off(sized)
    sized.wait_for_selector("text=driven by")
    wait_until(lambda: state_of(sized) == "moving", "the page shows that it moves")
    assert places(sized) == before
    sized.mouse.up()
    robot.wait_for_rest()
    sized.keyboard.press("Space")
    wait_until(lambda: state_of(sized) == "estop", "the page shows the emergency stop")
    assert places(sized) == before


def test_what_moves_the_page_moves_no_command(robot, phone, fingers):
    robot.set_off(phone, hold_ahead(fingers))
    before = requested(phone)
    phone.evaluate("document.querySelector('header').style.marginTop = '40px'")
    x, y = middle(phone)
    fingers.move(0, x, y - 40.0 - AHEAD_PX - 0.6)
    wait_until(lambda: held(phone), "it drives on")
    phone.wait_for_timeout(300)
    linear, angular = requested(phone)
    assert linear == pytest.approx(before[0], abs=0.011)
    assert angular == pytest.approx(before[1], abs=0.011)
    fingers.move(0, x, y - 40.0)
    wait_until(lambda: requested(phone) == (0.0, 0.0), "a thumb in the middle requests rest")


@pytest.mark.parametrize("at", [(0.0, -0.9), (0.9, 0.0), (0.5, 0.5), (0.0, 0.35)])
@pytest.mark.parametrize("by", ["mouse", "finger"])
def test_a_press_outside_the_middle_drives_nothing(robot, phone, fingers, at, by):
    robot.stage.robot.arm()
    x, y = middle(phone)
    radius = phone.locator(".pad").bounding_box()["width"] / 2
    x, y = x + at[0] * radius, y + at[1] * radius
    if by == "mouse":
        phone.mouse.move(x, y)
        phone.mouse.down()
        phone.mouse.move(x + 5, y + 5, steps=3)
    else:
        fingers.press(0, x, y)
    assert not held(phone)
    assert requested(phone) == (0.0, 0.0)
    phone.get_by_text("begins in the middle").wait_for()
    phone.mouse.up()


@pytest.mark.parametrize("begin", [(0.0, 0.0), (0.1, 0.15), (0.0, 0.8), (-0.6, 0.3), (0.0, 1.3)])
def test_a_thumb_that_scrolls_over_the_pad_drives_nothing(robot, phone, fingers, begin):
    robot.stage.robot.arm()
    x, y = middle(phone)
    radius = phone.locator(".pad").bounding_box()["width"] / 2
    fastest = """() => {
        window.fastest = 0;
        const send = WebSocket.prototype.send;
        WebSocket.prototype.send = function (data) {
            if (data.byteLength === 45) {
                const view = new DataView(data);
                const asked = [21, 29, 37].map((at) => Math.abs(view.getFloat64(at, true)));
                window.fastest = Math.max(window.fastest, ...asked);
            }
            send.call(this, data);
        };
    }"""
    phone.evaluate(fastest)
    x, y = x + begin[0] * radius, y + begin[1] * radius
    fingers.swipe((x, y), (x + 10, y - 150))
    assert not held(phone)
    assert phone.evaluate("window.fastest") == 0
    assert robot.stage.state() == "armed"


def test_a_thumb_scrolls_the_page_from_the_rim_of_the_pad(phone, fingers):
    x, y = middle(phone)
    fingers.swipe((x, y + 120), (x, y - 120))
    wait_until(lambda: phone.evaluate("scrollY") > 0, "the page has scrolled")


def test_a_second_finger_does_not_take_the_command_over(robot, phone, fingers):
    robot.set_off(phone, hold_ahead(fingers))
    x, y = middle(phone)
    before = requested(phone)
    for second in ((x, y), (x, y + 120), (x + 120, y)):
        fingers.press(1, *second)
        fingers.move(1, second[0] + 10, second[1] + 10)
        fingers.lift(1)
        phone.wait_for_timeout(150)
        assert held(phone)
        assert requested(phone) == before
    fingers.press(1, x, y)
    fingers.lift(0)
    fingers.move(1, x, y - AHEAD_PX)
    wait_until(lambda: not held(phone), "the first finger ends it")
    assert requested(phone) == (0.0, 0.0)
    robot.wait_for_rest()


def test_the_emergency_stop_works_while_a_thumb_is_on_the_pad(robot, phone, fingers):
    robot.set_off(phone, hold_ahead(fingers))
    box = phone.locator(".estop-place .estop").bounding_box()
    fingers.press(1, box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    wait_until(lambda: robot.stage.state() == "estop", "the emergency stop")
    robot.wait_for_rest()
    assert not held(phone)
