# SPDX-License-Identifier: Apache-2.0
"""State, bit rate and restart of a CAN controller, by rtnetlink (linux/can/netlink.h). The restart
is that of `ip link set can0 type can restart` and needs CAP_NET_ADMIN."""

from __future__ import annotations

import os
import socket
import struct
import sys

_RTM_NEWLINK, _RTM_GETLINK = 16, 18
_NLM_F_REQUEST, _NLM_F_ACK = 0x1, 0x4
_NLMSG_ERROR = 2
_IFLA_LINKINFO, _IFLA_INFO_KIND, _IFLA_INFO_DATA = 18, 1, 2
_IFLA_CAN_BITTIMING, _IFLA_CAN_STATE, _IFLA_CAN_RESTART = 1, 4, 7
_TYPE_MASK = 0x3FFF
"""NLA_TYPE_MASK of linux/netlink.h: a type without the marks for nested and big-endian."""
BUS_OFF = 3
"""State of a controller that is bus-off: linux/can/netlink.h, enum can_state."""
_HEADER = struct.Struct("=IHHII")
"""struct nlmsghdr: length, type, flags, sequence, port."""
_INTERFACE = struct.Struct("=BxHiII")
"""struct ifinfomsg: family, type, index, flags, change."""
_ERROR = struct.Struct("=i")
ANSWER_WITHIN_S = 0.5
_ANSWER_BYTES = 16384


def restart_request(index: int, sequence: int) -> bytes:
    """Return the message that restarts the controller of the interface with this index."""
    data = _attribute(_IFLA_CAN_RESTART, struct.pack("=I", 1))
    info = _attribute(_IFLA_INFO_KIND, b"can\x00") + _attribute(_IFLA_INFO_DATA, data)
    body = _INTERFACE.pack(socket.AF_UNSPEC, 0, index, 0, 0) + _attribute(_IFLA_LINKINFO, info)
    flags = _NLM_F_REQUEST | _NLM_F_ACK
    return _HEADER.pack(_HEADER.size + len(body), _RTM_NEWLINK, flags, sequence, 0) + body


def _attribute(kind: int, payload: bytes) -> bytes:
    """Return an attribute (struct rtattr): length, type and payload, padded to four bytes."""
    size = 4 + len(payload)
    return struct.pack("=HH", size, kind) + payload + bytes(-size % 4)


def answer_error(answer: bytes) -> int:
    """Return the error number of an acknowledgement; 0: success. Raises ValueError for another
    answer."""
    if len(answer) < _HEADER.size + _ERROR.size:
        raise ValueError(f"{len(answer)} bytes are no acknowledgement")
    _, kind, _, _, _ = _HEADER.unpack_from(answer)
    if kind != _NLMSG_ERROR:
        raise ValueError(f"message {kind} is no acknowledgement")
    (code,) = _ERROR.unpack_from(answer, _HEADER.size)
    return -int(code)


def state_request(index: int, sequence: int) -> bytes:
    """Return the message that requests all attributes of the interface with this index."""
    body = _INTERFACE.pack(socket.AF_UNSPEC, 0, index, 0, 0)
    return _HEADER.pack(_HEADER.size + len(body), _RTM_GETLINK, _NLM_F_REQUEST, sequence, 0) + body


def state_in(answer: bytes) -> int | None:
    """Return the controller's state in the answer; None: the interface has no controller. Raises
    ValueError for another answer."""
    data = _data_in(answer)
    state = data.get(_IFLA_CAN_STATE, b"") if data is not None else b""
    return int.from_bytes(state, sys.byteorder) if len(state) == 4 else None


def _data_in(answer: bytes) -> dict[int, bytes] | None:
    """Return what a CAN interface reports of its controller; None: it is no CAN interface. Raises
    ValueError for another answer."""
    if len(answer) < _HEADER.size + _INTERFACE.size:
        raise ValueError(f"{len(answer)} bytes are no interface")
    size, kind, _, _, _ = _HEADER.unpack_from(answer)
    if kind != _RTM_NEWLINK:
        raise ValueError(f"message {kind} is no interface")
    link = _attributes(answer[_HEADER.size + _INTERFACE.size : size])
    info = _attributes(link.get(_IFLA_LINKINFO, b""))
    is_can = info.get(_IFLA_INFO_KIND, b"").rstrip(b"\x00") == b"can"
    return _attributes(info.get(_IFLA_INFO_DATA, b"")) if is_can else None


def _attributes(data: bytes) -> dict[int, bytes]:
    """Return the attributes by type, without one that is cut off."""
    found = {}
    while len(data) >= 4:
        size, kind = struct.unpack_from("=HH", data)
        if not 4 <= size <= len(data):
            break
        found[kind & _TYPE_MASK] = data[4:size]
        data = data[size + (-size % 4) :]
    return found


def _ask(message: bytes) -> bytes:
    """Send a message and return the answer. Waits at most ANSWER_WITHIN_S. Raises OSError."""
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as link:
        link.settimeout(ANSWER_WITHIN_S)
        link.send(message)
        return link.recv(_ANSWER_BYTES)


def restart(interface: str) -> None:
    """Restart the controller. Waits at most ANSWER_WITHIN_S. Raises OSError: not permitted (EPERM),
    not bus-off (EINVAL, EBUSY), no such interface."""
    answer = _ask(restart_request(socket.if_nametoindex(interface), 1))
    try:
        code = answer_error(answer)
    except ValueError as error:
        raise OSError(0, str(error), interface) from error
    if code:
        raise OSError(code, os.strerror(code), interface)


def can_state(interface: str) -> int | None:
    """Return the state of the interface's controller (see BUS_OFF); None: the interface has no
    controller. Waits at most ANSWER_WITHIN_S. Raises OSError: no such interface."""
    answer = _ask(state_request(socket.if_nametoindex(interface), 1))
    try:
        return state_in(answer)
    except ValueError as error:
        raise OSError(0, str(error), interface) from error


def bit_rate_in(answer: bytes) -> int | None:
    """Return the bit rate in an answer to `state_request`; None: a virtual CAN bus, or no rate is
    set. Raises ValueError for another answer. Source: struct can_bittiming of
    linux/can/netlink.h."""
    data = _data_in(answer)
    timing = data.get(_IFLA_CAN_BITTIMING, b"") if data is not None else b""
    return (int.from_bytes(timing[:4], sys.byteorder) or None) if len(timing) >= 4 else None


def bit_rate(interface: str) -> int | None:
    """Return the interface's bit rate, as `bit_rate_in` does. Waits at most ANSWER_WITHIN_S. Raises
    OSError: no such interface."""
    answer = _ask(state_request(socket.if_nametoindex(interface), 1))
    try:
        return bit_rate_in(answer)
    except ValueError as error:
        raise OSError(0, str(error), interface) from error
