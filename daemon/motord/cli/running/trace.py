# SPDX-License-Identifier: Apache-2.0
"""`motord trace`: show every exchange of a line, decoded."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from motord.base.extras import how_to_install
from motord.cli.common import Exit, Failure, load_or_exit
from motord.cli.complete import line_names
from motord.cli.running.talk import interruptible, talking
from motord.client import Client
from motord.tools.trace.decoder import MODBUS, Decoder
from motord.tools.trace.exchanges import Exchange, Joiner, Words
from motord.tools.trace.files import opened, record

LOOK_EVERY_S = 0.02
_FILE = click.Path(path_type=Path, dir_okay=False)


@click.command
@click.argument("line", required=False, shell_complete=line_names)
@click.option("--count", type=click.IntRange(1), help="End after this many exchanges.")
@click.option("--pcap", metavar="FILE", type=_FILE, help="Modbus: a file for Wireshark.")
@click.option("--candump", metavar="FILE", type=_FILE, help="CAN: a file as candump -L writes it.")
@click.option("--mcap", metavar="FILE", type=_FILE, help="An MCAP file, for Foxglove.")
@click.option(
    "--file", "robot_file", metavar="ROBOT.toml", type=click.Path(path_type=Path),
    help="Robot file to decode by. Default: the one that the daemon uses.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object for each exchange.")
@talking
def trace(
    client: Client,
    line: str | None,
    count: int | None,
    pcap: Path | None,
    candump: Path | None,
    mcap: Path | None,
    robot_file: Path | None,
    as_json: bool,
) -> None:
    """Show what goes over LINE until Ctrl-C: time, bytes, what it means, and the result.

    LINE may be left out if the robot has one line. The daemon keeps 256 frames; what is lost
    because the machine is too busy is counted. The trace ends with this program.

    \b
    Example: motord trace
             motord trace rs485 --pcap rs485.pcap
             motord trace can0 --candump can0.log --count 1000
    """
    line = line or _only_line(client)
    first = client.call("trace", line=line)
    kind = first["kind"]
    if (pcap is not None and kind not in MODBUS) or (candump is not None and kind != "can"):
        raise click.UsageError("--pcap is for Modbus lines, --candump for CAN lines")
    robot = load_or_exit(robot_file or Path(client.call("robot")["file"]))
    decoder, shown = Decoder(kind, robot, line), 0
    try:
        with opened(kind, line, first["port"], pcap, candump, mcap) as sinks:
            for exchange, time_ns in _exchanges(client, line, first):
                words = decoder.words(exchange)
                for sink in sinks:
                    sink.put(exchange, words, time_ns)
                if as_json:
                    click.echo(json.dumps(record(exchange, words, time_ns), ensure_ascii=False))
                elif not sinks:
                    click.echo(_row(exchange, words, time_ns))
                shown += 1
                if shown == count:
                    break
    except ModuleNotFoundError as error:
        text = f"--mcap needs the package {error.name}: {how_to_install('mcap')}"
        raise Failure(text, Exit.USAGE) from error
    except OSError as error:
        raise Failure(f"{error.filename}: {error.strerror}") from error


def _only_line(client: Client) -> str:
    names = list(client.status().lines)
    if len(names) != 1:
        raise click.UsageError(f"name a line: {', '.join(names)}")
    return names[0]


def _exchanges(client: Client, line: str, first: dict[str, Any]) -> Iterator[tuple[Exchange, int]]:
    """Yield each exchange with its time of day, until Ctrl-C; report missing entries on stderr."""
    joiner, number = Joiner(first["kind"]), int(first["newest"])
    with interruptible() as interrupts:
        while not interrupts:
            offset_ns = time.time_ns() - time.monotonic_ns()
            answer = client.call("trace", line=line, after=number)
            entries = answer["entries"]
            for entry in entries:
                if entry["number"] != number + 1:
                    lost = entry["number"] - number - 1
                    click.echo(f"({lost} frames were overwritten before this)", err=True)
                number = entry["number"]
                for exchange in joiner.feed([entry]):
                    yield exchange, exchange.stamp_ns + offset_ns
            if answer["newest"] < number:  # the daemon was restarted
                number = 0
            if answer["newest"] <= number:
                time.sleep(LOOK_EVERY_S)


def _row(exchange: Exchange, words: Words, time_ns: int) -> str:
    clock = datetime.fromtimestamp(time_ns / 1e9).astimezone().strftime("%H:%M:%S.%f")
    bytes_of = " → ".join(part.hex(" ") for part in (exchange.sent, exchange.received) if part)
    reply = ""
    if exchange.sent and exchange.reply_ns is not None:
        reply = f" {(exchange.reply_ns - exchange.stamp_ns) / 1e3:.0f} µs"
    return f"{clock} {words.joint:12} {words.result}{reply}  {words.what}  [{bytes_of}]"
