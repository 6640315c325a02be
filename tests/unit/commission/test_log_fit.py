# SPDX-License-Identifier: Apache-2.0
"""Fit of the geometry to recordings with poses that an external system measured."""

import contextlib
import math
import random

import numpy as np
import pytest
from mcap_ros2.writer import Writer

from motord.api.geometry_fit import fit
from motord.bus.messages.table import definition
from motord.commission.calibrate.log_fit import Log, read_csv, windows
from motord.commission.calibrate.mcap_log import read_mcap
from motord.commission.person import Failed

TRACK_M, RADIUS_M = 0.45, 0.0825
TRUE = {"left": 1.03, "right": 1.02, "track": 0.96}
SIDES = {"left": "left", "right": "right"}
RADII_M = {"left": RADIUS_M, "right": RADIUS_M}
SLIP_M2_PER_M = 2e-5
RATE_HZ = 50.0
SEEDS = 100


def recorded(seed, path_m=60.0):
    """Return the columns of a recording: a base drives eights with wheels that slip, and a camera
    measures its pose with a noise of a millimetre and a milliradian."""
    noise = np.random.default_rng(seed)
    count = round(path_m / 0.4 * RATE_HZ)
    time_s = np.arange(count + 1) / RATE_HZ
    turn_rad_s = 0.9 * np.sin(time_s * math.tau / 14.0)
    forward_m = 0.4 / RATE_HZ
    arm_m = turn_rad_s[1:] * TRACK_M / 2.0 / RATE_HZ
    rolled = {"left": forward_m - arm_m, "right": forward_m + arm_m}
    true_m = {
        side: part * TRUE[side] + noise.normal(0.0, np.sqrt(SLIP_M2_PER_M * np.abs(part)))
        for side, part in rolled.items()
    }
    turn_rad = (true_m["right"] - true_m["left"]) / (TRACK_M * TRUE["track"])
    heading_rad = np.concatenate([[0.0], np.cumsum(turn_rad)])
    middle_rad = heading_rad[:-1] + turn_rad / 2.0
    step_m = (true_m["left"] + true_m["right"]) / 2.0
    x_m, y_m = (
        np.concatenate([[0.0], np.cumsum(step_m * part(middle_rad))]) for part in (np.cos, np.sin)
    )
    seen = {
        "time_s": time_s,
        "x_m": x_m + noise.normal(0.0, 0.001, count + 1),
        "y_m": y_m + noise.normal(0.0, 0.001, count + 1),
        "heading_rad": np.angle(np.exp(1j * (heading_rad + noise.normal(0.0, 0.001, count + 1)))),
    }
    angles = {
        f"{side}_rad": np.concatenate([[0.0], np.cumsum(part)]) / RADIUS_M
        for side, part in rolled.items()
    }
    return seen | angles


def written(file, columns):
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(file, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return file


def log_of(columns):
    heading_rad = np.unwrap(columns["heading_rad"])
    pose = np.stack([columns["x_m"], columns["y_m"], heading_rad], axis=1)
    return Log(pose, columns["left_rad"] * RADIUS_M, columns["right_rad"] * RADIUS_M)


def test_a_file_is_read_as_it_was_written(tmp_path):
    columns = recorded(0)
    log, same = read_csv(written(tmp_path / "log.csv", columns), SIDES, RADII_M), log_of(columns)
    for part in ("pose", "left_m", "right_m"):
        assert np.allclose(getattr(log, part), getattr(same, part), atol=1e-6)


def test_estimates_are_within_two_of_their_deviations_in_ninety_of_a_hundred_seeds():
    within = dict.fromkeys(TRUE, 0)
    for seed in range(SEEDS):
        measures = windows(log_of(recorded(seed)))
        found = fit(measures, TRACK_M, ("scale", "ratio", "track"), robust=True)
        for name, true in TRUE.items():
            off = abs(getattr(found.factors, name) - true)
            assert off < 0.02
            within[name] += off < 2.0 * getattr(found.deviations, name)
    assert all(count >= 90 for count in within.values()), within


def test_a_log_without_a_column_names_it(tmp_path):
    columns = recorded(0)
    del columns["heading_rad"]
    with pytest.raises(Failed, match="has no column heading_rad"):
        read_csv(written(tmp_path / "log.csv", columns), SIDES, RADII_M)


def test_a_log_with_a_word_for_a_number_names_its_line(tmp_path):
    file = written(tmp_path / "log.csv", recorded(0))
    rows = file.read_text().splitlines()
    rows[3] = rows[3].replace("0", "zero", 1)
    file.write_text("\n".join(rows))
    with pytest.raises(Failed, match=r"log.csv:4: could not convert"):
        read_csv(file, SIDES, RADII_M)


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_a_value_that_is_not_finite_is_refused(tmp_path, value):
    file = written(tmp_path / "log.csv", recorded(0))
    rows = file.read_text().splitlines()
    rows[2] = ",".join([value, *rows[2].split(",")[1:]])
    file.write_text("\n".join(rows))
    with pytest.raises(Failed, match="not finite"):
        read_csv(file, SIDES, RADII_M)


def test_a_short_log_is_refused_with_the_path_that_is_needed(tmp_path):
    log = read_csv(written(tmp_path / "log.csv", recorded(0, path_m=3.0)), SIDES, RADII_M)
    with pytest.raises(Failed, match="at least 12 m are needed"):
        windows(log)


def recording(file, columns, step=5):
    """Write every `step`-th row as a robot's joint states and a motion capture system's poses."""
    with file.open("wb") as sink, Writer(sink) as writer:
        _, _, made_of = definition("nav_msgs/msg/Odometry").partition("=" * 80)
        texts = {
            "sensor_msgs/msg/JointState": definition("sensor_msgs/msg/JointState"),
            "geometry_msgs/msg/PoseStamped": (
                f"std_msgs/Header header\ngeometry_msgs/Pose pose\n{'=' * 80}{made_of}"
            ),
        }
        schemas = {kind: writer.register_msgdef(kind, text) for kind, text in texts.items()}
        for place in range(0, len(columns["time_s"]), step):
            for topic, kind, at in (
                ("/cart/joint_states", "sensor_msgs/msg/JointState", place),
                ("/ground_truth", "geometry_msgs/msg/PoseStamped", place),
            ):
                time_ns = round(columns["time_s"][at] * 1e9)
                stamp = {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}
                if topic == "/ground_truth":
                    half_rad = columns["heading_rad"][at] / 2.0
                    body = {"pose": {
                        "position": {"x": columns["x_m"][at], "y": columns["y_m"][at], "z": 0.0},
                        "orientation": {
                            "x": 0.0, "y": 0.0, "z": math.sin(half_rad), "w": math.cos(half_rad),
                        },
                    }}  # fmt: skip
                else:
                    angles = [columns["left_rad"][at], columns["right_rad"][at]]
                    body = {"name": ["left", "right"], "position": angles,
                            "velocity": [], "effort": []}  # fmt: skip
                message = {"header": {"stamp": stamp, "frame_id": ""}, **body}
                writer.write_message(topic, schemas[kind], message, time_ns, time_ns)
    return file


def test_a_recording_in_mcap_is_read_by_its_stamps(tmp_path):
    columns = recorded(0, path_m=20.0)
    log = read_mcap(recording(tmp_path / "log.mcap", columns), "/ground_truth", SIDES, RADII_M)
    same = log_of(columns)
    for part in ("pose", "left_m", "right_m"):
        assert np.allclose(getattr(log, part), getattr(same, part)[::5], atol=1e-6)
    measures = windows(log)
    found = fit(measures, TRACK_M, ("scale", "ratio", "track"), robust=True).factors
    assert found.left == pytest.approx(1.03, abs=0.01)


def test_a_recording_without_the_topic_names_those_that_it_has(tmp_path):
    file = recording(tmp_path / "log.mcap", recorded(0, path_m=1.0))
    with pytest.raises(Failed, match=r"has no /mocap; topics: /cart/joint_states, /ground_truth"):
        read_mcap(file, "/mocap", SIDES, RADII_M)


def test_a_file_that_is_no_recording_is_refused(tmp_path):
    file = tmp_path / "log.mcap"
    file.write_bytes(b"time_s,x_m\n0,0\n")
    with pytest.raises(Failed, match="not a complete MCAP file"):
        read_mcap(file, "/ground_truth", SIDES, RADII_M)


@pytest.mark.parametrize("kind", ["mcap", "csv"])
def test_a_damaged_file_is_read_or_refused_with_a_reason(tmp_path, kind):
    columns, dice, usable = recorded(0, path_m=2.0), random.Random(1), 0
    file = tmp_path / f"log.{kind}"
    good = (recording if kind == "mcap" else written)(file, columns).read_bytes()
    for _ in range(300):
        damaged = bytearray(good)
        for _ in range(dice.randint(1, 3)):
            damaged[dice.randrange(len(damaged))] ^= 1 << dice.randrange(8)
        file.write_bytes(
            bytes(damaged[: dice.choice((len(damaged), dice.randrange(len(damaged))))])
        )
        with contextlib.suppress(Failed):
            if kind == "mcap":
                read_mcap(file, "/ground_truth", SIDES, RADII_M)
            else:
                read_csv(file, SIDES, RADII_M)
            usable += 1
    assert 0 < usable < 270
