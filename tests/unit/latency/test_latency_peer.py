# SPDX-License-Identifier: Apache-2.0
"""The peer, the other end of a measurement: it sends commands and stamps the answers."""

import os
import socket
import threading
import time

import pytest

from motord.tools.latency.peer import CODES, COMMAND, Peer

DEADLINE_S = 30.0


@pytest.fixture
def ends():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    far_fd, near_fd = os.pipe()
    with ours, theirs:
        ours.settimeout(DEADLINE_S)
        yield ours, Peer(theirs, far_fd, command_hz=1000.0), near_fd
    os.close(far_fd)
    os.close(near_fd)


def test_each_answer_is_counted_once_and_the_end_of_the_socket_is_the_end(ends):
    ours, peer, near_fd = ends
    thread = threading.Thread(target=peer.run, daemon=True)
    thread.start()
    codes = []
    while len(codes) < 20:
        stamp_ns, code = COMMAND.unpack(ours.recv(64))
        assert 0 < stamp_ns <= time.monotonic_ns()
        codes.append(code)
        os.write(near_fd, bytes((code, code)))
    ours.shutdown(socket.SHUT_WR)
    thread.join(DEADLINE_S)
    assert not thread.is_alive()
    assert codes == list(range(1, 21))
    assert peer.sent >= 20
    assert 1 <= peer.command_to_byte.samples <= 20
    assert peer.command_to_byte.max_ns > 0


def test_an_answer_is_as_old_as_its_command(ends):
    ours, peer, near_fd = ends
    peer.send()
    stamp_ns, code = COMMAND.unpack(ours.recv(64))
    os.write(near_fd, bytes((code,)))
    before_ns = time.monotonic_ns()
    peer.receive()
    age_ns = peer.command_to_byte.max_ns
    assert before_ns - stamp_ns <= age_ns <= time.monotonic_ns() - stamp_ns


def test_a_byte_that_matches_no_command_is_not_counted(ends):
    _, peer, near_fd = ends
    os.write(near_fd, bytes((0, 7, 255)))
    peer.receive()
    assert peer.command_to_byte.samples == 0


def test_codes_repeat_and_are_never_zero(ends):
    ours, peer, _ = ends
    codes = set()
    for _ in range(2 * CODES):
        peer.send()
        codes.add(COMMAND.unpack(ours.recv(64))[1])
    assert codes == set(range(1, CODES + 1))


def test_a_full_socket_costs_commands_and_never_blocks(ends):
    _, peer, _ = ends
    for _ in range(20 * CODES):
        peer.send()
    assert peer.sent == 20 * CODES
    assert len(peer.given_ns) <= CODES
