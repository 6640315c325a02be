# SPDX-License-Identifier: Apache-2.0
"""An ordinary ROS 2 node on Zenoh: its topics, services and tokens. It is a client of a router
(zenohd, or `ros2 run rmw_zenoh_cpp rmw_zenohd`) and listens on no port itself."""

from __future__ import annotations

import asyncio
import json
import logging
from dataclasses import dataclass
from typing import Any

import zenoh

from motord.api.deadline import within
from motord.bus.messages.table import with_parts
from motord.bus.ros2.names import remapped
from motord.bus.ros2.quality import Answer, Distribution, Quality, Take
from motord.bus.ros2.zenoh.endpoints import Endpoint, Publisher, Service, Subscription
from motord.bus.ros2.zenoh.names import NodeNames
from motord_hal.base.tasks import TaskGroup

ROUTER = "tcp/127.0.0.1:7447"
"""Default address of the router of ROS 2."""
OPEN_WITHIN_S = 1.0
OPEN_AGAIN_S = 1.0
CLOSE_WITHIN_S = 2.0
_LOOK_EVERY_S = 2.0

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Router:
    """Address of the router, and paths of the files for TLS."""

    endpoint: str = ROUTER
    """Address as Zenoh writes it: tcp/HOST:PORT, tls/HOST:PORT."""
    ca_file: str | None = None
    cert_file: str | None = None
    key_file: str | None = None

    def configuration(self) -> str:
        """Return the configuration of the session, in JSON. The session does not scout, and it adds
        the timestamps that other nodes need to query latched messages."""
        tls_options = {
            "root_ca_certificate": self.ca_file,
            "connect_certificate": self.cert_file,
            "connect_private_key": self.key_file,
        }
        tls: dict[str, Any] = {
            key: value for key, value in tls_options.items() if value is not None
        }
        if self.cert_file is not None:
            tls["enable_mtls"] = True
        return json.dumps(
            {
                "mode": "client",
                "connect": {
                    "endpoints": [self.endpoint],
                    "timeout_ms": round(OPEN_WITHIN_S * 1000),
                    "exit_on_failure": True,
                },
                "scouting": {
                    "multicast": {"enabled": False},
                    "gossip": {"enabled": False},
                },
                "timestamping": {"enabled": True},
                "transport": {"link": {"tls": tls}},
            }
        )


class ZenohNode:
    """A ROS 2 node on Zenoh. Create its topics and services before `run`."""

    def __init__(
        self,
        name: str,
        namespace: str,
        domain_id: int,
        router: Router,
        distribution: Distribution = "jazzy",
    ) -> None:
        """`distribution`: ROS 2 distribution of the other nodes. Raises ValueError if Zenoh rejects
        the router's settings."""
        self._hashed = distribution != "humble"
        self.name = name
        self.namespace = namespace
        self.remap: dict[str, str] = {}
        self.types: set[str] = set()
        self._domain_id = domain_id
        self._router = router
        self._configuration = router.configuration()
        try:
            zenoh.Config.from_json5(self._configuration)
        except zenoh.ZError as error:
            raise ValueError(f"{router.endpoint}: {error}") from error
        self._endpoints: list[Endpoint] = []
        self._services: list[Service] = []
        self._reported = False
        self._running = asyncio.Lock()
        self._ending = False

    def full(self, name: str) -> str:
        """Return a name with its namespace, replaced by the rules in `remap`."""
        return remapped(self.namespace, self.name, name, self.remap)

    def publisher(self, name: str, kind: str, quality: Quality | None = None) -> Publisher:
        """Create a publisher. `kind`: a type of `table.TYPES`."""
        self.types.add(kind)
        publisher = Publisher(self.full(name), kind, quality or Quality())
        self._endpoints.append(publisher)
        return publisher

    def subscribe(self, name: str, kind: str, take: Take, quality: Quality | None = None) -> None:
        """Implement `nodes.Node.subscribe`."""
        self.types.add(kind)
        self._endpoints.append(Subscription(self.full(name), kind, quality or Quality(), take))

    def serve(
        self, name: str, kind: str, answer: Answer, depth: int = 10, together: int = 1
    ) -> None:
        """Implement `nodes.Node.serve`."""
        self.types.update(with_parts(kind))
        service = Service(self.full(name), kind, answer, depth, together)
        self._services.append(service)
        self._endpoints.append(service)

    async def run(self) -> None:
        """Keep the node connected until cancelled, and retry while there is no router. When several
        adapters share the node, one of them runs it for all; if that one fails, the next one
        does."""
        async with self._running:
            self._ending = False
            try:
                async with TaskGroup() as tasks:
                    for service in self._services:
                        tasks.create_task(service.run())
                    tasks.create_task(self._keep())
            finally:
                self._ending = True

    async def _keep(self) -> None:
        while True:
            try:
                session = await asyncio.to_thread(self._open)
            except zenoh.ZError as error:
                self._say(str(error))
                await asyncio.sleep(OPEN_AGAIN_S)
                continue
            try:
                await self._use(session)
            except zenoh.ZError as error:
                self._say(str(error))
            finally:
                async with within(CLOSE_WITHIN_S):
                    await asyncio.to_thread(_close, session)

    def _open(self) -> zenoh.Session:
        """Open the session. Runs in a thread because it waits for the network."""
        session = zenoh.open(zenoh.Config.from_json5(self._configuration))
        if self._ending:
            _close(session)
        return session

    async def _use(self, session: zenoh.Session) -> None:
        """Declare the node and its endpoints until the session ends. Zenoh itself reconnects to a
        router."""
        names = NodeNames(
            domain_id=self._domain_id,
            session_id=str(session.zid()),
            namespace=self.namespace,
            name=self.name,
            hashed=self._hashed,
        )
        with session.liveliness().declare_token(names.token()):
            for number, endpoint in enumerate(self._endpoints, start=1):
                endpoint.declare(session, names, number)
            _log.info("ROS 2 on Zenoh: at %s as %s", self._router.endpoint, self.full(self.name))
            self._reported = False
            while not session.is_closed():  # noqa: ASYNC110  Zenoh has no event for it
                await asyncio.sleep(_LOOK_EVERY_S)

    def _say(self, text: str) -> None:
        if not self._reported:
            self._reported = True
            _log.warning("ROS 2 on Zenoh: no router at %s: %s", self._router.endpoint, text)


def _close(session: zenoh.Session) -> None:
    session.close()  # type: ignore[no-untyped-call]
