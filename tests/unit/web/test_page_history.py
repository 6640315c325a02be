# SPDX-License-Identifier: Apache-2.0
"""The plots and the CSV of the dashboard draw no motion that was not measured: a time without
states, and values whose feedback is old, are gaps."""

import json
import shutil
import subprocess
from importlib.resources import files

import pytest

NODE = shutil.which("node")
SCRIPT = """
import { History } from "./history.mjs";
const [frames] = JSON.parse(process.argv[2]);
const listeners = {};
const link = { hello: { joints: ["left", "right"], rate_max_hz: 50 },
  on: (name, call) => { listeners[name] = call; } };
const history = new History(link);
listeners.hello(link.hello);
for (const [stamp_s, age_s, stale] of frames) {
  const joint = { velocity_rad_s: 5, setpoint_rad_s: 4, position_rad: 1, current_a: 2,
    voltage_v: 24, temperature_c: 30, feedback_age_s: age_s, stale };
  const other = { ...joint, feedback_age_s: 0.01, stale: 0 };
  listeners.frame({ stamp_s, linear_m_s: 0.5, lateral_m_s: 0, angular_rad_s: 0,
    setpoint_linear_m_s: 0.4, setpoint_lateral_m_s: 0, setpoint_angular_rad_s: 0,
    joints: [joint, other] });
}
const [time, ...series] = history.fast.data(
  ["linear_m_s", "velocity.0", "velocity.1", "setpoint.0"], 0);
console.log(JSON.stringify({ time: [...time], series: series.map((one) => [...one]),
  csv: history.csv() }));
"""

pytestmark = pytest.mark.skipif(NODE is None, reason="needs node (apt install nodejs)")


@pytest.fixture
def drawn(tmp_path):
    """A function from frames (stamp, age of the left joint's feedback, stale) to what is drawn."""
    page = files("motord.bus.web") / "page"
    (tmp_path / "history.mjs").write_text((page / "history.js").read_text("utf-8"), "utf-8")
    (tmp_path / "main.mjs").write_text(SCRIPT, "utf-8")

    def draw(*frames):
        done = subprocess.run(
            [NODE, "main.mjs", json.dumps([frames])],
            cwd=tmp_path, capture_output=True, text=True, timeout=60, check=True,
        )  # fmt: skip
        return json.loads(done.stdout)

    return draw


def test_a_time_without_states_is_a_gap(drawn):
    found = drawn((1.0, 0.01, 0), (1.02, 0.01, 0), (8.52, 0.01, 0))
    assert found["time"] == [1.0, 1.02, 1.52, 8.52]
    assert all(one[2] is None and one[3] is not None for one in found["series"])
    gap = found["csv"].splitlines()[3]
    assert gap.strip(",") == "1.52"


def test_a_joint_whose_feedback_is_old_is_a_gap_with_its_age(drawn):
    found = drawn((1.0, 0.01, 0), (1.4, 0.41, 0), (1.6, 0.61, 0), (1.8, 0.81, 1))
    linear, left, right, setpoint = found["series"]
    assert left == [5, 5, None, None]
    assert linear == [0.5, 0.5, None, 0.5], "the core drops the joint once it is stale"
    assert None not in [*right, *setpoint]
    title, *rows = (line.split(",") for line in found["csv"].splitlines())
    ages = [row[title.index("left.feedback_age_s")] for row in rows]
    assert ages == ["0.01", "0.41", "0.61", "0.81"]
