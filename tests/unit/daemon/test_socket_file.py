# SPDX-License-Identifier: Apache-2.0
"""The file of the local socket: its place, its owner, and the files that it may replace."""

import errno
import socket
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from motord.config import load_robot
from motord.local_socket.command_sockets import open_stop_socket
from motord.local_socket.server import SocketInUse, listening, socket_path

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"


def test_the_socket_is_for_user_and_group_and_is_removed_with_its_daemon(path):
    with listening(path):
        assert stat.S_IMODE(path.stat().st_mode) == 0o660
    assert not path.exists()


def test_the_socket_of_a_dead_daemon_is_replaced(path):
    code = "import socket,sys; socket.socket(socket.AF_UNIX).bind(sys.argv[1])"
    subprocess.run([sys.executable, "-c", code, str(path)], check=True, timeout=30)
    assert path.is_socket()
    with listening(path), socket.socket(socket.AF_UNIX) as peer:
        peer.connect(str(path))


def test_the_socket_of_a_live_daemon_is_left_alone(path):
    with listening(path):
        with pytest.raises(SocketInUse, match="already"), listening(path):
            pass
        with socket.socket(socket.AF_UNIX) as peer:
            peer.connect(str(path))


@pytest.mark.parametrize(
    "opened", [listening, lambda path: open_stop_socket(load_robot(DEMO), path)]
)
def test_a_path_that_is_longer_than_the_kernel_takes_is_named_with_the_reason(path, opened):
    far = path.with_name("x" * 110)
    with pytest.raises(OSError, match=f"too long: '{path.parent}") as raised, opened(far):
        pass
    assert raised.value.errno == errno.ENAMETOOLONG


def test_a_file_that_is_no_socket_is_left_alone(path):
    path.write_text("precious", encoding="ascii")
    with pytest.raises(SocketInUse, match="not a socket"), listening(path):
        pass
    assert path.read_text(encoding="ascii") == "precious"


def test_a_path_that_cannot_exist_is_named(path):
    with pytest.raises(FileNotFoundError) as error, listening(path / "below.sock"):
        pass
    assert error.value.filename == str(path / "below.sock")


def test_a_socket_that_replaced_ours_is_not_removed(path):
    with listening(path):
        path.unlink()
        path.write_text("another's", encoding="ascii")
    assert path.exists()


@pytest.fixture
def folders(tmp_path):
    """Candidates for the folder: those of the system and the user, which cannot be made, and the
    last resort."""
    (tmp_path / "file").touch()
    (tmp_path / "tmp").mkdir()
    return [tmp_path / "file/motord", tmp_path / "run/motord", tmp_path / "tmp/motord-1"]


def test_the_systems_folder_is_used_where_it_can_be_made(folders, tmp_path):
    assert socket_path("r2", [tmp_path, *folders]) == tmp_path / "r2.sock"


def test_without_another_folder_a_private_one_is_made(folders):
    path = socket_path("r2", folders)
    assert path == folders[2] / "r2.sock"
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert socket_path("r2", folders) == path


def test_a_link_in_the_place_of_the_folder_is_not_followed(folders, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    folders[2].symlink_to(tmp_path / "elsewhere")
    with pytest.raises(PermissionError):
        socket_path("r2", folders)
