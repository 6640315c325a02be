# SPDX-License-Identifier: Apache-2.0
"""Rules between a robot file and the profiles of its drives."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterator

from motord.config.finding import Finding
from motord.config.rules.alike import alike
from motord.config.rules.battery import battery_readings
from motord.config.rules.derating import derating
from motord.config.rules.joints import JOINT_DRIVE_RULES
from motord.config.rules.limits import ROUNDING, ceiling, reach
from motord.config.rules.speed_loop import speed_loops
from motord.config.rules.steering import STEERING_DRIVE_RULES
from motord.config.rules.wiring.positions import positions
from motord.config.rules.wiring.times import TIME_RULES
from motord.config.rules.wiring.wire import budget, helps
from motord.config.sections.bases import JointsBase, OmniBase, SteeredBase, side_of
from motord.config.sections.joint.wheels import (
    Profiles,
    counter_bits,
    counts_per_turn,
    drive_can_reverse,
    drive_velocity_max_rad_s,
    rad_per_count,
    reports_speed,
    takes_duty,
    takes_position,
    takes_torque,
)
from motord.config.sections.line import CanLine, PwmLine, SerialLine
from motord.config.sections.model import Joint, Robot
from motord.config.toml_lines import Path
from motord.config.wiring import line_specs

TRAVEL_PER_COUNT_USUAL_MM = (1e-5, 8.0)
"""Usual travel: from an encoder of 22 bits on a geared motor to the Hall sensors of a hub motor."""
_SPEAKS = {
    "ddsm": ("ddsm",),
    "can": ("can",),
    "mcu": ("mcu-frame",),
    "ascii": ("ascii",),
    "roboclaw": ("roboclaw",),
    "hoverboard": ("hoverboard", "hoverboard-steer"),
    "sabertooth": ("sabertooth",),
    "pwm": ("pwm",),
    "feetech": ("feetech",),
    "dynamixel": ("dynamixel",),
}
"""Protocols by the line's kind; all other kinds carry Modbus."""


def _one_joint_a_channel(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    for (one, first), (other, second) in itertools.combinations(robot.joint.items(), 2):
        if (first.line, first.unit) != (second.line, second.unit):
            continue
        where = f'unit {first.unit} on line "{first.line}"'
        paths = tuple(
            ("joint", joint, key) for joint in (other, one) for key in ("unit", "line", "channel")
        )
        if first.drive != second.drive:
            if isinstance(robot.line[first.line], CanLine):
                continue  # rules/wiring/can.py compares their identifiers
            path: Path = ("joint", other, "drive")
            yield Finding((path, *paths), f'{where} is a "{first.drive}" for joint {one}')
        elif first.channel == second.channel:
            key = "channel" if len(profiles[first.drive].channels) > 1 else "unit"
            path = ("joint", other, key)
            text = f"{where} channel {first.channel} is taken by joint {one}"
            yield Finding((path, *paths), text)


def spoken(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Check that each drive speaks the protocol of its line: other rules compute with it."""
    for name, joint in robot.joint.items():
        kind, protocol = robot.line[joint.line].kind, profiles[joint.drive].protocol
        if protocol not in _SPEAKS.get(kind, ("modbus-rtu",)):
            text = f'drive "{joint.drive}" speaks {protocol}, its line {kind}'
            yield Finding((("joint", name, "drive"), ("line", joint.line, "kind")), text)


def _mounting(robot: Robot, _: Profiles) -> Iterator[Finding]:
    """Check that motors that face each other turn in opposite directions, and motors on one side in
    the same."""
    for (one, first), (other, second) in itertools.combinations(robot.joint.items(), 2):
        if isinstance(robot.base, OmniBase | SteeredBase | JointsBase):
            return
        sides = side_of(robot.base, first), side_of(robot.base, second)
        placed = "place" if robot.base.strafes else "side"
        paths = tuple(
            ("joint", joint, key) for joint in (other, one) for key in ("inverted", placed)
        )
        same_drive = (first.line, first.unit, first.drive) == (
            second.line, second.unit, second.drive,
        )  # fmt: skip
        if sides[0] == sides[1]:
            if first.drive == second.drive and first.inverted != second.inverted:
                text = f"joint {one} on the same side is {_turned(first)}: do both turn alike?"
                yield Finding(paths, text, warning=True)
        elif same_drive and first.inverted == second.inverted:
            text = (
                f"joint {one} on the other side of the same drive is {_turned(first)} too: motors "
                "that face each other need one inverted"
            )
            yield Finding(paths, text, warning=True)


def _turned(joint: Joint) -> str:
    return "inverted" if joint.inverted else "not inverted"


def _velocity(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    for name, joint in robot.joint.items():
        profile = profiles[joint.drive]
        path = ("joint", name, "velocity_max_rad_s")
        keys = ("gear_ratio", "full_duty_rad_s", "duty_max", "drive", "channel")
        on = (path, *(("joint", name, key) for key in keys))
        most = drive_velocity_max_rad_s(joint, profile)
        wanted_rad_s = joint.velocity_max_rad_s
        if wanted_rad_s is not None and wanted_rad_s > most * (1 + ROUNDING):
            can = f'drive "{joint.drive}" can (at most {most:.4g} rad/s)'
            text = f"{wanted_rad_s:g} rad/s is more than {can}"
            yield Finding(on, text)


def _duty(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    keys = ("duty_dead_band", "duty_min", "duty_max", "duty_slew_per_s", "full_duty_rad_s")
    for name, joint in robot.joint.items():
        drive: Path = ("joint", name, "drive")
        if takes_duty(joint, profiles[joint.drive]):
            if joint.full_duty_rad_s is None:
                text = f'is missing: drive "{joint.drive}" takes a duty, and the speed at duty 1 is'
                path = ("joint", name, "full_duty_rad_s")
                yield Finding((path, drive), f"{text} not known (0.01 to 10000 rad/s)")
            elif joint.duty_dead_band >= joint.duty_max:
                paths = (("joint", name, "duty_dead_band"), ("joint", name, "duty_max"))
                yield Finding(paths, "the dead band leaves nothing below duty_max")
            continue
        takes = "a torque" if takes_torque(joint, profiles[joint.drive]) else "a velocity"
        for key in keys:
            if key in joint.model_fields_set:
                places = takes_position(joint, profiles[joint.drive])
                what = "a position" if places else takes
                text = f'is not used: drive "{joint.drive}" takes {what}'
                yield Finding((("joint", name, key), drive), text, warning=True)


def _reverse(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    for name, joint in robot.joint.items():
        if drive_can_reverse(joint, profiles[joint.drive]):
            continue
        for key in ("reversible", "inverted"):
            if getattr(joint, key):
                paths = (("joint", name, key), ("joint", name, "drive"))
                yield Finding(paths, f'drive "{joint.drive}" cannot turn backward')


def _counter(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    reported = set()
    for name, joint in robot.joint.items():
        profile = profiles[joint.drive]
        path, drive = ("joint", name, "counts_per_turn"), ("joint", name, "drive")
        if takes_position(joint, profile):
            continue  # rules/steering.py, rules/joints.py
        if counts_per_turn(joint, profile) and not counter_bits(joint, profile):
            yield Finding((path, drive), f'drive "{joint.drive}" has no position counter')
        elif not counts_per_turn(joint, profile) and joint.drive not in reported:
            reported.add(joint.drive)
            measures = reports_speed(robot, name, profile)
            source = "the measured speed" if measures else "the wheel's set-point"
            text = f"without a position counter: odometry comes from {source}, and is less exact"
            yield Finding((drive, path), text, warning=True)


def _resolution(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Warn of a count that is much travel or nearly none: the counts or the gear are usually
    wrong."""
    for name, joint in robot.joint.items():
        profile = profiles[joint.drive]
        no_wheel = joint.steers or isinstance(robot.base, JointsBase)
        if not counts_per_turn(joint, profile) or no_wheel:
            continue
        travel_mm = abs(rad_per_count(joint, profile)) * robot.wheel_radius_m(name) * 1e3
        if TRAVEL_PER_COUNT_USUAL_MM[0] <= travel_mm <= TRAVEL_PER_COUNT_USUAL_MM[1]:
            continue
        path: Path = ("joint", name, "encoder" if joint.encoder else "counts_per_turn")
        on = (path, ("joint", name, "gear_ratio"), ("joint", name, "drive"))
        text = (
            f"a count is {travel_mm:.3g} mm of travel: counts are of a motor turn (four for each "
            f"pulse of an encoder), and the motor turns {joint.gear_ratio:g} times for a wheel turn"
        )
        yield Finding(on, f"{text}: is this right?", warning=True)


def _edges(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Check that a drive that counts its speeds in encoder edges has one number for all of its
    joints."""
    for name, joint in robot.joint.items():
        profile = profiles[joint.drive]
        counts = counts_per_turn(joint, profile)
        path, drive = ("joint", name, "counts_per_turn"), ("joint", name, "drive")
        if not profile.speed_in_counts or joint.encoder is not None:
            continue
        if counts == 0:
            text = f'must not be 0: drive "{joint.drive}" counts its speed in encoder edges'
            yield Finding((path, drive), text)
        elif counts != profile.counts_per_turn:
            text = (
                f'{counts} differs from another joint with drive "{joint.drive}", which counts its '
                "speed in encoder edges: copy the profile for the other encoder "
                "(docs/drives/your-own-drive.md)"
            )
            yield Finding((path, drive), text)


def _reach(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    if not isinstance(robot.base, JointsBase):
        yield from reach(robot.limits, ceiling(robot, profiles), tuple(robot.joint))


def _serial(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    seen = set()
    for name, joint in robot.joint.items():
        profile, line = profiles[joint.drive], robot.line[joint.line]
        factory = (profile.baudrate, profile.parity, profile.stop_bits)
        ours = (line.baudrate, line.parity, line.stop_bits)
        if factory != ours and (joint.line, joint.drive) not in seen:
            seen.add((joint.line, joint.drive))
            on_can = profile.can is not None
            words = "{} bit/s" if on_can else "{} baud, parity {}, {} stop bit(s)"
            text = (
                f'drive "{joint.drive}" leaves the factory with {words.format(*factory)}; this '
                f"line has {words.format(*ours)}: it answers only if you have changed the drive; "
                f"else write {_as_keys(factory, on_can)} here"
            )
            key = "bitrate" if on_can else "baudrate"
            paths = (("line", joint.line, key), ("joint", name, "drive"))
            yield Finding(paths, text, warning=True)


def _as_keys(factory: tuple[int, str, int], on_can: bool) -> str:
    baudrate, parity, stop_bits = factory
    if on_can:
        return f"bitrate = {baudrate}"
    return f'baudrate = {baudrate}, parity = "{parity}", stop_bits = {stop_bits}'


def _budget(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Report rates that the wire cannot carry: an error if the file sets them, else a warning."""
    for spec in line_specs(robot, profiles):
        if not spec.joints or spec.kind == "can":
            continue
        need = budget(spec)
        if need.share <= 1 + ROUNDING:
            continue
        drives = "1 drive" if need.drives == 1 else f"{need.drives} drives"
        text = (
            f"line {spec.name}: {drives} at {need.cycle_hz:g} Hz need {100 * need.share:.0f} % of "
            f"the wire; most it carries is {need.most_hz:.3g} Hz"
        )
        if more := [f"{words}: {then_hz:.3g} Hz" for words, then_hz in helps(spec)]:
            text += f" ({'; '.join(more)})"
        paths = [("line", spec.name, "cycle_hz")]
        paths += [("joint", joint.name, "cycle_hz") for joint in spec.joints]
        given = [path for path in paths if _is_given(robot, path)]
        on = (("line", spec.name, "baudrate"), ("line", spec.name, "gap_s"))
        yield Finding((*(given or paths[:1]), *on), text, warning=not given)


def _is_given(robot: Robot, path: tuple[str, str, str]) -> bool:
    table, name, key = path
    section = robot.line[name] if table == "line" else robot.joint[name]
    return key in section.model_fields_set


def _watchdogs(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    path = ("safety", "drive_watchdog_s")
    wanted = robot.safety.drive_watchdog_s
    users: dict[str, list[str]] = defaultdict(list)
    for name, joint in robot.joint.items():
        users[joint.drive].append(name)
    for drive, joints in users.items():
        watchdog = profiles[drive].watchdog
        at = ("joint", joints[0], "drive")
        if watchdog is None and all(robot.joint[name].drive_watchdog_s for name in joints):
            continue  # reported for each of them, by another rule
        if watchdog is None:
            note = profiles[drive].watchdog_note
            fixed_s = profiles[drive].watchdog_fixed_s
            has = (
                f"has a fixed communication watchdog of {fixed_s:g} s"
                if fixed_s
                else "without a communication watchdog"
            )
            if "watchdog" in profiles[drive].unknown:
                has = "whose communication watchdog is unknown"
            text = f'drive "{drive}" {has}: {note}'
            yield Finding((at,), text, warning=True)
            continue
        if "r" not in profiles[drive].registers[watchdog.register].access:
            text = (
                f'drive "{drive}" cannot report its communication watchdog: motord writes it, and '
                "does not see whether the drive has it; try it with the wheels off the ground: "
                "pull the plug of the port while they turn"
            )
            yield Finding((at,), text, warning=True)
        if not watchdog.minimum_s <= wanted <= watchdog.maximum_s:
            span = f"{watchdog.minimum_s:g} to {watchdog.maximum_s:g} s"
            yield Finding((path, at), f'{wanted:g} s is out of range for drive "{drive}" ({span})')


Rule = Callable[[Robot, Profiles], Iterator[Finding]]
_RULES: tuple[Rule, ...] = (
    _one_joint_a_channel,
    _mounting,
    alike,
    _velocity,
    speed_loops,
    derating,
    _duty,
    _reverse,
    _counter,
    _resolution,
    _edges,
    _reach,
    positions,
    _serial,
    *TIME_RULES,
    _budget,
    _watchdogs,
    battery_readings,
    *STEERING_DRIVE_RULES,
    *JOINT_DRIVE_RULES,
)


def drive_rules(robot: Robot) -> Iterator[Rule]:
    """Yield the rules for the robot's drives. Those for a CAN bus and for pins are imported only
    for robots that have them: every start of a program reads its robot file."""
    yield from _RULES
    lines, joints = robot.line.values(), robot.joint.values()
    if any(isinstance(line, CanLine) for line in lines) or any(
        joint.drive_watchdog_s is not None for joint in joints
    ):
        from motord.config.rules.wiring.can import CAN_RULES

        yield from CAN_RULES
    if (
        any(isinstance(line, PwmLine) for line in lines)
        or any(isinstance(line, SerialLine) and line.direction == "gpio" for line in lines)
        or any(joint.encoder is not None for joint in joints)
        or robot.safety.estop is not None
        or robot.safety.watchdog is not None
    ):
        from motord.config.rules.wiring.pin import PIN_RULES

        yield from PIN_RULES
