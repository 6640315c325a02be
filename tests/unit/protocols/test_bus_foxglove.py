# SPDX-License-Identifier: Apache-2.0
"""Foxglove's messages come in threads of its SDK, and wait there for the event loop."""

import asyncio
import socket
import struct
import time
from pathlib import Path
from types import SimpleNamespace

from foxglove import Channel, Context
from tests.peers.tokens import TOKEN, token_file

from motord.bus.foxglove.clients import Commands
from motord.bus.runtime import Runtime
from motord.config import FoxgloveInput, load_robot

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"
DEADLINE_S = 20.0
WAITED_S = 0.2
HEAD = struct.Struct("<IHH16sQqIIdd")
"""The layout of a command, from docs/commands.md."""


async def test_a_message_that_waited_keeps_the_time_of_its_arrival(tmp_path):
    runtime = Runtime(load_robot(DEMO), tmp_path / "no.sock")
    section = FoxgloveInput(kind="foxglove", token_file=str(token_file(tmp_path)), stamped=False)
    looks = Channel("/robot_description", context=Context(), message_encoding="json"), b"{}"
    commands = Commands("fox", section, runtime, looks)
    client = SimpleNamespace(id=1)
    channel = SimpleNamespace(id=2, topic="/cmd_vel", encoding="json")
    twist = f'{{"token": "{TOKEN}", "linear": {{"x": 0.2}}, "angular": {{"z": 0}}}}'
    received, sent = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with received, sent:
        source = runtime.sources["fox"]
        source._token, source._sender = bytes(16), sent
        received.setblocking(False)  # noqa: FBT003  # socket's
        async with asyncio.TaskGroup() as tasks:
            running = tasks.create_task(commands.run())
            await asyncio.sleep(0)
            commands.on_client_advertise(client, channel)
            commands.on_message_data(client, 2, twist.encode())
            came_ns = time.monotonic_ns()
            time.sleep(WAITED_S)  # noqa: ASYNC251  # nothing else shall run
            async with asyncio.timeout(DEADLINE_S):
                raw = await asyncio.get_running_loop().sock_recv(received, 4096)
            running.cancel()
    *_, stamp_ns, _, _, linear_m_s, angular_rad_s = HEAD.unpack_from(raw)
    assert (linear_m_s, angular_rad_s) == (0.2, 0.0)
    assert stamp_ns - came_ns < WAITED_S / 2.0 * 1e9
