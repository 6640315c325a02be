# SPDX-License-Identifier: Apache-2.0
"""Opening of the safety pins, which the loop itself reads and writes."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping

from motord.config import Robot
from motord.realtime.types import GuardConfig

LINE_CYCLES = 5
"""Cycles that a line with enabled drives may miss."""


@contextlib.contextmanager
def open_guard(robot: Robot, cycle_hz: Mapping[str, float]) -> Iterator[GuardConfig | None]:
    """Open the pins and yield the loop's settings for them; None: the robot file has no such pins.
    `cycle_hz`: cycle rate of each line by its name. Raises PortError."""
    safety = robot.safety
    if safety.estop is None and safety.watchdog is None:
        yield None
        return
    # imported here: a robot without pins needs no libgpiod
    from gpiod.line import Bias

    from motord_hal.gpio.lines import Wanted, request_edges, request_outputs

    guard: GuardConfig = {
        "estop": 0,
        "estop_fd": -1,
        "estop_high": 0,
        "watchdog": 0,
        "watchdog_fd": -1,
        "watchdog_every_ticks": 1,
        "heartbeat_timeout_ns": round(safety.heartbeat_timeout_s * 1e9),
        "line_timeout_ns": line_timeouts_ns(robot, cycle_hz),
    }
    with contextlib.ExitStack() as unless_ended:
        if (estop := safety.estop) is not None:
            pull = Bias.PULL_UP if estop.switches_to == "ground" else Bias.PULL_DOWN
            wanted = Wanted(line=estop.gpio_line, purpose="safety.estop")
            fd = request_edges(
                estop.gpio_chip,
                wanted,
                "motord",
                pull if estop.pull else Bias.AS_IS,
                rising=estop.stop_is_high,
            )
            unless_ended.callback(os.close, fd)
            os.set_blocking(fd, False)
            guard |= {"estop": 1, "estop_fd": fd, "estop_high": int(estop.stop_is_high)}
        if (watchdog := safety.watchdog) is not None:
            wanted = Wanted(line=watchdog.gpio_line, purpose="safety.watchdog")
            fd = request_outputs(watchdog.gpio_chip, [wanted], "motord")
            unless_ended.callback(os.close, fd)
            guard |= {
                "watchdog": 1,
                "watchdog_fd": fd,
                "watchdog_every_ticks": watchdog.every_ticks,
            }
        yield guard


def line_timeouts_ns(robot: Robot, cycle_hz: Mapping[str, float]) -> list[int]:
    """Return how long each line may be silent, in the lines' order: as long as a wheel may be
    silent, or some cycles where they are slow."""
    silent_s = robot.safety.feedback_timeout_s
    return [round(max(silent_s, LINE_CYCLES / cycle_hz[name]) * 1e9) for name in robot.line]
