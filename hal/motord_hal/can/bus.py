# SPDX-License-Identifier: Apache-2.0
"""A CAN bus on asyncio, through any adapter that python-can reaches.

Received frames are handed on in the event loop: by the adapter's file descriptor if there is one,
else from a reader thread with a bounded queue. Sending never waits.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from typing import Any

import can

from motord_hal.base.clock import now_ns, now_s, within
from motord_hal.base.errors import PortError
from motord_hal.can.address import bus_arguments, split_address
from motord_hal.can.errors import BusTrouble, BusWarnings, error_words
from motord_hal.can.interface import BUS_OFF_TEXT, BusOffWatch, make_ready
from motord_hal.can.plan import Sent
from motord_hal.can.socket_frames import packed
from motord_hal.can.unix_client import UnixClient
from motord_hal.fieldbus.trace import PythonTrace

OPEN_WITHIN_S = 5.0
"""Time limit for opening. Serial and USB adapters take a while."""
READ_AT_ONCE = 64
"""Number of frames that are taken in before the event loop runs again."""
QUEUE_FRAMES = 1024
"""Size of the reader thread's queue, which loses the oldest frames first; also the greatest number
of frames that `catch_up` takes in."""
THREAD_LOOKS_S = 0.05
AGE_MAX_S = 1.0
"""Greatest age of a frame by its stamp. If it would be older, the frame counts as new: a wrong
stamp is more likely than an event loop that is so late."""
BAD_FRAMES_MAX = 100
"""Number of failed reads in a row after which the bus is at fault, not single frames."""
_UNREADABLE = (can.CanError, OSError, ValueError)
"""Errors of a failed read. A driver that reads text (slcan) raises ValueError for bad frames."""
_FULL = (errno.ENOBUFS, errno.EAGAIN, errno.ETIMEDOUT)

Taker = Callable[[can.Message, int], None]
"""Function that gets a frame and its arrival time in nanoseconds of CLOCK_MONOTONIC."""
_log = logging.getLogger(__name__)


class CanBus:
    """One CAN bus. `errors` counts errors by kind. The owner has to close it once `trouble` is
    set."""

    def __init__(
        self,
        address: str,
        bitrate: int,
        data_bitrate: int | None,
        identifiers: Iterable[tuple[int, bool]],
        take: Taker,
        warn: Callable[[str], None] = _log.warning,
        own: Iterable[tuple[int, bool]] = (),
    ) -> None:
        """Set the bus up. `own` are identifiers of motord's own frames that are to be taken in when
        they have left; this works only if `receives_own`."""
        self.address = address
        self.errors: Counter[str] = Counter()
        self.trouble: PortError | None = None
        self.trace = PythonTrace()
        self._arguments = bus_arguments(address, bitrate, data_bitrate)
        if receives_own(address):  # filters: elsewhere they are no cheaper than a look-up
            self._arguments["can_filters"] = [_filter(*one) for one in (*identifiers, *own)]
            self._arguments["receive_own_messages"] = bool(own)
        self._take = take
        self._warn = warn
        self._warnings = BusWarnings()
        self._bus: can.BusABC | None = None
        self._fd: int | None = None
        self._reader: _ReaderThread | None = None
        self._bad_in_a_row = 0
        self._fd_frames = data_bitrate is not None
        self._bus_off = BusOffWatch(address)
        self._emptied_ns = 0
        """Time of the newest look that found nothing to read. Frames that are read now came
        later."""

    # ------------------------------------------------------------------------------------- opening
    async def open(self) -> None:
        """Open the adapter. The event loop continues, whatever the adapter does. Raises
        PortError."""
        await make_ready(self.address, self.errors, fd_frames=self._fd_frames)
        opening = asyncio.get_running_loop().run_in_executor(None, self._open)
        try:
            async with within(OPEN_WITHIN_S):
                self._bus = await asyncio.shield(opening)
        except TimeoutError:
            raise PortError(f"{self.address}: not open after {OPEN_WITHIN_S:g} s") from None
        finally:
            if self._bus is None:
                opening.add_done_callback(_shut_late)
        self.trouble = None
        self._bad_in_a_row = 0
        self._listen(self._bus)

    def _open(self) -> can.BusABC:
        interface, channel = split_address(self.address)
        try:
            return UnixClient(channel) if interface == "unix" else can.Bus(**self._arguments)
        except (can.CanError, OSError, ValueError, ImportError) as error:
            raise PortError(f"{self.address}: {error}") from error

    def _listen(self, bus: can.BusABC) -> None:
        self._emptied_ns = now_ns()
        try:
            self._fd = bus.fileno()
        except RuntimeError:  # python-can: the adapter has none
            self._fd = None
        if self._fd is not None and self._fd >= 0:
            asyncio.get_running_loop().add_reader(self._fd, self._readable)
        else:
            self._fd = None
            self._reader = _ReaderThread(bus, self._take_in, self._fail)

    def close(self) -> None:
        """Close the CAN bus; does nothing if it is closed."""
        bus, self._bus = self._bus, None
        if bus is None:
            return
        if self._fd is not None:
            asyncio.get_running_loop().remove_reader(self._fd)
            self._fd = None
        if self._reader is not None:
            self._reader.stop()  # which closes the CAN bus when it ends
            self._reader = None
        else:
            _shut(bus)

    # ----------------------------------------------------------------------------------- receiving
    def _readable(self) -> None:
        self._read(READ_AT_ONCE)

    def _read(self, frames_max: int) -> None:
        for _ in range(frames_max):
            if self._bus is None or self.trouble is not None:
                return
            looked_ns = now_ns()
            try:
                message = self._bus.recv(timeout=0)
            except _UNREADABLE as error:
                self._fail(error)
                return
            if message is None:
                self._emptied_ns = looked_ns
                return
            self._take_in(message, came_ns(message, self._emptied_ns))

    def _take_in(self, message: can.Message, stamp_ns: int) -> None:
        self._bad_in_a_row = 0
        if self.trace.on:
            self.trace.put(stamp_ns, packed(message), outward=False)
        if message.is_error_frame:
            self._note(message)
        elif self._bus is not None:
            self._take(message, stamp_ns)

    def _note(self, message: can.Message) -> None:
        kinds, trouble = error_words(message.arbitration_id, bytes(message.data))
        self.errors.update(kinds)
        for warning in self._warnings.new(kinds, now_s()):
            self._warn(f"{self.address}: {warning}")
        if trouble is BusTrouble.BUS_OFF:
            self.trouble = PortError(f"{self.address}: {BUS_OFF_TEXT}")

    def _fail(self, error: Exception) -> None:
        """Count a failed read or write; set `trouble` if the CAN bus is at fault, not one frame."""
        number = _errno_of(error)
        self._bad_in_a_row += 1
        if number is None and self._bad_in_a_row <= BAD_FRAMES_MAX:
            self.errors["bad_frame"] += 1
            return
        if self.trouble is None:
            self.errors["port"] += 1
            words = errno.errorcode.get(number or 0, "")
            self.trouble = PortError(f"{self.address}: {error}{f' ({words})' if words else ''}")

    def catch_up(self) -> None:
        """Take in received frames, in case the event loop is late. Check for bus-off, too: the
        error frame that reports it may have been lost."""
        if self._fd is not None:
            self._read(QUEUE_FRAMES)
        elif self._reader is not None:
            self._reader.drain()
        if self.trouble is None and self._bus_off.is_off():
            self.errors["bus_off"] += 1
            self.trouble = PortError(f"{self.address}: {BUS_OFF_TEXT}")

    # ------------------------------------------------------------------------------------- sending
    def send(self, sent: Sent) -> bool:
        """Send a frame. Return False if the queue to the CAN bus is full: the frame is lost and
        counted, and the next one will be newer. Raises PortError."""
        self.check()
        assert self._bus is not None  # check
        message = _message(sent)
        try:
            self._bus.send(message, timeout=0)
        except can.CanTimeoutError:
            self.errors["tx_full"] += 1
            return False
        except (can.CanError, OSError) as error:
            if _errno_of(error) in (None, *_FULL):
                self.errors["tx_full"] += 1
                return False
            self._fail(error)
            self.check()
        if self.trace.on:
            self.trace.put(now_ns(), packed(message), outward=True)
        return True

    def check(self) -> None:
        """Raise PortError if the CAN bus is closed or has failed."""
        if self.trouble is not None:
            raise self.trouble
        if self._bus is None:
            raise PortError(f"{self.address} is closed")


def receives_own(address: str) -> bool:
    """Whether this kind of bus reports when a frame of motord's has left; SocketCAN does."""
    return split_address(address)[0] == "socketcan"


def shows_own(address: str) -> bool:
    """Whether this kind of bus hands motord its own frames as if they were those of other nodes."""
    return split_address(address)[0] == "udp_multicast"


def came_ns(message: can.Message, emptied_ns: int) -> int:
    """Return a frame's arrival time in CLOCK_MONOTONIC, from the age by the kernel's or adapter's
    stamp. These stamps are of the wall clock, which may be set meanwhile, or count from the
    adapter's start. If one is impossible, the frame counts as new. The result is not before
    `emptied_ns`, the time of the last look that found nothing to read."""
    age_s = time.time() - message.timestamp
    age_ns = round(age_s * 1e9) if 0.0 <= age_s <= AGE_MAX_S else 0
    return max(now_ns() - age_ns, emptied_ns)


def _filter(identifier: int, extended: bool) -> dict[str, Any]:
    mask = 0x1FFFFFFF if extended else 0x7FF
    return {"can_id": identifier, "can_mask": mask, "extended": extended}


def _message(sent: Sent) -> can.Message:
    return can.Message(
        arbitration_id=sent.identifier,
        is_extended_id=sent.extended,
        is_fd=sent.fd,
        bitrate_switch=sent.fd,
        is_remote_frame=sent.remote_bytes is not None,
        dlc=sent.remote_bytes,
        data=None if sent.remote_bytes is not None else sent.data,
    )


def _errno_of(error: BaseException) -> int | None:
    """Return the system's error number behind python-can's error. An OSError without one counts as
    EIO."""
    number = getattr(error, "error_code", None) or getattr(error, "errno", None)
    if number is None and isinstance(error.__cause__, OSError):
        number = error.__cause__.errno or errno.EIO
    if number is None and isinstance(error, OSError):
        number = errno.EIO
    return number


def _shut(bus: can.BusABC) -> None:
    try:
        bus.shutdown()
    except (can.CanError, OSError) as error:
        _log.debug("closing: %s", error)


def _shut_late(opening: asyncio.Future[can.BusABC]) -> None:
    """Close a bus that was opened after its caller had given up."""
    if not opening.cancelled() and opening.exception() is None:
        _shut(opening.result())


class _ReaderThread:
    """Reader for adapters without a file descriptor. The thread ends by itself soon after
    `stop`."""

    def __init__(self, bus: can.BusABC, take_in: Taker, fail: Callable[[Exception], None]) -> None:
        self._bus = bus
        self._take_in = take_in
        self._fail = fail
        self._loop = asyncio.get_running_loop()
        self._queue: deque[tuple[can.Message, int]] = deque(maxlen=QUEUE_FRAMES)
        self._stopped = threading.Event()
        threading.Thread(target=self._run, name="can-reader", daemon=True).start()

    def stop(self) -> None:
        self._stopped.set()

    def _run(self) -> None:
        emptied_ns = now_ns()
        while not self._stopped.is_set():
            looked_ns = now_ns()
            try:
                message = self._bus.recv(timeout=0)
                if message is None:
                    emptied_ns = looked_ns
                    message = self._bus.recv(timeout=THREAD_LOOKS_S)
            except _UNREADABLE as error:
                self._call_in_loop(self._fail, error)
                self._stopped.wait(THREAD_LOOKS_S)
                continue
            if message is not None:
                self._queue.append((message, came_ns(message, emptied_ns)))
                self._call_in_loop(self.drain)
        _shut(self._bus)

    def _call_in_loop(self, call: Callable[..., None], *values: Any) -> None:
        try:
            self._loop.call_soon_threadsafe(call, *values)
        except RuntimeError:  # the event loop has ended
            self._stopped.set()

    def drain(self) -> None:
        """Hand on all queued frames."""
        while self._queue and not self._stopped.is_set():
            self._take_in(*self._queue.popleft())
