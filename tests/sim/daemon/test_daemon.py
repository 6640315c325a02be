# SPDX-License-Identifier: Apache-2.0
"""The daemon on simulated drives: what it does, refuses and reports."""

import contextlib
import json
import math
import signal
import subprocess
import sys
import threading

import pytest
from click.testing import CliRunner
from tests.fork_server import started_from_nothing
from tests.sim.daemon_stage import ROOT, running, wait_until

from motord.cli import cli
from motord.client import ClientError, Refused

SPEED_M_S = 0.4
LIMITS = ("limits.linear_m_s", "limits.linear_m_s2", "limits.linear_m_s3")


@pytest.fixture(scope="module")
def everyone(tmp_path_factory):
    with started_from_nothing(), running(tmp_path_factory.mktemp("daemon")) as stage:
        stage.limits = stage.robot.params_get()
        yield stage


@pytest.fixture
def stage(everyone):
    """The same daemon for every test, brought back to rest, disarmed and without faults."""
    everyone.sim.clear_faults_script()
    wait_until(lambda: accepted(everyone.robot.disarm), "disarmed")
    everyone.wait_for("idle", "fault", "estop")
    wait_until(lambda: everyone.robot.status()["rest"] != "turning", "rest")
    wait_until(lambda: accepted(everyone.robot.reset), "a reset")
    everyone.robot.params_set(**everyone.limits)
    everyone.wait_for("idle")
    wait_until(lambda: not everyone.robot.status()["leases"], "the last test's sources are gone")
    # this zero releases a source that the test before left blocked
    wait_until(lambda: accepted(lambda: everyone.robot.drive(0.0, 0.0)), "the loop takes commands")
    everyone.robot.release()
    everyone.sim.reset_truth()
    return everyone


def accepted(ask):
    """Return whether the daemon accepts the request: it refuses while a drive is set up again."""
    try:
        ask()
    except Refused:
        return False
    return True


class Source(threading.Thread):
    """A program that sends a command repeatedly over its own connection."""

    def __init__(self, stage, *command, **lease):
        super().__init__(daemon=True)
        self.client = stage.client()
        self.command, self.lease = command, lease
        self.refusals, self.answers = [], []
        self.over = threading.Event()

    def run(self):
        while not self.over.is_set():
            try:
                self.answers.append(self.client.drive(*self.command, **self.lease))
            except Refused as refusal:
                self.refusals.append(str(refusal))
            self.over.wait(0.03)
        self.client.close()

    def __enter__(self):
        if not self.is_alive():
            self.start()
        return self

    def __exit__(self, *_):
        self.end()

    def end(self):
        self.over.set()
        self.join()


def wheels_turn(stage, rad_s=2.0):
    return all(abs(joint.velocity_rad_s) > rad_s for joint in stage.sim.truth().joints.values())


def set_off(stage, *more, **lease):
    """Arm the robot and drive it until both wheels turn; return the source that drives it."""
    stage.robot.arm()
    with contextlib.ExitStack() as unless_off:
        source = unless_off.enter_context(Source(stage, SPEED_M_S, *(more or (0.0,)), **lease))
        wait_until(lambda: wheels_turn(stage), "the wheels turn")
        unless_off.pop_all()
    return source


def at_rest(stage):
    return wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")


def power(stage):
    return [joint.enabled for joint in stage.sim.truth().joints.values()]


def drives(stage):
    return {joint["drive"] for joint in stage.robot.status()["joints"].values()}


def test_it_starts_disarmed_and_arms_drives_stops_and_disarms_on_request(stage):
    assert not any(power(stage))
    assert stage.robot.arm() == "armed"
    assert all(power(stage))
    with set_off(stage):
        assert stage.wait_for("moving")
        assert stage.robot.stop() == "armed"
        assert stage.sim.truth().moved_max_m_s > 0.9 * 2.0 * 0.0825
    at_rest(stage)
    assert stage.robot.disarm() == "idle"
    wait_until(lambda: not any(power(stage)), "the power is off")


def test_nothing_moves_before_arming_and_the_refusal_names_the_command(stage):
    with Source(stage, SPEED_M_S, 0.0) as source:
        wait_until(lambda: len(source.refusals) > 3, "refusals")
        with pytest.raises(Refused, match="socket requests motion"):
            stage.robot.arm()
    assert "motord arm" in source.refusals[0]
    assert stage.sim.truth().moved_max_m_s == 0.0


def test_arming_twice_is_arming_once(stage):
    assert (stage.robot.arm(), stage.robot.arm()) == ("armed", "armed")


def test_a_source_that_keeps_sending_through_a_stop_must_send_zero_first(stage):
    with set_off(stage) as source:
        assert stage.robot.stop() == "armed"
        source.refusals.clear()
        wait_until(lambda: len(source.refusals) > 10, "refusals")
        assert "has not sent zero since" in source.refusals[-1]
        assert stage.state() == "armed"
        at_rest(stage)
        source.command = (0.0, 0.0)
        source.answers.clear()
        wait_until(lambda: source.answers, "an answer")
        source.command = (SPEED_M_S, 0.0)
        wait_until(lambda: wheels_turn(stage), "it drives again")


def test_a_lease_ends_with_its_connection(stage):
    source = set_off(stage, lease_s=5.0)
    source.end()
    at_rest(stage)
    assert stage.wait_for("armed")
    assert stage.robot.status()["leases"] == []


def test_a_higher_priority_takes_the_command_and_gives_it_back(stage):
    with set_off(stage, owner="planner", priority=10) as planner:
        with Source(stage, 0.0, 1.0, owner="joystick", priority=50) as joystick:
            wait_until(lambda: joystick.answers, "an answer to the joystick")
            assert joystick.answers[0]["owner"] == "joystick"
            assert joystick.answers[0]["in_command"]
            planner.answers.clear()
            wait_until(lambda: planner.answers, "an answer to the planner")
            assert planner.answers[-1]["owner"] == "joystick"
            assert not planner.answers[-1]["in_command"]
        planner.answers.clear()
        wait_until(lambda: any(answer["in_command"] for answer in planner.answers), "it is back")


def test_an_emergency_stop_latches_until_reset_and_arm(stage):
    with set_off(stage) as source:
        assert stage.robot.estop() == "estop"
        at_rest(stage)
        for attempt in (stage.robot.arm, stage.robot.reset):
            with pytest.raises(Refused):  # the stop is latched, and the source requests motion
                attempt()
        assert stage.robot.status()["why"][0].startswith("requested by process")
        assert any("motord reset" in refusal for refusal in source.refusals)
    assert stage.robot.disarm() == "estop"
    assert stage.robot.reset() == "idle"
    assert stage.robot.arm() == "armed"
    assert stage.sim.truth().at_rest


def test_an_emergency_stop_does_not_wait_for_arming_to_end(stage):
    stage.sim.inject("delay:ms=15,p=1")
    outcome = []

    def arm():
        with stage.client() as client:
            try:
                outcome.append(client.arm())
            except Refused as refusal:
                outcome.append(str(refusal))

    arming = threading.Thread(target=arm)
    arming.start()
    assert stage.robot.estop() == "estop"
    arming.join()
    assert "emergency stop" in outcome[0]
    assert stage.state() == "estop"
    stage.sim.clear_faults_script()
    wait_until(lambda: not any(power(stage)), "the power is off")


def test_a_drive_fault_in_motion_is_latched_named_and_cleared_by_reset(stage):
    with set_off(stage):
        stage.sim.inject("fault:at_s=0,unit=1,channel=1,bit=2")
        stage.wait_for("fault")
    at_rest(stage)
    assert stage.robot.status()["faults"]
    wait_until(
        lambda: any("left" in reason for reason in stage.robot.status()["why"]),
        "the drive is named, also if it was seen off before it reported why",
    )
    with pytest.raises(Refused, match="motord reset"):
        stage.robot.arm()
    wait_until(lambda: stage.robot.status()["at_rest"], "rest")
    assert stage.robot.reset() == "idle"
    assert stage.robot.status()["why"] == []
    assert stage.robot.arm() == "armed"


def test_a_drive_fault_at_rest_refuses_arming_with_its_text(stage):
    stage.sim.inject("fault:at_s=0,unit=1,channel=2,bit=2")
    wait_until(lambda: stage.robot.status()["joints"]["right"]["drive_faults"], "the fault is seen")
    words = stage.robot.status()["joints"]["right"]["fault_words"]
    with pytest.raises(Refused) as refusal:
        stage.robot.arm()
    assert f"right: {words[0]}" in str(refusal.value)
    assert stage.robot.reset() == "idle"
    assert stage.robot.arm() == "armed"


def test_a_drive_that_does_not_arm_leaves_nothing_armed(stage):
    stage.sim.inject("exception:code=4,p=1")
    with pytest.raises(Refused, match=r"not armed|not ready"):
        stage.robot.arm()
    stage.sim.clear_faults_script()
    wait_until(lambda: not any(power(stage)), "the power is off")
    wait_until(lambda: drives(stage) == {"ready"}, "unresponsive drives answer again")
    stage.wait_for("idle")
    assert stage.robot.arm() == "armed"


def test_a_drive_that_cannot_be_disarmed_is_reported_with_its_watchdog(stage):
    stage.robot.arm()
    stage.sim.pull("rs485")
    with pytest.raises(Refused, match="watchdog"):
        stage.robot.disarm()
    stage.sim.plug("rs485")
    wait_until(lambda: stage.robot.status()["lines"]["rs485"]["state"] == "ready", "the line")
    wait_until(lambda: not any(power(stage)), "the power is off")


def test_a_line_lost_under_power_is_a_fault_that_reset_clears_when_it_is_back(stage):
    with set_off(stage):
        stage.sim.pull("rs485")
        stage.wait_for("fault")
    assert "rs485" in " ".join(stage.robot.status()["why"])
    wait_until(lambda: stage.robot.status()["rest"] == "unknown", "nobody sees the wheels")
    with pytest.raises(Refused, match="not ready: line rs485 is closed"):
        stage.robot.reset()
    stage.sim.plug("rs485")
    wait_until(lambda: stage.robot.status()["joints"]["left"]["drive"] == "ready", "the drive")
    wait_until(lambda: not stage.robot.status()["joints"]["left"]["stale"], "feedback")
    assert stage.robot.reset() == "idle"


def test_a_drive_that_reboots_under_power_is_a_fault_and_comes_back_disarmed(stage):
    with set_off(stage):
        stage.sim.inject("reboot:at_s=0,unit=1,for_s=0.1")
        stage.wait_for("fault")
    at_rest(stage)
    wait_until(lambda: stage.robot.status()["joints"]["left"]["drive"] == "ready", "the drive")
    assert not any(power(stage))


def test_a_pulled_cable_and_its_return_change_the_state(stage):
    stage.sim.pull("rs485")
    stage.wait_for("configuring")
    with pytest.raises(Refused, match="not ready"):
        stage.robot.arm()
    stage.sim.plug("rs485")
    stage.wait_for("idle")
    # arming waits until the stop that the cable interrupted has ended, within a second
    wait_until(lambda: accepted(stage.robot.arm), "armed again")
    assert stage.state() == "armed"


def test_limits_change_in_motion_as_one_group_or_not_at_all(stage):
    with set_off(stage):
        with pytest.raises(ClientError, match="linear_m_s"):
            stage.robot.params_set(**{"limits.linear_m_s2": 0.7, "limits.linear_m_s": -1.0})
        with pytest.raises(ClientError, match=r"did you mean limits\.linear_m_s"):
            stage.robot.params_set(**{"limits.linear_ms": 0.2})
        for name in ("limits.linear_m_s3", "drive.left.control_word"):
            with pytest.raises(ClientError, match=f"{name}: is too large a number"):
                stage.robot.params_set(**{name: 10**400})  # too large for a float
        assert stage.robot.params_get() == stage.limits
        slow = {"limits.linear_m_s": 0.2, "limits.linear_m_s3": None}
        assert stage.robot.params_set(**slow, force=True) == slow
        wait_until(
            lambda: math.isclose(
                stage.robot.status()["command"]["setpoint_linear_m_s"], 0.2, abs_tol=1e-9
            ),
            "the new limit",
        )
        assert "linear_velocity" in stage.robot.status()["reasons"]


def test_parameters_report_their_unit_and_range(stage):
    found = stage.robot.params_list()["limits.linear_m_s"]
    assert found["unit"] == "m/s"
    assert found["minimum"] <= found["value"] <= found["maximum"]
    assert stage.robot.params_get("limits.linear_m_s") == {"limits.linear_m_s": found["value"]}


def test_the_odometry_can_be_reset_to_the_origin(stage):
    with set_off(stage, 0.5):
        stage.robot.stop()
    at_rest(stage)
    assert stage.robot.status()["odometry"]["x_m"] != 0.0
    assert stage.robot.reset_odometry() == "armed"
    odometry = stage.robot.status()["odometry"]
    assert (odometry["x_m"], odometry["y_m"], odometry["heading_rad"]) == (0.0, 0.0, 0.0)


def test_commands_that_are_not_finite_or_out_of_range_are_refused(stage):
    stage.robot.arm()
    for value in (math.nan, math.inf):
        with pytest.raises(ClientError, match="is NaN or infinite"):
            stage.robot.drive(value, 0.0)
    for changes in ({"lease_s": 60.0}, {"priority": -1}, {"owner": "two words"}):
        with pytest.raises(ClientError, match=next(iter(changes))):
            stage.robot.drive(0.1, 0.0, **changes)
    assert stage.robot.status()["leases"] == []


def test_a_released_lease_is_gone_at_once(stage):
    stage.robot.arm()
    stage.robot.drive(0.0, 0.0, owner="me", lease_s=5.0)
    assert [lease["owner"] for lease in stage.robot.status()["leases"]] == ["me"]
    stage.robot.release("me")
    assert stage.robot.status()["leases"] == []


def test_the_loop_reports_its_histograms(stage):
    found = stage.robot.latency()
    assert found["samples"]["lateness"] > 0
    late = found["lateness_us"]
    assert late["p50"] <= late["p99"] <= late["p99_9"] <= late["max"]
    buckets = found["buckets"]["lateness"]
    assert sum(samples for _, _, samples in buckets) >= found["samples"]["lateness"]
    assert buckets[0][0] <= 1e3 * late["p50"] <= 1e3 * late["p99"] <= buckets[-1][1]


def test_histograms_only_grow(stage):
    def lateness():
        return {low: n for low, _, n in stage.robot.latency()["buckets"]["lateness"]}

    before = lateness()
    later = wait_until(
        lambda: now if sum((now := lateness()).values()) > sum(before.values()) + 100 else None,
        "a hundred ticks",
    )
    assert all(later[low] >= samples for low, samples in before.items())


def motord(stage, *words):
    return subprocess.run(
        [sys.executable, "-m", "motord", *words, "--socket", str(stage.socket)],
        cwd=ROOT, capture_output=True, text=True, timeout=60,
    )  # fmt: skip


def test_each_command_does_what_it_prints(stage):
    assert motord(stage, "arm").stdout == "armed\n"
    drive = motord(stage, "drive", "-0.2", "0.1", "--seconds", "0.5", "--json")
    assert json.loads(drive.stdout)["sent"] > 1
    assert stage.sim.truth().moved_max_m_s > 0.0
    stopped = json.loads(motord(stage, "stop", "--json").stdout)
    assert stopped == {"state": "armed", "rest": "at_rest", "rest_unknown_s": {}, "held": []}
    assert motord(stage, "disarm").stdout == "idle\n"
    text = motord(stage, "status").stdout
    assert "state" in text
    assert "joint left" in text
    assert json.loads(motord(stage, "status", "--json").stdout)["state"] == "idle"
    assert motord(stage, "params", "set", "limits.linear_m_s=0.3").stdout == (
        "limits.linear_m_s = 0.3\n"
    )
    assert "0.3 m/s" in motord(stage, "params", "list").stdout
    everything = json.loads(motord(stage, "params", "get", "--json").stdout)
    assert everything["limits.linear_m_s"] == 0.3


def test_ctrl_c_ends_the_drive_command_and_the_robot_stops(stage):
    stage.robot.arm()
    driving = subprocess.Popen(
        [sys.executable, "-m", "motord", "drive", "0.4", "0", "--socket", str(stage.socket)],
        cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip
    with driving:
        wait_until(lambda: wheels_turn(stage), "the wheels turn")
        driving.send_signal(signal.SIGINT)
        _, complaint = driving.communicate(timeout=30)
        assert (driving.returncode, complaint) == (0, b"")
    at_rest(stage)
    assert stage.wait_for("armed")


def test_the_exit_status_distinguishes_a_fault_from_a_refusal(stage):
    assert motord(stage, "drive", "0.1", "0").returncode == 1
    assert motord(stage, "params", "set", "limits.linear_m_s").returncode == 2
    assert motord(stage, "estop").returncode == 0
    latched = motord(stage, "status")
    assert (latched.returncode, "requested by process" in latched.stdout) == (3, True)
    refused = motord(stage, "arm")
    assert (refused.returncode, "motord reset" in refused.stderr) == (3, True)
    assert motord(stage, "disarm").returncode == 3
    assert motord(stage, "reset").returncode == 0


def test_a_second_daemon_on_the_same_socket_is_refused(stage):
    second = motord(stage, "run", "config/robots/demo.toml", "--set", "robot.name=second")
    assert second.returncode == 1
    assert "already" in second.stderr
    assert stage.state() == "idle"


def test_a_second_robot_of_the_same_name_is_refused(stage, tmp_path):
    name = stage.robot.status()["robot"]
    second = subprocess.run(
        [sys.executable, "-m", "motord", "run", "config/robots/demo.toml",
         "--set", f"robot.name={name}", "--socket", str(tmp_path / "other.sock")],
        cwd=ROOT, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert second.returncode == 1
    assert not (tmp_path / "other.sock").exists()


def test_an_idle_robot_logs_nothing(stage):
    before = stage.logged()
    ticks = stage.robot.status()["loop"]["ticks"]
    wait_until(lambda: stage.robot.status()["loop"]["ticks"] > ticks + 500, "ticks")
    assert stage.logged() == before


def motord_at(stage, *arguments):
    """Run a command of the command line on this daemon."""
    return CliRunner().invoke(cli, [*arguments, "--socket", str(stage.socket)])


def test_a_speed_above_the_limit_is_reported_with_the_limit(stage):
    stage.robot.arm()
    done = motord_at(stage, "drive", "5", "0", "--seconds", "0.1")
    assert done.exit_code == 0, done.output
    assert "5 m/s is above limits.linear_m_s: limited to 1 m/s" in done.stderr
    assert "rad/s is above" not in done.stderr


def test_a_limit_out_of_range_is_refused_with_its_range_and_unit(stage):
    done = motord_at(stage, "params", "set", "limits.linear_m_s=-1")
    assert done.exit_code == 2
    assert "limits.linear_m_s: -1.0 is out of range (0.001 to 1.2375 m/s)" in done.stderr


def test_an_idle_robot_shows_no_stale_command(stage):
    shown = motord_at(stage, "status").stdout
    assert "command_stale" not in shown
    assert "may command  local socket (socket, priority 100)" in shown


def test_an_emergency_stop_without_a_name_stops_every_robot(
    stage, tmp_path, tmp_path_factory, monkeypatch
):
    folder = tmp_path_factory.mktemp("all")  # a socket's path is short
    with running(tmp_path) as other:
        other.wait_for("idle")
        for robot in (stage, other):
            for suffix in (".sock", ".stop.sock", ".page"):
                name = robot.socket.name.removesuffix(".sock") + suffix
                place = robot.socket.with_name(name)
                (folder / f"{robot.robot.status()['robot']}{suffix}").symlink_to(place)
        monkeypatch.setattr("motord.client.socket_folders", lambda: [folder])
        done = CliRunner().invoke(cli, ["estop", "--json"])
        assert done.exit_code == 0, done.output
        assert sorted(json.loads(done.stdout)["robots"].values()) == ["estop", "estop"]
        refused = CliRunner().invoke(cli, ["stop"])
        assert "name one with --robot NAME (" in refused.stderr
        assert {stage.state(), other.state()} == {"estop"}
