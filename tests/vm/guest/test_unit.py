# SPDX-License-Identifier: Apache-2.0
"""motord@ROBOT.service under a real systemd, on a real UART: started, hung, killed, stopped."""

import contextlib
import json
import os
import signal
import socket
import struct
import time
from pathlib import Path

import pytest
from cable import UART, adapter, drive_on, plug, robot_file, simulated_drive
from daemon_stage import Stage, wait_until
from shell import journal, output, properties

from motord.client import Client, ClientError

NAME = "cart"
UNIT = f"motord@{NAME}.service"
ETC = Path("/etc/motord")
DROP_IN = Path(f"/run/systemd/system/{UNIT}.d/patient.conf")
SOCKET = Path(f"/run/motord/{NAME}.sock")
DRIVE_WATCHDOG_S = 4.0  # cable.robot_file's


class Unit(Stage):
    """The daemon as systemd runs it."""

    def said(self):
        return "\n".join(entry["MESSAGE"] for entry in journal(UNIT))

    def again(self, old_pid):
        """Waits for the next process of the unit, and is connected to it."""
        self.robot.close()

        def connected():
            with contextlib.suppress(ClientError):
                client = Client(SOCKET)
                if listener_pid(client) != old_pid:
                    return client
                client.close()
            return None

        self.robot = wait_until(connected, f"it is started again\n{self.said()}")
        return self


def listener_pid(client):
    """Who listens at its socket: unix(7), SO_PEERCRED. Costs less than asking systemd."""
    with socket.socket(socket.AF_UNIX) as probe:
        probe.connect(str(client.path))
        return struct.unpack("3i", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[0]


@pytest.fixture
def unit(tmp_path):
    """Started; its watchdog as patient as an emulated machine asks for."""
    plug()
    DROP_IN.parent.mkdir(parents=True, exist_ok=True)
    DROP_IN.write_text("[Service]\nWatchdogSec=10\n")
    output("systemctl", "daemon-reload")
    robot = robot_file(ETC, UART, name=NAME)
    try:
        with simulated_drive(tmp_path, adapter()) as sim:
            output("systemctl", "start", UNIT)
            with Client(SOCKET) as client:
                yield Unit(None, sim, SOCKET, None, client)
            output("systemctl", "stop", UNIT)
    finally:
        output("systemctl", "stop", UNIT)
        DROP_IN.unlink()
        for path in (robot, ETC / "zlac8015d.toml"):
            path.unlink()


def main_pid():
    return int(properties(UNIT, "MainPID")["MainPID"])


def test_it_runs_on_time_as_a_user_without_rights(unit):
    status = Path(f"/proc/{main_pid()}/status").read_text().splitlines()
    found = dict(line.split(":\t", 1) for line in status if ":\t" in line)
    assert Path(f"/proc/{main_pid()}").owner() == "motord"
    assert int(found["CapEff"], 16) == int(found["CapBnd"], 16) == 0
    assert (found["NoNewPrivs"], found["Seccomp"]) == ("1", "2")
    loop = unit.robot.status()["loop"]
    assert loop["policy"] == "SCHED_FIFO"
    assert int(found["VmLck"].split()[0]) > 0
    assert "refused" not in unit.said()
    drive_on(unit)


def test_it_reaches_the_devices_of_motors_and_no_other(unit):
    assert properties(UNIT, "DevicePolicy")["DevicePolicy"] == "closed"
    # from inside its own limits: the disk's file is there, and opening it is refused by the kernel
    limits = ["-p", "DevicePolicy=closed", "-p", "DeviceAllow=char-ttyS rw"]
    script = "exec 2>&1; head -c 1 /dev/vda | wc -c; dd if=/dev/ttyS1 iflag=noctty,nonblock count=0"
    done = output("systemd-run", "--quiet", "--pipe", "--wait", *limits, "sh", "-c", script)
    assert "Operation not permitted" in done
    assert "0 bytes copied" in done


def test_a_daemon_that_hangs_is_killed_and_comes_back_disarmed(unit):
    drive_on(unit)
    pid = main_pid()
    os.kill(pid, signal.SIGSTOP)
    wait_until(lambda: unit.sim.truth().at_rest, "the drive's own watchdog stops the wheels")
    unit.again(pid).wait_for("idle")
    assert not any(joint.enabled for joint in unit.sim.truth().joints.values())
    assert properties(UNIT, "NRestarts")["NRestarts"] != "0"
    drive_on(unit)


def test_drives_of_a_killed_daemon_are_told_to_stop_and_it_comes_back_disarmed(unit):
    drive_on(unit)
    pid, killed_s = main_pid(), time.monotonic()
    os.kill(pid, signal.SIGKILL)
    wait_until(lambda: unit.sim.truth().at_rest, "the wheels rest")
    rest_s = time.monotonic() - killed_s
    unit.again(pid).wait_for("idle")
    assert "stopped and without power" in unit.said()
    assert not any(joint.enabled for joint in unit.sim.truth().joints.values())
    print(f"kill -9 at full speed on this machine: at rest after {rest_s:.1f} s")


def test_the_journal_knows_the_line_the_joints_and_the_faults(unit):
    drive_on(unit)
    unit.sim.inject("fault:at_s=0,unit=1,channel=1,bit=2")
    unit.wait_for("fault")
    entries = wait_until(
        lambda: [entry for entry in journal(UNIT) if entry.get("MOTORD_EVENT") == "drive_fault"],
        "the entry",
    )
    assert entries[0]["MOTORD_LINE"] == "rs485"
    assert "left" in entries[0]["MOTORD_JOINT"]
    latched = [entry for entry in journal(UNIT) if entry.get("MOTORD_EVENT") == "fault"]
    assert "over-current" in json.dumps(latched[0]["MOTORD_FAULT"])


def test_stopping_the_unit_brings_the_robot_to_rest(unit):
    drive_on(unit)
    output("systemctl", "stop", UNIT)
    truth = unit.sim.truth()
    assert truth.at_rest
    assert not any(joint.enabled for joint in truth.joints.values())
    assert properties(UNIT, "Result")["Result"] == "success"


def test_a_robot_file_with_mistakes_is_not_tried_again_and_again():
    bad = ETC / "bad.toml"
    bad.write_text("[robot]\n")
    try:
        output("systemctl", "start", "--no-block", "motord@bad.service")

        def failed():
            time.sleep(0.5)  # each look costs the emulated machine a tenth of a second
            return properties("motord@bad.service", "ActiveState")["ActiveState"] == "failed"

        wait_until(failed, "it has failed")
        assert properties("motord@bad.service", "NRestarts")["NRestarts"] == "0"
    finally:
        bad.unlink()
        output("systemctl", "reset-failed", "motord@bad.service")
