# SPDX-License-Identifier: Apache-2.0
"""Measurements in Chromium: what the dashboard's page costs, and how soon it stops the robot."""

from __future__ import annotations

import contextlib
import itertools
import statistics
import time
from pathlib import Path

from tests.browser.dashboard import CHROMIUM_ARGUMENTS, installed_chromium, press_pad
from tests.browser.link_proxy import LinkProxy
from tests.sim.daemon_stage import running, wait_until
from tests.sim.web.web_page import free_port, listens

from motord.api.state_page import StatePage
from motord.client import Refused

SLOW_DOWN = 6
HEAP_FILLS_S = 120.0
"""After this time the page's ring buffers are full, and its functions compiled."""
HEAP_LOOKS, HEAP_LOOK_EVERY_S = 10, 1.0
LONG_MS = 50.0
"""Length from which a person notices an animation frame (w3.org/TR/longtasks-1)."""
STATE = 1
WHEELS = 8


def percentile(values, part):
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(part * len(ordered)))]


def first_paint_ms(browser, port):
    """Return the median of five loads without a cache."""
    found = []
    for _ in range(5):
        context = browser.new_context()
        page = context.new_page()
        session = context.new_cdp_session(page)
        session.send("Emulation.setCPUThrottlingRate", {"rate": SLOW_DOWN})
        page.goto(f"http://127.0.0.1:{port}/")
        page.wait_for_selector(".card")
        found.append(page.evaluate(
            "performance.getEntriesByName('first-contentful-paint')[0].startTime"))  # fmt: skip
        context.close()
    return statistics.median(found)


HIDE = """() => {
    Object.defineProperty(document, 'hidden', {value: true, configurable: true});
    document.dispatchEvent(new Event('visibilitychange'));
    delete document.hidden;
}"""


def hidden(page, _):
    page.evaluate(HIDE)


def released(page, _):
    page.mouse.up()


def cut(_, link):
    link.cut = True


def until_zero_ms(browser, stage, port, times, ending):
    """Measure the time from the end of a hold to the first requested speed of zero on the state
    page. The ramp that follows depends on the robot's limits, so it is left out."""
    found = []
    with StatePage.open(stage.robot.status()["robot"]) as state, LinkProxy(port) as link:
        page = browser.new_page()
        page.goto(f"http://127.0.0.1:{link.port}/#drive")
        page.wait_for_selector(".pad")
        while len(found) < times:
            page.wait_for_selector(".chip.connected")
            with contextlib.suppress(Refused):  # retried on a busy machine
                if stage.state() in ("fault", "estop"):
                    stage.robot.reset()
                if stage.state() == "idle":
                    stage.robot.arm()
            press_pad(page)
            end_s = time.monotonic() + 3.0
            while state.read().setpoint_linear_m_s < 0.1 and time.monotonic() < end_s:
                time.sleep(0.001)
            driven = state.read().wanted_linear_m_s != 0.0
            began_s = time.monotonic()
            ending(page, link)
            while state.read().wanted_linear_m_s != 0.0:
                time.sleep(0.0005)
            if driven:
                found.append(1e3 * (time.monotonic() - began_s))
            link.cut = False
            page.mouse.up()
        page.close()
    return {
        "p50": round(percentile(found, 0.5), 1), "p99": round(percentile(found, 0.99), 1),
        "times": times,
    }  # fmt: skip


def heap_bytes(browser, port, seconds):
    """Return the size of JavaScript's heap on the page of plots: when its buffers are full, and at
    the end of this time.

    Each size is the least of several samples, each after a garbage collection: what is being drawn
    or has just arrived is alive in some samples, and what has leaked is alive in all."""
    page = browser.new_page()
    page.goto(f"http://127.0.0.1:{port}/#plots")
    session = page.context.new_cdp_session(page)

    def look():
        time.sleep(HEAP_LOOK_EVERY_S)
        session.send("HeapProfiler.collectGarbage")
        return session.send("Runtime.getHeapUsage")["usedSize"]

    found = []
    for pause_s in (HEAP_FILLS_S, seconds):
        time.sleep(pause_s)
        found.append(min(look() for _ in range(HEAP_LOOKS)))
    page.close()
    return {
        "full": found[0], "later": found[1], "seconds": seconds,
        "ratio": round(found[1] / found[0], 3),
    }  # fmt: skip


def eight_wheels():
    """Return a robot file: an omni base with the largest number of joints, on two lines."""
    text = """[robot]
name = "eight"
[base]
kind = "omni"
radius_m = 0.2
wheel_radius_m = 0.05
[limits]
linear_m_s = 0.3
linear_m_s2 = 0.5
linear_deceleration_m_s2 = 0.8
angular_rad_s = 1.5
angular_rad_s2 = 3.0
angular_deceleration_rad_s2 = 4.0
[safety]
drive_watchdog_s = 0.5
"""
    for line in (0, 1):
        text += f"""[line.claw{line}]
kind = "roboclaw"
port = "/dev/ttyUSB{line}"
baudrate = 115200
cycle_hz = 50
"""
    for wheel in range(WHEELS):
        text += f"""[joint.wheel{wheel}]
line = "claw{wheel // 4}"
drive = "roboclaw"
unit = {128 + wheel // 2 % 2}
channel = {1 + wheel % 2}
angle_rad = {wheel * 6.2831 / WHEELS:.4f}
velocity_max_rad_s = 12.0
"""
    return text


FRAMES = """() => {
    window.gaps_ms = [];
    let before = performance.now();
    const look = (now) => {
        window.gaps_ms.push(now - before);
        before = now;
        requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
}"""


def plots(browser, folder, seconds):
    """Show all plots of eight joints at 50 states a second; return how many states the page has
    missed, and figures of its animation frames."""
    file, port = Path(folder) / "eight.toml", free_port()
    file.parent.mkdir()
    file.write_text(eight_wheels(), encoding="utf-8")
    settings = ("publish.web.kind=web", f"publish.web.port={port}")
    numbers = []

    def count(raw):
        if isinstance(raw, bytes) and raw[0] == STATE:
            numbers.append(int.from_bytes(raw[5:9], "little"))

    with running(file.parent, *settings, robot=file) as stage:
        stage.wait_for("idle")
        wait_until(lambda: listens(port), "the dashboard listens")
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.on("websocket", lambda found: found.on("framereceived", count))
        page.goto(f"http://127.0.0.1:{port}/#plots")
        page.wait_for_selector("[data-plot=voltage] canvas")
        page.wait_for_timeout(1000.0)
        page.evaluate(FRAMES)
        numbers.clear()
        began_s = time.monotonic()
        page.wait_for_timeout(seconds * 1000.0)
        took_s = time.monotonic() - began_s
        gaps_ms = page.evaluate("window.gaps_ms")
        page.close()
    missed = sum(later - number - 1 for number, later in itertools.pairwise(numbers))
    return {
        "seconds": round(took_s, 1), "states": len(numbers), "missed": missed,
        "animation_frames": len(gaps_ms), "long": sum(gap > LONG_MS for gap in gaps_ms),
        "longest_ms": round(max(gaps_ms)),
    }  # fmt: skip


def in_chromium(stage, folder, port, times, heap_s, plots_s):
    """Run all measurements of this module on the stage's dashboard at this port."""
    chromium = installed_chromium()
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        chromium = None
    if chromium is None:
        return {"skipped": "no Chromium or no Playwright"}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium, headless=True, args=list(CHROMIUM_ARGUMENTS)
        )
        found = {"first_paint_ms": round(first_paint_ms(browser, port))}
        for ending in (released, hidden, cut):
            name = f"{ending.__name__}_to_zero_ms"
            found[name] = until_zero_ms(browser, stage, port, times, ending)
        found["plots"] = plots(browser, folder / "eight", plots_s)
        if heap_s > 0:
            found["heap_bytes"] = heap_bytes(browser, port, heap_s)
        browser.close()
    return found
