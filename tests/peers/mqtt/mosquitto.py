# SPDX-License-Identifier: Apache-2.0
"""An MQTT broker (Eclipse Mosquitto) in its own process, and Mosquitto's own client programs."""

import contextlib
import json
import shutil
import signal
import socket
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from tests.sim.daemon_stage import DEADLINE_S, wait_until

BROKER = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
needs_mosquitto = pytest.mark.skipif(
    not (BROKER and shutil.which("mosquitto_sub")),
    reason="apt install mosquitto mosquitto-clients",
)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@dataclass
class Broker:
    folder: Path
    port: int
    process: subprocess.Popen = None
    options: tuple = ()
    """Options of mosquitto_pub and mosquitto_sub with which they connect."""
    lines: tuple = ()
    """Lines to add to the configuration of the broker."""
    readers: list = field(default_factory=list)

    def start(self):
        config = self.folder / "mosquitto.conf"
        rows = (f"listener {self.port} 127.0.0.1", "user root", *self.lines)
        config.write_text("\n".join(rows) + "\n", encoding="utf-8")
        with (self.folder / "mosquitto.log").open("ab") as log:
            self.process = subprocess.Popen(
                [BROKER, "-c", str(config)], stdout=log, stderr=log, stdin=subprocess.DEVNULL
            )
        wait_until(self.listens, "mosquitto")

    def listens(self):
        assert self.process.poll() is None, (self.folder / "mosquitto.log").read_text()
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            return True
        return False

    def stop(self):
        self.process.send_signal(signal.SIGCONT)
        self.process.kill()
        self.process.wait()

    def pub(self, topic, message, *more):
        payload = message if isinstance(message, str) else json.dumps(message)
        subprocess.run(
            ["mosquitto_pub", "-p", str(self.port), "-t", topic, "-m", payload, *self.options,
             *more],
            check=True, timeout=DEADLINE_S,
        )  # fmt: skip

    def get(self, topic, *more):
        """Return the retained message of a topic; without one, wait for the next message."""
        run = subprocess.run(
            ["mosquitto_sub", "-p", str(self.port), "-t", topic, "-C", "1",
             "-W", str(int(DEADLINE_S)), *self.options, *more],
            check=True, stdout=subprocess.PIPE, timeout=2 * DEADLINE_S,
        )  # fmt: skip
        return run.stdout.rstrip(b"\n")


@contextlib.contextmanager
def broker(folder, *lines, options=()):
    made = Broker(folder, free_port(), lines=lines, options=options)
    made.start()
    try:
        yield made
    finally:
        made.stop()


def stamp(age_s=0.0):
    """Return the header of a command that is `age_s` old."""
    sec, rest = divmod(time.time() - age_s, 1.0)
    return {"stamp": {"sec": int(sec), "nanosec": int(rest * 1e9)}, "frame_id": ""}


def certified(folder, name="DNS:localhost"):
    """Make a certificate authority in `folder`, and a certificate of it for the host `name`."""

    def openssl(*words):
        subprocess.run(["openssl", *words], check=True, cwd=folder, capture_output=True, timeout=60)

    key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")
    openssl("req", "-x509", *key, "-keyout", "ca.key", "-out", "ca.pem", "-subj", "/CN=test CA",
            "-days", "2")  # fmt: skip
    openssl("req", *key, "-keyout", "host.key", "-out", "host.csr", "-subj", "/CN=localhost")
    (folder / "names").write_text(f"subjectAltName={name}\n", encoding="ascii")
    openssl("x509", "-req", "-in", "host.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-days", "2",
            "-CAcreateserial", "-out", "host.pem", "-extfile", "names")  # fmt: skip


def with_password(folder):
    """Write the broker's file of users, with the user r2, and motord's file of the password."""
    (folder / "password").write_text("secret\n", encoding="ascii")
    (folder / "password").chmod(0o600)
    subprocess.run(
        ["mosquitto_passwd", "-b", "-c", str(folder / "users"), "r2", "secret"], check=True
    )
