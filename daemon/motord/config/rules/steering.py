# SPDX-License-Identifier: Apache-2.0
"""Rules between a base with steered wheels, its joints and their drives."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator

from motord.config.finding import Finding
from motord.config.sections.bases import (
    CarBase,
    JointsBase,
    SteeredBase,
    SwerveBase,
    WheelModule,
    wheel_modules,
)
from motord.config.sections.joint.wheels import Profiles, reference_of, takes_position
from motord.config.sections.line import CanLine, GatewayLine
from motord.config.sections.model import Joint, Robot
from motord.config.toml_lines import Path
from motord_hal.fieldbus.open_line import RT_CAN_INTERFACES

_ANYWHERE_RAD = math.pi - 1e-3
"""Range of half a turn, less rounding: a wheel that also rolls backward points anywhere within
it."""
_SMALL_M = 1e-6
_KEYS = ("position_min_rad", "position_max_rad", "acceleration_max_rad_s2", "zero_count")


def _at(joints: tuple[str, ...], key: str = "place") -> tuple[Path, ...]:
    return (*(("joint", name, key) for name in joints), *(("joint", name) for name in joints))


def _keys(robot: Robot) -> Iterator[Finding]:
    """Check that each joint that steers has a range of angles, and no other joint has one."""
    for name, joint in robot.joint.items():
        if not joint.steers:
            for key in () if isinstance(robot.base, JointsBase) else _KEYS:
                if key in joint.model_fields_set:
                    text = "only a joint that steers has it (steers = true)"
                    yield Finding((("joint", name, key),), text)
            continue
        if not isinstance(robot.base, SteeredBase):
            text = f"a {robot.base.kind} base has no steered wheels"
            yield Finding((("joint", name, "steers"),), text)
            continue
        for key in ("position_min_rad", "position_max_rad", "velocity_max_rad_s"):
            if getattr(joint, key) is None:
                text = f"{key} is missing: how far, and how fast, may this joint steer?"
                yield Finding((("joint", name, key), ("joint", name)), text)


def _one_of_each(robot: Robot) -> Iterator[Finding]:
    """Check that at most one joint steers a wheel, and at most one drives it."""
    for module in wheel_modules(robot.base, robot.joint):
        for names, what in ((module.steering, "steer"), (module.traction, "drive")):
            if len(names) > 1:
                text = f"joints {' and '.join(names)} {what} the same wheel"
                yield Finding(_at(names[1:]), text)


def _car(robot: Robot) -> Iterator[Finding]:
    base = robot.base
    if not isinstance(base, CarBase):
        return
    modules = wheel_modules(base, robot.joint)
    steered = [module for module in modules if module.steering]
    everywhere: tuple[Path, ...] = (("base",), ("joint",))
    if not steered:
        text = "no joint steers (steers = true): this base has no steered wheel"
        yield Finding(everywhere, text)
    if not any(module.traction for module in modules):
        yield Finding(everywhere, "no joint drives this base: each of them steers")
    for module in modules:
        off_axle = abs(module.x_m) > _SMALL_M
        if module.steering and not off_axle:
            text = f"this wheel is on the fixed axle: the {base.steered} axle is the steered one"
            yield Finding(_at(module.steering), text)
        elif off_axle and not module.steering:
            text = (
                "this wheel would be dragged in a curve: it is on the steered axle, and no joint "
                "steers it"
            )
            yield Finding(_at(module.traction), text)
    if len(steered) > 1 and any(abs(module.y_m) < _SMALL_M for module in steered):
        names = tuple(name for module in steered for name in module.steering)
        text = f'one joint in the middle steers ("{base.steered}"), or one on each side: not both'
        yield Finding(_at(names), text)
    if base.turning_radius_m is not None and steered:
        yield from _tightest(base, steered, robot)


def _tightest(base: CarBase, steered: list[WheelModule], robot: Robot) -> Iterator[Finding]:
    """Check that the steering reaches the tightest curve. Each steered wheel points across the line
    to the centre of the curve, which is on the fixed axle (Siegwart & Nourbakhsh, Autonomous Mobile
    Robots, 3.2.3: the sliding constraint)."""
    radius_m = base.turning_radius_m or 0.0
    for module, side in itertools.product(steered, (1.0, -1.0)):
        name = module.steering[0]
        joint = robot.joint[name]
        need_rad = math.atan2(abs(module.x_m), radius_m - side * module.y_m)
        left = (side > 0.0) == (module.x_m > 0.0)
        have_rad = (joint.position_max_rad if left else -(joint.position_min_rad or 0.0)) or 0.0
        if need_rad > have_rad:
            key = "position_max_rad" if left else "position_min_rad"
            text = (
                f"a curve of {radius_m:g} m needs {need_rad:.3g} rad of steering, and this joint "
                f"has {have_rad:.3g} rad"
            )
            yield Finding((("joint", name, key), ("base", "turning_radius_m")), text)


def _swerve(robot: Robot) -> Iterator[Finding]:
    if not isinstance(robot.base, SwerveBase):
        return
    modules = wheel_modules(robot.base, robot.joint)
    if len(modules) < 2:
        where: tuple[Path, ...] = (("base",), ("joint",))
        text = f"a swerve base has 2 to 4 modules at different places, not {len(modules)}"
        yield Finding(where, text)
    for module in modules:
        if not (module.steering and module.traction):
            names, what = (
                module.steering or module.traction,
                "steers" if module.traction else ("drives"),
            )
            text = f"no joint {what} this wheel: a swerve module has one that does"
            yield Finding(_at(names), text)
    for name, joint in robot.joint.items():
        if joint.steers and _range_rad(joint) < _ANYWHERE_RAD:
            text = (
                f"a range of {_range_rad(joint):.3g} rad is too small for a swerve module: it "
                "needs half a turn (pi) to point anywhere"
            )
            keys = ("position_max_rad", "position_min_rad")
            yield Finding(tuple(("joint", name, key) for key in keys), text)


def _range_rad(joint: Joint) -> float:
    if joint.position_min_rad is None or joint.position_max_rad is None:
        return math.inf  # another rule reports that it is missing
    return joint.position_max_rad - joint.position_min_rad


def _range(robot: Robot) -> Iterator[Finding]:
    for name, joint in robot.joint.items():
        if joint.steers and not _range_rad(joint) > 0.0:
            keys = ("position_max_rad", "position_min_rad")
            where = tuple(("joint", name, key) for key in keys)
            yield Finding(where, "a range of nothing steers no wheel")


def _engine(robot: Robot) -> Iterator[Finding]:
    """Check the lines of joints that steer: only the engine in C carries positions, and no others
    than the core's."""
    for name, joint in robot.joint.items():
        if joint.steers:
            yield from engine_for_positions(robot, name, f"joint {name} steers")


def engine_for_positions(robot: Robot, name: str, what: str) -> Iterator[Finding]:
    """Report why the line of a joint that takes positions cannot carry them."""
    joint = robot.joint[name]
    line = robot.line.get(joint.line)
    where = (("line", joint.line, "engine"), ("joint", name, "line"))
    if isinstance(line, GatewayLine):
        text = f'{what}: its line needs kind = "modbus-rtu", for the rt engine'
        yield Finding((("line", joint.line, "kind"), *where), text)
    elif line is not None and line.engine == "asyncio":
        yield Finding(where, f'{what}: its line needs engine = "rt"')
    elif isinstance(line, CanLine) and line.interface not in RT_CAN_INTERFACES:
        text = f'{what}: its line needs interface = "socketcan", for the rt engine'
        yield Finding((("line", joint.line, "interface"), *where), text)


def _drives(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Check that joints that steer take positions that mean the same each time, and other joints
    take no positions."""
    if isinstance(robot.base, JointsBase):
        return
    for name, joint in robot.joint.items():
        profile, drive = profiles[joint.drive], f'drive "{joint.drive}"'
        where: tuple[Path, ...] = (("joint", name, "drive"), ("joint", name, "steers"))
        if joint.steers != takes_position(joint, profile):
            takes = "takes no positions" if joint.steers else "takes positions"
            need = (
                "a joint that steers needs one that does"
                if joint.steers
                else ("only a joint that steers may have it (steers = true)")
            )
            yield Finding(where, f"{drive} {takes}: {need}")
        elif joint.steers and reference_of(joint, profile) < 0:
            text = (
                f"{drive} counts from where it was switched on, and cannot report that it was "
                "homed: where the wheel points would not be known"
            )
            yield Finding(where, text)


STEERING_RULES: tuple[Callable[[Robot], Iterator[Finding]], ...] = (
    _keys,
    _one_of_each,
    _car,
    _swerve,
    _range,
    _engine,
)
STEERING_DRIVE_RULES: tuple[Callable[[Robot, Profiles], Iterator[Finding]], ...] = (_drives,)
