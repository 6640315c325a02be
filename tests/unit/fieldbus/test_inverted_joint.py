# SPDX-License-Identifier: Apache-2.0
"""What is turned at a joint whose motor is mounted in reverse, for every drive: set-point, velocity
and current, and nothing else."""

from dataclasses import replace

import pytest
from tests.shipped import NAMES, shipped_profile

from motord_hal.fieldbus.ports import JointSpec
from motord_hal.realtime.table import FieldKind
from motord_hal.rt_engine.decoding import setpoint_scale, wheel_factor

BY_POWER = ("vesc", "vesc-duty")
GEAR = 4.0


@pytest.fixture(params=NAMES)
def joints(request):
    """A joint on a shipped drive, and the same joint inverted."""
    profile = shipped_profile(request.param)
    joint = JointSpec(
        index=0, name="left", profile=profile, unit=1, gear_ratio=GEAR, counts_per_turn=4096
    )
    return joint, replace(joint, inverted=True)


def test_set_point_and_velocity_are_turned(joints):
    straight, inverted = joints
    channel = straight.profile.channels[1]
    scales = [setpoint_scale(joint, channel, 1.0, (-1.0, 1.0))["raw_per_si"] for joint in joints]
    assert scales[0] == -scales[1] != 0.0
    assert wheel_factor(straight, FieldKind.VELOCITY) == 1.0 / GEAR
    assert wheel_factor(inverted, FieldKind.VELOCITY) == -1.0 / GEAR


def test_a_current_with_the_sign_of_the_torque_is_turned(joints):
    straight, inverted = joints
    current = straight.profile.channels[1].current
    signed = current is not None and straight.profile.registers[current].type.signed
    turned = signed and straight.profile.name not in BY_POWER
    assert wheel_factor(straight, FieldKind.CURRENT) == 1.0
    assert wheel_factor(inverted, FieldKind.CURRENT) == (-1.0 if turned else 1.0)


@pytest.mark.parametrize("kind", set(FieldKind) - {FieldKind.VELOCITY, FieldKind.CURRENT})
def test_nothing_else_is_turned(joints, kind):
    assert [wheel_factor(joint, kind) for joint in joints] == [1.0, 1.0]
