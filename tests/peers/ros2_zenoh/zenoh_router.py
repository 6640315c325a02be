# SPDX-License-Identifier: Apache-2.0
"""A Zenoh router in its own process, which tests kill, stop and start again.

zenoh_router.py PORT [TLS_PORT FOLDER]: on TLS_PORT it accepts only clients with a certificate of
the authority in FOLDER."""

import asyncio
import contextlib
import json
import signal
import socket
import subprocess
import sys

import zenoh

START_WITHIN_S = 20.0


def endpoint(port):
    return f"tcp/127.0.0.1:{port}"


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextlib.asynccontextmanager
async def router(port, *tls):
    """Run a router, and yield its process when it listens."""
    with started(port, *tls) as process:
        async with asyncio.timeout(START_WITHIN_S):
            assert await asyncio.to_thread(process.stdout.readline) == b"ready\n"
        yield process


@contextlib.contextmanager
def started(port, *tls):
    """Run a router, and yield its process at once. It is killed at the end, even if stopped."""
    command = [sys.executable, __file__, *map(str, (port, *tls))]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            process.kill()


def main():
    config = {
        "mode": "router",
        "listen": {"endpoints": [endpoint(sys.argv[1])]},
        "scouting": {"multicast": {"enabled": False}},
    }
    if len(sys.argv) > 2:
        folder = sys.argv[3]
        config["listen"]["endpoints"].append(f"tls/localhost:{sys.argv[2]}")
        config["transport"] = {
            "link": {
                "tls": {
                    "root_ca_certificate": f"{folder}/ca.pem",
                    "listen_certificate": f"{folder}/router.pem",
                    "listen_private_key": f"{folder}/router.key",
                    "enable_mtls": True,
                }
            }
        }
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))):
        print("ready", flush=True)
        signal.pause()


if __name__ == "__main__":
    main()
