# SPDX-License-Identifier: Apache-2.0
"""The registers of a drive that a person may read and write."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.config.drives.load import find_profile
from motord_hal.drives.profile import Register, RegisterType
from motord_hal.fieldbus.parameter import kept_back, raw_to_write, readable

GAIN = Register(
    name="gain", address=0x3000, type=RegisterType.U16, scale=0.5, unit="rpm", access="rw",
    minimum=10, maximum=500, source="test",
)  # fmt: skip
PROFILE = replace(
    find_profile("zlac8015d"), registers={**find_profile("zlac8015d").registers, "gain": GAIN}
)
RPM = 2 * math.pi / 60


def test_registers_that_motord_itself_writes_are_refused():
    assert kept_back(PROFILE) == {
        "target_velocity_1", "target_velocity_2", "control_word", "control_mode",
        "communication_timeout",
    }  # fmt: skip
    assert "run_command" in kept_back(find_profile("bld-305s"))
    for name in kept_back(PROFILE):
        with pytest.raises(ValueError, match="motord itself"):
            raw_to_write(PROFILE, name, 0.0)


def test_unknown_and_read_only_registers_are_not_written():
    with pytest.raises(LookupError, match="no register"):
        readable(PROFILE, "gian")
    with pytest.raises(ValueError, match="only be read"):
        raw_to_write(PROFILE, "bus_voltage", 24.0)


@given(st.one_of(st.floats(), st.floats(0, 60)))
def test_a_value_goes_out_within_its_limits_or_not_at_all(value):
    low, high = GAIN.si_limits
    assert (low, high) == pytest.approx((10 * RPM, 500 * RPM))
    if low <= value <= high:
        raw = raw_to_write(PROFILE, "gain", value)
        assert GAIN.to_si(raw) == pytest.approx(value, abs=0.25 * RPM + 1e-9)
    else:
        with pytest.raises(ValueError, match="is not within"):
            raw_to_write(PROFILE, "gain", value)
