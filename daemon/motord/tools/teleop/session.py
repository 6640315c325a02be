# SPDX-License-Identifier: Apache-2.0
"""A session of driving by hand: it turns keys and a gamepad into commands under a lease. Whatever
ends the session, the robot comes to rest first."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, Protocol

from motord.aio import Client, ClientError, Refused
from motord.api.snapshot import KEEP_AWAY, Rest, not_known, rest_text
from motord.api.status import Status
from motord.tools.teleop.keys import MOTIONS, PING, PONG, DeadMan, Decoder, Link
from motord.tools.teleop.terminal import Terminal
from motord_hal.base.tasks import TaskGroup

OWNER = "motord-teleop"
SEND_PERIOD_S = 0.05
PING_PERIOD_S = 0.05
LOOK_PERIOD_S = 0.2
GAP_S = 0.3
"""If this program stood still for longer than this, it drops the keys that have come meanwhile."""
REST_WITHIN_S = 10.0
ANSWERS_WITHIN_S = 0.3
"""Time to wait at the end for answers of the terminal, which would otherwise go to the shell."""
STEP = 0.1
"""Part of the full speed that one press of + or - adds or subtracts."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

KEYS = """\
  q w e    forward, in a curve with q and e       + -    faster, slower
  a   d    turn left and right                    m n    motors on (arm), motors off (disarm)
    s      back                                   r      reset a fault or an emergency stop
  z   c    left and right, of a base that moves sideways
  space    emergency stop                         x      end; so does Ctrl-C
Hold a key to move; release it to stop. Any other key stops, too."""


class Gamepad(Protocol):
    """The interface of a gamepad that a session uses."""

    def twist(self) -> tuple[float, ...] | None:
        """Return m/s, rad/s and m/s to the left; None while the dead-man button is released."""

    async def run(self, estop: Callable[[], None]) -> None:
        """Run until the gamepad is unplugged; then raise OSError. Call `estop` when its e-stop
        button is pressed."""


@dataclass(slots=True)
class Speeds:
    """The full speeds of the keys, and the part of them that is in force."""

    linear_m_s: float
    angular_rad_s: float
    lateral_m_s: float = 0.0
    """Full speed to the left or right; 0: the base cannot move sideways."""
    part: float = 0.3

    def step(self, up: bool) -> None:
        steps = round(self.part / STEP) + (1 if up else -1)
        self.part = min(max(steps * STEP, STEP), 1.0)


class Teleop:
    """One session at a terminal."""

    def __init__(
        self,
        robot: Client,
        watcher: Client,
        terminal: Terminal,
        speeds: Speeds,
        dead_man: DeadMan,
        gamepad: Gamepad | None = None,
    ) -> None:
        """`robot` sends the commands. `watcher` is another connection to the daemon, so that
        reading the status delays no command."""
        self._robot, self._watcher, self._terminal = robot, watcher, terminal
        self._speeds, self._dead_man, self._gamepad = speeds, dead_man, gamepad
        self._loop = asyncio.get_running_loop()
        self._decoder, self._link = Decoder(), Link(self._loop.time())
        self._over = asyncio.Event()
        self._why = ""
        self._answer: dict[str, Any] | None = None
        self._armed_here = False
        self._act: asyncio.Task[None] | None = None
        self._tasks: TaskGroup

    async def run(self) -> str:
        """Run until a key, a signal, the terminal or the daemon ends the session. Return the
        reason; empty: the user's key."""
        for number in SIGNALS:
            self._loop.add_signal_handler(number, self._end, f"ended by {number.name}")
        try:
            with self._terminal:
                await self._follow()
                await self._come_to_rest()
                await self._take_answers()
        finally:
            for number in SIGNALS:
                self._loop.remove_signal_handler(number)
        return self._why

    async def _follow(self) -> None:
        self._terminal.write(KEYS.replace("\n", "\r\n").encode() + b"\r\n")
        try:
            async with TaskGroup() as self._tasks:
                self._loop.add_reader(self._terminal.fd, self._read)
                parts = (self._command(), self._watch(), self._ping(), self._follow_gamepad())
                running = [self._tasks.create_task(part) for part in parts]
                await self._over.wait()
                for task in running:
                    task.cancel()
        finally:
            self._loop.remove_reader(self._terminal.fd)

    def _end(self, why: str = "") -> None:
        if not self._over.is_set():
            self._why = why
            self._dead_man.let_go()
            self._over.set()

    # ---------------------------------------------------------------------------------------- keys
    def _read(self) -> None:
        """Read all keys that have come. Of the motion keys only the newest counts."""
        try:
            data = self._terminal.read()
        except EOFError:
            self._loop.remove_reader(self._terminal.fd)
            self._end("the terminal was closed")
            return
        now_s, motions = self._loop.time(), list[str]()
        for key in self._decoder.feed(data):
            if key == PONG:
                self._link.answered(now_s)
            elif key in MOTIONS:
                motions.append(key)
            elif not (key.startswith("\x1b[") and key.endswith("n")):  # not a report
                motions.clear()
                self._dead_man.let_go()
                self._press(key)
        if motions:
            self._dead_man.take(motions, now_s, self._link.key_age_s(now_s))

    def _drop_keys(self) -> None:
        """Drop the keys that came while this program stood still, except emergency stop and end."""
        self._dead_man.bar(self._loop.time())
        with contextlib.suppress(EOFError):  # the next look ends the session
            for key in self._decoder.feed(self._terminal.read()):
                if key == PONG:
                    self._link.answered(self._loop.time())
                elif key in (" ", "x", "\x03", "\x04"):
                    self._press(key)

    def _press(self, key: str) -> None:
        """Handle a key that is not a motion."""
        robot = self._robot
        if key == " ":
            self._estop()
        elif key in ("+", "=", "-"):
            self._speeds.step(up=key != "-")
        elif key in ("x", "\x03", "\x04"):
            self._end()
        elif key in ("m", "n", "r"):
            if self._act is not None and not self._act.done():
                self._terminal.message("the request before is still running")
                return
            words, call = {
                "m": ("arm", self._arm), "n": ("disarm", robot.disarm), "r": ("reset", robot.reset),
            }[key]  # fmt: skip
            self._act = self._tasks.create_task(self._perform(words, call()))

    def _estop(self) -> None:
        self._tasks.create_task(self._perform("emergency stop", self._robot.estop()))

    async def _perform(self, words: str, call: Coroutine[Any, Any, str]) -> None:
        try:
            self._terminal.message(f"{words}: {await call}")
        except ClientError as error:
            self._terminal.message(f"{words}: {error}")

    async def _arm(self) -> str:
        state = await self._robot.arm()
        self._armed_here = True
        return state

    # ------------------------------------------------------------------------------------ commands
    def _twist(self) -> tuple[float, ...] | None:
        """Return the requested linear, angular and lateral speed; None: no key and no dead-man
        button is held."""
        if self._gamepad is not None and (twist := self._gamepad.twist()) is not None:
            return twist
        motion = self._dead_man.motion(self._loop.time())
        if motion is None or self._over.is_set():
            return None
        speeds = self._speeds
        return (
            motion.linear * speeds.part * speeds.linear_m_s,
            motion.angular * speeds.part * speeds.angular_rad_s,
            motion.lateral * speeds.part * speeds.lateral_m_s,
        )

    async def _command(self) -> None:
        """Send commands as long as a key is held. When it is released, send zero once and release
        the lease."""
        commanding, last_s, refused = False, self._loop.time(), ""
        while True:
            if self._loop.time() - last_s > GAP_S:
                self._drop_keys()
            last_s = self._loop.time()
            twist = self._twist()
            try:
                if twist is not None:
                    commanding = True
                    self._answer = await self._robot.drive(*twist, owner=OWNER)
                elif commanding:
                    commanding, self._answer = False, None
                    await self._robot.drive(0.0, 0.0, owner=OWNER)
                    await self._robot.release(OWNER)
                    refused = ""
            except Refused as error:  # r or m may fix it: the session goes on
                if str(error) != refused:
                    refused = str(error)
                    self._terminal.message(refused)
            except ClientError as error:
                self._end(str(error))
            await asyncio.sleep(SEND_PERIOD_S)

    async def _come_to_rest(self) -> None:
        """Bring the robot to rest by its own ramp; disarm the drives if this session armed them.
        The reason for the end says so if the robot was not seen at rest."""
        found = Status()  # without the daemon it is unknown whether its drives stop
        with contextlib.suppress(ClientError):
            await self._robot.drive(0.0, 0.0, owner=OWNER)
            await self._robot.release(OWNER)
            if self._armed_here and (await self._watcher.status()).armed:
                await self._robot.disarm()
        with contextlib.suppress(ClientError):
            end_s = self._loop.time() + REST_WITHIN_S
            found = await self._watcher.status()
            while found.rest == Rest.TURNING and not self._rests(found):
                if self._loop.time() >= end_s:
                    break
                await asyncio.sleep(SEND_PERIOD_S)
                found = await self._watcher.status()
        if not self._rests(found):
            unseen = rest_text(found.rest, found.rest_unknown_s) or f"the wheels turn: {KEEP_AWAY}"
            self._why = "; ".join(filter(None, (self._why, unseen)))

    def _rests(self, found: Status) -> bool:
        """Whether the robot is at rest, or another source has a lease."""
        return found.at_rest or any(lease.owner != OWNER for lease in found.leases)

    # ------------------------------------------------------------------------------------- display
    async def _watch(self) -> None:
        while True:
            try:
                found = await self._watcher.status()
            except ClientError as error:
                self._end(str(error))
                return
            self._terminal.line(self._words(found))
            await asyncio.sleep(LOOK_PERIOD_S)

    def _words(self, found: Status) -> str:
        at, now_s = found.odometry, self._loop.time()
        speed = f"speed {not_known(at.age_s)}"
        if at.linear_m_s is not None:
            speed = f"{at.linear_m_s:6.2f} m/s {at.angular_rad_s:6.2f} rad/s"
        text = (
            f"{found.state:9} {100 * self._speeds.part:3.0f} %  {speed}  "
            f"x {at.x_m:.2f} y {at.y_m:.2f} m {at.heading_rad:.2f} rad"
        )
        if self._dead_man.barred(now_s):
            return f"slow link: release the key and press it again   {text}"
        if self._answer is not None and not self._answer["in_command"]:
            return f"{text}  {self._answer['owner']} is in command"
        if found.rest == Rest.UNKNOWN and found.state != "configuring":
            return f"{found.state}: {rest_text(found.rest, found.rest_unknown_s)}"
        if found.state in ("fault", "estop"):
            return f"{found.state}, r resets: {'; '.join(found.why)}"
        if found.state == "idle":
            return f"{text}  m arms"
        trip_s = self._link.round_trip_s
        return text if trip_s is None else f"{text}  link {1000 * trip_s:.0f} ms"

    async def _ping(self) -> None:
        """Send pings to the terminal, whose answers show how old a key can be."""
        while True:
            now_s = self._loop.time()
            if self._link.answers(now_s) is False:
                self._terminal.message("this terminal sends no reports: a slow link shows late")
                return
            if self._link.may_ping and self._terminal.write(PING):
                self._link.pinged(now_s)
            await asyncio.sleep(PING_PERIOD_S)

    async def _take_answers(self) -> None:
        end_s = self._loop.time() + ANSWERS_WITHIN_S
        with contextlib.suppress(EOFError):
            while self._link.pending and self._loop.time() < end_s:
                for key in self._decoder.feed(self._terminal.read()):
                    if key == PONG:
                        self._link.answered(self._loop.time())
                await asyncio.sleep(SEND_PERIOD_S / 5)
        self._terminal.write(b"\r\n")

    async def _follow_gamepad(self) -> None:
        if self._gamepad is None:
            return
        try:
            await self._gamepad.run(self._estop)
        except* OSError as errors:
            self._end(f"the gamepad: {errors.exceptions[0]}")
