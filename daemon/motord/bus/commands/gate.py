# SPDX-License-Identifier: Apache-2.0
"""The check of commands of networked inputs: the token, the form, and the age. A command that
passes goes to the daemon, which checks it as every other command."""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from motord.api.commands import beyond
from motord.base.rate_limited_log import RateLimitedLog
from motord.bus.commands.gap import STOOD_STILL, Gap
from motord.bus.commands.link import Source, reason
from motord.bus.commands.senders import UNKNOWN, Sender, Senders
from motord.bus.secret import Token
from motord.client import ClientError

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime
    from motord.config import BusInput

METHODS = ("arm", "disarm", "stop", "estop", "reset", "reset_odometry", "status")
"""Methods of the daemon that may be called."""
TRIGGERS = tuple(method for method in METHODS if method != "status")
"""Methods that are services of type std_srvs/srv/Trigger."""
COMMANDS = ("cmd_vel", "joint_commands")
"""Topics of commands: see `CommandGate.take`."""
URGENT = ("estop", "stop")
ANY_TIME = (*URGENT, "disarm", "status", "params.list")
"""Methods that are accepted even if the call has waited for this process: they only read, or end at
rest."""
CALL_OLD_S = 0.5
"""A call that waited here for less time is accepted: the short lifetime of commands does not apply
to calls."""
CALLS_MAX = 4
URGENT_MAX = 16
"""Largest number of calls of one urgent method that the daemon has not answered yet."""
FUTURE_S = 0.5
"""Largest lead of a stamp over our clock. A later stamp comes from a clock that differs from ours,
and the command's age is unknown."""
OLD_S = 3600.0
"""Greatest age that is passed on: any command of that age is refused."""
ZERO_STAMP = "its stamp is zero: send the time, or set stamped = false"
AHEAD = "its stamp is in the future: synchronise the clocks"
ABSURD = 10.0
"""Multiple of the limit beyond which a command counts as absurd: OUT_OF_RANGE of
csrc/loop/command/arbiter.c."""
SAY_AGAIN_S = 10.0
_SHORT = 40
_EITHER = ("velocity", "position")

_log = logging.getLogger(__name__)


class NotTaken(Exception):
    """A command is not passed on; the text is the reason."""


class CommandGate:
    """The command gate of one networked input."""

    def __init__(self, name: str, section: BusInput, runtime: Runtime) -> None:
        """`section`: for an input that is no StampedInput, the gate measures how long a command
        waited. Raises OSError and ValueError for a token that cannot be used."""
        self._name = name
        self._runtime = runtime
        self._token: Token | None = None
        if (token_file := getattr(section, "token_file", None)) is not None:
            self._token = Token(runtime.beside_robot_file(token_file))
        self._stamped: bool = getattr(section, "stamped", False)
        robot = runtime.robot
        self._joints = {name: place for place, name in enumerate(robot.joint)}
        self._free = robot.base.kind == "joints"
        """Whether the robot has joints without a base; a joint with a range of positions takes
        positions."""
        self._ranges_rad = {
            name: (joint.position_min_rad or 0.0, joint.position_max_rad)
            for name, joint in (robot.joint.items() if self._free else ())
            if joint.position_max_rad is not None
        }
        self._positions = {self._joints[name] for name in self._ranges_rad}
        self._calls: Counter[str] = Counter()
        self._reported_s = -SAY_AGAIN_S
        self._voice = RateLimitedLog(_log)
        self.source: Source = runtime.source(name)
        self._senders = Senders()
        self._gap: Gap = runtime.gap(section.lease_s)
        self.gap: Gap = runtime.gap(max(section.lease_s, CALL_OLD_S))
        """Detects gaps after which calls and goals may be old."""

    def admit(self, shown: object) -> None:
        """Check the token. Raises NotTaken if it is missing or wrong."""
        if self._token is None or not self._token.fits(shown):
            raise self._no("the token is missing or wrong")

    def take(
        self, topic: str, message: object, waited_s: float = 0.0, sender: Sender = UNKNOWN
    ) -> None:
        """Pass on a message of one of COMMANDS: see `drive` and `drive_joints`. Raises NotTaken."""
        match topic:
            case "cmd_vel":
                self.drive(message, waited_s, sender)
            case "joint_commands":
                self.drive_joints(message, waited_s, sender)
            case other:
                raise self._no(f"{short(other)} is not taken; there are: {', '.join(COMMANDS)}")

    def drive(self, message: object, waited_s: float = 0.0, sender: Sender = UNKNOWN) -> None:
        """Pass a Twist or a TwistStamped on. `waited_s`: its time in transit, as far as that is
        known; for a message without a stamp it is the age. Raises NotTaken."""
        (linear_m_s, angular_rad_s, lateral_m_s), age_s = self._twist(message)
        if self._free and (linear_m_s, angular_rad_s, lateral_m_s) != (0.0, 0.0, 0.0):
            raise self._no("this robot has no base: command its joints by joint_commands")
        stamp_ns = self._stamp_ns(age_s, waited_s)
        number = self._senders.number(sender)
        if not self.source.drive(
            linear_m_s, angular_rad_s, stamp_ns, lateral_m_s=lateral_m_s, sender=number
        ):
            raise self._no(self.source.why_lost)
        self.name_absurd(linear_m_s, angular_rad_s, lateral_m_s, sender.name)

    def rest(self, sender: Sender) -> None:
        """Send zero for a sender, and give its command back."""
        number = self._senders.number(sender)
        self.source.drive(0.0, 0.0, sender=number)
        self.source.release(sender=number)

    def name_absurd(
        self, linear_m_s: float, angular_rad_s: float, lateral_m_s: float, sender: str
    ) -> None:
        """Log the sender of a command that the loop takes for zero: the loop counts it, without
        names."""
        robot = self._runtime.robot
        limits = robot.limits
        sideways = not robot.base.strafes or abs(lateral_m_s) <= ABSURD * limits.lateral_m_s
        if (
            abs(linear_m_s) <= ABSURD * limits.linear_m_s
            and abs(angular_rad_s) <= ABSURD * limits.angular_rad_s
            and sideways
        ):
            return
        self._voice.say(
            f"input.{self._name}: {sender or 'an unknown sender'} requests {linear_m_s:g} m/s,"
            f" {angular_rad_s:g} rad/s, {lateral_m_s:g} m/s sideways: not a number, or more"
            f" than {ABSURD:g} times the limit in the robot file, so it counts as zero unless a"
            " higher limit is in force: check the unit"
        )

    def drive_joints(
        self, message: object, waited_s: float = 0.0, sender: Sender = UNKNOWN
    ) -> None:
        """Pass the velocities of a JointState on; see `drive`. Wheels that it does not name are to
        rest. A joint without a base takes a velocity or a position. Raises NotTaken."""
        beyond_range, number = "", self._senders.number(sender)
        if self._free:
            velocities, positions, age_s = self._free_joints(message)
            names = list(self._joints)
            named = {names[place]: value for place, value in positions.items()}
            beyond_range = beyond(self._ranges_rad, named)
            stamp_ns, count = self._stamp_ns(age_s, waited_s), len(self._joints)
            self._name_infinite((*velocities.values(), *positions.values()), sender.name)
            sent = self.source.drive_free_joints(count, velocities, positions, stamp_ns, number)
        else:
            velocity_rad_s, age_s = self._wheels(message)
            self._name_infinite(velocity_rad_s, sender.name)
            stamp_ns = self._stamp_ns(age_s, waited_s)
            sent = self.source.drive_joints(velocity_rad_s, stamp_ns, number)
        if not sent:
            raise self._no(self.source.why_lost)
        if beyond_range:  # the loop takes it for zero
            raise self._no(f"{beyond_range}: check the unit (rad)")

    def _name_infinite(self, values: Iterable[float], sender: str) -> None:
        """Log the sender of a command of joints that the loop takes for zero; see `name_absurd`."""
        if not all(map(math.isfinite, values)):
            self._voice.say(
                f"input.{self._name}: {sender or 'an unknown sender'} requests by joint_commands"
                " what is not a number, so it counts as zero"
            )

    def _stamp_ns(self, age_s: float, waited_s: float) -> int:
        """Return when a command was given, CLOCK_MONOTONIC. Raises NotTaken for a command of
        unknown age that may have waited here."""
        if not self._stamped:
            self._not_old(self._gap)
            age_s = max(age_s, min(waited_s, OLD_S))
        return time.monotonic_ns() - round(age_s * 1e9)

    def _not_old(self, gap: Gap) -> None:
        """Raise NotTaken if a message without a stamp may have waited here."""
        if gap.just_over():
            raise self._no(STOOD_STILL)

    def _wheels(self, message: object) -> tuple[list[float], float]:
        """Return velocities in rad/s, in the order of the robot file, and the command's age in
        s."""
        known, (speeds,), stamp_s = self._named(message, "velocity")
        if len(speeds) != len(known) or len(set(known)) != len(known):
            raise self._no("each joint has one velocity")
        velocity_rad_s = [0.0] * len(self._joints)
        for place, speed in zip(known, speeds, strict=True):
            velocity_rad_s[place] = speed
        return velocity_rad_s, self._age_s(stamp_s)

    def _free_joints(self, message: object) -> tuple[dict[int, float], dict[int, float], float]:
        """Return velocities and positions by the joint's place in the robot file, each of the
        joints that take it, and the command's age in s. The number for a joint in the other list
        does not count."""
        known, lists, stamp_s = self._named(message, *_EITHER)
        if len(set(known)) != len(known):
            raise self._no("each joint is named once")
        found: tuple[dict[int, float], dict[int, float]] = {}, {}
        for at, place in enumerate(known):
            kind = int(place in self._positions)
            if len(lists[kind]) != len(known):
                name = list(self._joints)[place]
                raise self._no(f"joint {name} takes a {_EITHER[kind]}, and there is not one each")
            found[kind][place] = lists[kind][at]
        return *found, self._age_s(stamp_s)

    def _named(
        self, message: object, *keys: str
    ) -> tuple[list[int], list[list[float]], float | None]:
        """Return from a JointState the places of its joints, the numbers of these lists, and its
        stamp. When several lists are read, some may be missing."""
        try:
            if not isinstance(message, Mapping):
                raise TypeError("a command is an object")
            names = list(message["name"])
            raw = [message[key] if len(keys) == 1 else message.get(key, ()) for key in keys]
            lists = [list(map(_number, values)) for values in raw]
            stamp_s = _stamp_s(message)
            known = [self._joints.get(name, -1) for name in names]
        except (KeyError, TypeError, OverflowError) as error:
            raise self._no(f"it is not a JointState: {error}") from None
        if -1 in known:
            raise self._no(f"it names a joint that is not one of {', '.join(self._joints)}")
        return known, lists, stamp_s

    def _twist(self, message: object) -> tuple[tuple[float, float, float], float]:
        """Return the velocities of a twist in m/s, rad/s and m/s to the left, and the command's age
        in s."""
        try:
            if not isinstance(message, Mapping):
                raise TypeError("a command is an object")
            twist = message.get("twist", message)
            linear_m_s = _number(twist["linear"]["x"])
            lateral_m_s = _number(twist["linear"].get("y", 0.0))
            angular_rad_s = _number(twist["angular"]["z"])
            stamp_s = _stamp_s(message)
        except (AttributeError, KeyError, TypeError, OverflowError) as error:
            raise self._no(f"it is neither a Twist nor a TwistStamped: {error}") from None
        return (linear_m_s, angular_rad_s, lateral_m_s), self._age_s(stamp_s)

    def _age_s(self, stamp_s: float | None) -> float:
        """Return the age in s of a command that was given at that wall time; None: it has no
        stamp."""
        if not self._stamped and not stamp_s:
            return 0.0
        if stamp_s is None:
            raise self._no("it has no stamp (header.stamp, or stamped = false)")
        if stamp_s == 0.0:
            raise self._no(ZERO_STAMP)
        age_s = time.time() - stamp_s
        if not age_s >= -FUTURE_S:
            raise self._no(AHEAD)
        return min(max(age_s, 0.0), OLD_S)

    async def act(self, method: object, sender: str = "", **params: Any) -> Any:
        """Call one of METHODS. `sender`: the caller, if it is known. Raises NotTaken, also with the
        daemon's own reason."""
        if not isinstance(method, str) or method not in METHODS:
            raise self._no(f"{short(method)} is not one of {', '.join(METHODS)}")
        if method in URGENT:
            full = self._calls[method] >= URGENT_MAX
        else:
            full = self._calls.total() - sum(self._calls[name] for name in URGENT) >= CALLS_MAX
        if full:
            raise self.busy()
        self._calls[method] += 1
        try:
            if method == "estop":
                return await self.ask(
                    method, **reason(f"input.{self._name}: by {sender or 'call'}")
                )
            return await self.ask(method, **params)
        except ClientError as error:
            raise NotTaken(str(error)) from error
        finally:
            self._calls[method] -= 1

    async def ask(self, method: str, **params: Any) -> Any:
        """Call the daemon for a client with the token: see `Runtime.call`. Raises NotTaken for a
        call that moves or changes the robot and may have waited here."""
        if method not in ANY_TIME:
            self._not_old(self.gap)
        return await self._runtime.call(method, **params)

    def busy(self) -> NotTaken:
        """Return the refusal of a call beyond those that may run at once."""
        return self._no("busy: too many calls are running")

    def refuse(self, why: str, count: int = 1) -> None:
        """Count commands that were not passed on; log from time to time."""
        if count > 0:
            self.source.refused += count - 1
            self._no(why)

    def _no(self, why: str) -> NotTaken:
        """Count a refusal, log from time to time, and return the error to raise."""
        self.source.refused += 1
        now_s = time.monotonic()
        if now_s - self._reported_s >= SAY_AGAIN_S:
            self._reported_s = now_s
            _log.warning("input.%s: refused (%d so far): %s", self._name, self.source.refused, why)
        return NotTaken(why)


def _stamp_s(message: Mapping[str, Any]) -> float | None:
    """Return the wall time in the header; None: no stamp. Raises KeyError, TypeError and
    OverflowError."""
    stamp = message["header"]["stamp"] if "header" in message else None
    if stamp is None:
        return None
    return _number(stamp["sec"]) + _number(stamp["nanosec"]) * 1e-9


def _number(value: object) -> float:
    """Return a number. NaN and infinity pass: the loop takes them for zero, and reports it. Raises
    TypeError, and OverflowError for a whole number that is too large."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{short(value)} is not a number")
    return float(value)


def request_of(decode: Callable[[bytes], Any], raw: object, bytes_max: int) -> Mapping[str, Any]:
    """Return the request of an unknown sender; empty if it cannot hold a token. `decode` raises
    ValueError."""
    if not isinstance(raw, bytes) or len(raw) > bytes_max:
        return {}
    try:
        request = decode(raw)
    except ValueError:
        return {}
    return request if isinstance(request, Mapping) else {}


def short(value: object) -> str:
    """Return an unknown sender's value, short enough for a sentence: it may be long or nested."""
    return repr(value[:_SHORT]) if isinstance(value, str) else f"a {type(value).__name__}"


def tag(value: object) -> str | int | None:
    """Return what an answer repeats of its request; None if it is neither text nor number."""
    return value if isinstance(value, str | int) else None
