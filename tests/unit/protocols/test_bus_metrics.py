# SPDX-License-Identifier: Apache-2.0
"""Figures for Prometheus are read by its own parser, whatever was measured."""

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from prometheus_client.parser import text_string_to_metric_families
from tests.unit.messages.bus_views import BODY, LOOP, joint, view

from motord.bus.messages.sources import Body
from motord.bus.prometheus.metrics import STALE_S, exposition

STATUS = {
    "loop": LOOP | {"lateness_us": {"p50": 1.0, "p99": 20.0, "p99_9": 30.0, "max": 40.0}},
    "lines": {"rs485": {"exchanges": 7, "errors": {"timeout": 2}, "cycle_hz": None}},
    "commands": {"accepted": 3, "refused": {"age": 1}},
    "publishers": {"console": {"taken": 5, "dropped": 4}},
    "bus": {"pid": 1, "restarts": 6, "publishers": {"fleet": {"taken": 1, "dropped": 8}}},
    "leases": [],
}


def parsed(text):
    return {
        (sample.name, *(value for key, value in sample.labels.items() if key != "robot")): sample
        for family in text_string_to_metric_families(text.decode())
        for sample in family.samples
    }


def now_ms():
    return time.monotonic_ns() // 1_000_000


def test_without_a_robot_the_only_figure_is_that_it_is_not_up():
    assert {key: sample.value for key, sample in parsed(exposition(BODY, None)).items()} == {
        ("motord_up",): 0.0
    }


def test_a_loop_that_stands_still_is_not_up():
    assert parsed(exposition(BODY, view(now_ms())))["motord_up",].value == 1.0
    old = view(now_ms() - round(2000 * STALE_S))
    assert parsed(exposition(BODY, old))["motord_up",].value == 0.0


def test_a_loop_that_stands_still_shows_no_old_speed_as_the_present_one():
    fresh = parsed(exposition(BODY, view(now_ms(), STATUS)))
    old = parsed(exposition(BODY, view(now_ms() - round(2000 * STALE_S), STATUS)))
    gone = {key[0] for key in fresh.keys() - old.keys()}
    assert {"motord_armed", "motord_speed_metres_per_second", "motord_state"} <= gone
    assert any(name.startswith("motord_joint_") for name in gone)
    assert ("motord_bus_restarts_total",) in old  # the daemon itself answers


def test_the_daemons_status_is_among_the_figures_in_base_units():
    figures = parsed(exposition(BODY, view(now_ms(), STATUS)))
    assert figures["motord_loop_lateness_seconds", "0.99"].value == pytest.approx(20e-6)
    assert figures["motord_line_errors_total", "timeout", "rs485"].value == 2.0
    assert math.isnan(figures["motord_line_cycle_hertz", "rs485"].value)
    assert figures["motord_commands_refused_total", "age"].value == 1.0
    assert figures["motord_samples_dropped_total", "console"].value == 4.0
    assert figures["motord_samples_dropped_total", "fleet"].value == 8.0
    assert figures["motord_bus_restarts_total",].value == 6.0


def test_a_robot_without_a_second_process_has_figures_too():
    figures = parsed(exposition(BODY, view(now_ms(), STATUS | {"bus": None})))
    assert figures["motord_bus_restarts_total",].value == 0.0


@given(
    value=st.floats(), name=st.text(min_size=1, max_size=5).filter(lambda text: "\r" not in text)
)
def test_any_value_and_any_name_is_read_back_unchanged(value, name):
    body = Body(robot=name, joints=("left", "right"))
    measured = view(now_ms(), linear_m_s=value, joints=(joint(current_a=value), joint()))
    figures = parsed(exposition(body, measured))
    speed = figures["motord_speed_metres_per_second",]
    assert repr(speed.value) == repr(value) or math.isnan(value)
    assert speed.labels["robot"] == name
    current = figures["motord_joint_current_amperes", "left"]
    assert current.value == speed.value or math.isnan(value)
