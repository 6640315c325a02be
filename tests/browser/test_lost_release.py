# SPDX-License-Identifier: Apache-2.0
"""An event after which the browser reports no release of a key or the pad ends the drive at
once."""

import pytest
from tests.browser.dashboard import held, press_key, press_pad
from tests.sim.daemon_stage import wait_until

pytestmark = pytest.mark.usefixtures("idle")


def event_at(selector, made):
    return lambda page: page.locator(selector).first.evaluate(f"it => it.dispatchEvent({made})")


def key(pressed):
    return lambda page: page.keyboard.press(pressed)


def lose_capture(page):
    page.locator(".pad").evaluate("pad => pad.releasePointerCapture(1)")
    page.mouse.move(5, 5)  # the release takes effect with the next event of the pointer


OF_KEYS = {
    "a menu opens": lambda page: page.locator("h1").click(button="right"),
    "a menu opens by a key": event_at("h1", "new Event('contextmenu', {bubbles: true})"),
    "the right button is pressed": event_at(
        "h1", "new MouseEvent('mousedown', {bubbles: true, button: 2})"
    ),
    "a link is dragged": event_at("nav a", "new Event('dragstart', {bubbles: true})"),
    "the page is printed": lambda page: page.evaluate("dispatchEvent(new Event('beforeprint'))"),
    "the Meta key": key("Meta"),
    "the Control key": key("Control"),
    "the Alt key": key("Alt"),
    "a key that may open a menu": key("F10"),
    "an event with Meta": lambda page: page.evaluate(
        "dispatchEvent(new KeyboardEvent('keydown', {code: 'KeyW', repeat: true, metaKey: true}))"
    ),
}  # fmt: skip
OF_THE_PAD = {
    "a menu opens": event_at("h1", "new Event('contextmenu', {bubbles: true})"),
    "a link is dragged": OF_KEYS["a link is dragged"],
    "the page is printed": OF_KEYS["the page is printed"],
    "another button is pressed": lambda page: page.mouse.down(button="right"),
    "it moves with no button": event_at(
        ".pad", "new PointerEvent('pointermove', {bubbles: true, pointerId: 1, buttons: 0})"
    ),
    "its pointer is taken": event_at(
        ".pad", "new PointerEvent('pointercancel', {bubbles: true, pointerId: 1})"
    ),
    "its capture is lost": lose_capture,
}
ENDS = {f"key: {name}": (press_key, ending) for name, ending in OF_KEYS.items()}
ENDS |= {f"pad: {name}": (press_pad, ending) for name, ending in OF_THE_PAD.items()}


@pytest.mark.parametrize(("hold", "ending"), ENDS.values(), ids=ENDS)
def test_the_wheels_rest_though_no_release_arrives(robot, page, hold, ending):
    robot.set_off(page, hold)
    ending(page)
    robot.wait_for_rest()
    assert not held(page)
    if hold is press_key:
        page.keyboard.down("KeyW")  # a held key repeats
        assert not held(page)
    page.mouse.up(button="right")


def test_a_long_touch_of_the_pad_opens_no_menu_and_drives_on(robot, page):
    robot.set_off(page)
    menu = "new Event('contextmenu', {bubbles: true, cancelable: true})"
    assert page.locator(".pad").evaluate(f"pad => pad.dispatchEvent({menu})") is False
    wait_until(lambda: held(page) and robot.turns(), "it drives")
    page.mouse.up()
    robot.wait_for_rest()


def test_a_key_with_a_lost_release_does_not_count_in_the_next_hold(robot, page):
    page.evaluate("location.hash = 'drive'")
    page.wait_for_selector(".pad")
    press_pad(page)
    page.keyboard.down("KeyW")  # this key drives nothing: the pad drives
    page.mouse.up()
    page.keyboard.down("KeyS")
    requested = page.locator("dt", has_text="Requested").locator("xpath=../dd")
    wait_until(lambda: requested.inner_text().startswith("-"), "backward")
    page.keyboard.up("KeyS")
    page.evaluate(
        """() => {
            const press = (code) => dispatchEvent(new KeyboardEvent('keydown', {code}));
            press('KeyW');
            dispatchEvent(new Event('contextmenu'));
            press('KeyA');
        }"""
    )
    turns = "0.00 m/s, 0."
    wait_until(lambda: held(page) and turns in requested.inner_text(), "it turns, and no more")
