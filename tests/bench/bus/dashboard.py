# SPDX-License-Identifier: Apache-2.0
"""The cost of the dashboard, in this run: python -m tests.bench.bus.dashboard [--heap-s 0].

Bytes of the page; the robot's side with one viewer against none; the loop's lateness with fifty
viewers against none, in turns; and in Chromium, where there is one, the first paint with a
processor six times slower, the time from each end of a hold to a requested speed of zero,
plots of eight joints, and the growth of the heap.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import tempfile
import time
from pathlib import Path

import aiohttp
from tests.bench.bus.dashboard_page import SLOW_DOWN, in_chromium
from tests.sim.daemon_stage import running, wait_until
from tests.sim.web.web_page import free_port, listens

from motord.bus.web.assets import assets

ACKNOWLEDGE = 2
VIEWERS = 50
RATE_HZ = 20
BYTES_MAX, CPU_MAX, PAINT_MS, LATER, HEAP_GROWS = 250_000, 0.03, 1000, 1.1, 1.2


async def viewer(port, until_s, counts):
    """Read and acknowledge frames as a page does; add the size of each to `counts`."""
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
    """Return the sizes of all frames that this many viewers receive in this time."""

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
    """Return the shares of one core that motord-bus and the daemon take, and frames a second."""
    pids = (stage.robot.status()["bus"]["pid"], stage.robot.status()["pid"])
    before = [cpu_s(pid) for pid in pids]
    began_s = time.monotonic()
    frames = watch(port, viewers, seconds)
    took_s = time.monotonic() - began_s
    shares = [(cpu_s(pid) - old) / took_s for pid, old in zip(pids, before, strict=True)]
    return {"motord_bus": shares[0], "daemon": shares[1], "frames_s": len(frames) / took_s}


def lateness_us(stage, port, viewers, seconds):
    """Return p50 and p99 of the lateness of the ticks during this time."""
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


def measure(seconds, rounds, times, heap_s, plots_s):
    """Return all figures. `seconds`: length of each measurement on the robot's side; `rounds`:
    number of lateness pairs; `times`: number of holds that are ended in each manner."""
    port = free_port()
    settings = (
        "input.web.kind=web", f"input.web.port={port}", "input.web.trust_loopback=true",
        "loop.rate_hz=1000",
    )  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="motord-bench-") as name:
        folder = Path(name)
        (folder / "robot").mkdir()
        with running(folder / "robot", *settings) as stage:
            stage.wait_for("idle")
            wait_until(lambda: listens(port), "the dashboard listens")
            wait_until(lambda: stage.robot.status()["bus"].get("pid"), "motord-bus")
            time.sleep(min(3.0, seconds))  # every process has started by then
            none, one = (cpu_share(stage, port, count, seconds) for count in (0, 1))
            pairs = [
                (lateness_us(stage, port, 0, seconds), lateness_us(stage, port, VIEWERS, seconds))
                for _ in range(rounds)
            ]
            browser = in_chromium(stage, folder, port, times, heap_s, plots_s)
    packed = {id(asset): len(asset.packed) for asset in assets().values()}
    ratio = [statistics.median(b[i] / a[i] for a, b in pairs) for i in (0, 1)]
    return {
        "bytes": sum(packed.values()),
        "cpu_share": {"none": none, "one": one},
        "lateness_us": [{"none": a, f"{VIEWERS} viewers": b} for a, b in pairs],
        "lateness_ratio": {"p50": round(ratio[0], 3), "p99": round(ratio[1], 3)},
    } | browser


def verdicts(found):
    """Return the verdicts as `wire.verdicts` does."""
    share = found["cpu_share"]["one"]["motord_bus"] - found["cpu_share"]["none"]["motord_bus"]
    late = found["lateness_ratio"]["p99"]
    rows = [
        (f"the page has {found['bytes'] / 1e3:.0f} kB compressed ({BYTES_MAX / 1e3:g})",
         found["bytes"] < BYTES_MAX),
        (f"one page costs motord-bus {100 * share:.1f} % of a core ({100 * CPU_MAX:g})",
         share < CPU_MAX),
        (f"{VIEWERS} pages: lateness p99 {late:.2f} times ({LATER})", late <= LATER),
    ]  # fmt: skip
    if "skipped" not in found:
        paint_ms, seen = found["first_paint_ms"], found["plots"]
        rows += [
            (f"first paint at CPU x{SLOW_DOWN}: {paint_ms} ms ({PAINT_MS})", paint_ms < PAINT_MS),
            (f"{seen['states']} states of 8 joints plotted, {seen['missed']} missed (0)",
             seen["missed"] == 0),
        ]  # fmt: skip
    if "heap_bytes" in found:
        grown = found["heap_bytes"]["ratio"]
        rows.append((f"heap {grown:.2f} times ({HEAP_GROWS})", grown <= HEAP_GROWS))
    return [(text, reached, False) for text, reached in rows]


def table(found):
    return "the dashboard:\n" + json.dumps(found, indent=1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15.0, help="duration of a measurement")
    parser.add_argument("--rounds", type=int, default=3, help="pairs of lateness measurements")
    parser.add_argument("--times", type=int, default=100, help="releases of the pad")
    parser.add_argument("--plots-s", type=float, default=60.0, help="duration of the plots")
    parser.add_argument("--heap-s", type=float, default=3600.0, help="0: the heap is not measured")
    options = vars(parser.parse_args())
    print(json.dumps(measure(**options), indent=2))
