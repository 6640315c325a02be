# SPDX-License-Identifier: Apache-2.0
"""Sources whose commands come less often than they live, or with a gap, by each input of
the robot for programs of this machine. They request motion, and zero only where a test does."""

import contextlib
import json
import socket
import threading
import time

from motord.api.commands import RELEASE, datagram, joint_datagram, position_datagram
from motord.client import Refused
from motord_hal.realtime.exchange import now_ns

LEASE_S = 0.3
SPARSE_S = 0.5
"""Longer than the lease: the robot moves most of the time, and can be armed in a pause."""
DENSE_S = 0.05
SPEED_M_S, SPEED_RAD_S, GOAL_RAD = 0.3, 3.0, 0.5


class Datagrams:
    """Commands under a lease, as datagrams of one kind to one socket."""

    def __init__(self, stage, made, *, udp=False, owner="autopilot"):
        """`made` makes the datagram of a token, a number and whether motion is requested."""
        self.client, self._made, self.owner = stage.client(), made, owner
        lease = self.client.call("lease", owner=owner, lease_s=LEASE_S)
        self._token, self._sequence = bytes.fromhex(lease["token"]), 0
        family, at = (
            (socket.AF_INET, ("127.0.0.1", lease["udp_port"]))
            if udp
            else (socket.AF_UNIX, lease["socket"])
        )
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.connect(at)

    def send(self, motion):
        self._sequence += 1
        self._socket.send(self._made(self._token, self._sequence, motion))

    def release(self):
        self._sequence += 1
        self._socket.send(datagram(self._token, self._sequence, now_ns(), 0.0, 0.0, kind=RELEASE))

    def close(self):
        self._socket.close()
        self.client.close()


class Calls:
    """Commands as calls of one method; `anew`: each on a connection of its own."""

    def __init__(self, stage, method, params, *, anew=False, owner="program"):
        """`params`: those of a motion and those of zero."""
        self._stage, self._method, self._params, self.owner = stage, method, params, owner
        self._anew, self.client = anew, stage.client()

    def send(self, motion):
        with contextlib.suppress(Refused), contextlib.ExitStack() as ends:
            client = ends.enter_context(self._stage.client()) if self._anew else self.client
            params = self._params[0 if motion else 1]
            client.call(self._method, owner=self.owner, lease_s=LEASE_S, **params)

    def release(self):
        self.client.release(self.owner)

    def close(self):
        self.client.close()


def _twist(token, sequence, motion):
    return datagram(token, sequence, now_ns(), SPEED_M_S if motion else 0.0, 0.0)


def _wheels(token, sequence, motion):
    return joint_datagram(token, sequence, now_ns(), [SPEED_RAD_S if motion else 0.0] * 2)


def _positions(token, sequence, motion):
    goals = {0: GOAL_RAD, 1: GOAL_RAD} if motion else {}
    return position_datagram(token, sequence, now_ns(), 2, {}, goals)


BASE = {
    "drive": lambda stage: Calls(stage, "drive", (
        {"linear_m_s": SPEED_M_S, "angular_rad_s": 0.0}, {"linear_m_s": 0.0, "angular_rad_s": 0.0},
    )),
    "drive, each on a new connection": lambda stage: Calls(stage, "drive", (
        {"linear_m_s": SPEED_M_S, "angular_rad_s": 0.0}, {"linear_m_s": 0.0, "angular_rad_s": 0.0},
    ), anew=True),
    "datagram": lambda stage: Datagrams(stage, _twist),
    "datagram of wheels": lambda stage: Datagrams(stage, _wheels),
    "UDP": lambda stage: Datagrams(stage, _twist, udp=True),
}  # fmt: skip
JOINTS = {
    "joints": lambda stage: Calls(stage, "joints", (
        {"position_rad": {"pan": GOAL_RAD, "tilt": GOAL_RAD}}, {"position_rad": {}},
    )),
    "datagram of positions": lambda stage: Datagrams(stage, _positions),
}  # fmt: skip
"""The inputs, by what a robot is commanded: how to make a source of each."""


def settings(udp_port):
    """Return the settings of a robot that takes commands on all of them."""
    rt = {"kind": "rt", "priority": 50, "lease_s": LEASE_S, "udp_port": udp_port}
    return tuple(f"input.autopilot.{key}={json.dumps(value)}" for key, value in rt.items())


class Sending:
    """A thread in which a source sends. `period_s` may change, and None is a gap."""

    def __init__(self, source, period_s):
        self.source, self.period_s = source, period_s
        self.sent, self._sent_s = 0, time.monotonic()
        self._zeros, self._over = 0, threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        while not self._over.is_set():
            if self._zeros:
                self._zeros -= 1
                self.source.send(motion=False)
            elif self.period_s is not None:
                self.source.send(motion=True)
                self.sent += 1
                self._sent_s = time.monotonic()
            self._over.wait(DENSE_S if self.period_s is None else self.period_s)

    @property
    def silent_s(self):
        """Time since its newest request of motion."""
        return time.monotonic() - self._sent_s

    def send_zero(self):
        """Let the next command be a zero."""
        self._zeros += 1

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()
        self.source.close()


def lapsed(stage):
    """Return whether no command is alive."""
    return not stage.robot.status()["leases"]


def deadline(seconds):
    end_s = time.monotonic() + seconds
    return lambda: time.monotonic() > end_s
