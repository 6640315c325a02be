# SPDX-License-Identifier: Apache-2.0
"""The parts that are measured: the real loop with the real core, and asyncio between a command and
a byte.

    other end ── command ──▶ asyncio ──▶ loop ──▶ asyncio ── byte ──▶ other end
    (a process)  (socket)         (mailbox)  (eventfd)        (pty)

There is no motor: this file makes the feedback of the drives, and the port is its own pty.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import socket
import time
from collections.abc import Iterator

from motord.realtime.loop import BaseLimits, Control, CoreConfig, JointConfig, Loop, StopAction
from motord.tools.latency.other_end import LatencyError
from motord.tools.latency.peer import COMMAND, Tally
from motord_hal.base.clock import within
from motord_hal.realtime.exchange import Exchange, Setpoints

LINE = 0
WHEEL_RADIUS_M = 0.1
CODE_M_S = 0.01
"""Speed for each step of the code: a command with code n requests n times this. The code is
computed back from the wheel's set-point."""
NO_LIMIT = 1e6
LEASE_S = 60.0
PATIENCE_S = 60.0
"""Time-out of commands, feedback and heartbeats. It is long because no motor can move: a late
asyncio is measured, not stopped."""
ARM_DEADLINE_S = 20.0

LIMITS: BaseLimits = {
    "linear": {
        "velocity_u_s": 10.0,
        "acceleration_u_s2": NO_LIMIT,
        "deceleration_u_s2": NO_LIMIT,
        "jerk_u_s3": math.inf,
    },
    "angular": {
        "velocity_u_s": 10.0,
        "acceleration_u_s2": NO_LIMIT,
        "deceleration_u_s2": NO_LIMIT,
        "jerk_u_s3": math.inf,
    },
    "lateral": {
        "velocity_u_s": 10.0,
        "acceleration_u_s2": NO_LIMIT,
        "deceleration_u_s2": NO_LIMIT,
        "jerk_u_s3": math.inf,
    },
}
"""Limits so wide that the first tick with a command reaches its speed."""


def wheel(side: float) -> JointConfig:
    return {
        "row": {"x": 1.0, "y": 0.0, "lever_m": side * 0.25},
        "wheel_radius_m": WHEEL_RADIUS_M,
        "velocity_min_rad_s": -1000.0,
        "velocity_max_rad_s": 1000.0,
        "rad_per_count": 0.001,
        "counter_bits": 32,
        "line": LINE,
        "pwm": {
            "dead_band": 0.05,
            "duty_min": -1.0,
            "duty_max": 1.0,
            "slew_per_s": math.inf,
            "full_duty_rad_s": 100.0,
        },
    }


def core_config() -> CoreConfig:
    """Return a configuration with two wheels, and with limits that have no effect."""
    return {
        "joint_count": 2,
        "limits": LIMITS,
        "command_timeout_s": PATIENCE_S,
        "feedback_timeout_s": PATIENCE_S,
        "heartbeat_timeout_s": PATIENCE_S,
        "rest_velocity_rad_s": 0.01,
        "on_timeout": StopAction.RAMP,
        "on_fault": StopAction.RAMP,
        "on_estop": StopAction.BRAKE,
        "distance_variance_m2_per_m": 1e-4,
        "turn_variance_rad2_per_rad": 1e-3,
        "pose_variance_floor_m2": 1e-6,
        "heading_variance_floor_rad2": 1e-6,
        "twist_variance_floor_m2_s2": 1e-6,
        "twist_variance_floor_rad2_s2": 1e-6,
        "joint": [wheel(-1.0), wheel(1.0)],
    }


def code_of(setpoints: Setpoints) -> int:
    """Return the code of the command behind these set-points; 0: they are zero or not enabled."""
    if not setpoints.enabled:
        return 0
    return round(setpoints.joints[0].velocity_rad_s * WHEEL_RADIUS_M / CODE_M_S)


class Arrivals:
    """Measures the age of each notified tick when asyncio takes it. The loop wakes asyncio at ticks
    whose numbers are multiples of `every_ticks`.

    A mailbox has only the newest tick. Ticks that asyncio has missed get a stamp by interpolation
    between the two around them. They count, too: without them a stall of 40 ticks would look like
    one late wake-up.
    """

    def __init__(self, every_ticks: int) -> None:
        self._every_ticks = every_ticks
        self._seen: tuple[int, int] | None = None
        self.age = Tally()

    def take(self, tick: int, stamp_ns: int, taken_ns: int) -> None:
        before = self._seen or (tick, stamp_ns)
        if self._seen is not None and tick <= before[0]:
            return
        self._seen = tick, stamp_ns
        first = before[0] // self._every_ticks + 1
        for notified in range(first * self._every_ticks, tick + 1, self._every_ticks):
            share = (notified - before[0]) / (tick - before[0])
            self.age.add(taken_ns - before[1] - round(share * (stamp_ns - before[1])))


class Rig:
    """The part of the measurement in asyncio, while the loop runs. Call all methods in the event
    loop's thread."""

    def __init__(self, loop: Loop, commands: socket.socket, port_fd: int, every_ticks: int) -> None:
        self._loop, self._commands, self._port_fd = loop, commands, port_fd
        self._lease = loop.open_lease(lifetime_s=LEASE_S)
        self._exchange = Exchange.of_loop()
        self._answered = 0
        self.arrivals = Arrivals(every_ticks)

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Take the loop's notifications and the other end's commands in this block."""
        reactor = asyncio.get_running_loop()
        reactor.add_reader(self._loop.fileno(), self._on_tick)
        reactor.add_reader(self._commands, self._on_command)
        try:
            yield
        finally:
            reactor.remove_reader(self._loop.fileno())
            reactor.remove_reader(self._commands)

    def _on_tick(self) -> None:
        self._loop.drain()
        setpoints = self._exchange.take_setpoints(LINE)
        self.arrivals.take(setpoints.tick, setpoints.stamp_ns, time.monotonic_ns())
        code = code_of(setpoints)
        if code not in (0, self._answered):
            self._answered = code
            # If the port is full, the other end does not read any more, and the answer is lost.
            with contextlib.suppress(BlockingIOError):
                os.write(self._port_fd, bytes((code,)))

    def _on_command(self) -> None:
        """Pass all commands that have come to the loop with their own stamps, as the daemon
        does. The newest counts."""
        with contextlib.suppress(BlockingIOError):
            while packet := self._commands.recv(COMMAND.size):
                stamp_ns, code = COMMAND.unpack(packet)
                self._lease.send(code * CODE_M_S, 0.0, stamp_ns)
            asyncio.get_running_loop().remove_reader(self._commands)

    def stay_alive(self) -> None:
        """Send a heartbeat, and feedback of drives that stand still and have no fault."""
        for joint in range(2):
            self._exchange.put_feedback(
                joint, stamp_ns=time.monotonic_ns(), count=0, epoch=1, enabled=True, drive_faults=0
            )
        self._loop.beat()

    async def arm(self, period_s: float) -> None:
        """Arm the core. It arms at a change of `armed` that it sees, so the change is repeated
        until it is armed. Raise LatencyError if that takes too long."""
        with contextlib.suppress(TimeoutError):
            async with within(ARM_DEADLINE_S):
                while not self._loop.read_state().armed:
                    self.stay_alive()
                    for armed in (False, True):
                        self._loop.put_control(Control(armed=armed, limits=LIMITS))
                        await asyncio.sleep(2.0 * period_s)
                return
        state = self._loop.read_state()
        why = ", ".join((*state.reasons, *state.faults))
        raise LatencyError(f"the core did not arm within {ARM_DEADLINE_S:.0f} s: {why}")
