# SPDX-License-Identifier: Apache-2.0
"""Registers of the drives through the running daemon: which may be read and written, and when."""

import pytest
from click.testing import CliRunner
from tests.sim.daemon_stage import running

from motord.cli import cli
from motord.client import ClientError, Refused


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("daemon")) as stage:
        stage.wait_for("idle")
        yield stage


def test_every_register_is_listed_with_its_unit_range_access_and_source(stage):
    found = stage.robot.params_list()
    voltage = found["drive.left.bus_voltage"]
    assert (voltage["unit"], voltage["access"], voltage["value"]) == ("V", "r", None)
    assert (voltage["minimum"], voltage["maximum"]) == pytest.approx((0.0, 655.35))
    assert "20A1h" in voltage["description"]
    assert found["drive.right.control_word"]["access"] == "r"
    assert found["limits.linear_m_s"]["value"] > 0


def test_a_register_is_read_from_its_drive_in_si(stage):
    asked = "limits.linear_m_s", "drive.left.bus_voltage", "drive.right.communication_timeout"
    found = stage.robot.params_get(*asked)
    assert set(found) == set(asked)
    assert found["drive.left.bus_voltage"] == pytest.approx(36.0, abs=5.0)
    assert found["drive.right.communication_timeout"] == pytest.approx(2.0)
    assert not any(name.startswith("drive.") for name in stage.robot.params_get())


def test_an_unknown_parameter_is_refused_with_a_suggestion(stage):
    with pytest.raises(ClientError, match=r"did you mean drive\.left\.bus_voltage"):
        stage.robot.params_get("drive.left.bus_volt")
    with pytest.raises(ClientError, match="no parameter"):
        stage.robot.params_set(**{"drive.nobody.bus_voltage": 1.0})


def test_a_register_that_motord_writes_cannot_be_set_by_name(stage):
    for name in ("drive.left.control_word", "drive.left.target_velocity_1"):
        with pytest.raises(ClientError, match="motord itself"):
            stage.robot.params_set(**{name: 0.0})
    with pytest.raises(ClientError, match="not a number"):
        stage.robot.params_set(**{"drive.left.control_word": None})
    with pytest.raises(ClientError, match="one after the other"):
        stage.robot.params_set(**{"drive.left.control_word": 1.0, "limits.linear_m_s": 0.1})


def test_a_drive_under_power_is_not_written(stage):
    stage.robot.arm()
    try:
        with pytest.raises(Refused, match="disarm first"):
            stage.robot.params_set(**{"drive.left.control_word": 7.0})
        assert stage.robot.params_get("drive.left.control_word") == {"drive.left.control_word": 8.0}
    finally:
        stage.robot.disarm()
    assert stage.robot.params_get("drive.left.control_word") == {"drive.left.control_word": 7.0}


def params(stage, *arguments):
    return CliRunner().invoke(cli, ["params", *arguments, "--socket", str(stage.robot.path)])


def test_a_dump_can_be_loaded(stage, tmp_path):
    dump = params(stage, "dump")
    assert dump.exit_code == 0
    assert "limits.linear_m_s3 = " in dump.stdout
    assert "bus_voltage" not in dump.stdout
    file = tmp_path / "tuned.toml"
    before = stage.robot.params_get("limits.linear_m_s")["limits.linear_m_s"]
    old = f"limits.linear_m_s = {before!r}\n"
    assert old in dump.stdout
    file.write_text(dump.stdout.replace(old, "limits.linear_m_s = 0.25\n"), encoding="utf-8")
    assert params(stage, "load", str(file)).exit_code == 0
    assert stage.robot.params_get("limits.linear_m_s") == {"limits.linear_m_s": 0.25}
    file.write_text('limits.linear_m_s = "fast"\n', encoding="utf-8")
    assert params(stage, "load", str(file)).exit_code == 2
    file.write_text("limits = 3 = 4\n", encoding="utf-8")
    assert params(stage, "load", str(file)).exit_code == 2
    assert stage.robot.params_get("limits.linear_m_s") == {"limits.linear_m_s": 0.25}


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("params get drive.left.bus_", "drive.left.bus_voltage"),
        ("params set limits.linear_m_s", "limits.linear_m_s="),
        ("spin ri", "right"),
    ],
)
def test_tab_completes_parameters_and_joints_of_the_running_robot(stage, words, offered):
    typed = words.split()
    typed[-1:-1] = ["--socket", str(stage.socket)]
    found = CliRunner().invoke(
        cli, [], prog_name="motord",
        env={"_MOTORD_COMPLETE": "bash_complete", "COMP_WORDS": f"motord {' '.join(typed)}",
             "COMP_CWORD": str(len(typed))},
    )  # fmt: skip
    assert f"plain,{offered}" in found.stdout.splitlines()
