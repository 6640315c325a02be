# SPDX-License-Identifier: Apache-2.0
"""A bad link between a browser and the dashboard: data arrives late, in bursts, or not at all while
both connections stay open."""

import contextlib
import random
import selectors
import socket
import threading
import time

CHUNK = 65536
LOOK_EVERY_S = 0.005


class LinkProxy:
    """A proxy that delays data by `delay_s` in each direction. A share `stalls` of all chunks waits
    `stall_s` more, like a packet that TCP has to send again, and delays the data behind it. While
    `cut` is true, nothing goes through."""

    def __init__(self, port, delay_s=0.0, stalls=0.0, stall_s=0.2):
        self.delay_s, self.stalls, self.stall_s = delay_s, stalls, stall_s
        self.cut = False
        self._to = port
        self._random = random.Random(7)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._waiting = []
        self._sockets = {}
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()
        for one in (self._listener, *self._sockets):
            one.close()
        self._selector.close()

    def drop(self):
        """End every connection."""
        for one in list(self._sockets):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def _run(self):
        while not self._ended.is_set():
            for key, _ in self._selector.select(LOOK_EVERY_S):
                self._accept() if key.fileobj is self._listener else self._read(key.fileobj)
            self._deliver()

    def _accept(self):
        near, _ = self._listener.accept()
        far = socket.socket()
        with contextlib.suppress(OSError):
            far.connect(("127.0.0.1", self._to))
        for one, other in ((near, far), (far, near)):
            self._sockets[one] = {"other": other, "free_s": 0.0}
            self._selector.register(one, selectors.EVENT_READ)

    def _read(self, one):
        try:
            chunk = one.recv(CHUNK)
        except OSError:
            chunk = b""
        if not chunk:
            self._selector.unregister(one)
        state = self._sockets[one]
        late_s = self.stall_s if self._random.random() < self.stalls else 0.0
        state["free_s"] = max(state["free_s"], time.monotonic() + self.delay_s + late_s)
        self._waiting.append((state["free_s"], state["other"], chunk))

    def _deliver(self):
        if self.cut:
            return
        now_s = time.monotonic()
        due = [row for row in self._waiting if row[0] <= now_s]
        self._waiting = [row for row in self._waiting if row[0] > now_s]
        for _, to, chunk in due:
            with contextlib.suppress(OSError):
                to.sendall(chunk) if chunk else to.shutdown(socket.SHUT_WR)
