# SPDX-License-Identifier: Apache-2.0
"""Publishes each snapshot as one datagram of JSON. It does not check whether a program listens."""

from __future__ import annotations

import asyncio
import logging
import socket

from motord.api.deadline import within
from motord.bus.publish.snapshot_feed import SnapshotFeed
from motord.config import UdpPublish

RESOLVE_WITHIN_S = 5.0
RESOLVE_AGAIN_S = 5.0

Address = tuple[str, int] | tuple[str, int, int, int] | tuple[int, bytes]
"""Address of IPv4 or IPv6; the last form occurs only in the declared type of getaddrinfo."""

_log = logging.getLogger(__name__)


class UdpPublisher:
    def __init__(self, name: str, section: UdpPublish) -> None:
        self._name = name
        self._host, self._port = section.host, section.port
        self._failing = False
        self.sent = 0
        self.dropped = 0
        """Datagrams that the network stack did not take."""

    async def run(self, feed: SnapshotFeed) -> None:
        """Implement `Publisher.run`."""
        sender, address = await self._opened()
        with sender:
            async for datagram in feed:
                self._send(sender, datagram, address)

    async def _opened(self) -> tuple[socket.socket, Address]:
        """Return a socket and the host's address. Try again and again, and log only the first
        failure."""
        loop = asyncio.get_running_loop()
        while True:
            try:
                async with within(RESOLVE_WITHIN_S):
                    found = await loop.getaddrinfo(
                        self._host, self._port, type=socket.SOCK_DGRAM, proto=socket.IPPROTO_UDP
                    )
            except (OSError, TimeoutError, ValueError) as error:  # ValueError: not a valid name
                self._say(f"{self._host} has no address: {str(error) or 'no answer'}")
            else:
                family, _, _, _, address = found[0]
                try:
                    return socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK), address
                except OSError as error:  # IPv6 without its driver, or out of descriptors
                    self._say(f"no socket for {address[0]}: {error.strerror}")
            await asyncio.sleep(RESOLVE_AGAIN_S)

    def _send(self, sender: socket.socket, datagram: bytes, address: Address) -> None:
        try:
            sender.sendto(datagram, address)
        except OSError as error:
            self.dropped += 1
            self._say(f"{self._host}:{self._port}: {error.strerror}")
            return
        self.sent += 1
        if self._failing:
            self._failing = False
            _log.info("publish.%s: goes on; %d snapshots were lost", self._name, self.dropped)

    def _say(self, text: str) -> None:
        if not self._failing:
            self._failing = True
            _log.warning("publish.%s: %s", self._name, text)
