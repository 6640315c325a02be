# SPDX-License-Identifier: Apache-2.0
"""Messages to a supervisor's socket, on real sockets."""

import os
import socket
import uuid

import pytest

from motord.base.sdnotify import Notifier


@pytest.fixture(params=["a path", "an abstract name"])
def supervisor(request, tmp_path):
    name = f"@motord-{uuid.uuid4()}" if request.param == "an abstract name" else str(tmp_path / "n")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.settimeout(10)
        listener.bind(name.replace("@", "\0"))
        yield listener, name


def test_every_message_arrives_as_systemd_reads_it(supervisor):
    listener, name = supervisor
    notifier = Notifier({"NOTIFY_SOCKET": name})
    assert notifier.ready()
    assert notifier.status("armed\nby ünit")
    assert notifier.watchdog()
    assert notifier.stopping()
    received = [listener.recv(100).decode() for _ in range(4)]
    assert received == ["READY=1", "STATUS=armed by ünit", "WATCHDOG=1", "STOPPING=1"]


def test_without_a_supervisor_nothing_is_sent():
    assert not Notifier({}).ready()


def test_a_supervisor_that_went_away_is_no_error(tmp_path):
    assert not Notifier({"NOTIFY_SOCKET": str(tmp_path / "gone")}).ready()


def test_a_supervisor_that_does_not_read_blocks_nothing(supervisor):
    _, name = supervisor
    notifier = Notifier({"NOTIFY_SOCKET": name})
    assert notifier.watchdog()
    while notifier.watchdog():
        pass  # until the supervisor's queue is full: then the message is lost, without a wait
    assert not notifier.watchdog()


@pytest.mark.parametrize(
    ("environ", "watchdog_s"),
    [
        ({"WATCHDOG_USEC": "2000000"}, 2.0),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())}, 2.0),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "me"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_only_a_watchdog_time_for_this_process_counts(environ, watchdog_s):
    assert Notifier(environ).watchdog_s == watchdog_s
