# SPDX-License-Identifier: Apache-2.0
"""The content of `motord top` as styled text: made from the answers of the daemon alone, without a
screen.

Every line fits into 80 columns."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.text import Text

from motord.api.snapshot import Rest, not_known, rest_text
from motord.api.status import Joint, LineStatus, Status

TREND = 12
"""Number of values that a trend shows."""
GREW_WITHIN_S = 10.0
_BARS = "▁▂▃▄▅▆▇█"
_STATE_STYLES = {
    "moving": "bold black on green", "armed": "bold black on yellow",
    "stopping": "bold black on yellow", "idle": "bold white on blue",
    "fault": "bold white on red", "estop": "bold white on red",
}  # fmt: skip
_LEVEL_STYLES = {"warning": "yellow", "error": "bold red", "critical": "bold red"}
HEAD = "bold cyan"


def trend(values: Iterable[float], width: int = TREND) -> str:
    """Return bars for the newest values. The scale is their range, extended to include zero; a
    value that is not finite is a gap."""
    newest = list(values)[-width:]
    numbers = [value for value in newest if math.isfinite(value)]
    low, high = min([*numbers, 0.0]), max([*numbers, 0.0])
    step = (high - low) / (len(_BARS) - 1) or 1.0
    bars = [_BARS[round((v - low) / step)] if math.isfinite(v) else " " for v in newest]
    return "".join(bars).rjust(width)


class History:
    """Changes since earlier answers: speeds, lateness and error counters."""

    def __init__(self) -> None:
        self._speeds: dict[str, deque[float]] = {}
        self._lateness: deque[float] = deque(maxlen=TREND)
        self._errors: dict[tuple[str, str], tuple[int, float]] = {}

    def add(self, found: Status, now_s: float) -> None:
        for name, joint in found.joints.items():
            speeds = self._speeds.setdefault(name, deque(maxlen=TREND))
            speeds.append(math.nan if joint.velocity_rad_s is None else joint.velocity_rad_s)
        self._lateness.append(found.loop.lateness_us.p99)
        for line, status in found.lines.items():
            for kind, count in status.errors.items():
                before, grew_s = self._errors.get((line, kind), (count, -math.inf))
                self._errors[line, kind] = count, now_s if count > before else grew_s

    def speeds(self, joint: str) -> str:
        return trend(self._speeds.get(joint, ()))

    def lateness(self) -> str:
        return trend(self._lateness)

    def grows(self, line: str, kind: str, now_s: float) -> bool:
        """Return whether this error counter grew in the last GREW_WITHIN_S."""
        return now_s - self._errors.get((line, kind), (0, -math.inf))[1] < GREW_WITHIN_S


@dataclass(frozen=True, slots=True)
class Advice:
    """Meaning of the robot's state for the person in front of the screen."""

    text: str
    urgent: bool = False


def advice(found: Status) -> Advice:
    """Return why the robot is in its state, and what to do about it; before all a warning while it
    is unknown whether the robot rests."""
    on_state = _advice_on_state(found)
    if found.rest != Rest.UNKNOWN:
        return on_state
    warning = rest_text(found.rest, found.rest_unknown_s)
    return Advice(f"{warning}. {on_state.text}", urgent=True)


def _advice_on_state(found: Status) -> Advice:
    waits = [line.waits_for for line in found.lines.values() if line.waits_for]
    commander = found.leases[0] if found.leases else None
    match found.state:
        case "fault" | "estop":
            why = "; ".join(found.why or found.faults)
            return Advice(f"{why}. Remove the cause, then r resets.", urgent=True)
        case "idle" if waits:
            return Advice(f"Cannot be armed yet: {waits[0]}", urgent=True)
        case "idle":
            return Advice("The drives are off. a arms: then commands move the robot.")
        case "configuring" | "off":
            return Advice(waits[0] if waits else "The drives are being configured.")
        case "stopping":
            return Advice("It comes to rest.")
        case _ if found.held:
            names = ", ".join(one.owner for one in found.held)
            return Advice(f"Held until zero: {names}. a lets them go on.", urgent=True)
        case "armed" if commander is None:
            return Advice("Powered, at rest. Any command moves the robot.")
    limits = [name for name in found.reasons if name not in ("not_armed", "command_stale")]
    owner = commander.owner if commander is not None else "no source"
    return Advice(f"{owner} commands" + (f"; limited by {', '.join(limits)}" if limits else ""))


def header(found: Status) -> Text:
    """Return state, advice and odometry, in three lines."""
    words, at, to = advice(found), found.odometry, found.command
    text = Text(no_wrap=True, overflow="ellipsis")
    text.append(f" {found.state.upper()} ", _STATE_STYLES.get(found.state, "bold reverse"))
    text.append(f" {found.robot}  ", "bold")
    text.append(words.text + "\n", "bold red" if words.urgent else "")
    speed = f"{_fixed(at.linear_m_s, 2)} m/s {_fixed(at.angular_rad_s, 2)} rad/s"
    text.append(
        f"speed {not_known(at.age_s) if at.linear_m_s is None else speed}  set-point "
        f"{_fixed(to.setpoint_linear_m_s, 2)} {_fixed(to.setpoint_angular_rad_s, 2)}  "
    )
    text.append(_battery(found))
    text.append(
        f"\npose  x {_fixed(at.x_m, 2)} m  y {_fixed(at.y_m, 2)} m  "
        f"heading {_fixed(at.heading_rad, 2)} rad  driven {_fixed(at.distance_m, 1)} m"
    )
    return text


def _battery(found: Status) -> str:
    if found.battery is None or found.battery.voltage_v is None:
        return ""
    return f"battery {found.battery.voltage_v:.1f} V {found.battery.state}"


def joints(found: Status, history: History) -> Text:
    """Return a heading and a line for each joint."""
    text = Text(no_wrap=True, overflow="ellipsis")
    heading = f"{'joint':12} {'drive':9}{'set':>7}{'rad/s':>7}{'A':>6}{'°C':>5}{'age ms':>8}  trend"
    text.append(heading, HEAD)
    for name, joint in found.joints.items():
        bad = bool(joint.fault_words) or joint.stale or joint.drive == "unresponsive"
        text.append(
            f"\n{name[:12]:12} {joint.drive[:8]:9}{_fixed(joint.setpoint_rad_s, 2):>7}"
            f"{_measured(joint):>26}  ",
            "bold red" if bad else "",
        )
        text.append(history.speeds(name), "green")
        text.append("".join(f" {word}" for word in joint.fault_words), "bold red")
    return text


def _measured(joint: Joint) -> str:
    """Return what the joint's newest feedback shows, in 26 columns."""
    if joint.stale:
        return not_known(joint.feedback_age_s)
    return (
        f"{_fixed(joint.velocity_rad_s, 2):>7}{_fixed(joint.current_a, 2):>6}"
        f"{_fixed(joint.temperature_c, 0):>5}{_age_ms(joint):>8}"
    )


def _age_ms(joint: Joint) -> str:
    return _fixed(None if joint.feedback_age_s is None else 1000 * joint.feedback_age_s, 0)


def lines(found: Status, history: History, now_s: float) -> Text:
    """Return a line for each fieldbus line, then one for the loop."""
    text = Text(no_wrap=True, overflow="ellipsis")
    text.append(f"{'line':12} {'state':12}{'cycles/s':>9}{'p50 ms':>8}{'max ms':>8}  errors", HEAD)
    for name, line in found.lines.items():
        style = "" if line.state == "ready" else "bold red"
        text.append(f"\n{name[:12]:12} {line.state[:11]:12}{_numbers(line)}  ", style)
        errors = {kind: count for kind, count in line.errors.items() if count}
        for kind, count in errors.items():
            grows = history.grows(name, kind, now_s)
            text.append(f"{count} {kind} ", "bold yellow" if grows else "dim")
        if not errors:
            text.append("none", "dim")
    loop, late = found.loop, found.loop.lateness_us
    text.append(f"\n{'loop':12} {loop.policy[6:]:12}{loop.rate_hz:9.0f}  ")
    text.append(
        f"late {_fixed(late.p50, 0)} µs p50 {_fixed(late.p99, 0)} p99 {_fixed(late.max, 0)} max  "
        f"{loop.overruns} overruns"
    )
    return text


def _numbers(line: LineStatus) -> str:
    trip = line.round_trip_us
    return (
        f"{_fixed(line.cycle_hz, 0):>9}{_fixed(trip.p50 / 1000, 1):>8}"
        f"{_fixed(trip.max / 1000, 1):>8}"
    )


def leases(found: Status) -> Text:
    """Return the source in command, then the other ones."""
    text = Text(no_wrap=True, overflow="ellipsis")
    text.append(f"{'source':20} {'priority':>8}{'m/s':>8}{'rad/s':>8}{'1/s':>6}", HEAD)
    for number, lease in enumerate(found.leases):
        text.append(
            f"\n{lease.owner[:20]:20} {lease.priority:8}{_fixed(lease.linear_m_s, 2):>8}"
            f"{_fixed(lease.angular_rad_s, 2):>8}{_fixed(lease.rate_hz, 0):>6}  ",
            "bold" if number == 0 else "dim",
        )
        words = "held until it sends zero" if lease.held else lease.sparse or lease.why
        text.append(words, "bold red" if lease.sparse else "dim")
    if not found.leases:
        text.append("\nno source commands", "dim")
    return text


def log_line(record: Mapping[str, Any]) -> Text:
    """Return a record of the method `log` as a line."""
    clock = time.strftime("%H:%M:%S", time.localtime(record["time_s"]))
    text = Text(f"{clock} ", "dim")
    text.append(record["text"], _LEVEL_STYLES.get(record["level"], ""))
    return text


def log_tail(records: Sequence[Mapping[str, Any]], rows: int) -> Text:
    """Return the newest records, as many as there are rows."""
    newest = records[-rows:] if rows > 0 else ()
    return Text("\n", no_wrap=True, overflow="ellipsis").join(map(log_line, newest))


def _fixed(value: float | None, digits: int) -> str:
    """Format a value, with no sign for zero; a dash if it is not measured."""
    if value is None or not math.isfinite(value):
        return "–"
    shown = f"{value:.{digits}f}"
    return shown.removeprefix("-") if not shown.strip("-0.") else shown
