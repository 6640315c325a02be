# SPDX-License-Identifier: Apache-2.0
"""A DDS participant on the Cyclone DDS binding. It transports bytes in CDR and does not interpret
them. One thread waits for the network; everything else happens in the event loop.

It uses no listeners (they run Python in DDS's own receive thread) and no KEEP_ALL (a write would
wait for the slowest reader, with the interpreter's lock held).
"""

from __future__ import annotations

import asyncio
import logging
import os
import threading
from collections.abc import Callable
from functools import cache
from typing import Any, Literal

from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.core import (
    DDSException,
    GuardCondition,
    InstanceState,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.internal import load_cyclonedds
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from motord.bus.ros2.dds.cyclone_types import cyclone_type
from motord.bus.ros2.dds.discovered import Discovered
from motord.bus.ros2.quality import Quality
from motord_hal.base.tasks import TaskGroup

Discovery = Literal["localhost", "subnet"]
URI = "CYCLONEDDS_URI"
"""Environment variable with Cyclone's own configuration. With discovery "subnet" it takes
precedence over motord's. With "localhost" it is ignored, so it cannot open to the network what the
robot file keeps on this machine."""
BLOCKING_MAX = duration(milliseconds=5)
_ANY = SampleState.Any | ViewState.Any | InstanceState.Any
_JOIN_WITHIN_S = 2.0
_LOOK_EVERY_S = 2.0
_FATAL_AND_ERROR = 0x3
"""DDS_LC_FATAL and DDS_LC_ERROR of dds/ddsrt/log.h."""
_WRITERS_MAX = 256
_LOCALHOST = (
    '<General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto"
    "</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    '<Peers><Peer address="localhost"/></Peers></Discovery>'
)

_COMPATIBILITY = (
    "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
)
"""Makes types of Fast DDS (vendor 1.15) match by their names. Its releases from 3.0 on (Kilted)
describe each type, and Cyclone takes their description of arrays for invalid: odom and the graph
did not match. eclipse-cyclonedds/cyclonedds, pull request 2333."""

_log = logging.getLogger(__name__)


class DdsError(OSError):
    """An error of the DDS library; the text describes it."""


def configuration(discovery: Discovery, interface: str | None) -> str:
    """Return Cyclone's configuration for discovery on this machine alone, or by its network
    interface."""
    inside = ""
    if discovery == "localhost":
        inside = _LOCALHOST
    elif interface is not None:
        network = f'<NetworkInterface name="{interface}"/>'
        inside = f"<General><Interfaces>{network}</Interfaces></General>"
    return f"<CycloneDDS><Domain>{inside}{_COMPATIBILITY}</Domain></CycloneDDS>"


@cache
def _domain(domain_id: int, xml: str) -> Domain:
    """Return the domain with a number. Cyclone permits only one of each number in a process."""
    return Domain(domain_id, xml)


def _mute_library() -> None:
    """Turn off Cyclone's warnings. It warns of each request that it cannot read, on standard error:
    that would be a flood, and `Discovered` names the client. Warnings about the configuration are
    written before this call."""
    load_cyclonedds().dds_set_log_mask(_FATAL_AND_ERROR)


def _qos(quality: Quality, user_data: str) -> Qos:
    """Return the quality of service as the binding expects it."""
    durability = Policy.Durability.TransientLocal if quality.latched else Policy.Durability.Volatile
    reliability: Any = Policy.Reliability.BestEffort
    if quality.reliable:
        reliability = Policy.Reliability.Reliable(BLOCKING_MAX)
    policies = [
        reliability,
        durability,
        Policy.History.KeepLast(quality.depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.WriterDataLifecycle(autodispose=False),
        Policy.Userdata(user_data.encode()),
    ]
    if quality.latched:
        history = Policy.History.KeepLast(quality.depth)
        policies.append(Policy.DurabilityService(0, history, -1, -1, -1))
    return Qos(*policies)


class Writer:
    def __init__(self, entity: DataWriter[Any], name: str) -> None:
        self.entity = entity
        self.name = name
        self.gid = entity.guid.bytes
        self._handle = entity._ref  # noqa: SLF001  the binding's write would encode once more
        self.lost = 0
        """Samples that DDS did not take."""
        self._reported = 0

    def write(self, raw: bytearray) -> bool:
        """Write a sample: complete CDR with its header. Return False if DDS does not take it."""
        if ddspy_write(self._handle, raw) < 0:
            self.lost += 1
            return False
        return True

    def say_mismatch(self) -> None:
        """Log new readers that request more than this writer offers, and so receive nothing."""
        entity: Any = self.entity
        status = entity.get_offered_incompatible_qos_status()
        if status is not None and status.total_count > self._reported:
            self._reported = status.total_count
            _log.warning(_MISMATCH, self.name, "reader", _policy(status.last_policy_id), "offer")


class Reader:
    def __init__(
        self,
        entity: DataReader[Any],
        name: str,
        quality: Quality,
        take: Callable[[bytes, Any], None] | None,
    ) -> None:
        self.entity = entity
        self.name = name
        self.gid = entity.guid.bytes
        self.condition = ReadCondition(entity, _ANY)
        self._handle = entity._ref  # noqa: SLF001  the binding's take would decode, too
        self._quality = quality
        self._take = take
        self._reported = 0
        self._writers: dict[int, bytes] = {}

    @property
    def elsewhere(self) -> bool:
        """Whether its samples are taken elsewhere, without `deliver`."""
        return self._take is None

    def writer_gid(self, handle: int) -> bytes:
        """Return the gid of a sample's writer; empty if the writer is gone. `handle`: DDS's handle
        of the writer."""
        if handle not in self._writers:
            try:
                found: Any = self.entity.get_matched_publication_data(handle)
            except DDSException:
                found = None
            if found is None:
                return b""
            if len(self._writers) == _WRITERS_MAX:
                self._writers.clear()
            self._writers[handle] = found.key.bytes
        return self._writers[handle]

    def deliver(self) -> None:
        """Take all samples that have arrived."""
        if self._take is None:
            return
        taken = ddspy_take(self._handle, _ANY, self._quality.depth)
        if isinstance(taken, int):
            return
        for raw, info in taken:
            if info.valid_data:
                self._take(raw, info)

    def say_mismatch(self) -> None:
        """Log new writers that offer less than this reader requests, and so do not match."""
        if not self._quality.alone:
            return
        entity: Any = self.entity
        status = entity.get_requested_incompatible_qos_status()
        if status is not None and status.total_count > self._reported:
            self._reported = status.total_count
            _log.warning(_MISMATCH, self.name, "writer", _policy(status.last_policy_id), "request")


_MISMATCH = "%s: a %s is not served: it does not match the %s that motord %ss"
_POLICIES = {
    2: "durability (volatile or transient local)",
    11: "reliability (best effort or reliable)",
    23: "encoding",
    24: "type",
}
"""Policies by their numbers (DDS-XTypes 1.3, 7.6.3)."""


def _policy(number: int) -> str:
    return _POLICIES.get(number, f"quality of service number {number}")


class Participant:
    """A participant of a domain. Create its endpoints before `run`."""

    def __init__(self, domain_id: int, discovery: Discovery, interface: str | None = None) -> None:
        """Join the domain. Raises DdsError."""
        try:
            if discovery == "localhost" or URI not in os.environ:
                _domain(domain_id, configuration(discovery, interface))
            self.entity = DomainParticipant(domain_id, Qos(Policy.Userdata(b"enclave=/;")))
        except DDSException as error:
            raise DdsError(f"no DDS participant in domain {domain_id}: {error.msg}") from error
        _mute_library()
        self.gid = self.entity.guid.bytes
        self.readers: list[Reader] = []
        self.writers: list[Writer] = []
        self._topics: dict[str, Topic[Any]] = {}
        self._read: dict[str, str] = {}
        self._written: dict[str, str] = {}
        """Types by topic, of the topics that are written; `_read` has those that are read."""
        self._services: dict[str, str] = {}
        """Names of services by their request topics."""
        self._mute: list[DataWriter[Any]] = []
        self.node_of: Callable[[bytes], str | None] = lambda _: None
        """Returns the name of an endpoint's node, or None."""
        self._guard = GuardCondition(self.entity)
        self._arrived = asyncio.Event()
        self._taken = threading.Event()
        self._ending = False
        self._broken: DDSException | None = None

    def writer(
        self, topic: str, kind: str, quality: Quality, user_data: str, service: str | None = None
    ) -> Writer:
        """Create a writer. `kind`: a type of `table.TYPES`. `service`: name of the service whose
        replies it writes. Raises DdsError."""
        entity = self._writer(topic, kind, quality, user_data, service)
        if service is None:
            self._written[topic] = kind
        self.writers.append(Writer(entity, topic))
        return self.writers[-1]

    def mute_writer(self, topic: str, kind: str, quality: Quality, user_data: str) -> None:
        """Create one more writer of a service's replies, which never writes. Raises DdsError."""
        self._mute.append(self._writer(topic, kind, quality, user_data, topic))

    def _writer(
        self, topic: str, kind: str, quality: Quality, user_data: str, service: str | None
    ) -> DataWriter[Any]:
        try:
            return DataWriter(
                self.entity, self._topic(topic, kind, service), _qos(quality, user_data)
            )
        except DDSException as error:
            raise DdsError(f"{topic}: {error.msg}") from error

    def reader(
        self,
        topic: str,
        kind: str,
        quality: Quality,
        user_data: str,
        take: Callable[[bytes, Any], None] | None,
        service: str | None = None,
    ) -> Reader:
        """Create a reader. `take` is called in the event loop for each sample, with DDS's
        information about it, and must not raise; None: the samples are taken elsewhere. `service`:
        name of the service whose requests it reads. Raises DdsError."""
        try:
            entity = DataReader(
                self.entity, self._topic(topic, kind, service), _qos(quality, user_data)
            )
        except DDSException as error:
            raise DdsError(f"{topic}: {error.msg}") from error
        if service is None:
            self._read[topic] = kind
        else:
            self._services[topic] = service
        self.readers.append(Reader(entity, topic, quality, take))
        return self.readers[-1]

    def _topic(self, name: str, kind: str, service: str | None) -> Topic[Any]:
        if name not in self._topics:
            made = cyclone_type(kind, service=service is not None)
            self._topics[name] = Topic(self.entity, name, made)
        return self._topics[name]

    async def run(self) -> None:
        """Deliver what arrives, until cancelled. Raises DdsError when the library fails."""
        loop = asyncio.get_running_loop()
        self._ending, self._broken = False, None
        self._guard.set(False)
        waiting = threading.Thread(target=self._wait, args=(loop,), name="dds", daemon=True)
        waiting.start()
        try:
            async with TaskGroup() as tasks:
                tasks.create_task(self._deliver())
                tasks.create_task(self._say_mismatches())
        finally:
            self._ending = True
            self._guard.set(True)
            self._taken.set()
            await asyncio.to_thread(waiting.join, _JOIN_WITHIN_S)

    async def _deliver(self) -> None:
        while True:
            await self._arrived.wait()
            self._arrived.clear()
            if self._broken is not None:
                raise DdsError(f"waiting for DDS failed: {self._broken.msg}")
            for reader in self.readers:
                reader.deliver()
            self._taken.set()

    async def _say_mismatches(self) -> None:
        endpoints: tuple[Reader | Writer, ...] = (*self.readers, *self.writers)
        discovered = Discovered(self.entity, self._services, self.node_of)
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            for endpoint in endpoints:
                endpoint.say_mismatch()
                await asyncio.sleep(0)
            await discovered.look(self._read, self._written)

    def _wait(self, loop: asyncio.AbstractEventLoop) -> None:
        """Wake the event loop when samples arrive, and wait until they are taken before waking it
        again. Runs in a thread of its own."""
        waitset = WaitSet(self.entity)
        waitset.attach(self._guard)
        for reader in self.readers:
            if not reader.elsewhere:
                waitset.attach(reader.condition)
        while not self._ending:
            try:
                arrived = waitset.wait(duration(seconds=_LOOK_EVERY_S)) > 0
            except DDSException as error:
                self._broken = error
                loop.call_soon_threadsafe(self._arrived.set)
                return
            if arrived and not self._ending:
                self._taken.clear()
                loop.call_soon_threadsafe(self._arrived.set)
                self._taken.wait(_LOOK_EVERY_S)
