# SPDX-License-Identifier: Apache-2.0
"""The Debian package: what it puts where, and what is left when it has gone."""

import subprocess


def output(*command):
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


def test_the_installed_program_reads_a_robot_file_of_its_own_examples():
    said = output("motord", "check", "/usr/share/motord/robots/demo.toml")
    assert "demo" in said


def test_the_unit_is_hardened_beyond_what_the_house_asks_for():
    table = output("systemd-analyze", "security", "motord@demo.service", "--no-pager")
    score = float(table.split("exposure level for motord@demo.service:")[1].split()[0])
    assert score <= 2.0, table
