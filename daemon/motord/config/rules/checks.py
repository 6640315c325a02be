# SPDX-License-Identifier: Apache-2.0
"""Runs all rules, and finds the drives' profiles for them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from motord.config.drives.load import find_profile, is_file_name, list_profiles, load_profile
from motord.config.finding import Finding
from motord.config.rules.bus import BUS_RULES
from motord.config.rules.drive import drive_rules, spoken
from motord.config.rules.robot import ROBOT_RULES
from motord.config.rules.wiring.line import LINE_RULES
from motord.config.sections.joint.wheels import Profiles, encoders_of
from motord.config.sections.model import Joint, Robot
from motord_hal.base.errors import ProfileError
from motord_hal.base.nearest import nearest
from motord_hal.drives.profile import DriveProfile
from motord_hal.modbus.codec import UNIT_MAX
from motord_hal.roboclaw.codec import UNITS as ROBOCLAW_UNITS
from motord_hal.servo.packets import KINDS as SERVO_KINDS
from motord_hal.servo.packets import UNIT_MAX as SERVO_UNIT_MAX

_FAILURES = (ArithmeticError, AttributeError, LookupError, ProfileError, TypeError, ValueError)
_REFERENCES = (("line",), ("drive",), ("channel",), ("unit",))


def findings(robot: Robot) -> tuple[list[Finding], Profiles]:
    """Return everything that does not fit together, and the profiles of the drives. Rules that need
    drives check only the joints that have a line, a drive that speaks its protocol, an address and
    a channel."""
    rules = (*ROBOT_RULES, *LINE_RULES, *BUS_RULES)
    found = [hit for rule in rules for hit in _found_by(rule, robot)]
    profiles, wrong = _profiles(robot)
    found += wrong
    lost = {path[1] for path, *_ in (hit.paths for hit in found) if path[2:] in _REFERENCES}
    rest = _without(robot, lost)
    mute = _found_by(spoken, rest, profiles)
    rest = _without(rest, {hit.paths[0][1] for hit in mute})
    if rest.joint:
        found += [hit for rule in drive_rules(rest) for hit in _found_by(rule, rest, profiles)]
    return [*found, *mute], profiles


def _without(robot: Robot, names: set[str | int]) -> Robot:
    joints = {name: joint for name, joint in robot.joint.items() if name not in names}
    return robot.model_copy(update={"joint": joints})


def _found_by(rule: Callable[..., Iterator[Finding]], *arguments: object) -> list[Finding]:
    """Return what a rule finds. One that fails is a bug of motord, and a finding: the file is
    refused, and the other findings may show what the rule did not expect."""
    try:
        return list(rule(*arguments))
    except _FAILURES as error:
        text = (
            f"a check of motord failed ({rule.__module__}.{rule.__name__}: "
            f"{type(error).__name__}: {error}). Mend what else is found here; if nothing is, "
            "report this with your file: it is a bug"
        )
        return [Finding((("robot",),), text)]


def _profiles(robot: Robot) -> tuple[Profiles, list[Finding]]:
    profiles: dict[str, DriveProfile] = {}
    wrong = []
    known = list_profiles()
    for name, joint in robot.joint.items():
        path = ("joint", name, "drive")
        if not is_file_name(joint.drive) and joint.drive not in known:
            meant = nearest(joint.drive, known)
            hint = f'did you mean "{meant}"?' if meant else f"known: {', '.join(known)}"
            wrong.append(Finding((path,), f'there is no drive profile "{joint.drive}" ({hint})'))
            continue
        try:
            profiles[joint.drive] = _profile(robot, joint.drive)
        except ProfileError as error:
            first, *more = str(error).splitlines()
            text = f"{first}{f' (and {len(more)} more)' if more else ''}"
            wrong.append(Finding((path,), f"the drive profile cannot be used: {text}"))
            continue
        channels = profiles[joint.drive].channels
        if joint.channel not in channels:
            has = ", ".join(map(str, channels))
            text = f'drive "{joint.drive}" has no channel {joint.channel} (it has {has})'
            wrong.append(Finding((("joint", name, "channel"), path), text))
        wrong += _address(name, joint, profiles[joint.drive])
    return profiles, wrong


def _profile(robot: Robot, drive: str) -> DriveProfile:
    """Return a profile by its name, or by its path from the robot file's folder, for the encoders
    that its joints have. Raises ProfileError."""
    file = robot.path.parent / drive
    profile = load_profile(file) if is_file_name(drive) else find_profile(drive)
    encoders = encoders_of(robot, drive, profile)
    if len(encoders) == 1 and profile.counts_per_turn not in encoders:
        return load_profile(profile.path, encoders.pop())
    return profile


def _address(name: str, joint: Joint, profile: DriveProfile) -> Iterator[Finding]:
    low, high = (0, SERVO_UNIT_MAX) if profile.protocol in SERVO_KINDS else (1, UNIT_MAX)
    if profile.protocol == "roboclaw":
        low, high = ROBOCLAW_UNITS[0], ROBOCLAW_UNITS[-1]
    if profile.can is not None:
        low, high = profile.can.node_min, profile.can.node_max
    if not low <= joint.unit <= high:
        text = f'{joint.unit} is not an address of drive "{joint.drive}" ({low} to {high})'
        yield Finding((("joint", name, "unit"), ("joint", name, "drive")), text)
