# SPDX-License-Identifier: Apache-2.0
"""A client of the Foxglove protocol (foxglove/ws-protocol, docs/spec.md) for single messages."""

import asyncio
import contextlib
import json
import struct

from websockets.asyncio.client import connect

MESSAGE_DATA, SERVICE_CALL, SERVICE_ANSWER = 1, 2, 3
SUBPROTOCOL = "foxglove.sdk.v1"


class Wire:
    """A connection. `services` and `channels`: all that the server has advertised, by name."""

    def __init__(self, socket):
        self._socket = socket
        self._numbers = iter(range(1, 1 << 30))
        self.services, self.channels = {}, {}

    async def received(self, op, fits=lambda message: True):
        """Return the next `op` message that fits; record the advertisements before it."""
        while True:
            raw = await self._socket.recv()
            if isinstance(raw, bytes):
                if op == raw[0] and fits(raw):
                    return raw
                continue
            message = json.loads(raw)
            if message["op"] == "advertise":
                self.channels |= {one["topic"]: one for one in message["channels"]}
            elif message["op"] == "advertiseServices":
                self.services |= {one["name"]: one for one in message["services"]}
            if message["op"] == op and fits(message):
                return message

    async def advertised(self, count):
        """Wait until `count` channels are advertised; return all by topic."""
        while len(self.channels) < count:
            await self.received("advertise")
        return self.channels

    async def send(self, op, **more):
        await self._socket.send(json.dumps({"op": op} | more))

    async def call(self, service, **request):
        """Call the service and return its answer."""
        while f"/{service}" not in self.services:
            await self.received("advertiseServices")
        number = next(self._numbers)
        head = struct.pack(
            "<BIII", SERVICE_CALL, self.services[f"/{service}"]["id"], number, len("json")
        )
        await self._socket.send(head + b"json" + json.dumps(request).encode())
        raw = await self.received(
            SERVICE_ANSWER, lambda raw: struct.unpack_from("<I", raw, 5)[0] == number
        )
        length = struct.unpack_from("<I", raw, 9)[0]
        return json.loads(raw[13 + length :])

    async def advertise(self, topic, encoding="json"):
        number = next(self._numbers)
        channel = {"id": number, "topic": topic, "encoding": encoding, "schemaName": "any"}
        await self.send("advertise", channels=[channel])
        return number

    async def publish(self, channel, message):
        raw = message if isinstance(message, bytes) else json.dumps(message).encode()
        await self._socket.send(struct.pack("<BI", MESSAGE_DATA, channel) + raw)

    async def parameters(self, op, **more):
        """Send `op`, getParameters or setParameters; return the values of the answer by name."""
        number = f"p{next(self._numbers)}"
        await self.send(op, id=number, **more)
        answer = await self.received("parameterValues", lambda answer: answer.get("id") == number)
        return {one["name"]: one["value"] for one in answer["parameters"]}


@contextlib.asynccontextmanager
async def wired(port, tls=None):
    """Connect as soon as the server listens. `tls`: the SSL context; without, no encryption."""
    while True:
        try:
            socket = await connect(
                f"ws{'s' if tls else ''}://localhost:{port}",
                ssl=tls,
                subprotocols=[SUBPROTOCOL],
                max_size=1 << 22,
                close_timeout=1.0,  # a server that no longer reads does not answer
            )
            break
        except OSError:
            await asyncio.sleep(0.05)
    try:
        yield Wire(socket)
    finally:
        await socket.close()
