# SPDX-License-Identifier: Apache-2.0
"""Fixtures of tests with real kernel drivers. The tests change devices, users and packages of their
machine. So they run only with MOTORD_VM=1, which the guest of `make vm` sets."""

import os
import sys
from pathlib import Path

import pytest

collect_ignore_glob = [] if os.environ.get("MOTORD_VM") == "1" else ["*"]

PACKAGES = [str(path) for path in Path("/usr/lib/motord/lib").glob("python3.*/site-packages")]
sys.path[:0] = PACKAGES
os.environ["PYTHONPATH"] = os.pathsep.join(PACKAGES)  # for the processes that tests start


def pytest_runtest_logreport(report):
    """Print a failure at once, because the remaining tests may take minutes."""
    if report.failed:
        print(f"\n{report.longreprtext}", file=sys.__stdout__, flush=True)


@pytest.fixture(scope="session")
def simulator(tmp_path_factory):
    """Simulated drives of the demo robot, started once: an emulated machine takes seconds."""
    from cable import ROBOT
    from hardware import simulated

    with simulated(ROBOT, link_dir=tmp_path_factory.mktemp("drives")) as it:
        yield it


@pytest.fixture(scope="module")
def rig():
    """Pins and PWM of the kernel's simulated chips. Tests of CAN lines define another `rig`."""
    from pin_rig import pins

    with pins() as found:
        yield found
