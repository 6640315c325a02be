# SPDX-License-Identifier: Apache-2.0
"""Every event in every mode of a drive on a line in asyncio, checked by the table of tests in C."""

import math

import pytest
from drive_walk import FROM, CanMedium, ModbusMedium, cells, walk

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.plan import REST
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.modbus.plan import DrivePlan
from motord_hal.realtime.drive_state import DriveRules, Mode, left_alone
from motord_hal.realtime.exchange import JointSetpoint

CELLS = {medium: cells(medium.names) for medium in (ModbusMedium, CanMedium)}


def test_the_table_has_every_event_in_every_mode():
    count = {medium: sum(map(len, leads.values())) for medium, leads in CELLS.items()}
    assert count == {ModbusMedium: 56, CanMedium: 51}
    for leads in CELLS.values():
        for event, modes in leads.items():
            assert list(modes) == list(FROM[:-1]) or event == "REQUESTED_READY"


@pytest.mark.parametrize(
    ("make", "event"), [(medium, event) for medium, leads in CELLS.items() for event in leads]
)
async def test_every_event_leads_from_every_mode_to_the_mode_of_the_table(
    tmp_path, monkeypatch, make, event
):
    ends = DriveRules.end_stopping  # a stop ends by rest alone: its time never passes
    monkeypatch.setattr(
        DriveRules, "end_stopping", lambda one, _, at_rest: ends(one, 0, at_rest=at_rest)
    )
    await walk(make, tmp_path, event, CELLS[make][event])


def plan_of(name):
    joint = JointSpec(index=0, name="wheel", profile=find_profile(name), unit=1)
    return DrivePlan([joint], 0.0, lambda size: 0.0)


@pytest.mark.parametrize("name", ["zlac8015d", "cs2rs", "blvd20km"])
def test_only_a_finite_set_point_of_the_drive_s_own_kind_requests_motion(name):
    plan = plan_of(name)
    assert plan.wants_motion({0: JointSetpoint(1.0, 0.0)})
    assert plan.wants_motion({0: JointSetpoint(-1e-9, 0.0)})
    for still in (REST, JointSetpoint(0.0, 0.5, 0.5), JointSetpoint(math.nan, 0.0),
                  JointSetpoint(math.inf, 0.0)):  # fmt: skip
        assert not plan.wants_motion({0: still})
    assert not plan.wants_motion({})


def test_an_angle_of_zero_is_a_target():
    plan = plan_of("sts3215-position")
    assert plan.wants_motion({0: JointSetpoint(0.0, 0.0, position_rad=0.0)})
    assert not plan.wants_motion({0: REST})


def test_set_points_that_got_old_meanwhile_do_not_arm_a_drive():
    rules = DriveRules()
    rules.request(Mode.READY)
    rules.request(Mode.ARMED, fresh=False)
    assert rules.mode is Mode.READY
    rules.request(Mode.ARMED, fresh=True)
    assert rules.mode is Mode.ARMED


def test_a_drive_without_a_watchdog_is_never_left_alone():
    assert left_alone(0.0, 1.0, 0.5)
    assert not left_alone(0.5, 1.0, 0.5)
    assert not left_alone(0.0, 1e6, math.inf)
