# SPDX-License-Identifier: Apache-2.0
"""The set-up of a drive on any medium: what answers is compared with what is expected, what turns
is braked by the drive's own means, then the drive loses its power, then it is configured."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

from motord_hal.base.clock import now_s
from motord_hal.base.errors import WrongDrive
from motord_hal.drives.can_profile import Signal
from motord_hal.drives.profile import DriveProfile, Enabled, Step
from motord_hal.fieldbus.job import Job
from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.fieldbus.positions import HALF_A_STEP, raw_range
from motord_hal.realtime.drive_state import STOPPING_WITHIN_S

BRAKING_WITHIN_S = 20.0
"""Longest time that a drive brakes at its set-up, while its wheels get slower."""
SLOWER_BY = 0.9
"""Part of its speed below which a wheel has to come within STOPPING_WITHIN_S: else the drive does
not brake it."""
_NO_POWER_RAD_S, _UNSEEN_RAD_S = 0.0, math.nan


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a set-up: a read, or steps that follow one another."""

    steps: tuple[Step, ...]
    stops: bool = False
    """Whether it is a stop: after a refused write the next ones still go out."""


Parts = Generator[Part, int, None]
"""The parts of a set-up, one after the other. Each read is answered with its raw value."""


def braking_within_s(spec: LineSpec) -> float:
    """Return the longest time that a drive of this line brakes at its set-up. A program that only
    stops the drives waits for their power-off no longer than a stop takes."""
    return STOPPING_WITHIN_S if spec.left_running else BRAKING_WITHIN_S


def set_up(
    joints: Sequence[JointSpec],
    profile: DriveProfile,
    configure: tuple[Step, ...],
    rest_velocity_rad_s: float,
    say: Callable[[str], None],
    within_s: float,
) -> Parts:
    """Yield the parts of a drive's set-up. Raise WrongDrive, before anything is written, if another
    drive answers, or one that keeps a narrower range of positions than the joint has."""
    yield from _compare_identity(joints, profile)
    yield from _compare_range(joints, profile)
    if _brakes(profile):
        yield from _brake(joints, profile, rest_velocity_rad_s, say, within_s)
    yield Part(profile.disarm, stops=True)
    yield Part(configure)


def _brake(
    joints: Sequence[JointSpec],
    profile: DriveProfile,
    rest_velocity_rad_s: float,
    say: Callable[[str], None],
    within_s: float,
) -> Parts:
    """Repeat the quick stop of a drive that turns, because a drive with a watchdog releases its
    motor without it: until the wheels rest, or for as long as they get slower, or, where no speed
    is seen, for STOPPING_WITHIN_S. `say` gets what was seen at the end."""
    speed_rad_s = yield from _speed_rad_s(joints, profile)
    if speed_rad_s < rest_velocity_rad_s:
        return
    began_s = slower_s = now_s()
    slowest_rad_s = math.inf
    while not speed_rad_s < rest_velocity_rad_s:
        if speed_rad_s < SLOWER_BY * slowest_rad_s:
            slowest_rad_s, slower_s = speed_rad_s, now_s()
        if now_s() > min(slower_s + STOPPING_WITHIN_S, began_s + within_s):
            break
        yield Part(profile.quick_stop, stops=True)
        speed_rad_s = yield from _speed_rad_s(joints, profile)
    say(_seen(joints, profile, speed_rad_s, rest_velocity_rad_s, now_s() - began_s))


def _seen(
    joints: Sequence[JointSpec],
    profile: DriveProfile,
    speed_rad_s: float,
    rest_velocity_rad_s: float,
    braked_s: float,
) -> str:
    """Return what was seen of a drive at the end of its braking."""
    if math.isnan(speed_rad_s) or not _speeds(joints, profile):
        return (
            f"had power when it was set up: braked for {braked_s:.1f} s, then released. Its speed "
            "is not known: motord cannot see whether it turns"
        )
    if speed_rad_s < rest_velocity_rad_s:
        return "turned when it was set up: braked until it was at rest, then released"
    return (
        f"turned when it was set up: braked for {braked_s:.1f} s, then released while it still "
        f"turned at {speed_rad_s:.2g} rad/s: keep away from it"
    )


def _compare_identity(
    joints: Sequence[JointSpec], profile: DriveProfile
) -> Generator[Part, int, None]:
    named = {name: value for joint in joints for name, value in joint.identity.items()}
    for one in profile.identity:
        if one.register not in named:
            value = (yield _read(profile, one.register)) & one.mask
            if value not in one.values:
                found = one.name_of(value) or "another drive"
                raise WrongDrive(_differs(found, profile, one.register, value, one.values))
    for name, wanted in named.items():
        value = yield _read(profile, name)
        if value != wanted:
            raise WrongDrive(_differs("another one", profile, name, value, (wanted,)))


def _compare_range(
    joints: Sequence[JointSpec], profile: DriveProfile
) -> Generator[Part, int, None]:
    """Compare each joint's range with the one that the drive keeps by itself: it would stop there,
    or refuse the set-point."""
    for joint in joints:
        channel = profile.channels[joint.channel]
        if channel.position_least is None or channel.position_greatest is None:
            continue
        least = yield _read(profile, channel.position_least)
        greatest = yield _read(profile, channel.position_greatest)
        low, high = raw_range(joint, profile)
        if least < greatest and (low < least - HALF_A_STEP or high > greatest + HALF_A_STEP):
            raise WrongDrive(
                f"{joint.name}: the drive itself keeps {least} to {greatest} "
                f"({channel.position_least}, {channel.position_greatest}), and "
                f"{joint.position_min_rad:g} to {joint.position_max_rad:g} rad are {low:.0f} to "
                f"{high:.0f}: narrow the joint's range, or change these registers"
            )


def _differs(
    found: str, profile: DriveProfile, register: str, value: int, wanted: Sequence[int]
) -> str:
    numbers = " or ".join(str(one) for one in wanted)
    return f"{found} answers, not {profile.title}: {register} is {value}, not {numbers}"


def _brakes(profile: DriveProfile) -> bool:
    """Whether the drive has a quick stop that is not its power-off."""
    writes = (
        [(step.register, step.value) for step in steps if step.value is not None]
        for steps in (profile.quick_stop, profile.disarm)
    )
    return next(writes) != next(writes)


def _speeds(joints: Sequence[JointSpec], profile: DriveProfile) -> list[tuple[str, float]]:
    """Return the register of the speed, and the gear ratio, of each joint that reports one."""
    speeds = [(profile.channels[joint.channel].velocity, joint.gear_ratio) for joint in joints]
    return [(name, gear_ratio) for name, gear_ratio in speeds if name is not None]


def _speed_rad_s(joints: Sequence[JointSpec], profile: DriveProfile) -> Generator[Part, int, float]:
    """Read the speed of the fastest wheel. NaN: one reports no number, or no joint reports its
    speed and the drive has power."""
    fastest_rad_s = 0.0
    speeds = _speeds(joints, profile)
    for name, gear_ratio in speeds:
        raw = yield _read(profile, name)
        speed_rad_s = abs(profile.registers[name].to_si(raw) / gear_ratio)
        if math.isnan(speed_rad_s):
            return _UNSEEN_RAD_S
        fastest_rad_s = max(fastest_rad_s, speed_rad_s)
    if speeds:
        return fastest_rad_s
    return _UNSEEN_RAD_S if (yield from _has_power(profile)) else _NO_POWER_RAD_S


def _has_power(profile: DriveProfile) -> Generator[Part, int, bool]:
    """Read whether the drive reports that it has power. Some drives are not enabled while they
    brake: these report in another place that they have none."""
    if profile.power_off is not None and not (yield from _holds(profile, profile.power_off)):
        return True
    return profile.enabled is not None and (yield from _holds(profile, profile.enabled))


def _holds(profile: DriveProfile, place: Enabled) -> Generator[Part, int, bool]:
    raw = yield _read(profile, place.register)
    return raw & place.mask == place.equals


def _read(profile: DriveProfile, name: str) -> Part:
    return Part((Step(register=readable_now(profile, name), mask=0, equals=0),))


def readable_now(profile: DriveProfile, name: str) -> str:
    """Return the name under which the value can be read also when its frames do not come: that of
    the object with the same value, on a CAN drive that has one."""
    register = profile.registers[name]
    return (isinstance(register, Signal) and register.object) or name


class SetUpJob(Job):
    """A set-up as a job whose next steps follow from what the earlier ones have read."""

    def __init__(self, parts: Parts) -> None:
        super().__init__("configure", ())
        self._parts = parts
        self._begin(next(parts))

    def advance(self) -> None:
        super().advance()
        while self.step is None:
            try:
                self._begin(self._parts.send(self.raw))
            except StopIteration:
                return

    def _begin(self, part: Part) -> None:
        self.steps, self.urgent = part.steps, part.stops
        self._index = 0
