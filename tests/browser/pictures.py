# SPDX-License-Identifier: Apache-2.0
"""The pictures of the dashboard in docs/pictures, of a simulated robot: all, or those named.

python -m tests.browser.pictures
python -m tests.browser.pictures overview fault
"""

import argparse
import contextlib
import math
import tempfile
import time
from pathlib import Path

from playwright.sync_api import sync_playwright
from tests.browser.commissioning import TRUTH, Floor, answers, begin, fill, open_page, truth
from tests.browser.dashboard import CHROMIUM_ARGUMENTS, dashboard_of, installed_chromium, state_of
from tests.sim.daemon_stage import POLL_S, ROOT, SURE, wait_until
from tests.sim.person_stage import copied

from motord.client import Refused

FOLDER = ROOT / "docs/pictures"
FILE = "/srv/motord/cart.toml"
"""Path of the robot file that the pictures show instead of the real one."""
PHONE = {"width": 390, "height": 844}
TALL = {"width": 1180, "height": 900}
SPEED_M_S, TURN_RAD_S, PERIOD_S = 0.4, 0.9, 10.0
PLAIN = """replaced => {
    const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (texts.nextNode()) for (const [old, plain] of replaced)
        if (texts.currentNode.data.includes(old))
            texts.currentNode.data = texts.currentNode.data.replaceAll(old, plain);
}"""
EDITED = (
    ("linear_m_s = 1.0", "linear_m_s = 100.0\nlinaer_m_s2 = 1.0"),
    ('on_timeout = "ramp"\non_fault = "ramp"\n', ""),
)


class Photographer:
    def __init__(self, robot):
        self.robot, self.client = robot, robot.stage.robot

    def take(self, page, name):
        folder = self.robot.file.parent
        places = [(f"{folder}/rs485", "/dev/ttyUSB0"), (str(self.robot.file), FILE)]
        page.evaluate(PLAIN, places)
        page.screenshot(path=FOLDER / f"dashboard-{name}.png")

    def take_moving(self, page, name, for_s):
        """Take the picture of a moving robot, again where a busy machine has stopped the robot."""
        moves = False
        while not moves:
            self.drive(for_s)
            self.take(page, name)
            moves = self.robot.stage.state() == state_of(page) == "moving"

    def drive(self, for_s):
        """Drive a winding course for `for_s`; the robot still moves on return."""
        begun_s = time.monotonic()
        while (passed_s := time.monotonic() - begun_s) < for_s:
            with contextlib.suppress(Refused):
                state = self.robot.stage.state()
                if state in ("fault", "estop"):  # a busy machine causes faults
                    self.client.reset()
                elif state == "idle":
                    self.client.arm()
                swing = math.sin(math.tau * passed_s / PERIOD_S)
                self.client.drive(SPEED_M_S, TURN_RAD_S * swing)
            time.sleep(POLL_S)

    def overview(self, name="overview", scheme="light"):
        with self.robot.page() as page:
            page.emulate_media(color_scheme=scheme)
            zoom_out = page.get_by_role("button", name="Zoom out")
            for _ in range(2):
                zoom_out.click()
            self.take_moving(page, name, for_s=9.0)

    def dark(self):
        self.overview("dark", "dark")

    def plots(self):
        with self.robot.page(at="plots") as page:
            self.take_moving(page, "plots", for_s=24.0)

    def phone(self):
        with self.robot.page(at="drive", viewport=PHONE) as page:
            self.robot.set_off(page)
            box = page.locator(".pad").bounding_box()
            page.mouse.move(box["x"] + 0.58 * box["width"], box["y"] + 0.28 * box["height"])
            page.wait_for_selector("text=driven by")
            self.take(page, "phone")
            page.mouse.up()

    def file(self):
        with self.robot.page(at="file") as page:
            area = page.locator("textarea")
            area.wait_for()
            text = area.input_value()
            for old, new in EDITED:
                text = text.replace(old, new, 1)
            area.fill(text)
            wait_until(lambda: page.locator(".problems li, .checked").count(), "the check")
            wait_until(lambda: "2 problems" in page.locator("main").inner_text(), "two problems")
            area.evaluate(
                """area => {
                    const at = area.value.indexOf("[safety]") + "[safety]".length;
                    area.focus();
                    area.setSelectionRange(at, at);
                    area.scrollTop = 210;
                }"""
            )
            page.keyboard.press("Enter")
            page.keyboard.type("on_")
            page.wait_for_selector(".completion [role=option]")
            page.keyboard.press("ArrowDown")
            self.take(page, "file")

    def calibration(self):
        with self.robot.page(viewport=TALL) as page:
            open_page(page, "Wheel radii")
            fill(page, Length_of_the_line=1.5, Top_speed=0.4)
            begin(page)
            answers(page, {**Floor(self.robot).replies(), "Write .*cart.toml": "No"})
            page.locator(".ended").scroll_into_view_if_needed()
            page.locator(".ended .picture").first.evaluate(
                "picture => scrollBy(0, picture.getBoundingClientRect().top - 330)"
            )
            self.take(page, "calibration")

    def fault(self):
        with self.robot.page() as page:
            self.drive(for_s=6.0)
            self.robot.stage.sim.pull()
            self.robot.stage.wait_for("fault")
            page.wait_for_selector("tr.bad")
            page.wait_for_selector("text=no source")
            self.take(page, "fault")
            self.robot.stage.sim.plug()


PICTURES = ("overview", "dark", "plots", "phone", "file", "calibration", "fault")


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(PICTURES))
    names = parser.parse_args().names or PICTURES
    if unknown := set(names) - set(PICTURES):
        parser.error(f"no such picture: {', '.join(sorted(unknown))}")
    chromium = installed_chromium()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium, headless=True, args=list(CHROMIUM_ARGUMENTS)
        )
        for name in names:
            with tempfile.TemporaryDirectory() as made:
                folder = Path(made)
                with dashboard_of(
                    browser, folder, copied(folder), *SURE, "robot.name=cart",
                    sim_options=truth(*TRUTH),
                ) as robot:  # fmt: skip
                    getattr(Photographer(robot), name)()
            print(f"docs/pictures/dashboard-{name}.png", flush=True)


if __name__ == "__main__":
    main()
