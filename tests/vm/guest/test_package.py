# SPDX-License-Identifier: Apache-2.0
"""The Debian package: what it puts where, and what is left when it has gone."""

from pathlib import Path

import pytest
from shell import output

PACKAGE = "/project/motord.deb"


@pytest.fixture
def put_back():
    yield
    output("dpkg", "-i", PACKAGE)


def test_the_installed_program_reads_a_robot_file_of_its_own_examples():
    said = output("motord", "check", "/usr/share/motord/robots/demo.toml")
    assert "demo" in said


def test_the_unit_is_hardened():
    table = output("systemd-analyze", "security", "motord@demo.service", "--no-pager")
    score = float(table.split("exposure level for motord@demo.service:")[1].split()[0])
    assert score <= 2.0, table


def test_the_unit_is_well_formed():
    assert output("systemd-analyze", "verify", "motord@demo.service") == ""


def test_a_purge_leaves_nothing_but_the_user_and_robot_files(put_back):
    mine = Path("/etc/motord/mine.toml")
    mine.write_text("[robot]\n")
    output("systemctl", "enable", "motord@mine.service")
    output("dpkg", "--purge", "motord")
    assert mine.read_text() == "[robot]\n"
    mine.unlink()
    mine.parent.rmdir()
    left = output("find", "/usr", "/etc", "/lib", "/run", "/var/lib", "-name", "*motord*",
                  "-not", "-path", "/var/lib/dpkg/*")  # fmt: skip
    assert left == ""
