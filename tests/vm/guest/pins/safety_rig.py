# SPDX-License-Identifier: Apache-2.0
"""A simulated GPIO chip that can be removed, and a loop with its safety pins on it.

Source: kernel, Documentation/admin-guide/gpio/gpio-sim.rst.
"""

import contextlib
import dataclasses
import math
import os
from pathlib import Path

from gpiod.line import Bias
from pin_rig import CONFIG, wait_until

from motord.realtime import loop as rt
from motord_hal.gpio.lines import Wanted, request_edges, request_outputs
from motord_hal.realtime.exchange import Exchange, now_ns

LABEL, CONTACT, PUMP = "motord-safety", "ESTOP", "PUMP"
NAMES = (CONTACT, PUMP)
FOREVER_S = 1e4
HEARTBEAT_TIMEOUT_NS = 2_000_000_000


@dataclasses.dataclass
class Lines:
    folder: Path
    chip: Path

    def level(self, name):
        return float((self.folder / f"sim_gpio{NAMES.index(name)}/value").read_text())

    def drive(self, name, level):
        """Drives a line from outside, like a contact."""
        pull = self.folder / f"sim_gpio{NAMES.index(name)}/pull"
        pull.write_text("pull-up" if level else "pull-down")

    def remove(self):
        (self.chip / "live").write_text("0")


@contextlib.contextmanager
def chip():
    """A chip with both lines."""
    made = CONFIG / LABEL
    bank = made / "bank0"
    bank.mkdir(parents=True)
    (bank / "num_lines").write_text(str(len(NAMES)))
    (bank / "label").write_text(LABEL)
    for offset, name in enumerate(NAMES):
        (bank / f"line{offset}").mkdir()
        (bank / f"line{offset}/name").write_text(name)
    (made / "live").write_text("1")
    device = (made / "dev_name").read_text().strip()
    number = (bank / "chip_name").read_text().strip()
    wait_until(Path("/dev", number).exists, "the chip's device file")
    try:
        yield Lines(Path("/sys/devices/platform", device, number), made)
    finally:
        if (made / "live").read_text().strip() == "1":  # the kernel refuses an unchanged value
            (made / "live").write_text("0")
        for folder in (*(bank / f"line{n}" for n in range(len(NAMES))), bank, made):
            folder.rmdir()


AXIS = rt.AxisLimits(
    velocity_u_s=1.0, acceleration_u_s2=50.0, deceleration_u_s2=50.0, jerk_u_s3=math.inf
)
LIMITS = rt.BaseLimits(linear=AXIS, angular=AXIS, lateral=AXIS)


def joint(side):
    pwm = rt.PwmConfig(
        dead_band=0.0, duty_min=-1.0, duty_max=1.0, slew_per_s=math.inf, full_duty_rad_s=20.0
    )
    return rt.JointConfig(
        row={"x": 1.0, "y": 0.0, "lever_m": side * 0.2},
        wheel_radius_m=0.1,
        velocity_min_rad_s=-20.0,
        velocity_max_rad_s=20.0,
        rad_per_count=0.001,
        counter_bits=32,
        line=0,
        pwm=pwm,
    )


def core_config():
    return rt.CoreConfig(
        joint_count=2,
        limits=LIMITS,
        command_timeout_s=FOREVER_S,
        feedback_timeout_s=FOREVER_S,
        heartbeat_timeout_s=FOREVER_S,
        rest_velocity_rad_s=0.05,
        on_timeout=rt.StopAction.RAMP,
        on_fault=rt.StopAction.RAMP,
        on_estop=rt.StopAction.BRAKE,
        distance_variance_m2_per_m=1e-3,
        turn_variance_rad2_per_rad=1e-3,
        pose_variance_floor_m2=1e-6,
        heading_variance_floor_rad2=1e-6,
        twist_variance_floor_m2_s2=1e-6,
        twist_variance_floor_rad2_s2=1e-6,
        joint=[joint(-1.0), joint(1.0)],
    )


@contextlib.contextmanager
def looped(rate_hz=200.0, pull=Bias.AS_IS):
    """A loop with a normally-closed contact to ground, and a watchdog. The simulated chip takes the
    bias of a request for the level from outside, so only a test of the bias requests one."""
    with contextlib.ExitStack() as unless_ended:
        contact = Wanted(line=CONTACT, purpose="safety.estop")
        estop_fd = request_edges(LABEL, contact, "motord", pull, rising=True)
        unless_ended.callback(os.close, estop_fd)
        os.set_blocking(estop_fd, False)
        pump = Wanted(line=PUMP, purpose="safety.watchdog")
        watchdog_fd = request_outputs(LABEL, [pump], "motord")
        unless_ended.callback(os.close, watchdog_fd)
        guard = rt_guard(estop_fd, watchdog_fd)
        settings = rt.LoopSettings(rate_hz=rate_hz, priority=0, lock_memory=False, guard=guard)
        with rt.Loop(core_config(), settings) as loop:
            yield loop


def rt_guard(estop_fd, watchdog_fd):
    return {
        "estop": 1,
        "estop_fd": estop_fd,
        "estop_high": 1,
        "watchdog": 1,
        "watchdog_fd": watchdog_fd,
        "watchdog_every_ticks": 1,
        "heartbeat_timeout_ns": HEARTBEAT_TIMEOUT_NS,
        "line_timeout_ns": [0, 0, 0, 0],
    }


def reset(loop, count):
    """Requests a reset with fresh feedback of resting wheels, and waits for some ticks."""
    for index in (0, 1):
        Exchange.of_loop().put_feedback(
            index,
            stamp_ns=now_ns(),
            count=0,
            velocity_rad_s=0.0,
            epoch=0,
            enabled=True,
            drive_faults=0,
        )
    loop.put_control(rt.Control(reset_count=count, limits=LIMITS))
    seen = loop.status().ticks + 10
    wait_until(lambda: loop.status().ticks > seen, "ticks")
