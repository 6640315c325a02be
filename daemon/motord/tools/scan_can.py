# SPDX-License-Identifier: Apache-2.0
"""Finds the drives on a CAN bus. The scan listens first. If it recognises no drive by its own
frames, it sends reads, protocol by protocol. On a CAN bus whose protocol is known it sends requests
of that protocol only, because the same identifier may be a command in another protocol.
"""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import can

from motord.config.drives.load import list_profiles, load_profile
from motord.tools.scan import Found, Match
from motord_hal.base.errors import PortError, ProfileError
from motord_hal.can.address import bus_arguments, split_address
from motord_hal.can.interface import exists, missing
from motord_hal.can.unix_client import UnixClient

LISTEN_S = 2.2
"""Time to listen for two heartbeats. The default is ten a second, with CANopen often one."""
HEARTBEATS_LEAST = 2
ANSWERS_WITHIN_S = 0.1
"""Time to wait for answers after the last request; drives take a few milliseconds."""
BETWEEN_S = 0.001
"""Time between two requests: a CAN bus of 125 kbit/s carries them, and their answers."""
CIA402_PROFILE = 402
"""Number of the device profile CiA 402, in the low half of object 1000h (CiA 301, 7.5.2.1)."""
ODRIVE_STATES = range(15)
"""Values of AxisState: 0 (undefined) to 14 (anticogging calibration)."""


@dataclass(frozen=True, slots=True)
class Node:
    """A node with its protocol. `about` describes how it was recognised; `profiles` are the names
    of the profiles that may fit."""

    protocol: str
    node: int
    about: str
    profiles: tuple[str, ...]


class Sends(Protocol):
    """The interface of a python-can bus that the scan uses."""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame. Raise can.CanError or OSError if that fails."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame; None: none came within `timeout`."""


@dataclass(slots=True)
class Received:
    """The nodes recognised so far: (protocol, node number) → node."""

    nodes: dict[tuple[str, int], Node] = field(default_factory=dict)
    heartbeats: Counter[int] = field(default_factory=Counter)
    """Number of heartbeats of each node that may be an ODrive. One frame is not enough, because it
    may be an answer of any protocol."""
    frames: int = 0

    def add(self, message: can.Message) -> None:
        """Take a frame that a drive may have sent."""
        if message.is_error_frame or message.is_remote_frame:
            return
        self.frames += 1
        for recognise in (_canopen, _vesc, _rmd, _moteus):
            if (node := recognise(message)) is not None:
                self._put(node)
                return
        # an identifier of CANopen can be equal to one of an ODrive
        canopen = {number for protocol, number in self.nodes if protocol == "CANopen"}
        if message.arbitration_id & 0x7F not in canopen and (node := _odrive(message)):
            self.heartbeats[node.node] += 1
            if self.heartbeats[node.node] >= HEARTBEATS_LEAST:
                self._put(node)

    def _put(self, node: Node) -> None:
        before = self.nodes.get((node.protocol, node.node))
        if before is None or len(node.profiles) <= len(before.profiles):
            self.nodes[node.protocol, node.node] = node
        if node.protocol == "CANopen":  # before its heartbeat it may have counted as an ODrive
            for key in [k for k in self.nodes if k[0] == "ODrive"]:
                if (key[1] << 5 | 1) & 0x7F == node.node:
                    del self.nodes[key]

    @property
    def protocols(self) -> set[str]:
        """The protocols of the nodes."""
        return {protocol for protocol, _ in self.nodes}


# -------------------------------------------------------------------------- recognition of nodes
def _standard(message: can.Message, low: int, high: int) -> bool:
    return not message.is_extended_id and low < message.arbitration_id <= high


def _canopen(message: can.Message) -> Node | None:
    """Recognise a CANopen node by its heartbeat or boot-up (CiA 301, 7.2.8.3.2), or by its answer
    to a read of object 1000h."""
    data, identifier = bytes(message.data), message.arbitration_id
    if _standard(message, 0x700, 0x77F) and len(data) == 1 and data[0] & 0x7F in (0, 4, 5, 0x7F):
        return Node("CANopen", identifier & 0x7F, "heartbeat", _CIA402_PROFILES)
    upload = _standard(message, 0x580, 0x5FF) and data[1:4] == b"\x00\x10\x00"
    if upload and len(data) == 8 and data[0] & 0xE0 == 0x40:
        number = int.from_bytes(data[4:6], "little")
        fitting = _CIA402_PROFILES if number == CIA402_PROFILE else ()
        return Node("CANopen", identifier & 0x7F, f"device profile {number}", fitting)
    return None


def _odrive(message: can.Message) -> Node | None:
    """Recognise a frame that may be an ODrive's heartbeat, by the axis state in it."""
    data, identifier = bytes(message.data), message.arbitration_id
    if message.is_extended_id or len(data) != 8:
        return None
    if identifier & 0x1F == 1 and data[4] in ODRIVE_STATES:
        return Node("ODrive", identifier >> 5, "heartbeat", ("odrive-0.6", "odrive-0.5"))
    return None


def odrive_version(message: can.Message) -> Node | None:
    """Recognise an ODrive by its answer to a request of its version (CAN Protocol 0.6,
    Get_Version)."""
    data, identifier = bytes(message.data), message.arbitration_id
    if message.is_extended_id or len(data) != 8 or identifier & 0x1F or message.is_remote_frame:
        return None
    return Node("ODrive", identifier >> 5, f"firmware {data[4]}.{data[5]}.{data[6]}",
                ("odrive-0.6",))  # fmt: skip


def _vesc(message: can.Message) -> Node | None:
    """Recognise a VESC by its status messages 1 to 5, which carry the sender, or by its answer PONG
    (vedderb/bldc, comm_can.md)."""
    command = message.arbitration_id >> 8
    if not message.is_extended_id or message.is_fd:
        return None
    if command in (9, 14, 15, 16, 27):
        return Node("VESC", message.arbitration_id & 0xFF, "status", ("vesc", "vesc-duty"))
    if command == 18 and message.data:
        return Node("VESC", message.data[0], "answers a ping", ("vesc", "vesc-duty"))
    return None


def _rmd(message: can.Message) -> Node | None:
    """Recognise an RMD by its reply to command 9Ah, status 1 (MyActuator, Motor Motion Protocol
    V4.2, 2.14)."""
    if _standard(message, 0x240, 0x260) and len(message.data) == 8 and message.data[0] == 0x9A:
        return Node("RMD", message.arbitration_id - 0x240, "answers a read", ("rmd",))
    return None


def _moteus(message: can.Message) -> Node | None:
    """Recognise a moteus by its reply to a read of register 0, the mode (mjbots/moteus,
    docs/protocol/can.md)."""
    if message.is_fd and bytes(message.data[:2]) == b"\x21\x00":
        return Node("moteus", message.arbitration_id >> 8 & 0x7F, "answers a read", ("moteus",))
    return None


_CIA402_PROFILES = ("cia402", "cia402-csv", "cia402-torque")


# -------------------------------------------------------------------------------------- requests
def requests(protocol: str) -> Iterator[can.Message]:
    """Yield a read for each node that the protocol can have."""
    if protocol == "CANopen":  # SDO upload of object 1000h: CiA 301, 7.2.4.3
        for node in range(1, 128):
            yield _message(0x600 + node, b"\x40\x00\x10\x00\x00\x00\x00\x00")
    elif protocol == "VESC":  # CAN_PACKET_PING, 17; the answer goes to node 254
        for node in range(254):
            yield _message(17 << 8 | node, b"\xfe", extended=True)
    elif protocol == "RMD":
        for node in range(1, 33):
            yield _message(0x140 + node, b"\x9a" + bytes(7))
    elif protocol == "moteus":  # bit 15: a reply is wanted; 0x11: read one register as int8
        for node in range(1, 128):
            yield _message(0x8000 | node, b"\x11\x00", extended=True, fd=True)


def _message(
    identifier: int, data: bytes, *, extended: bool = False, fd: bool = False
) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=extended, is_fd=fd,
                       bitrate_switch=fd)  # fmt: skip


PROTOCOLS = ("CANopen", "VESC", "RMD", "moteus")
"""Protocols whose requests the scan sends, in this order. An ODrive sends heartbeats by itself."""


# ----------------------------------------------------------------------------------------- the scan
def scan_can(
    address: str,
    bitrate: int,
    data_bitrate: int | None,
    say: Callable[[str], None],
    ended: Callable[[], bool] = lambda: False,
) -> list[Found]:
    """Scan a CAN bus; return the nodes found, by protocol and number. Raise PortError if the bus
    cannot be opened or read."""
    with _opened(address, bitrate, data_bitrate) as bus:
        return Scan(bus, say, ended, fd=data_bitrate is not None).found(bitrate)


@contextlib.contextmanager
def _opened(address: str, bitrate: int, data_bitrate: int | None) -> Iterator[can.BusABC]:
    interface, channel = split_address(address)
    try:
        if interface == "unix":
            bus: can.BusABC = UnixClient(channel)
        else:
            bus = can.Bus(**bus_arguments(address, bitrate, data_bitrate))
    except (can.CanError, OSError, ValueError, ImportError) as error:
        if interface == "socketcan" and not exists(channel):
            raise PortError(f"{address}: {missing(channel)}") from error
        up = f": ip link set {channel} up type can bitrate {bitrate}"
        cure = up if interface == "socketcan" else ""
        raise PortError(f"{address}: {error}{cure}") from error
    try:
        yield bus
    finally:
        bus.shutdown()


class Scan:
    """A scan of an open CAN bus."""

    def __init__(
        self, bus: Sends, say: Callable[[str], None], ended: Callable[[], bool], *, fd: bool
    ) -> None:
        self._bus, self._say, self._ended, self._fd = bus, say, ended, fd
        self.received = Received()

    def found(self, bitrate: int) -> list[Found]:
        """Run the scan; return the nodes found. Raise PortError if the bus cannot be read."""
        self._say(f"listening for {LISTEN_S:g} s")
        self._take(LISTEN_S)
        if not self.received.nodes and self.received.frames:
            self._say(f"{self.received.frames} frames came, of no protocol that the scan knows")
        else:
            self._ask()
        nodes = [self.received.nodes[key] for key in sorted(self.received.nodes)]
        known = _known_profiles()
        return [
            Found(
                unit=one.node, baudrate=bitrate, parity="none", kind="can",
                answer=f"{one.protocol}, {one.about}",
                matches=tuple(Match(name, 1, 1) for name in one.profiles if name in known),
            )
            for one in nodes
        ]  # fmt: skip

    def _ask(self) -> None:
        if "ODrive" in self.received.protocols:
            self._ask_odrives()
            return
        received = [one for one in PROTOCOLS if one in self.received.protocols]
        for protocol in received or PROTOCOLS:
            if protocol == "moteus" and not self._fd:
                self._say("moteus is not asked: the interface was not opened with CAN FD")
                continue
            self._say(f"asking for {protocol}: reads only")
            for message in requests(protocol):
                if self._ended():
                    return
                self._put(message)
                self._take(BETWEEN_S)
            self._take(ANSWERS_WITHIN_S)
            if self.received.nodes:
                return

    def _ask_odrives(self) -> None:
        """Request the version of each ODrive: firmware 0.6 answers, 0.5 has no such request."""
        for node in [node for protocol, node in self.received.nodes if protocol == "ODrive"]:
            self._say(f"asking ODrive {node} for its version")
            self._put(can.Message(arbitration_id=node << 5, is_extended_id=False,
                                  is_remote_frame=True, dlc=8))  # fmt: skip
            answers = [odrive_version(message) for message in self._frames(ANSWERS_WITHIN_S)]
            old = Node("ODrive", node, "heartbeat, no version", ("odrive-0.5", "odrive-0.6"))
            found = (one for one in answers if one is not None and one.node == node)
            self.received.nodes["ODrive", node] = next(found, old)

    def _put(self, message: can.Message) -> None:
        # without a node that acknowledges, the queue becomes full: then there are no answers
        with contextlib.suppress(can.CanError, OSError):
            self._bus.send(message, timeout=0)

    def _take(self, seconds: float) -> None:
        for message in self._frames(seconds):
            self.received.add(message)

    def _frames(self, seconds: float) -> Iterator[can.Message]:
        end_s = time.monotonic() + seconds
        while not self._ended():
            left_s = end_s - time.monotonic()
            try:
                message = self._bus.recv(timeout=min(max(left_s, 0.0), 0.05))
            except (can.CanError, OSError, ValueError) as error:
                raise PortError(f"the CAN bus cannot be read: {error}") from error
            if message is not None:
                yield message
            elif left_s <= 0.0:
                return


def _known_profiles() -> Sequence[str]:
    known = []
    for name, path in list_profiles().items():
        with contextlib.suppress(ProfileError):  # `motord drives` shows the error in it
            load_profile(path)
            known.append(name)
    return known
