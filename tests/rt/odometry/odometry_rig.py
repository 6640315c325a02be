# SPDX-License-Identifier: Apache-2.0
"""The bare odometry: counts, stamps and time by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from _motord_rt import ffi, lib
from tests.rt.core_rig import core_config, joint_config

STEP_NS = 10_000_000
STEP_S = 0.01
LOOK_NS = 50_000_000  # SPREAD_EVERY_NS of csrc/core/core.h
LEFT, RIGHT = 0, 1


class Base:
    """An odometry_state with its feedback; counts and time by hand."""

    def __init__(self, joints: int = 2, **changes: Any) -> None:
        rows = [joint_config(-1.0 if j % 2 == 0 else 1.0, **changes) for j in range(joints)]
        self.config = ffi.new("core_config *", core_config(joints, joint=rows))
        self.state = ffi.new("odometry_state *")
        lib.odometry_init(self.state, self.config)
        self.feedback = ffi.new("joint_feedback[8]")
        self.stale = ffi.new("uint32_t[8]")
        self.setpoint = ffi.new("joint_setpoint[8]")
        self.joints = joints
        self.now_ns = 1_000_000_000
        self.step_ns = STEP_NS
        for j in range(joints):
            self.feedback[j].velocity_rad_s = math.nan

    def take(self) -> Any:
        lib.odometry_step(self.state, self.config, self.feedback, self.stale, self.setpoint)
        return self.state

    def step(self, *counts: int, skip: tuple[int, ...] = ()) -> Any:
        """Time goes on; each joint that is not skipped counts on by its number and reports."""
        self.now_ns += self.step_ns
        for j, count in enumerate(counts):
            if j not in skip:
                bits = self.config.joint[j].counter_bits or 64
                self.feedback[j].count = (self.feedback[j].count + count) % (1 << bits)
                self.feedback[j].stamp_ns = self.now_ns
        return self.take()

    def covariance(self) -> np.ndarray:
        xx, xy, xh, yy, yh, hh = self.state.pose_covariance
        return np.array([[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]])
