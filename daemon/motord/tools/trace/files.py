# SPDX-License-Identifier: Apache-2.0
"""Writes traces to files for other tools: pcap (Wireshark), candump (can-utils), MCAP (Foxglove).

Sources: libpcap, pcap-savefile(5); Wireshark, epan/exported_pdu.h (LINKTYPE_WIRESHARK_UPPER_PDU).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import BinaryIO, Protocol

from can.io.canutils import CanutilsLogWriter
from can.io.generic import MessageWriter

from motord.tools.trace.decoder import rtu_frame
from motord.tools.trace.exchanges import Exchange, Words, can_message

_PCAP_MAGIC_NS = 0xA1B23C4D
_UPPER_PDU = 252
_DISSECTOR, _PORT_TYPE, _SOURCE_PORT, _TARGET_PORT, _END = 12, 24, 25, 26, 0
_UDP = 3
_PORT, _OURS = 502, 50000
"""UDP ports in the packets. Wireshark takes a packet to port 502 for a request, and one from it for
a reply."""


class Sink(Protocol):
    """A file that takes exchanges as they come."""

    def put(self, exchange: Exchange, words: Words, time_ns: int) -> None:
        """Write an exchange. `time_ns` is its Unix time."""


class Pcap:
    """Writes Modbus RTU frames in a form that Wireshark decodes without any setting."""

    def __init__(self, file: BinaryIO, kind: str) -> None:
        self._file, self._kind = file, kind
        file.write(struct.pack("<IHHiIII", _PCAP_MAGIC_NS, 2, 4, 0, 0, 65535, _UPPER_PDU))

    def put(self, exchange: Exchange, words: Words, time_ns: int) -> None:  # noqa: ARG002  # a Sink
        if exchange.sent:
            self._packet(rtu_frame(self._kind, exchange.sent), time_ns, _OURS, _PORT)
        if exchange.received and exchange.reply_ns is not None:
            came_ns = time_ns + exchange.reply_ns - exchange.stamp_ns
            self._packet(rtu_frame(self._kind, exchange.received), came_ns, _PORT, _OURS)

    def _packet(self, frame: bytes, time_ns: int, source: int, target: int) -> None:
        tags = (
            (_DISSECTOR, b"mbrtu\0\0\0"),
            (_PORT_TYPE, struct.pack(">I", _UDP)),
            (_SOURCE_PORT, struct.pack(">I", source)),
            (_TARGET_PORT, struct.pack(">I", target)),
            (_END, b""),
        )
        head = b"".join(struct.pack(">HH", tag, len(value)) + value for tag, value in tags)
        seconds, ns = divmod(time_ns, 1_000_000_000)
        size = len(head) + len(frame)
        self._file.write(struct.pack("<IIII", seconds, ns, size, size) + head + frame)
        self._file.flush()


class Candump:
    """Writes the format of `candump -L`, with python-can's own writer."""

    def __init__(self, writer: MessageWriter, channel: str) -> None:
        self._writer, self._channel = writer, channel

    def put(self, exchange: Exchange, words: Words, time_ns: int) -> None:  # noqa: ARG002  # a Sink
        self._writer.on_message_received(can_message(exchange, time_ns / 1e9, self._channel))


class Mcap:
    """Writes an MCAP file with JSON messages without a schema, and a topic for the line."""

    def __init__(self, stack: ExitStack, file: BinaryIO, line: str) -> None:
        """Raise ModuleNotFoundError if the extra `mcap` is not installed."""
        from mcap.writer import Writer

        self._writer = Writer(file)
        self._writer.start()
        stack.callback(self._writer.finish)
        self._channel = self._writer.register_channel(f"/motord/trace/{line}", "json", 0)

    def put(self, exchange: Exchange, words: Words, time_ns: int) -> None:
        data = json.dumps(record(exchange, words, time_ns)).encode()
        self._writer.add_message(self._channel, time_ns, data, time_ns)


def record(exchange: Exchange, words: Words, time_ns: int) -> dict[str, object]:
    """Return an exchange as one JSON object."""
    reply_us = None if exchange.reply_ns is None else (exchange.reply_ns - exchange.stamp_ns) / 1e3
    return {
        "time_s": time_ns / 1e9,
        "sent": exchange.sent.hex(),
        "received": exchange.received.hex(),
        "reply_us": reply_us if exchange.sent else None,
        "joint": words.joint,
        "what": words.what,
        "result": words.result,
    }


@contextmanager
def opened(
    kind: str, line: str, port: str, pcap: Path | None, candump: Path | None, mcap: Path | None
) -> Iterator[list[Sink]]:
    """Open the requested files (those that are not None). Raise OSError if one cannot be opened."""
    sinks: list[Sink] = []
    with ExitStack() as stack:
        if pcap is not None:
            sinks.append(Pcap(stack.enter_context(pcap.open("wb")), kind))
        if candump is not None:
            channel = port.rpartition(":")[2].rpartition("/")[2] or line
            writer = stack.enter_context(CanutilsLogWriter(candump, channel))
            sinks.append(Candump(writer, channel))
        if mcap is not None:
            sinks.append(Mcap(stack, stack.enter_context(mcap.open("wb")), line))
        yield sinks
