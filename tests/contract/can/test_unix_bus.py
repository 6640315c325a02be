# SPDX-License-Identifier: Apache-2.0
"""The simulated CAN bus under threads: one receives, another sends, programs come and go."""

import contextlib
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import can
import pytest

from motord_hal.can.unix_client import UnixClient
from motord_hal.sim.can.unix_bus import UnixBus

VISITS = 2000
ROUNDS = 200
DEADLINE_S = 60.0
FRAME = can.Message(arbitration_id=0x123, data=b"motord", is_extended_id=False)


@contextlib.contextmanager
def threads(*works):
    """Run each function in a thread; at the end raise the error of one that failed."""
    with ThreadPoolExecutor(len(works)) as pool:
        futures = [pool.submit(work) for work in works]
        yield futures
        for future in futures:
            future.result(DEADLINE_S)


def joined(path):
    """Join the bus as soon as it has room for one more client."""
    end_s = time.monotonic() + DEADLINE_S
    while True:
        try:
            return UnixClient(path)
        except BlockingIOError:
            assert time.monotonic() < end_s
            time.sleep(0.001)


@pytest.fixture
def path(tmp_path):
    return str(tmp_path / "bus")


def test_a_program_that_leaves_while_a_thread_sends_harms_nothing(path):
    left = threading.Event()
    bus = UnixBus(path)

    def receive():
        while not left.is_set():
            bus.recv(timeout=0.01)

    def send():
        while not left.is_set():
            bus.send(FRAME)

    try:
        with threads(receive, send) as working:
            for _ in range(VISITS):
                joined(path).shutdown()
                if any(one.done() for one in working):
                    break
            left.set()
    finally:
        left.set()
        bus.shutdown()


def test_a_bus_that_closes_ends_the_threads_that_use_it(path):
    for _ in range(ROUNDS):
        bus, used = UnixBus(path), threading.Semaphore(0)

        def receive(bus=bus, used=used):
            used.release()
            with pytest.raises(can.CanOperationError, match="closed"):
                while True:
                    bus.recv(timeout=DEADLINE_S)

        def send(bus=bus, used=used):
            used.release()
            with pytest.raises(can.CanOperationError, match="closed"):
                while True:
                    bus.send(FRAME)

        with UnixClient(path) as client, threads(receive, send):
            for _ in range(2):
                used.acquire()
            client.send(FRAME)
            bus.shutdown()


def test_a_datagram_that_is_no_frame_is_dropped_and_the_next_frame_arrives(path):
    bus = UnixBus(path)
    try:
        with UnixClient(path) as client, UnixClient(path) as other:
            bus.recv(timeout=0)
            for junk in (b"x", bytes(15), bytes(17), bytes(71)):
                client._socket.send(junk)
            client.send(FRAME)
            received = []
            while not received:
                received += filter(None, [bus.recv(timeout=DEADLINE_S)])
            assert bytes(received[0].data) == b"motord"
            assert bytes(other.recv(timeout=DEADLINE_S).data) == b"motord"
    finally:
        bus.shutdown()
