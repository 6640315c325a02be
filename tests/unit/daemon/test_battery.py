# SPDX-License-Identifier: Apache-2.0
"""Levels of a battery: they have hysteresis, and are unknown where nothing was measured."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.unit.messages.bus_views import BODY, LOOP, joint, message, view

from motord.bus.messages.sources import PowerSupply
from motord.bus.prometheus.metrics import exposition
from motord.config import DrivesBattery
from motord.control.battery import BatteryLevel, BatteryWatch, Measure, of_drives
from motord.control.machine import Event, Facts, Refusal, State, step

S = 1_000_000_000
NORMAL, WARNING, CRITICAL = BatteryLevel.NORMAL, BatteryLevel.WARNING, BatteryLevel.CRITICAL
UNKNOWN = BatteryLevel.UNKNOWN


def section(**changes):
    values = {"low_v": 22.0, "critical_v": 20.0, "hysteresis_v": 0.5, "settle_s": 0.0}
    return DrivesBattery(source="drives", **values | changes)


def measured(watch, voltage_v, at_s, **more):
    return watch.take(Measure(stamp_ns=int(at_s * S), voltage_v=voltage_v, **more), int(at_s * S))


def test_each_change_of_level_is_reported_once_with_the_voltage():
    watch = BatteryWatch(section(), 0)
    levels = [measured(watch, v, at_s) for at_s, v in enumerate((24.0, 24.0, 21.9, 21.8, 19.9))]
    assert levels == [
        "the battery is normal: 24.00 V (was unknown)",
        None,
        "the battery is warning: 21.90 V (was normal)",
        None,
        "the battery is critical: 19.90 V (was warning)",
    ]


def test_a_voltage_that_sways_about_a_threshold_changes_the_level_once():
    watch = BatteryWatch(section(), 0)
    levels = []
    for at_s, voltage_v in enumerate((22.1, 21.9, 22.4, 21.9, 22.49, 22.5)):
        measured(watch, voltage_v, at_s)
        levels.append(watch.level)
    assert levels == [NORMAL, WARNING, WARNING, WARNING, WARNING, NORMAL]


def test_a_critical_battery_recovers_through_the_warning_level():
    watch = BatteryWatch(section(), 0)
    levels = []
    for at_s, voltage_v in enumerate((19.0, 20.4, 20.5, 22.4, 22.5)):
        measured(watch, voltage_v, at_s)
        levels.append(watch.level)
    assert levels == [CRITICAL, CRITICAL, WARNING, WARNING, NORMAL]


def test_a_dip_that_is_shorter_than_settle_s_changes_nothing():
    watch = BatteryWatch(section(settle_s=3.0), 0)
    dips = ((0, 24.0), (1, 19.0), (3.9, 19.0), (4.0, 24.0), (5, 19.0), (7.9, 19.0))
    assert [measured(watch, v, at_s) for at_s, v in dips][1:] == [None] * 5
    assert watch.level is NORMAL
    assert measured(watch, 19.0, 8.0) == "the battery is critical: 19.00 V (was normal)"


def test_registers_give_the_battery_and_a_discharge_is_negative():
    seen = view(1, joints=(joint(voltage_v=23.0), joint(voltage_v=25.0))).snapshot
    readings = {"voltage_from": 24.5, "current_from": 3.0, "temperature_from": 31.0}
    named = {"voltage_from": "left.a", "current_from": "left.b", "temperature_from": "left.c"}
    names = BODY.joints
    measure = of_drives(section(**named), names, seen, readings)
    assert (measure.voltage_v, measure.current_a, measure.temperature_c) == (24.5, -3.0, 31.0)
    assert of_drives(section(**named, inverted=True), names, seen, readings).current_a == 3.0
    assert math.isnan(of_drives(section(**named), names, seen).voltage_v)
    plain = of_drives(section(), names, seen)
    assert plain.voltage_v == 23.0
    assert math.isnan(plain.current_a)
    assert math.isnan(plain.temperature_c)


@pytest.mark.parametrize("nothing", [None, math.nan, math.inf, 0.0, -1.0])
def test_without_a_measure_the_battery_is_unknown_which_is_reported_once(nothing):
    watch = BatteryWatch(section(silent_s=5.0), 0)
    measured(watch, 24.0, 1)
    levels = []
    for at_s in (2, 5.9, 6, 7, 100):
        none = nothing is None
        levels.append(watch.take(None, at_s * S) if none else measured(watch, nothing, at_s))
    assert levels == [
        None,
        None,
        "the battery is unknown: nothing was measured for 5.0 s",
        None,
        None,
    ]
    report = watch.report(100 * S)
    assert (report["state"], report["voltage_v"], report["age_s"]) == ("unknown", None, None)


def test_a_battery_that_is_measured_again_gets_its_level_at_once():
    watch = BatteryWatch(section(settle_s=3.0), 0)
    watch.take(None, 10 * S)
    assert measured(watch, 21.0, 11) == "the battery is warning: 21.00 V (was unknown)"


@given(st.lists(st.one_of(st.none(), st.floats()), max_size=50))
def test_any_measure_is_reported_as_a_voltage_or_as_nothing(values):
    watch = BatteryWatch(section(), 0)
    for at_s, voltage_v in enumerate(values):
        watch.take(None, at_s * S) if voltage_v is None else measured(watch, voltage_v, at_s)
        report = watch.report(at_s * S)
        sent = report["voltage_v"]
        assert sent is None or (math.isfinite(sent) and sent > 0)
        assert report["state"] == "unknown" or sent is not None


def test_drives_give_the_lowest_fresh_voltage_and_no_current():
    joints = (joint(voltage_v=24.0), joint(voltage_v=23.5))
    measure = of_drives(section(), BODY.joints, view(1, joints=joints).snapshot)
    assert (measure.voltage_v, math.isnan(measure.current_a)) == (23.5, True)
    chosen = of_drives(section(joints=("left",)), BODY.joints, view(1, joints=joints).snapshot)
    assert chosen.voltage_v == 24.0
    stale = (joint(voltage_v=24.0, stale=True), joint(voltage_v=math.nan))
    assert not of_drives(section(), BODY.joints, view(1, joints=stale).snapshot).counts


def test_a_critical_battery_may_forbid_an_arm_but_not_a_reset():
    facts = Facts(battery_forbids=True)
    refusal = step(State.IDLE, Event.ARM, facts)
    assert isinstance(refusal, Refusal)
    assert "battery is critical" in refusal.reason
    assert step(State.FAULT, Event.RESET, facts) is State.IDLE


def report(**changes):
    watch = BatteryWatch(section(cells=6, capacity_ah=10.0), 0)
    measured(watch, 24.5, 1, current_a=-2.0)
    return watch.report(1 * S) | changes


def test_the_message_has_the_values_of_the_sensor_and_not_of_the_drives():
    def found(**changes):
        joints = (joint(voltage_v=1.0),) * 2
        one = view(1, status={"battery": report(**changes)}, joints=joints)
        return message("battery_state", one, BODY, 0)

    battery = found()
    assert (battery.voltage, battery.current, battery.design_capacity) == (24.5, -2.0, 10.0)
    assert battery.power_supply_status == PowerSupply.DISCHARGING
    assert len(battery.cell_voltage) == 6
    assert all(map(math.isnan, (*battery.cell_voltage, battery.percentage, battery.temperature)))
    assert found(current_a=0.1).power_supply_status == PowerSupply.CHARGING


def test_an_unknown_battery_is_no_message_though_a_drive_measures_something():
    unknown = {"battery": report(voltage_v=None)}
    one = view(1, status=unknown, joints=(joint(voltage_v=24.0),) * 2)
    assert message("battery_state", one, BODY, 0) is None


@pytest.mark.parametrize(
    ("state", "level"), [("normal", 0), ("warning", 1), ("critical", 2), ("unknown", 3)]
)
def test_diagnostics_show_the_battery_by_severity(state, level):
    one = view(1, status={"battery": report(state=state)})
    *_, battery = message("diagnostics", one, BODY, 0).status
    assert (battery.name, battery.level, battery.message) == ("r2: battery", level, state)


def test_prometheus_has_the_battery_and_nan_where_nothing_is_known():
    status = {"battery": report(current_a=None), "loop": LOOP, "lines": {}, "publishers": {},
              "bus": None, "commands": {"accepted": 0, "refused": {}}}  # fmt: skip
    rows = exposition(BODY, view(1, status=status)).decode().splitlines()
    assert 'motord_battery_voltage_volts{robot="r2"} 24.5' in rows
    assert 'motord_battery_current_amperes{robot="r2"} NaN' in rows
    assert 'motord_battery_state{robot="r2",state="normal"} 1.0' in rows
