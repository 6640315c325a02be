# SPDX-License-Identifier: Apache-2.0
"""The synchronous client, against a real server and against one that misbehaves."""

import asyncio
import contextlib
import json
import os
import socket
import threading

import pytest

from motord import aio
from motord import client as client_module
from motord.client import Client, ClientError, Refused, find_socket, socket_folders
from motord.local_socket.server import Method, listening, serve
from motord.local_socket.server import Refused as ServerRefused


def refuse(caller, params):
    raise ServerRefused("the robot sleeps: motord arm")


METHODS = {
    name: Method(lambda caller, params, name=name: {"state": name, **params}, None)
    for name in (
        "arm", "disarm", "stop", "estop", "reset_odometry", "status", "drive", "release",
        "params.list", "params.get", "params.set", "latency",
    )
} | {"reset": Method(refuse)}  # fmt: skip


@pytest.fixture
def path(tmp_path):
    """Path of the socket of a real server, which runs in a thread of its own."""
    path = tmp_path / "r2.sock"
    started, ended = threading.Event(), []

    async def main():
        with listening(path) as listener:
            server = asyncio.current_task()
            loop = asyncio.get_running_loop()
            ended.append(lambda: loop.call_soon_threadsafe(server.cancel))
            started.set()
            with contextlib.suppress(asyncio.CancelledError):
                await serve(listener, METHODS, lambda number: None)

    thread = threading.Thread(target=lambda: asyncio.run(main()))
    thread.start()
    assert started.wait(20)
    yield path
    ended[0]()
    thread.join()


@contextlib.contextmanager
def answering(path, *replies):
    """Serve each request with the next of `replies`, valid or not; yield a client of the server."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen(1)

        def talk():
            peer, _ = listener.accept()
            with peer, peer.makefile("rb") as lines:
                for reply in replies:
                    lines.readline()
                    peer.sendall(reply)
                lines.readline()

        thread = threading.Thread(target=talk)
        thread.start()
        try:
            with Client(path, timeout_s=0.3) as client:
                yield client
        finally:
            thread.join()


def test_every_method_reaches_the_server_by_its_name(path):
    with Client(path) as robot:
        for name in ("arm", "disarm", "stop", "estop", "reset_odometry"):
            assert getattr(robot, name)() == name
        assert robot.status()["state"] == "status"
        assert robot.latency()["state"] == "latency"
        assert robot.params_list()["state"] == "params.list"
        assert robot.params_get("a", "b")["names"] == ["a", "b"]
        assert robot.params_set(**{"limits.linear_m_s": None})["limits.linear_m_s"] is None
        robot.release("me")


def test_what_is_not_given_is_left_to_the_robot_file(path):
    with Client(path) as robot:
        assert robot.drive(0.1, 0.2) == {
            "state": "drive", "linear_m_s": 0.1, "angular_rad_s": 0.2,
        }  # fmt: skip
        assert robot.drive(0.1, 0.2, owner="me", lease_s=1.0)["owner"] == "me"


def test_a_refusal_is_an_error_with_the_daemons_reason(path):
    with Client(path) as robot:
        with pytest.raises(Refused, match="the robot sleeps") as refusal:
            robot.reset()
        assert refusal.value.code == -32000
        assert robot.arm() == "arm"


def test_other_errors_are_no_refusals(path):
    with Client(path) as robot, pytest.raises(ClientError, match="fly") as error:
        robot.call("fly")
    assert not isinstance(error.value, Refused)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_nan_and_infinity_are_never_sent(path, value):
    with Client(path) as robot:
        with pytest.raises(ClientError, match="linear_m_s is NaN or infinite"):
            robot.drive(value, 0.0)
        assert robot.arm() == "arm"


def test_a_call_ends_at_its_deadline_and_the_next_skips_a_late_answer(tmp_path):
    late = b'{"jsonrpc":"2.0","id":1,"result":"late"}\n{"jsonrpc":"2.0","id":2,"result":"mine"}\n'
    with answering(tmp_path / "s", b"", late) as robot:
        with pytest.raises(ClientError, match=r"no answer within 0\.3 s"):
            robot.call("first")
        assert robot.call("second") == "mine"


def test_an_answer_may_follow_lines_that_are_not_its_own(tmp_path):
    raw = b'[]\n{"id":99,"result":0}\n{"jsonrpc":"2.0","id":1,"result":{"a":[1]}}\n'
    with answering(tmp_path / "s", raw) as robot:
        assert robot.call("x") == {"a": [1]}


def test_a_closed_connection_is_an_error(tmp_path):
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "s"))
        listener.listen(1)
        with Client(tmp_path / "s") as robot:
            listener.accept()[0].close()
            with pytest.raises(ClientError):
                robot.status()


def test_an_answer_that_is_no_json_is_reported(tmp_path):
    with (
        answering(tmp_path / "s", b"hello\n") as robot,
        pytest.raises(ClientError, match="does not answer in JSON"),
    ):
        robot.status()


def test_an_answer_without_end_is_cut_off(tmp_path, monkeypatch):
    monkeypatch.setattr(client_module, "ANSWER_BYTES_MAX", 1000)
    with (
        answering(tmp_path / "s", b"x" * 2000) as robot,
        pytest.raises(ClientError, match="without end"),
    ):
        robot.status()


def test_a_missing_daemon_is_reported_with_its_path(tmp_path):
    with pytest.raises(ClientError, match=r"absent.sock: no daemon has this socket: motord run"):
        Client(tmp_path / "absent.sock")


def test_a_killed_daemon_is_reported_with_the_command_that_stops_all(tmp_path):
    path = tmp_path / "r2.sock"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
    with pytest.raises(ClientError, match=r"has ended without closing it: .*motord stop-all"):
        Client(path)


def test_the_only_robot_is_found(path):
    folders = [path.parent / "empty", path.parent]
    assert find_socket(folders=folders) == path
    assert find_socket("r2", folders) == path


def test_no_robot_and_several_robots_are_an_error(path):
    with pytest.raises(ClientError, match="no robot x runs here: motord run"):
        find_socket("x", [path.parent])
    with listening(path.with_name("r3.sock")), pytest.raises(ClientError, match=r"r2.*r3"):
        find_socket(None, [path.parent])


def test_a_dead_daemons_socket_is_not_found(tmp_path):
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(tmp_path / "r2.sock"))
    (tmp_path / "file.sock").touch()
    with pytest.raises(ClientError, match="no robot"):
        find_socket(None, [tmp_path])


@pytest.mark.skipif(os.geteuid() != 0, reason="giving a file away takes root")
def test_a_strangers_socket_is_no_robot(path):
    os.chown(path, 65534, 65534)
    with pytest.raises(ClientError, match="no robot"):
        find_socket(None, [path.parent])


@pytest.mark.skipif(os.geteuid() != 0, reason="giving a folder away takes root")
@pytest.mark.parametrize(("above_mode", "found"), [(0o755, True), (0o1777, False)])
def test_a_services_socket_is_trusted_where_only_root_makes_folders(tmp_path, above_mode, found):
    above = tmp_path / "run"
    folder = above / "motord"
    folder.mkdir(parents=True)
    above.chmod(above_mode)
    with listening(folder / "r4.sock") as _:
        os.chown(folder, 65534, 65534)
        os.chown(folder / "r4.sock", 65534, 65534)
        if found:
            assert find_socket(None, [folder]).name == "r4.sock"
        else:
            with pytest.raises(ClientError, match="no robot"):
                find_socket(None, [folder])


def test_sockets_are_sought_where_daemons_put_them():
    folders = list(map(str, socket_folders({"XDG_RUNTIME_DIR": "/run/user/7"}, uid=7)))
    assert folders[:2] == ["/run/motord", "/run/user/7/motord"]
    assert folders[2].endswith("/motord-7")
    assert len(socket_folders({}, uid=7)) == 2


def test_a_client_sends_the_documented_request(tmp_path):
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "s"))
        listener.listen(1)
        received = []

        def talk():
            peer, _ = listener.accept()
            with peer, peer.makefile("rb") as lines:
                received.append(json.loads(lines.readline()))
                peer.sendall(b'{"jsonrpc":"2.0","id":1,"result":{"state":"armed"}}\n')

        thread = threading.Thread(target=talk)
        thread.start()
        with Client(tmp_path / "s") as robot:
            assert robot.arm() == "armed"
        thread.join()
    assert received == [{"jsonrpc": "2.0", "id": 1, "method": "arm", "params": {}}]


def test_without_a_free_descriptor_a_client_raises_its_error(path, no_descriptor_left):
    with no_descriptor_left(), pytest.raises(ClientError, match="Too many open files"):
        Client(path)


async def test_without_a_free_descriptor_the_asyncio_client_raises_too(path, no_descriptor_left):
    with no_descriptor_left(), pytest.raises(ClientError, match="Too many open files"):
        await aio.Client(path).open()
