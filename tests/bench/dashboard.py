# SPDX-License-Identifier: Apache-2.0
"""What the dashboard costs, in this run: python tests/bench/dashboard.py [--heap-s 0].

Bytes of the page; the robot's side with one viewer against none; the loop's lateness with fifty
viewers against none, in turns; and in Chromium, where there is one, the first paint with a
processor six times slower and the time from each end of the dead-man to a requested speed of zero.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import shutil
import socket
import statistics
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "daemon"), str(ROOT / "hal")]

import aiohttp  # noqa: E402
from tests.browser.dashboard import CHROMIUM_ARGUMENTS, press_pad  # noqa: E402
from tests.browser.link_proxy import LinkProxy  # noqa: E402
from tests.sim.daemon_stage import running, wait_until  # noqa: E402

from motord.api.state_page import StatePage  # noqa: E402
from motord.bus.web.assets import assets  # noqa: E402

ACKNOWLEDGE = 2
SLOW_DOWN = 6
VIEWERS = 50
RATE_HZ = 20


def percentile(values, part):
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(part * len(ordered)))]


async def viewer(port, until_s, counts):
    """A page that reads and acknowledges."""
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"http://127.0.0.1:{port}/socket", protocols=("motord.1",)) as page,
    ):
        await page.send_json({"rate_hz": RATE_HZ})
        while time.monotonic() < until_s:
            message = await page.receive()
            if message.type == aiohttp.WSMsgType.BINARY:
                counts.append(len(message.data))
                await page.send_bytes(bytes((ACKNOWLEDGE,)) + message.data[5:9])


def watch(port, viewers, seconds):
    """Frames that so many viewers have received."""

    async def run():
        counts = []
        until_s = time.monotonic() + seconds
        async with asyncio.TaskGroup() as tasks:
            for _ in range(viewers):
                tasks.create_task(viewer(port, until_s, counts))
        return counts

    if viewers == 0:
        time.sleep(seconds)
        return []
    return asyncio.run(run())


def cpu_s(pid):
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def cpu_share(stage, port, viewers, seconds):
    """Of one core, of motord-bus and of the daemon."""
    pids = (stage.robot.status()["bus"]["pid"], stage.robot.status()["pid"])
    before = [cpu_s(pid) for pid in pids]
    began_s = time.monotonic()
    frames = watch(port, viewers, seconds)
    took_s = time.monotonic() - began_s
    shares = [(cpu_s(pid) - old) / took_s for pid, old in zip(pids, before, strict=True)]
    return {"motord_bus": shares[0], "daemon": shares[1], "frames_s": len(frames) / took_s}


def lateness_us(stage, port, viewers, seconds):
    """p50 and p99 of the ticks meanwhile."""
    before = {low: n for low, _, n in stage.robot.call("latency")["buckets"]["lateness"]}
    watch(port, viewers, seconds)
    after = stage.robot.call("latency")["buckets"]["lateness"]
    rows = [(high / 1e3, n - before.get(low, 0)) for low, high, n in after]
    total = sum(n for _, n in rows)

    def reached(part):
        so_far = 0
        for high, n in rows:
            so_far += n
            if so_far >= part * total:
                return high
        return rows[-1][0]

    return reached(0.5), reached(0.99)


def first_paint_ms(browser, port):
    """Median of five loads without a cache."""
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
    """From an ending of the dead-man to the first requested speed of zero on the state page. The
    ramp that follows is the robot's limits."""
    found = []
    with StatePage.open(stage.robot.status()["robot"]) as state, LinkProxy(port) as link:
        page = browser.new_page()
        page.goto(f"http://127.0.0.1:{link.port}/#drive")
        page.wait_for_selector(".pad")
        while len(found) < times:
            page.wait_for_selector(".chip.connected")
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
    """JavaScript's heap after a collection, on the page of plots: when it has run for a minute,
    which fills its buffers, and so long after that."""
    page = browser.new_page()
    page.goto(f"http://127.0.0.1:{port}/#plots")
    session = page.context.new_cdp_session(page)
    found = []
    for pause_s in (60.0, seconds):
        time.sleep(pause_s)
        session.send("HeapProfiler.collectGarbage")
        found.append(session.send("Runtime.getHeapUsage")["usedSize"])
    page.close()
    return {"after_60_s": found[0], f"after_{60 + seconds:g}_s": found[1],
            "ratio": round(found[1] / found[0], 3)}  # fmt: skip


def in_chromium(stage, port, times, heap_s):
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
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
        if heap_s > 0:
            found["heap_bytes"] = heap_bytes(browser, port, heap_s)
        browser.close()
    return found


def measured(seconds, rounds, times, heap_s):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    settings = (
        "input.web.kind=web", f"input.web.port={port}", "input.web.trust_loopback=true",
        "loop.rate_hz=1000",
    )  # fmt: skip
    folder = Path(tempfile.mkdtemp(prefix="motord-bench-"))
    with running(folder, *settings) as stage:
        stage.wait_for("idle")
        wait_until(lambda: stage.robot.status()["bus"].get("pid"), "motord-bus")
        time.sleep(3.0)  # what starts has started
        none, one = (cpu_share(stage, port, count, seconds) for count in (0, 1))
        pairs = [
            (lateness_us(stage, port, 0, seconds), lateness_us(stage, port, VIEWERS, seconds))
            for _ in range(rounds)
        ]
        browser = in_chromium(stage, port, times, heap_s)
    packed = {id(asset): len(asset.packed) for asset in assets().values()}
    ratio = [statistics.median(b[i] / a[i] for a, b in pairs) for i in (0, 1)]
    return {
        "bytes": sum(packed.values()),
        "cpu_share": {"none": none, "one": one},
        "lateness_us": [{"none": a, f"{VIEWERS} viewers": b} for a, b in pairs],
        "lateness_ratio": {"p50": round(ratio[0], 3), "p99": round(ratio[1], 3)},
    } | browser


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15.0, help="of each measurement")
    parser.add_argument("--rounds", type=int, default=3, help="pairs of lateness")
    parser.add_argument("--times", type=int, default=100, help="releases of the pad")
    parser.add_argument("--heap-s", type=float, default=3600.0, help="0: the heap is not measured")
    options = vars(parser.parse_args())
    print(json.dumps(measured(**options), indent=2))
