# SPDX-License-Identifier: Apache-2.0
"""The course of a shipped robot with another counter, sample by sample, and how well the core
measures its speed. `python -m tests.rt.odometry.twist_noise` prints the table."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from _motord_rt import ffi, lib

from motord.config import Robot, load_robot
from motord.control.assembly import core_config
from motord.realtime.raw_config import raw_config
from motord.tools.course import COURSE, STRAFING, command_at

ROBOTS = Path(__file__).resolve().parents[3] / "config" / "robots"
NAMES = (
    "arduino-text", "cia402-two", "demo", "esp32", "lekiwi-base", "mecanum4", "odrive-two",
    "roboclaw", "skid4", "turtlebot3-burger",
)  # fmt: skip
TURNS = 20_000
COUNTERS = {"fine": 2**16, "hall": 90, "float": 2**13}
"""Counts per turn of the wheel; the float counter is one of 32 bits, TURNS turns from its zero."""
SECONDS = 18.0
STEP_S = 0.001
LAG_S = 0.02
"""Time constant with which a wheel follows its set-point."""
STAMP_S = 0.0002
"""Deviation of a stamp from the moment of its sample."""
AXES = 3


@dataclass
class Measured:
    """Errors of the measured twist in deviations, and in units, axis by axis."""

    deviations: list[float]
    errors: list[float]

    def within(self) -> float:
        return 100.0 * sum(abs(e) <= 2.0 for e in self.deviations) / len(self.deviations)

    def root_mean_square(self) -> float:
        return math.sqrt(sum(e * e for e in self.errors) / len(self.errors))


def twists(robot: Robot) -> Iterator[tuple[float, ...]]:
    """Yield the true twist of each millisecond: the course, within the robot's limits, each part
    followed with a lag."""
    limits = robot.limits
    slope = (limits.linear_m_s2, limits.angular_rad_s2, limits.lateral_m_s2)
    most = (limits.linear_m_s, limits.angular_rad_s, limits.lateral_m_s)
    course = STRAFING if robot.base.strafes else COURSE
    ramp, now = [0.0] * AXES, [0.0] * AXES
    for step in range(round(SECONDS / STEP_S)):
        wanted = (*command_at(step * STEP_S, SECONDS - 1.0, course), 0.0)[:AXES]
        for i, want in enumerate(wanted):
            want = max(-most[i], min(most[i], want))
            ramp[i] += max(-slope[i] * STEP_S, min(slope[i] * STEP_S, want - ramp[i]))
            now[i] += (ramp[i] - now[i]) * STEP_S / LAG_S
        yield tuple(now)


def _velocity_step_rad_s(robot: Robot, name: str) -> float:
    """Return the step of the speed that the drive reports, at the wheel; 0: it reports none."""
    joint = robot.joint[name]
    profile = robot.profiles[joint.drive]
    register = profile.channels[joint.channel].velocity
    if register is None:
        return 0.0
    found = profile.registers[register]
    step = abs(found.to_si(1) - found.to_si(0)) / joint.gear_ratio
    return max(step, 1e-4)  # a floating-point number


def run(name: str, counter: str, seed: int = 0, *, reports: bool = True) -> Measured:
    robot = load_robot(ROBOTS / f"{name}.toml")
    config = core_config(robot, robot.profiles)
    per_turn = COUNTERS[counter]
    for joint in config["joint"]:
        joint["rad_per_count"] = math.tau / per_turn
        joint["counter_bits"] = 32
        joint["counter_mantissa_bits"] = 24 if counter == "float" else 0
    steps = [_velocity_step_rad_s(robot, joint) * reports for joint in robot.joint]
    raw = raw_config(config)
    state = ffi.new("odometry_state *")
    lib.odometry_init(state, raw)
    line = next(iter(robot.line.values()))
    return _drive(robot, raw, state, counter, steps, 1.0 / line.cycle_hz, random.Random(seed))


def _drive(
    robot: Robot,
    raw: Any,
    state: Any,
    counter: str,
    steps: list[float],
    period_s: float,
    noise: random.Random,
) -> Measured:
    count = len(steps)
    feedback, stale = ffi.new("joint_feedback[8]"), ffi.new("uint32_t[8]")
    setpoint, twist, wheel = (
        ffi.new("joint_setpoint[8]"),
        ffi.new("double[3]"),
        ffi.new("double[8]"),
    )
    origin_rad = TURNS * math.tau if counter == "float" else 0.0
    position = [origin_rad + noise.random() for _ in range(count)]
    # each joint is sampled at its own moment of the cycle
    cycle_s = 0.02
    due_s = [cycle_s + 0.3 * period_s * j / count for j in range(count)]
    found = Measured([], [])
    true = [(0.0,) * AXES]
    for step, now in enumerate(twists(robot)):
        at_s = (step + 1) * STEP_S
        true.append(now)
        twist[0:AXES] = now
        lib.kinematics_wheels(raw, twist, wheel)
        before_ns = state.stamp_ns
        for j in range(count):
            position[j] += wheel[j] * STEP_S
            if at_s < due_s[j]:
                continue
            due_s[j] = math.inf
            feedback[j].count = _shown(position[j], counter) % (1 << 32)
            rough = steps[j]
            feedback[j].velocity_rad_s = round(wheel[j] / rough) * rough if rough else math.nan
            feedback[j].stamp_ns = round((at_s + 1.0 + STAMP_S * noise.gauss(0.0, 1.0)) * 1e9)
        if min(due_s) == math.inf:
            cycle_s = max(cycle_s + period_s * (1.0 + 0.05 * noise.gauss(0.0, 1.0)), at_s)
            due_s = [cycle_s + 0.3 * period_s * j / count for j in range(count)]
        lib.odometry_step(state, raw, feedback, stale, setpoint)
        if state.stamp_ns > before_ns and at_s > 0.5 and max(map(abs, now)) > 0.02:
            index = min(max(round((state.stamp_ns * 1e-9 - 1.0) / STEP_S), 0), len(true) - 1)
            _compare(robot, state, true[index], found)
    return found


def _shown(position_rad: float, counter: str) -> int:
    per_turn = COUNTERS[counter]
    if counter != "float":
        return math.floor(position_rad / math.tau * per_turn)
    turns = position_rad / math.tau
    return round(float(ffi.cast("float", turns)) * per_turn)


def _compare(robot: Robot, state: Any, true: tuple[float, ...], found: Measured) -> None:
    pairs = [
        (state.linear_m_s - true[0], state.twist_covariance[0]),
        (state.angular_rad_s - true[1], state.twist_covariance[2]),
    ]
    if robot.base.strafes:
        pairs.append((state.lateral_m_s - true[2], state.lateral_covariance[1]))
    for error, variance in pairs:
        found.deviations.append(error / math.sqrt(variance))
    found.errors.append(pairs[0][0])


def main() -> None:
    for counter in COUNTERS:
        both: list[list[float]] = [[], []]
        for name in NAMES:
            text = f"{counter:6} {name:18}"
            for reports in (True, False):
                one = run(name, counter, reports=reports)
                both[reports] += one.deviations
                text += f" {one.within():5.1f} % {1e3 * one.root_mean_square():6.2f} mm/s"
            print(text)
        shares = (Measured(both[reports], []).within() for reports in (True, False))
        print(f"{counter:6} {'all':18}", *(f"{share:5.1f} %" for share in shares))


if __name__ == "__main__":
    main()
