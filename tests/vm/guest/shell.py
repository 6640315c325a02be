# SPDX-License-Identifier: Apache-2.0
"""Commands of the guest, and what they say."""

import json
import subprocess


def output(*command):
    """What it prints; a failure is the test's."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


def properties(unit, *names):
    lines = output("systemctl", "show", unit, *(f"-p{name}" for name in names)).splitlines()
    return dict(line.split("=", 1) for line in lines)


def journal(unit):
    """Its entries since the machine has started, oldest first."""
    output("journalctl", "--sync")
    return [
        json.loads(line) for line in output("journalctl", "-u", unit, "-o", "json").splitlines()
    ]
