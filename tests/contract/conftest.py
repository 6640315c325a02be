# SPDX-License-Identifier: Apache-2.0
"""Rigs are imported by their names alone, from any of these folders: in the guest of `make vm`,
which has some of these tests, all files are in one folder."""

import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), *(str(path) for path in HERE.iterdir() if path.is_dir())]


@pytest.fixture
def chip(tmp_path):
    """A PWM chip with its channels as plain files."""
    from pwm_rig import Chip

    return Chip(tmp_path / "chip")


@pytest.fixture
def sim(profile, folder):
    """The simulated drive of a file's `profile`; its port is in the file's `folder`."""
    from sim_bench import simulated

    with simulated(profile, folder) as control:
        yield control
