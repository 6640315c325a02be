# SPDX-License-Identifier: Apache-2.0
"""Quadrature encoders on the kernel's own GPIO: every edge of its simulated lines is counted, and
faults of the lines are reported.

Source: kernel, kernel/irq/irq_sim.c (6.1): a pending interrupt is a bit, not a number.
"""

import math
import os
from pathlib import Path

import pytest
from bridge_rig import places, spec_of
from loop_side import running, until
from pin_rig import LABEL, PWM

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import EdgesEncoder, EventKind, JointSpec, LineState
from motord_hal.gpio.lines import Wanted, request_outputs

A, B = "PIN8", "PIN9"
DRIVE = "bts7960"
GRAY = [(0, 0), (1, 0), (1, 1), (0, 1)]
PER_COUNT = math.tau / 1320
pytestmark = [
    pytest.mark.skipif(not list(PWM.glob("pwmchip*")), reason="no PWM chip (module pwm-sim)"),
    pytest.mark.skipif(not Path("/sys/kernel/config/gpio-sim").is_dir(), reason="no gpio-sim"),
]


class Wheel:
    """An encoder. A test turns it, which sets the levels of its lines."""

    def __init__(self, rig):
        self.rig, self.position = rig, 0
        self.show()

    def show(self):
        for line, level in zip((A, B), GRAY[self.position % 4], strict=True):
            self.rig.drive(line, level)

    def turn(self, edges):
        for _ in range(abs(edges)):
            self.position += 1 if edges > 0 else -1
            self.show()


def with_encoder(rig, **changes):
    encoder = EdgesEncoder(gpio_chip=LABEL, a=A, b=B, pull="none", rad_per_count=PER_COUNT)
    joint = JointSpec(index=0, name="left", profile=find_profile(DRIVE), unit=1,
                      pins=places(DRIVE), encoder=encoder)  # fmt: skip
    return spec_of(rig, DRIVE, joints=(joint,), **changes)


def count_is(line, wanted):
    return lambda: line.loop.exchange.take_feedback(0).count == wanted % 2**64


@pytest.mark.parametrize("begin", [0, 1, 2, 3])
async def test_every_edge_is_counted_forward_and_back_from_any_place(rig, begin):
    wheel = Wheel(rig)
    wheel.turn(begin)
    async with running(with_encoder(rig)) as line:
        await line.ready()
        for edges in (1, 7, -3, -20, 40, -1):
            for _ in range(abs(edges)):  # one at a time: the simulated lines merge quick edges
                wheel.turn(1 if edges > 0 else -1)
                await until(count_is(line, wheel.position - begin), f"edge {wheel.position}")
        assert "encoder_lost" not in line.line.stats().errors
        assert "encoder_illegal" not in line.line.stats().errors


@pytest.mark.smoke
async def test_a_turning_wheel_is_measured_and_a_still_one_is_at_rest(rig):
    wheel = Wheel(rig)
    async with running(with_encoder(rig)) as line:
        await line.ready()

        def turning():
            wheel.turn(2)
            return line.loop.exchange.take_feedback(0).velocity_rad_s > 0.0

        await until(turning, "forward")
        await until(lambda: line.loop.exchange.take_feedback(0).velocity_rad_s == 0.0, "rest")


async def test_edges_before_the_line_was_opened_do_not_count(rig):
    wheel = Wheel(rig)
    wheel.turn(13)
    async with running(with_encoder(rig)) as line:
        await until(lambda: line.loop.exchange.take_feedback(0).stamp_ns > 0)
        assert line.loop.exchange.take_feedback(0).count == 0


async def test_an_encoder_channel_in_use_is_reported_with_joint_channel_and_owner(rig):
    fd = request_outputs(LABEL, [Wanted(line=B, purpose="a test")], "coffee machine")
    try:
        async with running(with_encoder(rig)) as line:
            await until(lambda: EventKind.LINE_LOST in line.kinds())
            text = line.events[0].text
            assert "joint left, encoder b" in text
            assert 'in use by "coffee machine"' in text
            os.close(fd)
            fd = -1
            await until(lambda: line.line.state is LineState.READY, "it gets its lines after all")
    finally:
        if fd >= 0:
            os.close(fd)
