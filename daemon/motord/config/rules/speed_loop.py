# SPDX-License-Identifier: Apache-2.0
"""Rules between the speed loop of a joint and its drive."""

from __future__ import annotations

from collections.abc import Iterator

from motord.config.finding import Finding
from motord.config.sections.joint.speed_loop import DUTY_KEYS, TORQUE_KEYS
from motord.config.sections.joint.wheels import (
    Profiles,
    measures_speed,
    takes_duty,
    takes_torque,
    torque_max_n_m,
)
from motord.config.sections.model import Joint, Robot
from motord.config.toml_lines import Path

_ROUNDING = 1e-6


def speed_loops(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Check that a drive that takes a torque has a loop; one that takes a duty may have one, and
    one that holds the speed has its own."""
    for name, joint in robot.joint.items():
        profile = profiles[joint.drive]
        if takes_torque(joint, profile):
            yield from _torque(name, joint, torque_max_n_m(joint, profile))
        elif joint.speed_loop is None:
            continue
        elif not takes_duty(joint, profile):
            loop, drive = _paths(name)
            text = f'is not used: drive "{joint.drive}" holds the speed by itself'
            yield Finding((loop, drive), text, warning=True)
        else:
            yield from _duty(name, joint, measured=measures_speed(joint, profile))


def _paths(name: str) -> tuple[Path, Path]:
    return ("joint", name, "speed_loop"), ("joint", name, "drive")


def _torque(name: str, joint: Joint, most_n_m: float) -> Iterator[Finding]:
    loop, drive = _paths(name)
    takes = f'drive "{joint.drive}" takes a torque'
    if joint.velocity_max_rad_s is None:
        path = ("joint", name, "velocity_max_rad_s")
        yield Finding((path, drive), f"is missing: {takes}, and knows no speed at most")
    if joint.speed_loop is None:
        yield Finding((loop, drive), f"is missing: {takes}, and motord holds the speed")
        return
    yield from _others(loop, joint, DUTY_KEYS, takes)
    if "gain_n_m_s_per_rad" not in joint.speed_loop.model_fields_set:
        yield Finding(((*loop, "gain_n_m_s_per_rad"), loop), f"is missing: {takes}")
    given_n_m = joint.speed_loop.torque_max_n_m
    if given_n_m is None:
        yield Finding(((*loop, "torque_max_n_m"), loop), f"is missing: {takes} (N·m at the wheel)")
    elif given_n_m > most_n_m * (1 + _ROUNDING):
        text = f'is more than drive "{joint.drive}" takes (at most {most_n_m:.4g} N·m at the wheel)'
        yield Finding(((*loop, "torque_max_n_m"), drive), text)


def _duty(name: str, joint: Joint, *, measured: bool) -> Iterator[Finding]:
    loop, drive = _paths(name)
    if not measured:
        text = (
            f'needs a measured speed, and drive "{joint.drive}" reports neither speed nor counts: '
            "give the joint an encoder (counts_per_turn or [joint.NAME.encoder]), or take this out"
        )
        yield Finding((loop, drive), text)
    yield from _others(loop, joint, TORQUE_KEYS, f'drive "{joint.drive}" takes a duty')


def _others(loop: Path, joint: Joint, keys: frozenset[str], takes: str) -> Iterator[Finding]:
    """Report keys in the unit of the other kind of drive."""
    assert joint.speed_loop is not None
    for key in sorted(keys & joint.speed_loop.model_fields_set):
        yield Finding(((*loop, key),), f"has the wrong unit: {takes}")
