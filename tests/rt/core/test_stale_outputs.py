# SPDX-License-Identifier: Apache-2.0
"""A measured value does not outlive its feedback: for each output, what is shown of a joint that is
silent, and of a base whose joints are all silent."""

import math
import struct

import pytest
from prometheus_client.parser import text_string_to_metric_families
from tests.rt.core_rig import Rig
from tests.unit.terminal.test_top_view import LEASE, LINE, answer

from motord.api.snapshot import Rest
from motord.bus.messages.forms import as_message
from motord.bus.messages.sources import Body
from motord.bus.messages.topics import TOPICS, View
from motord.bus.prometheus import metrics
from motord.bus.publish.snapshot_feed import encode
from motord.bus.web import frames
from motord.cli import status_text
from motord.realtime import loop as rt
from motord.tui import view

BODY = Body(robot="r2", joints=("left", "right"))
MEASURED = ("velocity_rad_s", "position_rad", "current_a", "voltage_v", "temperature_c")
SILENT_S = 1.3


class Base(Rig):
    """A base of two joints of which some stop sending feedback."""

    def __init__(self):
        super().__init__()
        self.silent = ()

    def follow(self, dt_s):
        kept = [self.feedback[j].stamp_ns for j in self.silent]
        super().follow(dt_s)
        for j, stamp_ns in zip(self.silent, kept, strict=True):
            self.feedback[j].stamp_ns = stamp_ns


@pytest.fixture(params=[(0,), (0, 1)], ids=["left is silent", "all are silent"])
def base(request):
    """A base that was at speed, and whose joints have been silent for SILENT_S."""
    base = Base()
    for feedback, voltage_v in zip(base.feedback, (20.0, 24.0), strict=True):
        feedback.current_a, feedback.voltage_v, feedback.temperature_c = 7.25, voltage_v, 33.5
    base.moving()
    base.before = rt._snapshot(base.shown)
    assert base.before.linear_m_s == pytest.approx(0.5, abs=0.1)
    base.silent = request.param
    base.now = rt._snapshot(base.ticks(SILENT_S))
    return base


def message(topic, base):
    return as_message(TOPICS[topic], BODY)(View(snapshot=base.now), 0)


def of_snapshot(base):
    found = base.now.to_json()
    twist = (found["linear_m_s"], found["angular_rad_s"], *found["twist_covariance"])
    return [*(found["joints"][0][key] for key in MEASURED), *twist]


def of_stdout(base):
    raw = encode("r2", base.now, 0)
    assert b"7.25" not in raw or len(base.silent) == 1
    return []


def of_joint_states(base):
    found = message("joint_states", base)
    assert (found is None) == (len(base.silent) == 2)
    assert found is None or list(found["name"]) == ["right"]
    return []


def of_odometry(base):
    return [] if message("odom", base) is None else [math.inf]


def of_motor_status(base):
    found = message("motor_status", base)
    assert found["stale"][0]
    return [found[key][0] for key in ("current_a", "voltage_v", "temperature_c")]


def of_battery(base):
    found = message("battery_state", base)
    assert (found is None) == (len(base.silent) == 2)
    assert found is None or found["voltage"] == 24.0, "of the joint that is fresh"
    return []


def of_diagnostics(base):
    joint = message("diagnostics", base)["status"][1]
    assert joint.message == "no feedback"
    values = {pair.key: pair.value for pair in joint.values}
    return [float(values[key]) for key in ("current_a", "voltage_v", "temperature_c")]


def of_prometheus(base):
    now_ns = base.now.stamp_ns
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(metrics.time, "monotonic_ns", lambda: now_ns)
        text = metrics.exposition(BODY, View(snapshot=base.now)).decode()
    samples = [one for family in text_string_to_metric_families(text) for one in family.samples]
    speeds = ("motord_speed_metres_per_second", "motord_turn_rate_radians_per_second")
    units = ("radians_per_second", "amperes", "volts", "celsius")
    return [
        one.value for one in samples
        if one.name in speeds
        or (one.labels.get("joint") == "left" and one.name.endswith(units))
    ]  # fmt: skip


def of_page(base):
    raw, layout = frames.Packer(2).pack(base.now, 1), frames.layout()
    fields = [*layout["state"], *layout["joint"]]
    codes = "<" + "".join(code for _, code in fields)
    found = dict(zip([name for name, _ in fields], struct.unpack_from(codes, raw), strict=True))
    assert found["stale"] == 1
    return [found[key] for key in (*MEASURED, "linear_m_s", "angular_rad_s")]


def of_status(base):
    joint = {"drive": "armed", "takes_position": True, "fault_words": []}
    text = status_text._joint(base.now.to_json()["joints"][0] | joint)
    assert text == f"drive armed, measured values not known since {SILENT_S} s"
    age_s = (base.now.stamp_ns - base.now.odometry_stamp_ns) * 1e-9
    at = base.now.to_json() | {"age_s": age_s}
    assert status_text.speed_text(at) == f"speed not known since {SILENT_S:.1f} s"
    return []


def of_top(base):
    shown, joint = base.now.to_json(), {"drive": "armed", "fault_words": []}
    found = answer(
        odometry={**shown, "age_s": SILENT_S},
        joints={"left": shown["joints"][0] | joint},
        leases=[LEASE], lines={"rs485": LINE},
    )  # fmt: skip
    history = view.History()
    history.add(found, 0.0)
    assert f"speed not known since {SILENT_S} s" in view.header(found).plain
    row = view.joints(found, history).plain.splitlines()[1]
    assert row.split()[3:] == ["not", "known", "since", "1.3", "s"], "and a gap as trend"
    assert max(map(len, row.splitlines())) <= 80
    return []


OUTPUTS = (
    of_snapshot, of_stdout, of_joint_states, of_odometry, of_motor_status, of_battery,
    of_diagnostics, of_prometheus, of_page, of_status, of_top,
)  # fmt: skip


@pytest.mark.parametrize("output", OUTPUTS, ids=lambda one: one.__name__)
def test_no_output_shows_what_a_silent_joint_measured_last(base, output):
    shown = output(base)
    assert [value for value in shown if value is not None and not math.isnan(value)] == []


def test_the_pose_keeps_its_stamp_and_rest_is_unknown(base):
    assert base.now.odometry_stamp_ns == base.before.odometry_stamp_ns
    assert (base.now.x_m, base.now.rest) == (base.before.x_m, Rest.UNKNOWN)
    assert base.now.joints[0].feedback_age_s == pytest.approx(SILENT_S, abs=0.002)
