# SPDX-License-Identifier: Apache-2.0
"""The Debian package: the installed program and unit, and the files that a purge leaves."""

from pathlib import Path

import pytest
from shell import output
from unit import prepared

PACKAGE = "/project/motord.deb"


@pytest.fixture
def put_back():
    yield
    output("dpkg", "-i", PACKAGE)


@pytest.mark.smoke
def test_the_installed_program_reads_a_robot_file_of_its_own_examples():
    shown = output("motord", "check", "/usr/share/motord/robots/demo.toml")
    assert "demo" in shown


def exposure(unit):
    table = output("systemd-analyze", "security", unit, "--no-pager")
    score = float(table.split(f"exposure level for {unit}:")[1].split()[0])
    assert score <= 2.0, table


@pytest.mark.smoke
def test_the_unit_is_hardened():
    exposure("motord@demo.service")


def test_the_unit_is_hardened_for_the_most_demanding_robot_too():
    robot = "pi4-encoders"
    drop_in = output("motord", "unit", f"/usr/share/motord/robots/{robot}.toml")
    assert "ReadWritePaths" in drop_in
    with prepared(robot, drop_in):
        exposure(f"motord@{robot}.service")


@pytest.mark.smoke
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
