# SPDX-License-Identifier: Apache-2.0
"""The datagram sockets for commands from other programs, which the loop itself reads.

A robot has them only if its file has an `[input.*]` of kind "rt", or one of the second process."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from motord.api.page_file import own_page
from motord.api.stop_request import page_link, stop_socket
from motord.config import BusInput, Robot, RtInput
from motord.realtime.loop import LEASES_MAX

SOCKET_MODE = 0o660
LOOPBACK = "127.0.0.1"


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandSockets:
    """Sockets for commands, and what they may request. `fds` stay open as long as the daemon
    runs."""

    section: RtInput | None = None
    """What a client that may command may request; None: there is no such section."""
    inputs: Mapping[str, BusInput] = field(default_factory=dict)
    """What the second process may request, by the names of its inputs."""
    paths: tuple[Path, ...] = ()
    """One for each lease: a source that floods its own socket blocks no other source."""
    udp_port: int | None = None
    fds: tuple[int, ...] = ()


def section_of(robot: Robot) -> RtInput | None:
    """Return the robot file's section for commands as datagrams; None: it has no such section."""
    return next((found for found in robot.input.values() if isinstance(found, RtInput)), None)


def inputs_of(robot: Robot) -> dict[str, BusInput]:
    """Return the inputs of the second process, by name."""
    return {name: found for name, found in robot.input.items() if isinstance(found, BusInput)}


@contextlib.contextmanager
def open_stop_socket(robot: Robot, beside: Path) -> Iterator[int]:
    """Open the socket on which the loop receives stop requests, and make a link to the state page,
    which confirms them: NAME.stop.sock and NAME.page for a local socket NAME.sock. Raises
    OSError."""
    path, link = stop_socket(beside), page_link(beside)
    with contextlib.ExitStack() as cleanup:
        fd = _local(path, cleanup, credentials=True)
        link.unlink(missing_ok=True)
        link.symlink_to(own_page(robot.robot.name))
        cleanup.callback(link.unlink, missing_ok=True)
        yield fd


@contextlib.contextmanager
def open_command_sockets(robot: Robot, beside: Path) -> Iterator[CommandSockets]:
    """Open the sockets of this robot: NAME.cmd.N.sock beside its local socket, which belongs to
    this daemon alone, and UDP on loopback if a port is given. Raises OSError with the path or
    address."""
    section, inputs = section_of(robot), inputs_of(robot)
    if section is None and not inputs:
        yield CommandSockets()
        return
    name = robot.robot.name
    paths = tuple(beside.with_name(f"{name}.cmd.{number}.sock") for number in range(LEASES_MAX))
    with contextlib.ExitStack() as sockets:
        fds = [_local(path, sockets) for path in paths]
        udp_port = section.udp_port if section else None
        if udp_port is not None:
            udp = sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            _bind(udp, (LOOPBACK, udp_port), f"UDP {LOOPBACK}:{udp_port}")
            os.set_blocking(udp.fileno(), False)
            fds.append(udp.fileno())
        yield CommandSockets(
            section=section, inputs=inputs, paths=paths, udp_port=udp_port, fds=tuple(fds)
        )


def _local(path: Path, sockets: contextlib.ExitStack, *, credentials: bool = False) -> int:
    kind = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK
    opened = sockets.enter_context(socket.socket(socket.AF_UNIX, kind))
    if credentials:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
    path.unlink(missing_ok=True)  # the socket beside it belongs to this daemon, so this is ours
    # The file is made with this mode: a client that connects before the chmod could go on sending
    # after it.
    os.fchmod(opened.fileno(), SOCKET_MODE)
    _bind(opened, str(path), str(path))
    sockets.callback(path.unlink, missing_ok=True)
    path.chmod(SOCKET_MODE)
    return opened.fileno()


def _bind(opened: socket.socket, address: object, address_text: str) -> None:
    try:
        opened.bind(address)  # type: ignore[arg-type]  # a path or a pair, by the family
    except OSError as error:
        raise OSError(
            error.errno or errno.ENAMETOOLONG,  # Python has no number for it
            f"commands cannot come in: {error.strerror or error}",
            address_text,
        ) from error
