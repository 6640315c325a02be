# SPDX-License-Identifier: Apache-2.0
"""The advice for a user without permission for the robot's socket or a drive's port."""

import grp
import os
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="becoming another user takes root")

GROUP = next(group for group in grp.getgrall() if group.gr_gid != 0)
STRANGER = """
import grp, os, sys  # now: without rights no module can be read any more
from pathlib import Path
from motord.client import Client, ClientError
from motord_hal.base.errors import PortError
from motord_hal.serial.port import open_exclusively
os.setgroups([]); os.setgid(65534); os.setuid(65534)
try:
    {call}
except (ClientError, PortError) as error:
    print(error)
"""


@pytest.fixture
def folder():
    """A folder that every user may enter."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        os.chmod(folder, 0o755)
        yield Path(folder)


def shown(call, path):
    """Run `call` as a user without any rights; return the error that it prints."""
    return subprocess.run(
        [sys.executable, "-c", STRANGER.format(call=call), str(path)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    ).stdout


@pytest.mark.parametrize("gid", [0, GROUP.gr_gid])
def test_the_advice_for_a_socket_names_sudo_and_its_group(folder, gid):
    path = folder / "r2.sock"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        os.chown(path, -1, gid)
        path.chmod(0o660)
        text = shown("Client(Path(sys.argv[1]))", path)
    cure = "this user may not command the robot: run this with sudo"
    if gid:
        cure += f", or join its group (sudo usermod -aG {GROUP.gr_name} $USER)"
        cure += " and log in again"
    assert text == f"{path}: {cure}\n"


def test_the_advice_for_a_port_names_sudo_and_the_group_dialout(folder):
    path = folder / "ttyUSB0"
    path.touch(0o660)
    text = shown("open_exclusively(sys.argv[1])", path)
    assert "this user may not use it: run this with sudo" in text
    assert "sudo usermod -aG dialout $USER" in text
