# SPDX-License-Identifier: Apache-2.0
"""Commands in the guest, their output, and waiting for their effects."""

import json
import os
import subprocess
import time

DEADLINE_S = 100.0 + float(os.environ.get("MOTORD_VM_SET_UP_S", "0"))
"""An emulated machine on a busy one is slow: its time for boot and installation shows how slow."""
LOOK_EVERY_S = 0.05


def wait_until(condition, what, shown=str):
    """Calls `condition` until it is true, and returns its value; fails with `what` and what was
    shown."""
    end_s = time.monotonic() + DEADLINE_S
    while not (found := condition()):
        assert time.monotonic() < end_s, f"{what}: not within {DEADLINE_S} s\n{shown()}"
        time.sleep(LOOK_EVERY_S)
    return found


def status_of(*command):
    """Its exit status."""
    return subprocess.run(
        command, capture_output=True, timeout=2 * DEADLINE_S, check=False
    ).returncode


def output(*command):
    """Its output; fails the test if the command fails."""
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=2 * DEADLINE_S, check=False
    )
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


def properties(unit, *names):
    lines = output("systemctl", "show", unit, *(f"-p{name}" for name in names)).splitlines()
    return dict(line.split("=", 1) for line in lines)


def journal(unit):
    """The unit's entries since the machine started, oldest first."""
    output("journalctl", "--sync")
    return [
        json.loads(line) for line in output("journalctl", "-u", unit, "-o", "json").splitlines()
    ]
