# SPDX-License-Identifier: Apache-2.0
"""The binary frames of the dashboard, read by the layout that a page gets."""

import contextlib
import dataclasses
import math
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.unit.messages.bus_views import joint, view

from motord.api.snapshot import STATES
from motord.bus.web.description import description
from motord.bus.web.frames import FLAGS, Packer, drive_frame, layout, number_of
from motord.config import load_robot

STRAFES = "mecanum4"


def decoded(raw):
    """Return the values of a frame, read as the page reads them."""
    found, at = layout(), 0

    def fields(rows):
        nonlocal at
        values = {}
        for name, code in rows:
            (values[name],) = struct.unpack_from("<" + code, raw, at)
            at += struct.calcsize("<" + code)
        return values

    state = fields(found["state"])
    state["joints"] = [fields(found["joint"]) for _ in range(state["joints"])]
    assert at == len(raw)
    return state


def test_a_frame_holds_the_values_of_the_snapshot():
    one = joint(velocity_rad_s=1.5, position_rad=1e6 + 1e-6, enabled=None, drive_faults=0xFFFFFFFF)
    now = view(5000, joints=(one, joint(stale=True)), machine_state=4, armed=True, x_m=12.345678901,
               reasons=("linear_jerk", "fault"), faults=("estop",), owner=7,
               setpoint_linear_m_s=0.25, lateral_m_s=-0.5,
               command_age_s=math.inf).snapshot  # fmt: skip
    found = decoded(Packer(2).pack(now, 9))
    assert STATES[found["state"]] == "moving"
    assert found["flags"] == 1 << FLAGS.index("armed")
    assert (found["stamp_s"], found["sequence"], found["owner"]) == (5.0, 9, 7)
    assert found["x_m"] == 12.345678901
    assert found["setpoint_linear_m_s"] == 0.25
    assert found["lateral_m_s"] == -0.5
    assert found["command_age_s"] == math.inf
    assert found["faults"] == 1
    assert found["reasons"] == 1 << 3 | 1 << 20
    left, right = found["joints"]
    assert (left["velocity_rad_s"], left["position_rad"]) == (1.5, 1e6 + 1e-6)
    assert (left["enabled"], left["drive_faults"], right["enabled"]) == (2, 0xFFFFFFFF, 1)
    assert (left["stale"], right["stale"]) == (0, 1)


@given(value=st.floats())
def test_every_number_can_be_sent(value):
    numbers = {
        field.name: value
        for field in dataclasses.fields(joint())
        if isinstance(getattr(joint(), field.name), float)
    }
    now = view(1, joints=(joint(**numbers),), wanted_linear_m_s=value, x_m=value).snapshot
    found = decoded(Packer(1).pack(now, 0))
    assert found["x_m"] == value or math.isnan(value)
    sent = found["wanted_linear_m_s"]
    assert math.isnan(sent) == math.isnan(value)
    if math.isfinite(sent):
        assert sent == pytest.approx(value, rel=1e-6, abs=1e-44)
    elif math.isinf(sent):
        assert abs(value) > 3e38


def test_a_daemon_with_another_robot_file_gives_no_frame():
    assert Packer(3).pack(view(1).snapshot, 1) is None


@pytest.mark.parametrize("time", [math.nan, math.inf, -math.inf, 1e308, -1e16])
@pytest.mark.parametrize("place", [0, 1])
def test_a_command_without_a_time_is_refused(time, place):
    times = [5.0, 5.0]
    times[place] = time
    with pytest.raises(ValueError, match="finite"):
        drive_frame(struct.pack("<BIddddd", 1, 1, *times, 0.1, 0.0, 0.1))


@given(raw=st.binary(max_size=60))
def test_an_invalid_frame_of_a_page_is_a_value_error(raw):
    for read, size in ((drive_frame, 45), (number_of, 5)):
        if len(raw) == size:
            with contextlib.suppress(ValueError):
                read(raw)
        else:
            with pytest.raises(ValueError):
                read(raw)


def test_a_page_gets_the_wheels_and_the_lateral_limit_of_a_base_that_strafes():
    robots = Path(__file__).resolve().parents[3] / "config/robots"
    found = {name: description(load_robot(robots / f"{name}.toml")) for name in ("demo", STRAFES)}
    assert found["demo"]["limits"]["lateral_m_s"] == 0.0
    assert found[STRAFES]["limits"]["lateral_m_s"] > 0.0
    assert all(len(one["wheels"]) == len(one["joints"]) for one in found.values())
    places = {(wheel["x_m"], wheel["y_m"]) for wheel in found[STRAFES]["wheels"]}
    assert len(places) == len(found[STRAFES]["joints"])
