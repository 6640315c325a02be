# SPDX-License-Identifier: Apache-2.0
"""The `status` of a daemon: typed for programs, and as text for people."""

import dataclasses
import json

import pytest
from click.testing import CliRunner
from tests.sim.daemon_stage import running, wait_until

from motord.cli import cli


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("status")) as stage:
        stage.wait_for("idle")
        yield stage


def test_every_field_of_status_is_typed_and_equals_the_answer(stage):
    status = stage.robot.status()

    def compare(typed, raw, where):
        fields = {field.name: getattr(typed, field.name) for field in dataclasses.fields(typed)}
        assert set(raw) <= set(fields), where
        for name, value in raw.items():
            found = fields[name]
            if dataclasses.is_dataclass(found):
                compare(found, value, name)
            elif isinstance(value, dict) and any(map(dataclasses.is_dataclass, found.values())):
                for key, one in value.items():
                    compare(found[key], one, f"{name}.{key}")
            elif isinstance(value, list) and any(map(dataclasses.is_dataclass, found)):
                for one, its in zip(found, value, strict=True):
                    compare(one, its, name)
            else:
                assert found == (tuple(value) if isinstance(value, list) else value), name

    compare(status, status, "status")
    assert status.odometry.x_m == status["odometry"]["x_m"]
    assert status.joints["left"].drive == "ready"
    assert json.loads(json.dumps(status)) == status


def shown(stage):
    return CliRunner().invoke(cli, ["status", "--socket", str(stage.socket)]).stdout


def test_a_line_reports_the_missing_port_that_it_waits_for(tmp_path):
    with running(tmp_path, simulated=False) as stage:
        wait_until(lambda: "there is no such port" in shown(stage), "the port that is missing")
        (waits,) = (row for row in shown(stage).splitlines() if "waits:" in row)
        assert str(tmp_path / "nothing") in waits
        assert stage.robot.status().lines["rs485"].waits_for in waits


def test_a_line_names_its_silent_drive_until_it_answers_again(stage):
    assert "waits:" not in shown(stage)
    stage.sim.inject("drop:p=1.0")
    try:
        waits = wait_until(
            lambda: stage.robot.status().lines["rs485"].waits_for, "a drive that is waited for"
        )
        assert "is unresponsive" in waits
    finally:
        stage.sim.clear_faults_script()
    wait_until(lambda: stage.robot.status().lines["rs485"].waits_for is None, "nothing is left")


def test_the_command_line_makes_the_pose_the_origin(stage):
    stage.wait_for("idle")
    before = stage.robot.status().odometry.epoch
    done = CliRunner().invoke(cli, ["reset-odometry", "--json", "--socket", str(stage.socket)])
    assert (done.exit_code, json.loads(done.stdout)) == (0, {"state": "idle"})
    odometry = stage.robot.status().odometry
    assert odometry.epoch > before
    assert (odometry.x_m, odometry.y_m) == (0.0, 0.0)
