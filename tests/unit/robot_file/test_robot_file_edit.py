# SPDX-License-Identifier: Apache-2.0
"""A robot file is changed by keys: comments stay, and a wrong file is not written."""

import os
import stat
import tomllib
from pathlib import Path

import pytest

from motord.commission.params_save import put_in_force
from motord.commission.person import Failed
from motord.commission.robot_file_edit import EditError, RobotFileEdit, write_new
from motord.config import ConfigError, load_robot
from motord.config.sections.limits import LATERAL_KEYS

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"


@pytest.fixture
def file(tmp_path):
    place = tmp_path / "cart.toml"
    text = DEMO.read_text(encoding="utf-8")
    text = text.replace("wheel_radius_m = 0.0825", "wheel_radius_m = 0.0825 # worn tyres")
    place.write_text(text.replace("[joint.right]", "# the other one\n[joint.right]"), "utf-8")
    return place


def added(edit):
    rows = edit.diff().splitlines()[2:]
    return [row for row in rows if row.startswith(("+", "-"))]


def test_a_changed_value_keeps_its_comment(file):
    edit = RobotFileEdit(file)
    edit.set(("base", "wheel_radius_m"), 0.081)
    assert added(edit) == [
        "-wheel_radius_m = 0.0825 # worn tyres",
        "+wheel_radius_m = 0.081 # worn tyres",
    ]


def test_a_new_key_comes_before_the_comment_of_the_next_table(file):
    edit = RobotFileEdit(file)
    edit.set(("joint", "left", "inverted"), value=True)
    rows = edit.text.splitlines()
    at = rows.index("inverted = true")
    assert rows[at - 1 : at + 4] == [
        "velocity_max_rad_s = 15.0", "inverted = true", "", "# the other one", "[joint.right]",
    ]  # fmt: skip


def test_a_new_table_comes_at_the_end(file):
    edit = RobotFileEdit(file)
    edit.set(("odometry", "pose_variance_floor_m2"), 1e-5)
    assert edit.text.rstrip().endswith("[odometry]\npose_variance_floor_m2 = 1e-05")
    assert edit.checked().odometry.pose_variance_floor_m2 == 1e-5


def test_an_equal_value_keeps_its_spelling(file):
    edit = RobotFileEdit(file)
    edit.set(("loop", "rate_hz"), 1000.0)
    assert not edit.changed
    assert edit.diff() == ""


def test_saving_leaves_a_backup_and_the_mode(file):
    file.chmod(0o640)
    before = file.read_bytes()
    edit = RobotFileEdit(file)
    edit.set(("base", "track_m"), 0.5)
    backup = edit.save()
    assert backup.read_bytes() == before
    assert load_robot(file).base.track_m == 0.5
    assert {stat.S_IMODE(each.stat().st_mode) for each in (file, backup)} == {0o640}
    assert sorted(each.name for each in file.parent.iterdir()) == [file.name, backup.name]


def test_saving_twice_in_a_second_leaves_two_backups(file):
    edit = RobotFileEdit(file)
    backups = set()
    for track_m in (0.5, 0.6, 0.7):
        edit.set(("base", "track_m"), track_m)
        backups.add(edit.save())
    assert len(backups) == 3


def test_a_file_that_does_not_check_is_not_written(file):
    before = file.read_bytes()
    edit = RobotFileEdit(file)
    edit.set(("base", "track_m"), -1.0)
    with pytest.raises(ConfigError, match=r"track_m: -1.0 is out of range \(0.02 to 20 m\)"):
        edit.save()
    assert file.read_bytes() == before
    assert list(file.parent.iterdir()) == [file]


def test_a_file_that_was_changed_meanwhile_is_not_overwritten(file):
    edit = RobotFileEdit(file)
    edit.set(("base", "track_m"), 0.5)
    file.write_text(file.read_text("utf-8") + "\n# by another editor\n", "utf-8")
    with pytest.raises(EditError, match="has changed since it was read"):
        edit.save()
    assert "by another editor" in file.read_text("utf-8")


def test_a_link_to_the_file_stays_a_link(file):
    link = file.with_name("link.toml")
    link.symlink_to(file)
    edit = RobotFileEdit(link)
    edit.set(("base", "track_m"), 0.5)
    edit.save()
    assert link.is_symlink()
    assert load_robot(file).base.track_m == 0.5


def test_a_missing_file_is_named():
    with pytest.raises(EditError, match=r"nowhere\.toml: cannot be read"):
        RobotFileEdit(Path("nowhere.toml"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_of_another_user_is_an_error_with_a_cure(file):
    file.parent.chmod(0o555)
    edit = RobotFileEdit(file)
    edit.set(("base", "track_m"), 0.5)
    try:
        with pytest.raises(EditError, match=r"may not write .*: run this with sudo"):
            edit.save()
    finally:
        file.parent.chmod(0o755)


GAIN = ("joint", "right", "speed_loop", "gain_s_per_rad")
INTEGRAL = (*GAIN[:-1], "integral_per_rad")


def spelled(file, layout):
    """Rewrite the table of the joint on the right in another form with the same meaning."""
    text = file.read_text("utf-8")
    start = text.index("[joint.right]")
    rows, rest = [], text[start:].splitlines()[1:]
    while rest and "=" in rest[0]:
        rows.append(rest.pop(0))
    file.write_text(f"{text[:start]}{layout(rows)}\n" + "\n".join(rest) + "\n", "utf-8")


SPELLINGS = {
    "inline": lambda rows: f"[joint]\nright = {{ {', '.join(rows)} }}",
    "dotted": lambda rows: "[joint]\n" + "\n".join(f"right.{row}" for row in rows),
}


@pytest.mark.parametrize("layout", SPELLINGS.values(), ids=SPELLINGS)
def test_a_new_table_comes_into_a_table_however_that_is_spelled(file, layout):
    spelled(file, layout)
    edit = RobotFileEdit(file)
    wanted = tomllib.loads(edit.text)
    wanted["joint"]["right"]["speed_loop"] = {GAIN[-1]: 1.5, INTEGRAL[-1]: 2.5}
    edit.update({GAIN: 1.5, INTEGRAL: 2.5})
    assert tomllib.loads(edit.text) == wanted


def test_a_key_that_cannot_be_put_where_it_belongs_is_an_error_and_changes_nothing(file):
    edit = RobotFileEdit(file)
    before = edit.text
    with pytest.raises(EditError, match=r"limits.linear_m_s.a: .* by hand"):
        edit.set(("limits", "linear_m_s", "a"), 1.0)
    assert edit.text == before
    edit.set(("base", "track_m"), 0.5)  # the edit can be continued
    assert edit.get(("base", "track_m")) == 0.5


def test_a_new_file_does_not_replace_another(file):
    with pytest.raises(EditError, match="is there already"):
        write_new(file, b"")


def in_force(file, **changes):
    """Return the answer of params.get for a base that does not move sideways."""
    limits = vars(load_robot(file).limits) | changes
    return {f"limits.{name}": value for name, value in limits.items() if name not in LATERAL_KEYS}


def test_limits_in_force_go_into_the_file(file):
    edit = RobotFileEdit(file)
    put = put_in_force(edit, in_force(file, linear_m_s=0.3, linear_m_s3=None))
    assert set(put) == {"limits.linear_m_s", "limits.linear_m_s3"}
    assert added(edit) == [
        "-linear_m_s = 1.0", "+linear_m_s = 0.3", "-linear_m_s3 = 8.0", "+linear_m_s3 = inf",
    ]  # fmt: skip


def test_a_limit_whose_default_follows_another_is_written_too(file):
    text = file.read_text("utf-8").replace("linear_deceleration_m_s2 = 1.5\n", "")
    file.write_text(text, "utf-8")
    edit = RobotFileEdit(file)
    put_in_force(edit, in_force(file, linear_m_s2=2.0))
    limits = edit.checked().limits
    assert (limits.linear_m_s2, limits.linear_deceleration_m_s2) == (2.0, 1.0)


def test_a_register_of_a_drive_cannot_be_saved_in_the_file(file):
    with pytest.raises(Failed, match="store it in the drive"):
        put_in_force(RobotFileEdit(file), {"drive.left.kp": 1.0})
