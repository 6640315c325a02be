# SPDX-License-Identifier: Apache-2.0
"""The position of a drive, in its own numbers, that is the angle 0."""

import pytest
from tests.shipped import shipped_profile

from motord_hal.fieldbus.ports import JointSpec
from motord_hal.fieldbus.positions import raw_offset


@pytest.mark.parametrize(
    ("name", "zero_count", "raw"),
    [
        ("cia402-csp", 2500, 2500),
        ("cia402-csp", -2500, -2500),
        ("cia402-csp", (1 << 32) - 2500, -2500),  # as -2500 in a counter of 32 bits
        ("odrive-0.6-position", 4096, 0.5),
        ("odrive-0.6-position", -2048, -0.25),
        ("odrive-0.6-position", (1 << 32) - 2048, -0.25),
        ("cs2rs-position", -10, -10),
        ("sts3215-position", 2048, 2048),
        ("xl430-position", 4095, 4095),
    ],
)
def test_a_zero_below_the_counter_s_zero_is_a_negative_number_of_the_drive(name, zero_count, raw):
    profile = shipped_profile(name)
    joint = JointSpec(index=0, name="turret", profile=profile, unit=1, zero_count=zero_count)
    assert raw_offset(joint, profile) == raw
