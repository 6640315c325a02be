# SPDX-License-Identifier: Apache-2.0
"""A daemon with ROS 2, and programs without code of motord that connect to it."""

import contextlib
import json
import os
import subprocess
import sys
import threading

from tests.peers.light import LIGHT
from tests.sim.daemon_stage import PATIENT, running, wait_until

from motord.client import ClientError

PEER = (sys.executable, "-m", "tests.peers.ros2.ros2_peer")
DOMAIN = 100 + os.getpid() % 100  # differs between test runs side by side
NAMESPACE = "/r2"
LEASE_S = 1.0
NICENESS = 10
"""Niceness of the peers: the robot has precedence over them on a busy machine."""


@contextlib.contextmanager
def ros2_stage(folder, *more, environ=None):
    """Run a daemon that publishes to ROS 2 and takes commands from it."""
    settings = (
        "publish.ros2.kind=ros2", f"publish.ros2.domain_id={DOMAIN}",
        f"publish.ros2.namespace={NAMESPACE}", "publish.ros2.rate_hz=20",
        "input.ros2.kind=ros2", f"input.ros2.domain_id={DOMAIN}",
        f"input.ros2.namespace={NAMESPACE}", f"input.ros2.lease_s={LEASE_S}",
        f"safety.command_timeout_s={LEASE_S}", *PATIENT, *LIGHT, *more,
    )  # fmt: skip
    with running(folder, *settings, environ=environ) as stage:
        stage.wait_for("idle")
        wait_until(lambda: inputs(stage).get("ros2", {}).get("lease"), "a lease")
        try:
            yield stage
        finally:
            caller.leave()


def inputs(stage):
    return (stage.robot.status()["bus"] or {}).get("inputs", {})


class Peer:
    """A running program without code of motord. A thread decodes its output line by line."""

    def __init__(self, command, decode):
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        os.setpriority(os.PRIO_PROCESS, self.process.pid, NICENESS)
        self._decode = decode
        self.received = []
        self._reading = threading.Thread(target=self._read)
        self._reading.start()

    def _read(self):
        for line in self.process.stdout:
            self.received.append(self._decode(line))

    def find(self, fits, what):
        return wait_until(lambda: next(filter(fits, list(self.received)), None), what)

    def say(self, line):
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def close(self):
        self.process.kill()
        self.process.wait()
        self._reading.join()
        self.process.stdin.close()
        self.process.stdout.close()


@contextlib.contextmanager
def peer(*words, program=PEER, decode=json.loads):
    made = Peer([*program, str(DOMAIN), *map(str, words)], decode)
    try:
        yield made
    finally:
        made.close()


class Caller:
    """A node that calls services: one process for all calls, like an operator's panel."""

    def __init__(self):
        self._peer = None

    def ask(self, name, *words):
        if self._peer is None:
            self._peer = Peer([*PEER, str(DOMAIN), "calls"], json.loads)
        answers = len(self._peer.received)
        try:
            self._peer.say(json.dumps([name, *words]))
            return wait_until(lambda: self._peer.received[answers:], f"an answer of {name}")[0]
        except BaseException:
            self.leave()
            raise

    def leave(self):
        """End the process. The next call starts another one, which discovers the robot anew."""
        if self._peer is not None:
            self._peer.close()
        self._peer = None


caller = Caller()


def called(name, kind="Trigger", **values):
    return caller.ask(f"{NAMESPACE}/motord/{name}", kind, values)


def no_source_commands(stage):
    wait_until(lambda: not stage.robot.status()["leases"], "the command's end")


def settle(stage):
    """Disarm, or reset a fault that a busy machine caused, until the robot is idle."""
    no_source_commands(stage)

    def settled():
        state = stage.state()
        with contextlib.suppress(ClientError):
            if state in ("fault", "estop"):
                stage.robot.call("reset")
            elif state not in ("idle", "configuring"):
                stage.robot.call("disarm")
        return state == "idle"

    wait_until(settled, "idle")
