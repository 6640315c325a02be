# SPDX-License-Identifier: Apache-2.0
"""motord@ROBOT.service under a real systemd, on a real UART: started, hung, killed, stopped."""

import json
import os
import signal
import time
from pathlib import Path

import pytest
from cable import UART, adapter, behind, plug, robot_file
from shell import journal, output, properties, status_of, wait_until
from stage import granted
from unit import ETC, prepared, reached

NAME = "cart"
UNIT = f"motord@{NAME}.service"


@pytest.fixture(scope="module")
def drives(simulator):
    """Simulated drives, for which the robot file and the unit are prepared."""
    plug()
    robot = robot_file(ETC, UART, name=NAME)
    with behind(simulator, adapter()) as sim, prepared(NAME):
        yield sim
    for path in (robot, ETC / "zlac8015d.toml"):
        path.unlink()


@pytest.fixture
def unit(drives):
    """The unit, running and idle, with drives without faults. It keeps running after a test: an
    emulated machine needs ten seconds for a start."""
    drives.clear_faults_script()
    with reached(NAME, drives) as unit:
        granted(unit.is_idle, "it is idle", unit.logged)
        yield unit


@pytest.mark.smoke
def test_it_runs_in_real_time_as_an_unprivileged_user(unit):
    status = Path(f"/proc/{unit.main_pid()}/status").read_text().splitlines()
    found = dict(line.split(":\t", 1) for line in status if ":\t" in line)
    assert Path(f"/proc/{unit.main_pid()}").owner() == "motord"
    assert int(found["CapEff"], 16) == int(found["CapBnd"], 16) == 0
    assert (found["NoNewPrivs"], found["Seccomp"]) == ("1", "2")
    loop = unit.robot.status()["loop"]
    assert loop["policy"] == "SCHED_FIFO"
    assert int(found["VmLck"].split()[0]) > 0
    assert "refused" not in unit.logged()
    unit.drive_on()


def test_it_can_open_motor_devices_and_no_others(unit):
    assert properties(UNIT, "DevicePolicy")["DevicePolicy"] == "closed"
    # With the limits of the unit, the kernel refuses to open the disk, whose device file exists.
    limits = ["-p", "DevicePolicy=closed", "-p", "DeviceAllow=char-ttyS rw"]
    script = "exec 2>&1; head -c 1 /dev/vda | wc -c; dd if=/dev/ttyS1 iflag=noctty,nonblock count=0"
    done = output("systemd-run", "--quiet", "--pipe", "--wait", *limits, "sh", "-c", script)
    assert "Operation not permitted" in done
    assert "0 bytes copied" in done


CONFINED = """
import os
from motord.bus.confine import confine
confine()
for priority in (1, 2):
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(priority))
        print(priority)
    except PermissionError as error:
        print(error.strerror)
"""


def test_the_second_process_may_have_the_lowest_real_time_priority_and_no_other(drives):
    rules = ("User=", "Limit", "Capability", "NoNewPrivileges", "SystemCall")
    unit_file = Path(properties(UNIT, "FragmentPath")["FragmentPath"]).read_text()
    kept = [line for line in unit_file.splitlines() if line.startswith(rules)]
    options = [word for line in kept for word in ("-p", line)]
    program = ("env", f"PYTHONPATH={os.environ['PYTHONPATH']}", "python3", "-c", CONFINED)
    done = output("systemd-run", "--quiet", "--pipe", "--wait", *options, *program)
    assert done.splitlines() == ["1", "Operation not permitted"]


def test_only_members_of_its_group_command_it(unit):
    output("useradd", "--groups", "motord", "driver")
    output("useradd", "visitor")
    try:
        arm = ("runuser", "-u", "driver", "--", "motord", "arm")
        # repeated, because an emulated drive may need longer than the daemon waits
        wait_until(lambda: status_of(*arm) == 0, "armed by a member", unit.logged)
        output("runuser", "-u", "visitor", "--", "sh", "-c", "! motord disarm")
        assert unit.state() != "idle"  # it may be "fault": a late drive of a busy machine
    finally:
        output("userdel", "driver")
        output("userdel", "visitor")


def test_a_daemon_that_hangs_is_killed_and_comes_back_disarmed(unit):
    unit.drive_on()
    pid = unit.main_pid()
    os.kill(pid, signal.SIGSTOP)
    wait_until(lambda: unit.sim.truth().at_rest, "the drive's own watchdog stops the wheels")
    unit.again(pid).wait_for("idle")
    assert unit.rests_without_power()
    assert properties(UNIT, "NRestarts")["NRestarts"] != "0"
    unit.drive_on()


def latched() -> str:
    """Return the last fault of the journal as JSON; empty without a fault."""
    faults = [entry for entry in journal(UNIT) if entry.get("MOTORD_EVENT") == "fault"]
    return json.dumps(faults[-1]["MOTORD_FAULT"]) if faults else ""


def test_the_journal_has_fields_for_line_joints_and_faults(unit):
    unit.drive_on()
    unit.sim.inject("fault:at_s=0,unit=1,channel=1,bit=2")
    unit.wait_for("fault")
    entries = wait_until(
        lambda: [entry for entry in journal(UNIT) if entry.get("MOTORD_EVENT") == "drive_fault"],
        "the entry",
    )
    assert entries[0]["MOTORD_LINE"] == "rs485"
    assert "left" in entries[0]["MOTORD_JOINT"]
    wait_until(lambda: "over-current" in latched(), "the fault by its name", unit.logged)
    unit.sim.clear_faults_script()
    granted(unit.robot.reset, "a reset", unit.logged)


def test_an_upgrade_brings_the_robot_to_rest_first_and_starts_it_again_disarmed(unit):
    unit.drive_on()
    pid = unit.main_pid()
    output("dpkg", "-i", "/project/motord.deb")
    unit.again(pid).wait_for("idle")
    assert unit.rests_without_power()
    assert "comes to rest" in unit.logged()


@pytest.mark.smoke
def test_stopping_the_unit_brings_the_robot_to_rest(unit):
    unit.drive_on()
    output("systemctl", "stop", UNIT)
    assert unit.rests_without_power()
    assert properties(UNIT, "Result")["Result"] == "success"


def test_a_robot_file_with_mistakes_is_not_tried_again_and_again():
    bad = ETC / "bad.toml"
    bad.write_text("[robot]\n")
    try:
        with prepared("bad"):
            output("systemctl", "start", "--no-block", "motord@bad.service")

            def failed():
                time.sleep(0.5)  # each query takes the emulated machine 0.1 s
                return properties("motord@bad.service", "ActiveState")["ActiveState"] == "failed"

            wait_until(failed, "it has failed")
            assert properties("motord@bad.service", "NRestarts")["NRestarts"] == "0"
    finally:
        bad.unlink()
        status_of("systemctl", "reset-failed", "motord@bad.service")
