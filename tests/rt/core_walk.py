# SPDX-License-Identifier: Apache-2.0
"""A core of any robot that is driven by a mixture of good, odd and hostile input."""

import math
import random

from _motord_rt import ffi, lib

from motord.realtime.raw_config import raw_config
from motord.realtime.recorded import checked_input

TICK_NS = 1_000_000
ODD = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e300, -1e-300, 1.0, -7.5)


def raw_bytes(raw):
    return bytes(ffi.buffer(raw))


class Walk:
    def __init__(self, config, seed):
        self.dice = random.Random(seed)
        self.state = ffi.new("core_state *")
        assert lib.core_init(self.state, raw_config(config)) == 0
        self.initial = raw_bytes(self.state)
        self.record = ffi.new("journal_record *")
        self.out, self.snapshot = ffi.new("setpoints *"), ffi.new("robot_state *")
        self.record.input.now_ns = 10**12
        self.record.input.control.limits = self.state.config.limits

    def number(self):
        return self.dice.choice(ODD) if self.dice.random() < 0.02 else self.dice.gauss(0.0, 1.0)

    def flag(self, often=0.98):
        return int(self.dice.random() < often)

    def step(self):
        dice, inputs = self.dice, self.record.input
        inputs.now_ns += TICK_NS
        control, command = inputs.control, inputs.command
        command.stamp_ns, command.expires_ns = inputs.now_ns, inputs.now_ns + 10**9
        command.sequence += 1
        command.linear_m_s, command.angular_rad_s, command.lateral_m_s = (
            self.number() for _ in range(3)
        )
        control.heartbeat_ns = inputs.now_ns
        control.armed, control.stop = self.flag(), 1 - self.flag()
        control.estop, control.fault = 1 - self.flag(0.999), 1 - self.flag(0.999)
        control.reset_count += dice.random() < 0.05
        control.odometry_reset_count += dice.random() < 0.01
        control.release = 1 - self.flag()
        for joint in range(self.state.config.joint_count):
            feedback = inputs.feedback[joint]
            if dice.random() < 0.9:
                feedback.stamp_ns = inputs.now_ns
            feedback.count = (feedback.count + dice.randrange(-30, 31)) % (1 << 64)
            if dice.random() < 0.001:
                feedback.count = dice.randrange(1 << 64)
                feedback.epoch += 1
            for name in ("velocity_rad_s", "current_a", "voltage_v", "temperature_c"):
                setattr(feedback, name, self.number())
            feedback.enabled, feedback.referenced = dice.choice((0, 1, 1, 2)), dice.randrange(3)
            feedback.drive_faults = 0 if dice.random() < 0.99 else dice.randrange(1 << 32)
            inputs.joints.value_u[joint] = self.number()
        inputs.joints.named = dice.randrange(256)
        inputs.imu.stamp_ns = inputs.now_ns
        for axis in range(3):
            inputs.imu.angular_rad_s[axis] = self.number() * 0.01
        inputs.suspended = 1 - self.flag(0.999)
        self.record.dt_s = 0.001
        checked_input(raw_bytes(self.record))
        inputs = ffi.addressof(self.record, "input")
        lib.core_step(self.state, inputs, 0.001, self.out, self.snapshot)
        self.record.tick = self.state.tick
