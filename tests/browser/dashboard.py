# SPDX-License-Identifier: Apache-2.0
"""The dashboard of a simulated robot, and pages that show it."""

import contextlib
import json
import shutil
import socket
import subprocess
import uuid
from urllib.parse import urlsplit

from tests.sim.daemon_stage import (
    DEADLINE_S,
    connected,
    ended,
    release_sources,
    running,
    wait_until,
)
from tests.sim.web.web_page import bus_children, free_port

from motord.client import Refused

TOKEN = "a-token-for-tests-0123456789"
CHROMIUM_ARGUMENTS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
UNNEEDED = (
    "WebUIOmniboxAimPopup", "WebUIOmniboxPopup", "PaintHolding", "SpareRendererForSitePerProcess",
)  # fmt: skip
CHEAP_ARGUMENTS = (
    "--in-process-gpu", "--disable-software-rasterizer", "--num-raster-threads=1",
    "--renderer-process-limit=1", f"--disable-features={','.join(UNNEEDED)}",
)  # fmt: skip
"""Arguments by which Chromium starts only the processes that a page needs; a window starts four."""
CHROMIUMS = ("chromium-headless-shell", "chromium", "chromium-browser")
"""Names of the program, the best first: it has no window and takes half of the CPU time."""
DEADLINE_MS = DEADLINE_S * 1000.0
EMPTY = "about:blank"
STORAGE = """([origin, key, token, use]) => {
    if (location.origin !== origin || sessionStorage.getItem('use') === use) return;
    sessionStorage.setItem('use', use);
    localStorage.clear();
    if (token !== null) localStorage.setItem(key, token);
}"""
"""Script that runs before a document's own: the first document finds only the token stored."""
SHOWN = """() => [document.body.innerText, ...performance.getEntriesByType('resource').map(
    ({ name, responseStatus, responseEnd }) => `${name} ${responseStatus} ${responseEnd} ms`,
)].join("\\n")"""
"""Script that returns the text that a page shows, and the resources that it has loaded."""
TURNS_RAD_S, RESTS_RAD_S = 1.0, 0.05


def installed_chromium():
    """Return the path of the Chromium program, or None."""
    return next(filter(None, map(shutil.which, CHROMIUMS)), None)


class Dashboard:
    def __init__(self, browser, stage, port, file, recordings):
        self.browser, self.stage, self.port = browser, stage, port
        self.file, self.recordings = file, recordings
        self._again = None

    def listens(self):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port)):
            return True
        return False

    @contextlib.contextmanager
    def page(self, token=TOKEN, port=None, at="", viewport=None, fleet=()):
        """Open a page whose storage holds the token alone. At its end, check its log and the hosts
        that it contacted. `fleet`: ports of other dashboards that it may contact."""
        address = f"http://127.0.0.1:{port or self.port}"
        page = self._empty_page()
        problems, hosts = [], set()
        listeners = {
            "pageerror": lambda error: problems.append(str(error)),
            "console": lambda line: problems.append(line.text) if line.type == "error" else None,
            "request": lambda request: hosts.add(urlsplit(request.url).netloc),
            "websocket": lambda found: hosts.add(urlsplit(found.url).netloc),
        }
        for event, listener in listeners.items():
            page.on(event, listener)
        try:
            page.set_viewport_size(viewport or {"width": 1280, "height": 800})
            page.emulate_media(color_scheme="light")
            use = [address, f"motord.token.{address}", token, uuid.uuid4().hex]
            with page.add_init_script(f"({STORAGE})({json.dumps(use)})"):
                page.goto(f"{address}/#{at}", wait_until="load")
                yield page
            for event, listener in listeners.items():
                page.remove_listener(event, listener)
        except BaseException:
            print(page.url, *problems, page.evaluate(SHOWN), self.stage.logged()[-4000:], sep="\n")
            page.context.close()
            raise
        self._emptied(page)
        others = {f"127.0.0.1:{other}" for other in fleet}
        assert hosts <= {urlsplit(address).netloc, "", *others}
        lost = ("WebSocket connection to", "Failed to load resource: net::ERR_CONNECTION")
        problems = [text for text in problems if not text.startswith(lost)]
        assert problems == [], problems

    def _empty_page(self):
        """Return an empty page in a browser profile of its own. A profile that a test has left is
        reused: a new one costs a second of a processor."""
        for context in self.browser.contexts:
            if [page.url for page in context.pages] == [EMPTY]:
                return context.pages[0]
        page = self.browser.new_context().new_page()
        page.set_default_timeout(DEADLINE_MS)
        return page

    def _emptied(self, page):
        """Empty the page and release its mouse and keys."""
        if page.is_closed():
            page.context.close()
            return
        page.goto(EMPTY)
        page.mouse.up()
        page.mouse.move(0, 0)
        page.keyboard.up("KeyW")

    def speeds_rad_s(self):
        return [abs(one.velocity_rad_s) for one in self.stage.sim.truth().joints.values()]

    def turns(self):
        return all(speed > TURNS_RAD_S for speed in self.speeds_rad_s())

    def rests(self):
        return all(speed < RESTS_RAD_S for speed in self.speeds_rad_s())

    def wait_for_rest(self):
        wait_until(self.rests, "the wheels rest")

    def children(self, command):
        """Return the child processes of motord-bus that run this command of motord."""
        return bus_children(self.stage, command)

    def ready(self):
        """Bring the robot to idle from any state."""

        def attempt():
            with contextlib.suppress(Refused):
                state = self.stage.state()
                if state in ("fault", "estop"):
                    self.stage.robot.reset()
                elif state == "idle":
                    return True
                else:
                    self.stage.robot.disarm()
            return False

        wait_until(attempt, "idle")

    def set_off(self, page, hold=None):
        """Arm and drive until the wheels turn: `hold` presses a control of the page (default: the
        pad), again where a busy machine has released it."""
        hold = hold or press_pad
        page.evaluate("location.hash = 'drive'")
        page.wait_for_selector(".pad")

        def turning():
            state = self.stage.state()
            with contextlib.suppress(Refused):
                if state in ("fault", "estop"):
                    self.stage.robot.reset()
                elif state == "idle":
                    self.stage.robot.arm()
                    release_sources(self.stage)
            if state in ("armed", "moving") and not held(page):
                hold(page)
            return self.turns()

        wait_until(turning, "the wheels turn")

    def end(self):
        """End a daemon that `restart` has started."""
        if self._again is not None:
            self.stage.robot.close()
            ended(self._again)

    def restart(self):
        """Start the daemon again, as a service manager does after a kill."""
        with self.stage.log.open("ab") as log:
            self._again = subprocess.Popen(
                self.stage.daemon.args, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=log,
            )  # fmt: skip
        self.stage.daemon = self._again
        self.stage.robot.close()
        self.stage.robot = connected(self._again, self.stage.socket, self.stage.log)
        self.stage.wait_for("idle")
        wait_until(self.listens, "the dashboard listens")


@contextlib.contextmanager
def dashboard_of(browser, folder, file, *settings, **simulated):
    """Run a robot with a dashboard, from a robot file; `simulated`: options of `running`."""
    token = folder / "token"
    token.write_text(TOKEN, encoding="utf-8")
    token.chmod(0o600)
    port = free_port()
    recordings = folder / "recordings"
    web = (
        "input.web.kind=web", f"input.web.port={port}", f'input.web.token_file="{token}"',
        "input.web.rate_hz=20",  # a page draws each state: a higher rate slows every test
        "publish.tape.kind=mcap", f'publish.tape.folder="{recordings}"',
        "publish.tape.mode=manual", "publish.tape.journal=true",
    )  # fmt: skip
    with running(folder, *settings, *web, robot=file, **simulated) as stage:
        stage.wait_for("idle")
        dashboard = Dashboard(browser, stage, port, file, recordings)
        wait_until(dashboard.listens, "the dashboard listens")
        yield dashboard
        with contextlib.suppress(subprocess.TimeoutExpired):
            dashboard.end()


def press_pad(page):
    """Press the pad for straight ahead, and hold it."""
    box = page.locator(".pad").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.up()
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 0.45 * box["height"], steps=3)


def press_key(page):
    """Press the key for straight ahead, and hold it."""
    page.keyboard.up("KeyW")
    page.keyboard.down("KeyW")


def held(page):
    """Return whether the page drives."""
    return page.locator("html[data-held]").count() == 1


def state_of(page):
    """Return the state that the page shows."""
    return page.locator("header .chip[data-state]").get_attribute("data-state")
