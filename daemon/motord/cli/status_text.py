# SPDX-License-Identifier: Apache-2.0
"""The text of `motord status` for a person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import click

from motord.api.snapshot import Rest, not_known, rest_text


def show_status(found: dict[str, Any]) -> None:
    """Print the answer of `status`, one row a subject."""
    rows = [
        ("robot", f"{found['robot']} (process {found['pid']})"),
        ("state", found["state"]),
        *(("because", reason) for reason in found["why"]),
        ("rest", _rest(found)),
        ("faults", ", ".join(found["faults"])),
        ("reasons", ", ".join(_reasons(found))),
        ("command", _command(found)),
        ("odometry", _odometry(found["odometry"])),
        *((f"joint {name}", _joint(joint)) for name, joint in found["joints"].items()),
        ("battery", _battery(found["battery"])),
        ("imu", _imu(found["imu"])),
        ("loop", _loop(found["loop"])),
        ("e-stop", _contact(found["loop"]["estop_input"])),
        *(("", text) for text in found["loop"]["refusals"].values()),
        *(row for name, line in found["lines"].items() for row in _line_rows(name, line)),
        *(("lease", _lease(lease)) for lease in found["leases"]),
        *(("", lease["sparse"]) for lease in found["leases"]),
        ("held", held_text(found["held"])),
        ("may command", commanders_text(found["inputs"])),
    ]
    width = max(len(key) for key, _ in rows)
    for key, text in rows:
        if text:
            click.echo(f"{key:{width}}  {text}")


def _rest(found: dict[str, Any]) -> str:
    """Return whether the robot rests, with a warning if that is unknown."""
    text = rest_text(found["rest"], found["rest_unknown_s"], found["rest_unmeasured"])
    if found["rest"] != Rest.UNKNOWN:
        return text or found["rest"].replace("_", " ")
    longest_s = max(found["rest_unknown_s"].values(), default=0.0)
    return f"unknown for {longest_s:.1f} s: {text}"


def _telling(reasons: Sequence[str], state: str) -> list[str]:
    """Return the reasons without those that hold for every robot at rest."""
    usual = () if state in ("armed", "moving", "stopping") else ("not_armed", "command_stale")
    return [reason for reason in reasons if reason not in usual]


def _reasons(found: dict[str, Any]) -> list[str]:
    """Return each reason with its joint, and how long it has held."""
    return [
        _reason(name, found["limited"].get(name, {}))
        for name in _telling(found["reasons"], found["state"])
    ]


def _reason(name: str, about: Mapping[str, Any]) -> str:
    by = f" to {100 * about['factor']:.0f} % by {about['by']}" if "by" in about else ""
    names = about.get("joints", [about["joint"]] if "joint" in about else [])
    joint = f" of {', '.join(names)}" if names else ""
    lasts = f" for {about['for_s']:.1f} s" if "for_s" in about else ""
    return f"{name}{by}{joint}{lasts}"


def _sideways(lateral_m_s: float) -> str:
    """Return the lateral speed in words; empty for 0."""
    return f" {lateral_m_s:.3f} m/s to the left" if lateral_m_s else ""


def _command(found: dict[str, Any]) -> str:
    command = found["command"]
    return (
        f"{command['setpoint_linear_m_s']:.3f} m/s {command['setpoint_angular_rad_s']:.3f} rad/s"
        f"{_sideways(command['setpoint_lateral_m_s'])}, "
        f"requested {command['wanted_linear_m_s']:.3f} and {command['wanted_angular_rad_s']:.3f}"
        f"{_sideways(command['wanted_lateral_m_s'])}"
    )


def speed_text(at: Mapping[str, Any]) -> str:
    """Return the measured speed of the base; `at` is "odometry" of the answer of `status`."""
    if at["linear_m_s"] is None:
        return f"speed {not_known(at['age_s'])}"
    speed = f"{at['linear_m_s']:.3f} m/s {at['angular_rad_s']:.3f} rad/s"
    return speed + _sideways(at["lateral_m_s"])


def _odometry(at: dict[str, Any]) -> str:
    text = (
        f"x {at['x_m']:.3f} m, y {at['y_m']:.3f} m, heading {at['heading_rad']:.3f} rad, "
        f"{speed_text(at)}, {at['distance_m']:.2f} m in all"
    )
    return text + (" (degraded)" if at["degraded"] else "")


def _joint(joint: dict[str, Any]) -> str:
    measures = (
        ("velocity_rad_s", "rad/s", 2), ("current_a", "A", 2),
        ("voltage_v", "V", 1), ("temperature_c", "°C", 0),
    )  # fmt: skip
    parts = [f"drive {joint['drive']}"]
    if joint["takes_position"] and not joint["stale"]:
        at_rad = joint["position_rad"]
        parts.append("angle not known" if at_rad is None else f"at {at_rad:.3f} rad")
    parts += [
        f"{joint[key]:.{digits}f} {unit}"
        for key, unit, digits in measures
        if joint[key] is not None
    ]
    if joint["feedback_age_s"] is None:
        parts.append("no feedback yet")
    elif joint["stale"]:
        parts.append(f"measured values {not_known(joint['feedback_age_s'])}")
    else:
        parts.append(f"feedback {joint['feedback_age_s'] * 1000:.0f} ms ago")
    return ", ".join([*parts, *joint["fault_words"]])


def _battery(battery: dict[str, Any] | None) -> str:
    if battery is None:
        return ""
    measures = (("voltage_v", "V", 2), ("current_a", "A", 2), ("temperature_c", "°C", 0))
    parts = [battery["state"]]
    parts += [
        f"{battery[key]:.{digits}f} {unit}"
        for key, unit, digits in measures
        if battery[key] is not None
    ]
    return ", ".join(parts)


def _imu(imu: dict[str, Any] | None) -> str:
    if imu is None:
        return ""
    rate_rad_s, zero_rad_s = imu["angular_rad_s"][2], imu["bias_rad_s"]
    parts = [
        {"unbiased": "its zero is not known yet: let the base stand"}.get(
            imu["state"], imu["state"]
        )
    ]
    parts.append(f"heading by {'gyro' if imu['heading_by_gyro'] else 'wheels'}")
    if rate_rad_s is not None:
        parts.append(f"{rate_rad_s:.3f} rad/s")
    if zero_rad_s is not None:
        parts.append(f"zero at {zero_rad_s:.4f} rad/s")
    if imu["refused"]:
        parts.append(f"{imu['refused']} samples refused")
    return ", ".join(parts)


def _contact(found: str) -> str:
    return "" if found == "none" else f"the contact is {found}"


def _loop(loop: dict[str, Any]) -> str:
    late = loop["lateness_us"]
    return (
        f"{loop['rate_hz']:g} Hz {loop['policy']}, late {late['p50']:.0f} µs p50, "
        f"{late['p99']:.0f} µs p99, {late['max']:.0f} µs max, {loop['overruns']} overruns"
    )


def _line_rows(name: str, line: dict[str, Any]) -> list[tuple[str, str]]:
    waits_for = line["waits_for"]
    return [(f"line {name}", _line(line)), ("", f"waits: {waits_for}" if waits_for else "")]


def _line(line: dict[str, Any]) -> str:
    trip = line["round_trip_us"]
    errors = ", ".join(f"{count} {kind}" for kind, count in line["errors"].items() if count)
    return (
        f"{line['state']} at {line['port']}, {line['cycle_hz']:.0f} of {line['requested_hz']:.0f} "
        "cycles/s, "
        f"{trip['p50'] / 1000:.1f} ms p50 {trip['max'] / 1000:.1f} ms max a round trip, "
        f"{errors or 'no errors'}"
    )


def commanders_text(inputs: Sequence[Mapping[str, Any]]) -> str:
    """Return the sources that may command, by falling priority; `inputs` as `status` has them."""
    rows = sorted(inputs, key=lambda source: -source["priority"])
    texts = (f"{row['name']} ({row['kind']}, priority {row['priority']})" for row in rows)
    return ", ".join(texts) or "no source: every input of the robot file is switched off"


def held_text(held: Sequence[Mapping[str, Any]]) -> str:
    """Return who is held, why, and how it moves the robot again; empty: no source is held."""
    if not held:
        return ""
    names = ", ".join(map(_silent, held))
    return f"{names}: held, since {held[0]['why']}. {held[0]['release']}"


def _silent(held: Mapping[str, Any]) -> str:
    if held["silent_for_s"] is None:
        return f"{held['owner']} (gone)"
    return f"{held['owner']} (newest command {held['silent_for_s']:.1f} s ago)"


def _lease(lease: dict[str, Any]) -> str:
    held = ", held" if lease["held"] else ""
    return (
        f"{lease['owner']} priority {lease['priority']}: {lease['linear_m_s']:.3f} m/s "
        f"{lease['angular_rad_s']:.3f} rad/s{_sideways(lease['lateral_m_s'])}{held}"
    )
