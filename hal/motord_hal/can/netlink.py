# SPDX-License-Identifier: Apache-2.0
"""Restarting a CAN controller that has gone bus-off, by rtnetlink (linux/can/netlink.h): what
`ip link set can0 type can restart` does. Needs CAP_NET_ADMIN."""

from __future__ import annotations

import os
import socket
import struct

_RTM_NEWLINK = 16
_NLM_F_REQUEST, _NLM_F_ACK = 0x1, 0x4
_NLMSG_ERROR = 2
_IFLA_LINKINFO, _IFLA_INFO_KIND, _IFLA_INFO_DATA = 18, 1, 2
_IFLA_CAN_RESTART = 7
_HEADER = struct.Struct("=IHHII")
"""struct nlmsghdr: length, type, flags, sequence, port."""
_INTERFACE = struct.Struct("=BxHiII")
"""struct ifinfomsg: family, type, index, flags, change."""
_ERROR = struct.Struct("=i")
ANSWER_WITHIN_S = 0.5


def restart_request(index: int, sequence: int) -> bytes:
    """The message for the interface with this index."""
    data = _attribute(_IFLA_CAN_RESTART, struct.pack("=I", 1))
    info = _attribute(_IFLA_INFO_KIND, b"can\x00") + _attribute(_IFLA_INFO_DATA, data)
    body = _INTERFACE.pack(socket.AF_UNSPEC, 0, index, 0, 0) + _attribute(_IFLA_LINKINFO, info)
    flags = _NLM_F_REQUEST | _NLM_F_ACK
    return _HEADER.pack(_HEADER.size + len(body), _RTM_NEWLINK, flags, sequence, 0) + body


def _attribute(kind: int, payload: bytes) -> bytes:
    """Length, type and payload, padded to four bytes (struct rtattr)."""
    size = 4 + len(payload)
    return struct.pack("=HH", size, kind) + payload + bytes(-size % 4)


def answer_error(answer: bytes) -> int:
    """The error number of an acknowledgement; 0: it was done. ValueError: it is none."""
    if len(answer) < _HEADER.size + _ERROR.size:
        raise ValueError(f"{len(answer)} bytes are no acknowledgement")
    _, kind, _, _, _ = _HEADER.unpack_from(answer)
    if kind != _NLMSG_ERROR:
        raise ValueError(f"message {kind} is no acknowledgement")
    (code,) = _ERROR.unpack_from(answer, _HEADER.size)
    return -int(code)


def restart(interface: str) -> None:
    """Raises OSError: not permitted (EPERM), not bus-off (EINVAL, EBUSY), no such interface. Waits
    at most ANSWER_WITHIN_S."""
    index = socket.if_nametoindex(interface)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as link:
        link.settimeout(ANSWER_WITHIN_S)
        link.send(restart_request(index, 1))
        try:
            code = answer_error(link.recv(4096))
        except ValueError as error:
            raise OSError(0, str(error), interface) from error
    if code:
        raise OSError(code, os.strerror(code), interface)
