# SPDX-License-Identifier: Apache-2.0
"""Tests against a real kernel's drivers. They change devices, users and packages of the machine
that they run on: only in the guest of `make vm`, or where MOTORD_VM=1 permits it."""

import os
import sys
from pathlib import Path

import pytest

collect_ignore_glob = [] if os.environ.get("MOTORD_VM") == "1" else ["*"]

PACKAGES = [str(path) for path in Path("/usr/lib/motord/lib").glob("python3.*/site-packages")]
sys.path[:0] = PACKAGES
os.environ["PYTHONPATH"] = os.pathsep.join(PACKAGES)  # for the processes that tests start


def pytest_runtest_logreport(report):
    """Prints a failure at once: the rest may take minutes."""
    if report.failed:
        print(f"\n{report.longreprtext}", file=sys.__stdout__, flush=True)


@pytest.fixture(scope="session")
def simulator(tmp_path_factory):
    """The demo robot's drives, in one process: starting it takes an emulated machine seconds."""
    from cable import ROBOT
    from hardware import simulated

    with simulated(ROBOT, link_dir=tmp_path_factory.mktemp("drives")) as it:
        yield it


@pytest.fixture(scope="module")
def rig():
    """Pins and PWM of the kernel's simulated chips. Tests of lines have rigs of their own."""
    from pin_rig import pins

    with pins() as found:
        yield found
