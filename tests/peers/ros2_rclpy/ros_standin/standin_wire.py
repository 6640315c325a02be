# SPDX-License-Identifier: Apache-2.0
"""The middleware of the stand-in: a hub that passes each message of a process to all other
processes. An environment variable names its socket."""

import contextlib
import itertools
import os
import pickle
import socketserver
import struct
import threading
from socket import AF_UNIX, socket

HUB = "ROS_STANDIN_HUB"
_LENGTH = struct.Struct("<I")


def _frame(stream):
    raw = stream.read(_LENGTH.size)
    return stream.read(*_LENGTH.unpack(raw)) if len(raw) == _LENGTH.size else b""


@contextlib.contextmanager
def hub(path):
    """Run a hub on a socket at `path`."""
    peers, lock = [], threading.Lock()

    class Peer(socketserver.StreamRequestHandler):
        def handle(self):
            with lock:
                peers.append(self)
            try:
                while raw := _frame(self.rfile):
                    with lock:
                        for other in peers:
                            if other is not self:
                                with contextlib.suppress(OSError):
                                    other.request.sendall(_LENGTH.pack(len(raw)) + raw)
            except OSError:
                pass
            finally:
                with lock:
                    peers.remove(self)

    class Server(socketserver.ThreadingMixIn, socketserver.UnixStreamServer):
        daemon_threads = True
        request_queue_size = 32

    with Server(str(path), Peer) as server:
        serving = threading.Thread(target=server.serve_forever)
        serving.start()
        try:
            yield
        finally:
            server.shutdown()
            serving.join()


class Graph:
    """Endpoints of this process, and those that other processes have announced."""

    def __init__(self):
        self.lock = threading.RLock()
        self.numbers = itertools.count(1)
        self.here, self.there = {}, {}
        """Endpoint objects of this process, and the `about` of all others, by (pid, number)."""
        self._socket = socket(AF_UNIX)
        self._socket.connect(os.environ[HUB])
        threading.Thread(target=self._read, daemon=True).start()
        self._send(("hello",))

    def add(self, endpoint, about):
        """Add an endpoint of this process. `about`: its role, name, type, node and QoS."""
        key = (os.getpid(), next(self.numbers))
        with self.lock:
            self.here[key] = endpoint
            endpoint.key, endpoint.about = key, about
            self._send(("endpoint", key, about))
            others = [sent for sent in self.here.values() if sent is not endpoint]
        for other in others:
            other.met(about)
        return key

    def remove(self, endpoint):
        with self.lock:
            self.here.pop(endpoint.key, None)
            self._send(("gone", endpoint.key))

    def known(self, role, name):
        """Return (key, about) of each known endpoint of that role and name."""
        with self.lock:
            ours = [(key, endpoint.about) for key, endpoint in self.here.items()]
            found = [*ours, *self.there.items()]
        return [(key, about) for key, about in found if about[:2] == (role, name)]

    def send(self, role, name, *what):
        """Send `what` to every endpoint of that role and name, also to those of this process."""
        self._send(("tell", role, name, what))
        self._hand(role, name, what)

    def _hand(self, role, name, what):
        with self.lock:
            meant = [end for end in self.here.values() if end.about[:2] == (role, name)]
        for endpoint in meant:
            endpoint.take(*what)

    def _send(self, item):
        raw = pickle.dumps(item)
        with self.lock, contextlib.suppress(OSError):
            self._socket.sendall(_LENGTH.pack(len(raw)) + raw)

    def _read(self):
        stream = self._socket.makefile("rb")
        with contextlib.suppress(OSError, ValueError):
            while raw := _frame(stream):
                self._received(*pickle.loads(raw))

    def _received(self, what, *rest):
        if what == "hello":
            with self.lock:
                for key, endpoint in self.here.items():
                    self._send(("endpoint", key, endpoint.about))
        elif what == "endpoint":
            with self.lock:
                new = rest[0] not in self.there
                self.there[rest[0]] = rest[1]
                others = list(self.here.values()) if new else []
            for other in others:
                other.met(rest[1])
        elif what == "gone":
            with self.lock:
                self.there.pop(rest[0], None)
        else:
            self._hand(*rest)


_graphs = []


def graph():
    """Return the graph of this process. Make it on the first call."""
    if not _graphs:
        _graphs.append(Graph())
    return _graphs[0]


def forget():
    """Drop the graph, because the hub has ended. The next call of `graph` makes another one."""
    _graphs.clear()
