# SPDX-License-Identifier: Apache-2.0
"""Checks of a running daemon: the drives on each line, and five signs that the daemon works (its
heartbeats): process and threads, topics, rates, values, devices."""

from __future__ import annotations

import itertools
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from motord.api.status import Joint, LineStatus, Status
from motord.client import Client
from motord.tools.doctor.finding import Finding, Root, Verdict
from motord_hal.serial.sysfs import holders

LOOKS = 7
LOOK_PERIOD_S = 0.5
STEADY = 0.05
"""Largest deviation of a steady rate: part by which one window may differ from the nominal or mean
rate."""
FRESH_S = 1.0
VOLTAGE_V, TEMPERATURE_C = (5.0, 100.0), (-40.0, 125.0)
_STOPPED = {"T": "is stopped by a signal", "Z": "has ended", "D": "waits for a device"}
_LINE_THREADS = ("motord-line", "motord-can", "motord-board", "motord-pwm")


@dataclass(frozen=True, slots=True)
class Look:
    """A status of the daemon, and the time at which it came."""

    at_s: float
    found: Status


def observe(client: Client) -> list[Look]:
    """Read the status LOOKS times, each LOOK_PERIOD_S after the one before. Raise ClientError if
    the daemon does not answer."""
    looks = []
    for number in range(LOOKS):
        if number:
            time.sleep(LOOK_PERIOD_S)
        found = client.status()
        looks.append(Look(time.monotonic(), found))
    return looks


def judge(root: Root, looks: Sequence[Look]) -> Iterator[Finding]:
    """Yield the findings about the drives, then those about the heartbeats. The newest of the looks
    is the last one."""
    newest = looks[-1].found
    yield from _drives(newest)
    yield _state(newest)
    yield _process(root, looks)
    yield _topics(newest)
    yield from _rates(looks)
    yield from _values(newest)
    yield _holders(root, newest)


def _finding(group: str, check: str, verdict: Verdict, text: str, mend: str = "") -> Finding:
    return Finding(group=group, check=check, verdict=verdict, text=text, mend=mend)


# ------------------------------------------------------------------------------------------- drives
def _drives(found: Status) -> Iterator[Finding]:
    for name, line in found.lines.items():
        if line.state != "ready":
            text = line.waits_for or f"{line.state} at {line.port}"
            yield _finding("drive", f"line {name}", "fail", text, f"see {line.port}: plug, power")
        else:
            yield _finding("drive", f"line {name}", *_line_words(line))
    for name, joint in found.joints.items():
        if joint.fault_words:
            text = f"reports {', '.join(joint.fault_words)}"
            yield _finding("drive", f"joint {name}", "fail", text, "remove the cause; motord reset")
        elif joint.drive in ("unresponsive", "unknown"):
            yield _finding(
                "drive", f"joint {name}", "fail", f"its drive is {joint.drive}: it does not answer",
                "check its power, its cable and its address: motord scan PORT",
            )  # fmt: skip
        else:
            yield _finding("drive", f"joint {name}", "ok", f"its drive is {joint.drive}")


def _line_words(line: LineStatus) -> tuple[Verdict, str, str]:
    failed = sum(line.errors.values())
    part = failed / max(line.exchanges, 1)
    kinds = ", ".join(f"{count} {kind}" for kind, count in line.errors.items() if count)
    if part > 0.01:
        mend = "check shield, ground and termination; motord trace shows each exchange"
        return "warn", f"{part:.1%} of its exchanges fail: {kinds}", mend
    return "ok", f"ready at {line.port}, {line.cycle_hz:.0f} cycles/s, {kinds or 'no errors'}", ""


def _state(found: Status) -> Finding:
    if found.state in ("fault", "estop"):
        why = "; ".join(found.why or found.faults)
        return _finding("daemon", "state", "fail", f"{found.state}: {why}", "motord reset")
    return _finding("daemon", "state", "ok", found.state)


# --------------------------------------------------------------------------------------- heartbeats
def _process(root: Root, looks: Sequence[Look]) -> Finding:
    found = looks[-1].found
    check, task = "1 process and threads", f"/proc/{found.pid}/task"
    state = root.text(f"/proc/{found.pid}/stat").rpartition(")")[2].split()[:1]
    names = [path.read_text().strip() for path in root.glob(f"{task}/*/comm")]
    if state and state[0] in _STOPPED:
        text = f"process {found.pid} {_STOPPED[state[0]]}"
        return _finding("daemon", check, "fail", text, f"kill -CONT {found.pid}, or restart it")
    if found.loop.ticks == looks[0].found.loop.ticks:
        text = "the loop's thread stands still"
        return _finding("daemon", check, "fail", text, "restart the daemon: systemctl restart")
    wanted = sum(line.engine == "rt" and line.state != "closed" for line in found.lines.values())
    there = sum(name in _LINE_THREADS for name in names)
    if names and ("motord-loop" not in names or there < wanted):
        text = f"threads are missing; there are {', '.join(sorted(names))}"
        return _finding("daemon", check, "fail", text, "restart the daemon: systemctl restart")
    stalls = {name: count for name, count in found.stalls.items() if count}
    if stalls:
        text = f"stood still before: {', '.join(f'{n} {c} times' for n, c in stalls.items())}"
        return _finding("daemon", check, "warn", text, "motord latency: is the machine too busy?")
    return _finding("daemon", check, "ok", f"process {found.pid}, loop and {there} line threads")


def _topics(found: Status) -> Finding:
    """Check the ages of the data from which everything on the buses is made."""
    check, missing = "2 topics", []
    if found.odometry.age_s is None or found.odometry.age_s > FRESH_S:
        missing.append("odometry")
    missing += [
        f"joint {name}"
        for name, joint in found.joints.items()
        if joint.feedback_age_s is None or joint.feedback_age_s > FRESH_S
    ]
    if found.battery is not None and (found.battery.age_s is None or found.battery.age_s > 30.0):
        missing.append("battery")
    if found.imu is not None and (found.imu.age_s is None or found.imu.age_s > FRESH_S):
        missing.append("imu")
    if found.bus is not None and found.bus.get("pid") is None:
        missing.append("motord-bus")
    if missing:
        text = f"nothing new from {', '.join(missing)}"
        return _finding("daemon", check, "fail", text, "see its drive or line above; motord status")
    return _finding("daemon", check, "ok", "odometry and every joint are fresh")


def _rates(looks: Sequence[Look]) -> Iterator[Finding]:
    newest = looks[-1].found
    loop = _windows([(look.at_s, look.found.loop.ticks) for look in looks])
    yield _rate("loop", loop, newest.loop.rate_hz)
    for name, line in newest.lines.items():
        if line.state == "ready":
            cycles = [(look.at_s, look.found.lines[name].cycles) for look in looks]
            yield _rate(f"line {name}", _windows(cycles), None)
    yield from _published(looks)


def _published(looks: Sequence[Look]) -> Iterator[Finding]:
    """Check the rate of each topic of each publisher, of the daemon and of motord-bus, which
    reports once a second. The rate is over all looks, so that also a slow topic has messages."""
    own = [(look.at_s, look.found.publishers) for look in looks]
    of_bus = [
        (look.found.bus["at_s"], look.found.bus["publishers"])
        for look in looks
        if look.found.bus is not None and "at_s" in look.found.bus
    ]
    for reports in (own, of_bus):
        if len(reports) < 2 or reports[-1][0] <= reports[0][0]:
            continue
        span_s = reports[-1][0] - reports[0][0]
        for name, newest in reports[-1][1].items():
            before = reports[0][1].get(name, {}).get("topics", {})
            for topic, counted in newest.get("topics", {}).items():
                if counted["taken"] == 0:
                    text = "has had no message: the robot has nothing for it, or it has just begun"
                    yield _finding("daemon", f"3 rate of {name}/{topic}", "warn", text,
                                   "leave it out of topics in the robot file")  # fmt: skip
                elif topic in before:
                    grown = counted["taken"] - before[topic]["taken"]
                    yield _topic_rate(f"{name}/{topic}", grown, counted["rate_hz"], span_s)


def _topic_rate(what: str, messages: int, rate_hz: float, span_s: float) -> Finding:
    """Check the rate of a topic. One message more or less is no problem for a topic that has few in
    this time."""
    check, due = f"3 rate of {what}", rate_hz * span_s
    text = f"{messages / span_s:.1f} Hz of {rate_hz:g} Hz"
    if abs(messages - due) <= max(STEADY * due, 1.5):
        return _finding("daemon", check, "ok", text)
    mend = "lower its rate_hz in the robot file, or see its network: motord status"
    return _finding("daemon", check, "warn" if messages else "fail", text, mend)


def _windows(counts: Sequence[tuple[float, int]]) -> list[float]:
    """Return the rate between each two adjacent looks, in Hz."""
    return [
        (after[1] - before[1]) / (after[0] - before[0])
        for before, after in itertools.pairwise(counts)
    ]


def _rate(what: str, rates_hz: Sequence[float], nominal_hz: float | None) -> Finding:
    check, mean_hz = f"3 rate of {what}", statistics.fmean(rates_hz)
    if mean_hz <= 0.0:
        return _finding("daemon", check, "fail", "0 Hz", "see its drives above")
    around_hz = nominal_hz or mean_hz
    worst = max(abs(rate_hz - around_hz) / around_hz for rate_hz in rates_hz)
    if worst > STEADY:
        text = f"{mean_hz:.1f} Hz, off by up to {worst:.0%}"
        return _finding("daemon", check, "warn", text, "motord latency --suspects")
    return _finding("daemon", check, "ok", f"{mean_hz:.1f} Hz, within {worst:.1%}")


def _values(found: Status) -> Iterator[Finding]:
    for name, joint in found.joints.items():
        check = f"4 values of {name}"
        measures = (
            joint.position_rad, joint.velocity_rad_s, joint.current_a, joint.voltage_v,
            joint.temperature_c,
        )  # fmt: skip
        known = [value for value in measures if value is not None]
        odd = _implausible(joint)
        if not known:
            yield _finding("daemon", check, "warn", "its drive sends none", "see its drive above")
        elif odd:
            mend = "is it the right profile? motord drives; motord scan PORT"
            yield _finding("daemon", check, "warn", odd, mend)
        elif len(known) > 2 and not any(known):
            text = "all are zero: the drive answers, and measures nothing"
            yield _finding("daemon", check, "warn", text, "check encoder cable and profile")
        else:
            yield _finding("daemon", check, "ok", "plausible")


def _implausible(joint: Joint) -> str:
    for value, (low, high), unit in (
        (joint.voltage_v, VOLTAGE_V, "V"), (joint.temperature_c, TEMPERATURE_C, "°C"),
    ):  # fmt: skip
        if value is not None and not low <= value <= high:
            return f"{value:g} {unit} is not a plausible value"
    return ""


def _holders(root: Root, found: Status) -> Finding:
    check = "5 devices"
    ports = [line.port for line in found.lines.values() if line.port.startswith("/")]
    others = [
        f"{port}: {holder}"
        for port in ports
        for holder in holders(str(root.path(port)), root.path("/proc"))
        if not holder.endswith(f"(pid {found.pid})")
    ]
    if others:
        return _finding("daemon", check, "fail", f"also open: {'; '.join(others)}", "end it")
    return _finding("daemon", check, "ok", "no other program holds a device of the robot")
