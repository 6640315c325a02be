# SPDX-License-Identifier: Apache-2.0
"""A connection to an MQTT 3.1.1 broker (aiomqtt) that reconnects by itself."""

from __future__ import annotations

import asyncio
import logging
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

import aiomqtt

from motord.base.rate_limited_log import RateLimitedFilter
from motord.bus.guard import first, raise_if_cancelled
from motord.bus.messages import json_form
from motord.bus.messages.forms import Form, Make, as_json, as_message
from motord.bus.messages.sources import Body
from motord.bus.messages.topics import Topic, View
from motord.bus.mqtt.names import names_of
from motord.bus.secret import read_secret
from motord.config import MqttBroker
from motord_hal.base.bounded import regular

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

KEEPALIVE_S = 5
"""A connection ends when the broker is silent for this long; messages that the broker still holds
for this client are lost."""
ANSWER_WITHIN_S = 5.0
AGAIN_MIN_S, AGAIN_MAX_S = 0.5, 5.0
QUEUED_MAX = 256
_PORT, _TLS_PORT = 1883, 8883

_log = logging.getLogger(__name__)


class MqttConnection:
    """One client of one broker. `keep` runs a function with each connection."""

    def __init__(self, where: str, section: MqttBroker, runtime: Runtime) -> None:
        """`where` is the section's name in the robot file. Raises OSError and ValueError for files
        that cannot be used, and ImportError if the encoding's package is missing."""
        self._where = where
        robot = runtime.robot.robot.name
        self._section = section
        self._identifier = f"motord-{robot}-{where}"
        self._password = None
        if section.password_file is not None:
            self._password = read_secret(runtime.beside_robot_file(section.password_file))
        self._tls = _tls_context(section, runtime) if section.tls else None
        # aiomqtt logs every message that a full queue drops: a flooded topic would fill the log
        self._library_log = logging.getLogger(f"{__name__}.{where}")
        self._library_log.setLevel(logging.WARNING)
        self._library_log.addFilter(RateLimitedFilter(self._library_log, where))
        self.encode = encoder(section.encoding)
        self.names = names_of(section, robot, self.encode)
        self.form: Form = as_json if section.encoding == "json" else self._as_cbor
        self.decode = decoder(section.encoding)

    def _as_cbor(self, topic: Topic, body: Body) -> Make:
        build = as_message(topic, body)

        def encoded(view: View, wall_offset_ns: int) -> bytes | None:
            message = build(view, wall_offset_ns)
            return None if message is None else self.encode(message)

        return encoded

    async def keep(
        self,
        use: Callable[[aiomqtt.Client], Awaitable[None]],
        will: Callable[[], aiomqtt.Will | None] = lambda: None,
    ) -> None:
        """Connect and run `use`, again and again until cancelled. `will` is called for each
        connection. Of a series of failures only the first is logged."""
        again_s, failing = AGAIN_MIN_S, False
        while True:
            try:
                async with self._connected(will()) as client:
                    raise_if_cancelled()  # for the reason given in `taken`
                    if failing:
                        _log.info("%s: connected again", self._where)
                    again_s, failing = AGAIN_MIN_S, False
                    await use(client)
            except* (aiomqtt.MqttError, OSError) as errors:
                if not failing:
                    failing = True
                    _log.warning("%s: %s: %s", self._where, self._section.host, first(errors))
            raise_if_cancelled()
            await asyncio.sleep(again_s)
            again_s = min(2.0 * again_s, AGAIN_MAX_S)

    @asynccontextmanager
    async def _connected(self, will: aiomqtt.Will | None) -> AsyncIterator[aiomqtt.Client]:
        section = self._section
        async with aiomqtt.Client(
            section.host,
            section.port or (_TLS_PORT if section.tls else _PORT),
            username=section.username,
            password=self._password,
            identifier=self._identifier,
            clean_session=True,  # the broker keeps no command for us
            will=will,
            keepalive=KEEPALIVE_S,
            timeout=ANSWER_WITHIN_S,
            tls_context=self._tls,
            logger=self._library_log,
            max_queued_incoming_messages=QUEUED_MAX,
            max_queued_outgoing_messages=QUEUED_MAX,
        ) as client:
            yield client


async def taken(call: Awaitable[object]) -> None:
    """Await a call of aiomqtt, and raise CancelledError if the task was cancelled. aiomqtt uses
    asyncio.wait_for, which before Python 3.12 drops a cancellation that arrives together with the
    answer: the publisher would go on, and motord-bus would never end."""
    await call
    raise_if_cancelled()


def _tls_context(section: MqttBroker, runtime: Runtime) -> ssl.SSLContext:
    def beside(name: str | None) -> str | None:
        return None if name is None else str(regular(runtime.beside_robot_file(name)))

    context = ssl.create_default_context(cafile=beside(section.ca_file))
    if certificate := beside(section.cert_file):
        context.load_cert_chain(certificate, beside(section.key_file))
    return context


def encoder(encoding: str) -> Callable[[Any], bytes]:
    """Return the function from a message to bytes. Raises ImportError if the encoding's package is
    missing."""
    if encoding == "json":
        return json_form.encode
    import cbor2

    return lambda message: cbor2.dumps(json_form.plain(message))


def decoder(encoding: str) -> Callable[[bytes], Any]:
    """Return the function from bytes to dictionaries and numbers; it raises ValueError for bytes
    that are not valid. Raises ImportError if the encoding's package is missing."""
    if encoding == "json":
        return json_form.decode
    import cbor2

    def decode(raw: bytes) -> Any:
        try:
            return cbor2.loads(raw)
        except (cbor2.CBORDecodeError, RecursionError) as error:
            raise ValueError(str(error)) from None

    return decode
