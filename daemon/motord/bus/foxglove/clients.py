# SPDX-License-Identifier: Apache-2.0
"""Messages to clients of the Foxglove server, and their requests: services, parameters and
published messages in JSON (Foxglove ws-protocol). The SDK calls this code from its own threads;
whatever moves the robot runs in the event loop.

The protocol has no token, and the SDK does not show the headers of a connection. So a client puts
the token into each request, {"token": ..., ...}, or calls the service `authorize` once, which
admits its connection until it ends.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from foxglove import Channel, MessageSchema, Parameter, Schema, Service, ServiceSchema, StatusLevel
from foxglove.websocket import (
    ChannelView,
    Client,
    ClientChannel,
    ServerListener,
    ServiceRequest,
    WebSocketServer,
)

from motord.api.snapshot import stop_answer
from motord.bus.commands.gate import COMMANDS, TRIGGERS, CommandGate, NotTaken, request_of, short
from motord.bus.commands.link import CALL_WITHIN_S
from motord.bus.commands.senders import Sender
from motord.bus.inbox import Inbox, ThreadBridge
from motord.bus.messages import json_form
from motord.bus.parameters import Tunable, value_of
from motord.config import FoxgloveInput
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

ENCODING = "json"
AUTHORIZE = "authorize"
NO_LIMIT = "inf"
"""Infinity as the robot file writes it, because JSON has no number for it."""
ANSWER_WITHIN_S = CALL_WITHIN_S + 2.0
CHANGE_WITHIN_S = 2.0
"""Longest time that a change of parameters may block a thread of the SDK, which serves other
clients, too."""
LOOK_EVERY_S = 1.0
COMPLAIN_AGAIN_S = 0.5
REQUEST_BYTES_MAX = 4096
WAITING_MAX = 32
ADMITTED_MAX = 64
CHANNELS_MAX = 256
"""Largest number of channels of clients that have shown the token, and of all others; the least
recently used are forgotten first. The SDK does not report that a client is gone."""
FORGOTTEN = "this channel is not known, or was forgotten for newer ones: advertise it again"

_TRIGGER = (
    ("Request", {"token": {"type": "string"}}),
    ("Response", {"success": {"type": "boolean"}, "message": {"type": "string"}}),
)


@dataclass(frozen=True, slots=True)
class _Message:
    """A message from a client. `came_s`: its time of arrival, CLOCK_MONOTONIC."""

    client: int
    topic: str
    request: Mapping[str, Any]
    came_s: float


class Looks(ServerListener):
    """Sends the robot description to each client that subscribes to its topic."""

    def __init__(self, looks: tuple[Channel, bytes]) -> None:
        """`looks`: channel of the robot description, and its message."""
        self._channel, self._message = looks

    def on_subscribe(
        self,
        client: Client,  # noqa: ARG002  # the SDK's signature
        channel: ChannelView,
    ) -> None:
        """Implement `ServerListener.on_subscribe`."""
        if channel.id == self._channel.id():
            self._channel.log(self._message, log_time=time.time_ns())


class Commands(Looks):
    """Takes commands from clients with the token."""

    def __init__(
        self, name: str, section: FoxgloveInput, runtime: Runtime, looks: tuple[Channel, bytes]
    ) -> None:
        """Raises OSError and ValueError for a token that cannot be used."""
        super().__init__(looks)
        self._runtime = runtime
        self._gate = CommandGate(name, section, runtime)
        self._tunable = Tunable(runtime.robot, self._gate.ask)
        self._parameters = {name: _shown(about) for name, about in self._tunable.fixed.items()}
        self._sent = dict(self._parameters)
        """Parameters as last sent to the clients that have subscribed."""
        self._thread_bridge = ThreadBridge()
        self._admitted: tuple[int, ...] = ()
        """Numbers of the connections that may command; the SDK never reuses a number. Threads read
        the tuple, so it is only replaced as a whole."""
        self._known: tuple[int, ...] = ()
        """Numbers of the connections that have shown the token, also in a single request."""
        self._topics: dict[tuple[int, int], str] = {}
        """Topics by the numbers of the connection and of its channel."""
        self._advertising = threading.Lock()
        self._inbox: Inbox[_Message] = Inbox(WAITING_MAX, self._take)
        """Messages with the token, or of admitted clients: all others are refused before."""
        self._complained_s: dict[str, float] = {}
        self.server: WebSocketServer | None = None

    async def run(self) -> None:
        """Run until cancelled."""
        self._inbox.open()
        async with TaskGroup() as tasks:
            tasks.create_task(self._gate.source.run())
            tasks.create_task(self._thread_bridge.run())
            tasks.create_task(self._watch())

    def _request(self, client: int, raw: bytes, *, admitted: bool = True) -> Mapping[str, Any]:
        """Return a request that has the token, or of an admitted connection if that is enough. It
        is checked in the SDK's thread: requests without the token take no place among those that
        wait for the event loop. Raises NotTaken."""
        request = request_of(json_form.decode, raw, REQUEST_BYTES_MAX)
        if not (admitted and client in self._admitted):
            self._gate.admit(request.get("token"))
        return request

    def _admitted_now(self, client: int) -> None:
        """Note in the event loop that a connection has just commanded."""
        if client in self._admitted:
            self._admitted = _newest(self._admitted, client)
        self._known = _newest(self._known, client)

    def _complain(self, about: str, error: NotTaken) -> None:
        """Report an error to all clients: the protocol has no reply to a message or a parameter."""
        now_s = time.monotonic()
        if self.server is not None and now_s - self._complained_s.get(about, 0) > COMPLAIN_AGAIN_S:
            self._complained_s[about] = now_s
            self.server.publish_status(f"{about}: {error}", StatusLevel.Warning, about)

    def _content(self, about: str) -> None:
        """Withdraw the report of a problem that is over."""
        if self._complained_s.pop(about, None) is not None and self.server is not None:
            self.server.remove_status([about])

    # ------------------------------------------------------------------------------------- topics
    def on_client_advertise(self, client: Client, channel: ClientChannel) -> None:
        """Implement `ServerListener.on_client_advertise`."""
        topic = channel.topic.removeprefix("/")
        if topic not in COMMANDS or channel.encoding != ENCODING:
            known = ", ".join(f"/{name}" for name in COMMANDS)
            self._complain("publish", NotTaken(f"taken are {known}, in {ENCODING}"))
            return
        with self._advertising:
            friend = client.id in self._known
            alike = [key for key in self._topics if (key[0] in self._known) == friend]
            for oldest in alike[: len(alike) - CHANNELS_MAX + 1]:
                del self._topics[oldest]
            self._topics[client.id, channel.id] = topic

    def on_client_unadvertise(self, client: Client, client_channel_id: int) -> None:
        """Implement `ServerListener.on_client_unadvertise`."""
        with self._advertising:
            self._topics.pop((client.id, client_channel_id), None)

    def on_message_data(self, client: Client, client_channel_id: int, data: bytes) -> None:
        """Implement `ServerListener.on_message_data`."""
        key = client.id, client_channel_id
        with self._advertising:
            topic = self._topics.pop(key, None)
            if topic is not None:
                self._topics[key] = topic  # used last, forgotten last
        if topic is None:
            self._complain("publish", NotTaken(FORGOTTEN))
            return
        came_s = time.monotonic()
        try:
            request = self._request(client.id, data)
        except NotTaken as error:
            self._complain(topic, error)
        else:
            self._inbox.put(_Message(client.id, topic, request, came_s))

    def _take(self, message: _Message) -> None:
        try:
            self._admitted_now(message.client)
            sender = Sender(f"client {message.client}", message.client)
            waited_s = time.monotonic() - message.came_s
            self._gate.take(message.topic, message.request, waited_s, sender)
        except NotTaken as error:
            self._complain(message.topic, error)
        else:
            self._content(message.topic)

    # ----------------------------------------------------------------------------------- services
    def services(self) -> list[Service]:
        """Return the services, of type std_srvs/Trigger with a token in the request."""
        schema = ServiceSchema(
            "std_srvs/srv/Trigger",
            **{part.lower(): _json_schema(part, fields) for part, fields in _TRIGGER},
        )
        return [
            Service(f"/{method}", schema=schema, handler=partial(self._served, method))
            for method in (AUTHORIZE, *TRIGGERS)
        ]

    def _served(self, method: str, request: ServiceRequest) -> bytes:
        """Answer a call of a service. Runs in a thread of the SDK."""
        try:
            self._request(request.client_id, request.payload, admitted=method != AUTHORIZE)
            make = partial(self._answer, method, request.client_id)
            answer = {"success": True, "message": self._thread_bridge.ask(make, ANSWER_WITHIN_S)}
        except NotTaken as error:
            answer = {"success": False, "message": str(error)}
        return json_form.encode(answer)

    async def _answer(self, method: str, client: int) -> str:
        """Carry out a call of a service that has been checked, and return the message of its
        response. Raises NotTaken."""
        self._admitted_now(client)
        if method == AUTHORIZE:
            self._admitted = _newest(self._admitted, client)
            return "this connection may command until it ends"
        success, message = stop_answer(method, await self._gate.act(method))
        if not success:
            raise NotTaken(message)
        return message

    # --------------------------------------------------------------------------------- parameters
    def on_get_parameters(
        self,
        client: Client,  # noqa: ARG002  # the SDK's signature
        param_names: list[str],
        request_id: str | None = None,  # noqa: ARG002  # the SDK's
    ) -> list[Parameter]:
        """Implement `ServerListener.on_get_parameters`; without names, return all parameters."""
        return self._listed(param_names)

    def on_set_parameters(
        self,
        client: Client,
        parameters: list[Parameter],
        request_id: str | None = None,  # noqa: ARG002  # the SDK's
    ) -> list[Parameter]:
        """Implement `ServerListener.on_set_parameters`: change all of the parameters or none. The
        answer, which also goes to subscribers, contains the values in force afterwards."""
        try:
            self._thread_bridge.ask(partial(self._change, client.id, parameters), CHANGE_WITHIN_S)
        except NotTaken as error:
            self._complain("parameters", error)
        else:
            self._content("parameters")
        return self._listed([parameter.name for parameter in parameters])

    async def _change(self, client: int, parameters: list[Parameter]) -> None:
        """Change all of the parameters or none. Raises NotTaken."""
        if client not in self._admitted:
            self._gate.admit(None)
        self._admitted_now(client)
        wanted = {one.name: _wanted(one) for one in parameters}
        await self._tunable.change(wanted)
        await self._look()
        self._sent |= {name: self._parameters[name] for name in wanted if name in self._parameters}

    def _listed(self, names: list[str]) -> list[Parameter]:
        known = self._parameters
        return [Parameter(name, value=known[name]) for name in names or known if name in known]

    async def _watch(self) -> None:
        """Send every change of a parameter to subscribers, whichever program made it."""
        while True:
            if self._runtime.view is not None:
                await self._look()
            now, before = self._parameters, self._sent
            changed = [name for name in now if before.get(name) != now[name]]
            if changed and self.server is not None:
                self._sent = dict(now)
                self.server.publish_parameter_values(self._listed(changed))
            await asyncio.sleep(LOOK_EVERY_S)

    async def _look(self) -> None:
        known = await self._tunable.known()
        self._parameters = {name: _shown(about) for name, about in known.items()}


def _newest(clients: tuple[int, ...], client: int) -> tuple[int, ...]:
    """Return the clients with this one last, and without the one that was last for longest."""
    return (*(one for one in clients if one != client), client)[-ADMITTED_MAX:]


def _wanted(parameter: Parameter) -> float:
    """Return the value that a parameter is to have. Raises NotTaken if it is not a number."""
    value = parameter.get_value()
    if value == NO_LIMIT:
        return float(NO_LIMIT)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise NotTaken(f'{parameter.name}: {short(value)} is not a number (no limit: "{NO_LIMIT}")')
    return float(value)


def _shown(about: Mapping[str, Any]) -> float | str:
    value = value_of(about)
    return NO_LIMIT if value == float(NO_LIMIT) else value


def _json_schema(part: str, fields: Mapping[str, Any]) -> MessageSchema:
    data = json_form.encode({"type": "object", "properties": fields})
    schema = Schema(name=f"std_srvs/srv/Trigger_{part}", encoding="jsonschema", data=data)
    return MessageSchema(encoding=ENCODING, schema=schema)
