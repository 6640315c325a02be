# SPDX-License-Identifier: Apache-2.0
"""From entries of a trace to exchanges, to words, and to files; and when a trace goes off."""

import asyncio
import struct
from pathlib import Path

import pytest

from motord.config import load_robot
from motord.control.assembly import line_specs
from motord.daemon import tracing
from motord.local_socket.server import RpcError
from motord.tools.trace.exchanges import Decoder, Exchange, Joiner, rtu_frame
from motord.tools.trace.files import opened, record
from motord_hal.base.clock import within
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.trace import ENTRIES_MAX, PythonTrace
from motord_hal.modbus.codec import Function, Request, build_exception, build_reply, build_request
from motord_hal.realtime.exchange import Exchange as CoreExchange

ROBOTS = Path(__file__).resolve().parents[2] / "config/robots"
DEMO = load_robot(ROBOTS / "demo.toml")
UNIT = DEMO.joint["left"].unit
READ = Request(UNIT, Function.READ_HOLDING, 0x20A1, 1)
WRITE = Request(UNIT, Function.WRITE_SINGLE, 0x2000, values=(500,))


def entry(number, data, *, outward, stamp_ns=0):
    return {"number": number, "stamp_ns": stamp_ns, "outward": outward, "data": data.hex()}


def test_a_reply_in_pieces_is_one_exchange():
    reply = build_reply(READ, (3600,))
    joiner = Joiner("modbus-rtu")
    entries = [
        entry(1, build_request(READ), outward=True, stamp_ns=1000),
        entry(2, reply[:3], outward=False, stamp_ns=2000),
        entry(3, reply[3:], outward=False, stamp_ns=3000),
    ]
    assert list(joiner.feed(entries)) == []
    (found,) = joiner.end()
    assert (found.received, found.reply_ns, found.stamp_ns) == (reply, 3000, 1000)


def test_on_can_every_frame_is_shown_at_once():
    found = list(Joiner("can").feed([entry(1, b"a", outward=True), entry(2, b"b", outward=False)]))
    assert [(one.sent, one.received) for one in found] == [(b"a", b""), (b"", b"b")]


def words(sent, received, kind="modbus-rtu"):
    exchange = Exchange(stamp_ns=0, sent=sent, received=received, reply_ns=1)
    return Decoder(kind, DEMO, "rs485").words(exchange)


def test_values_are_named_by_the_profile_in_si():
    found = words(build_request(READ), build_reply(READ, (3600,)))
    assert (found.joint, found.result) == ("left,right", "ok")
    assert "bus_voltage 36" in found.what


@pytest.mark.parametrize(
    ("received", "result"),
    [
        (b"", "no reply"),
        (build_reply(READ, (3600,))[:-1] + b"\0", "bad CRC"),
        (build_exception(UNIT, Function.READ_HOLDING, 2), "exception 2 (illegal data address)"),
        (build_reply(Request(UNIT + 1, Function.READ_HOLDING, 0x20A1, 1), (1,)), "bad reply"),
    ],
)
def test_each_end_of_an_exchange_is_named(received, result):
    assert words(build_request(READ), received).result.startswith(result)


def test_a_write_shows_what_was_written():
    assert words(build_request(WRITE), build_reply(WRITE)).what.startswith("write ")
    assert words(b"", b"\x01").result == "came without a request"


def test_frames_of_a_gateway_lose_their_header():
    frame = build_request(READ)
    gateway = struct.pack(">HHH", 7, 0, len(frame) - 2) + frame[:-2]
    assert rtu_frame("modbus-tcp", gateway) == frame
    assert words(gateway, b"", "modbus-tcp").result == "no reply"


def test_the_mcap_file_is_read_by_its_library(tmp_path):
    reader = pytest.importorskip("mcap.reader")
    exchange = Exchange(stamp_ns=0, sent=build_request(READ), received=b"", reply_ns=None)
    shown = words(exchange.sent, b"")
    file = tmp_path / "trace.mcap"
    with opened("modbus-rtu", "rs485", "/dev/ttyUSB0", None, None, file) as sinks:
        sinks[0].put(exchange, shown, 5)
    with file.open("rb") as source:
        ((_, channel, message),) = reader.make_reader(source).iter_messages()
    assert (channel.topic, message.log_time) == ("/motord/trace/rs485", 5)
    assert b"no reply" in message.data
    assert record(exchange, shown, 5)["reply_us"] is None


def test_a_trace_that_is_off_keeps_nothing_and_forgets_the_oldest():
    trace = PythonTrace()
    trace.put(1, b"a", outward=True)
    assert (trace.newest, list(trace.after(0))) == (0, [])
    trace.switch(on=True)
    for number in range(ENTRIES_MAX + 1):
        trace.put(number, b"a", outward=True)
    assert trace.newest == ENTRIES_MAX + 1
    assert [one.number for one in trace.after(0)] == list(range(2, ENTRIES_MAX + 2))


@pytest.fixture
def asyncio_line():
    robot = load_robot(ROBOTS / "demo.toml", ["line.rs485.engine=asyncio"])
    (spec,) = line_specs(robot, robot.profiles)
    return open_line(spec, CoreExchange.of_loop(), lambda _: None)


async def test_a_trace_goes_off_when_no_program_asks_any_more(monkeypatch, asyncio_line):
    monkeypatch.setattr(tracing, "KEPT_ON_S", 0.01)
    traces = tracing.Tracing([asyncio_line])
    traces.read("rs485", None)
    assert asyncio_line.trace.on
    async with within(60.0):
        while asyncio_line.trace.on:
            await asyncio.sleep(0.01)
    with pytest.raises(RpcError, match="there are: rs485"):
        traces.read("nothing", None)
