# SPDX-License-Identifier: Apache-2.0
"""Two network namespaces connected by one cable, which a test can pull."""

import contextlib
import os
import shutil
import subprocess
from dataclasses import dataclass

THERE, HERE = "10.213.77.1", "10.213.77.2"


def why_not():
    """Return the reason why no cable can be made on this machine; empty if one can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "apt install iproute2"
    name = f"motord-try-{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True)
    if made.returncode:
        return f"no network namespaces here: {made.stderr.strip()}"
    dummy = ["ip", "-n", name, "link", "add", "v0", "type", "veth", "peer", "name", "v1"]
    cable = subprocess.run(dummy, capture_output=True, text=True)
    subprocess.run(["ip", "netns", "del", name], check=True)
    return f"no veth here: {cable.stderr.strip()}" if cable.returncode else ""


@dataclass
class Cable:
    """A cable between the namespaces `there` (address THERE) and `here` (address HERE)."""

    there: str
    here: str

    def pull(self):
        _ip("-n", self.there, "link", "set", "cable", "down")

    def plug(self):
        _ip("-n", self.there, "link", "set", "cable", "up")


def inside(name):
    """Return the words to put before a command, so that it runs in the namespace `name`."""
    return ("ip", "netns", "exec", name)


@contextlib.contextmanager
def cable():
    made = Cable(f"motord-a-{os.getpid()}", f"motord-b-{os.getpid()}")
    with contextlib.ExitStack() as cleanup:
        for name in (made.there, made.here):
            _ip("netns", "add", name)
            cleanup.callback(_ip, "netns", "del", name)
            _ip("-n", name, "link", "set", "lo", "up")
        _ip("-n", made.there, "link", "add", "cable", "type", "veth", "peer", "name", "cable",
            "netns", made.here)  # fmt: skip
        for name, address in ((made.there, THERE), (made.here, HERE)):
            _ip("-n", name, "addr", "add", f"{address}/24", "dev", "cable")
            _ip("-n", name, "link", "set", "cable", "up")
        yield made


def _ip(*words):
    subprocess.run(["ip", *words], check=True, timeout=20)
