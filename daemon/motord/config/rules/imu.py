# SPDX-License-Identifier: Apache-2.0
"""Rules between [imu] and the rest of a robot file."""

from __future__ import annotations

from collections.abc import Iterator

from motord.config.finding import Finding
from motord.config.sections.imu import ChipImu, LineImu
from motord.config.sections.line import AsciiLine, McuLine
from motord.config.sections.model import Robot

SAMPLES_PER_TIMEOUT = 2.5
"""Least number of samples in a timeout: two may be lost, or late, before the wheels give the
heading."""


def imu_axes(robot: Robot) -> Iterator[Finding]:
    """Check that up and forward are two axes."""
    imu = robot.imu
    if imu is not None and imu.up[-1] == imu.forward[-1]:
        at = (("imu", "forward"), ("imu", "up"))
        yield Finding(at, f"forward and up are the same axis of the sensor ({imu.up[-1]})")


def imu_line(robot: Robot) -> Iterator[Finding]:
    """Check that the line exists, and can carry a gyro."""
    imu = robot.imu
    if not isinstance(imu, LineImu):
        return
    line = robot.line.get(imu.line)
    at = (("imu", "line"), ("line", imu.line))
    if line is None:
        yield Finding(at, f'there is no line "{imu.line}" (known: {", ".join(robot.line)})')
    elif not isinstance(line, McuLine | AsciiLine):
        yield Finding(at, f'a line of kind "{line.kind}" carries no gyro (mcu and ascii do)')
    elif isinstance(line, AsciiLine):
        if "{gyro_z_rad_s" not in (line.feedback or ""):
            place = ("line", imu.line, "feedback")
            text = "the template of the feedback has no {gyro_z_rad_s}"
            yield Finding((place, ("imu", "line")), text)
        if imu.up[-1] != "z":
            yield Finding((("imu", "up"),), "a line of text has the rate about z alone (z or -z)")


def imu_rates(robot: Robot) -> Iterator[Finding]:
    """Check that samples come often enough for their timeout, and not more often than the loop
    ticks."""
    imu = robot.imu
    if isinstance(imu, ChipImu):
        rate_hz, where = imu.rate_hz, ("imu", "rate_hz")
    elif imu is not None and imu.line in robot.line:
        rate_hz, where = robot.line[imu.line].cycle_hz, ("line", imu.line)
    else:
        return
    if imu.timeout_s * rate_hz < SAMPLES_PER_TIMEOUT:
        text = f"too short for {rate_hz:g} samples a second"
        least_s = SAMPLES_PER_TIMEOUT / rate_hz
        yield Finding((("imu", "timeout_s"), where), f"{text} (at least {least_s:.3g} s)")
    if rate_hz > robot.loop.rate_hz:
        text = f"more than the loop can take ({robot.loop.rate_hz:g} a second)"
        yield Finding((where, ("loop", "rate_hz")), f"{rate_hz:g} samples a second are {text}")
