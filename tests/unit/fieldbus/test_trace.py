# SPDX-License-Identifier: Apache-2.0
"""Conversion of a trace's entries to exchanges, text and files; and the end of a trace."""

import asyncio
import struct
from pathlib import Path

import can
import pytest

from motord.config import load_robot
from motord.control.assembly import line_specs
from motord.daemon import tracing
from motord.local_socket.server import RpcError
from motord.tools.trace.decoder import Decoder, rtu_frame
from motord.tools.trace.exchanges import Exchange, Joiner
from motord.tools.trace.files import opened, record
from motord_hal.base.clock import within
from motord_hal.can.socket_frames import packed
from motord_hal.ddsm import codec as ddsm
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.trace import ENTRIES_MAX, PythonTrace
from motord_hal.hoverboard import codec as hoverboard
from motord_hal.mcu import frames as mcu
from motord_hal.modbus.codec import Function, Request, build_exception, build_reply, build_request
from motord_hal.realtime.exchange import Exchange as CoreExchange
from motord_hal.sabertooth import codec as sabertooth
from motord_hal.servo.packets import Instruction, build_fast_status, packets_of

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
DEMO = load_robot(ROBOTS / "demo.toml")
UNIT = DEMO.joint["left"].unit
READ = Request(UNIT, Function.READ_HOLDING, 0x20A1, 1)
WRITE = Request(UNIT, Function.WRITE_SINGLE, 0x2000, values=(500,))


def entry(number, data, *, outward, stamp_ns=0):
    return {"number": number, "stamp_ns": stamp_ns, "outward": outward, "data": data.hex()}


def test_a_reply_in_pieces_makes_one_exchange():
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
def test_each_outcome_of_an_exchange_is_named(received, result):
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


def test_a_trace_keeps_nothing_while_off_and_only_the_newest_while_on():
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


async def test_a_trace_goes_off_when_no_program_reads_it_any_more(monkeypatch, asyncio_line):
    monkeypatch.setattr(tracing, "KEPT_ON_S", 0.01)
    traces = tracing.Tracing([asyncio_line])
    traces.read("rs485", None)
    assert asyncio_line.trace.on
    async with within(60.0):
        while asyncio_line.trace.on:
            await asyncio.sleep(0.01)
    with pytest.raises(RpcError, match="there are: rs485"):
        traces.read("nothing", None)


def test_frames_of_11_and_of_29_bits_are_not_mixed_up():
    """0x301 is the heartbeat of ODrive 24, and the speed of VESC 1."""
    vesc = ("joint.right.drive=vesc", "joint.right.unit=1")
    robot = load_robot(ROBOTS / "odrive-two.toml", ("joint.left.unit=24", *vesc))
    decoder = Decoder("can", robot, "can0")
    for extended, drive, word in ((False, "left", "heartbeat"), (True, "right", "set_rpm")):
        message = can.Message(arbitration_id=0x301, is_extended_id=extended, data=bytes(8))
        outward = drive == "right"
        frame = packed(message)
        exchange = Exchange(
            stamp_ns=0, sent=frame if outward else b"", received=b"" if outward else frame
        )
        words = decoder.words(exchange)
        assert words.joint == drive
        assert words.what.startswith(word)
    message = can.Message(arbitration_id=0x301, is_extended_id=True, data=bytes(8))
    words = decoder.words(Exchange(stamp_ns=0, received=packed(message), reply_ns=0))
    assert (words.joint, words.what) == ("", "301")


# ------------------------------------------------------------------------------- boards and servos
def decoder_of(name, line=None):
    robot = load_robot(ROBOTS / f"{name}.toml")
    line = line or next(iter(robot.line))
    return Decoder(robot.line[line].kind, robot, line)


def decoded(decoder, sent=b"", received=b""):
    return decoder.words(Exchange(stamp_ns=0, sent=sent, received=received, reply_ns=1))


def board_frame(kind, sequence, payload):
    return mcu.build(mcu.Frame(kind, sequence, 0, payload))


def test_a_frame_of_a_board_that_comes_in_pieces_is_decoded_when_it_is_whole():
    decoder = decoder_of("esp32")
    frame = board_frame(mcu.Type.FEEDBACK, 7, bytes(36))
    first = decoded(decoder, received=frame[:9])
    assert (first.what, first.result) == ("", "part of a frame")
    second = decoded(decoder, received=frame[9:])
    assert second.what.startswith("feedback 7: status 0, ")
    assert "position_2 0" in second.what
    assert second.result == "in"


def test_a_frame_of_a_board_with_a_wrong_crc_is_named():
    frame = bytearray(board_frame(mcu.Type.SETPOINTS, 1, bytes(18)))
    frame[-2] ^= 1
    assert decoded(decoder_of("esp32"), sent=bytes(frame)).result.startswith("bad frame: ")


def test_a_short_frame_of_a_board_shows_the_values_that_it_has():
    found = decoded(decoder_of("esp32"), sent=board_frame(mcu.Type.SETPOINTS, 1, bytes(6)))
    assert "watchdog 0" in found.what
    assert "target_velocity" not in found.what


def test_text_of_a_board_that_fits_no_template_is_shown_as_it_is():
    decoder = decoder_of("arduino-text")
    decoded(decoder, received=b"\n")  # bytes before it may be half a line: not decoded
    assert decoded(decoder, received=b"hello\n").what == "hello"


@pytest.mark.parametrize(
    ("received", "result"),
    [(b"", "no reply"), (b"\x01\x02\x03\x04", "bad reply: "), (bytes(8) + b"\xc8\x9a", "ok")],
)
def test_each_outcome_of_a_roboclaw_read_is_named(received, result):
    found = decoded(decoder_of("roboclaw"), b"\x80\x4e", received)
    assert found.result.startswith(result)
    assert found.joint == "left,right"


def test_unexpected_bytes_of_a_roboclaw_are_named():
    assert decoded(decoder_of("roboclaw"), b"\x80\x77").result.startswith("not expected: ")
    assert decoded(decoder_of("roboclaw"), b"", b"\xff").result == "came without a request"


def test_servo_traffic_is_named_by_joint_and_register():
    robot = load_robot(ROBOTS / "turtlebot3-burger.toml")
    decoder, packets = decoder_of("turtlebot3-burger"), packets_of("dynamixel")
    unit = robot.joint["left"].unit
    goal = robot.profiles["xl430"].registers["goal_velocity"].address
    number = packets.number
    velocity = (100).to_bytes(4, "little")
    write = packets.build(0xFE, Instruction.SYNC_WRITE,
                          number(goal) + number(4) + bytes((unit,)) + velocity)  # fmt: skip
    found = decoded(decoder, write)
    assert found.what.startswith("write left: goal_velocity ")
    assert (found.joint, found.result) == ("all", "out")
    read = packets.build(unit, Instruction.READ, number(goal) + number(4))
    assert decoded(decoder, read).result == "no reply"
    answer = packets.build_status(unit, 0, velocity)
    echoed = decoded(decoder, read, read + answer)
    assert "→ left: goal_velocity " in echoed.what
    assert echoed.result == "ok"
    failed = decoded(decoder, read, packets.build_status(unit, 4))
    assert failed.result == "left: error 4 (data range error)"
    spoilt = decoded(decoder, read, answer[:-1] + bytes((answer[-1] ^ 1,)))
    assert spoilt.result == "bad reply: wrong check sum"
    assert decoded(decoder, b"", answer).result == "came without a request"


def test_servos_that_answer_in_one_packet_are_each_named_with_their_value():
    robot = load_robot(ROBOTS / "turtlebot3-burger.toml")
    decoder, packets = decoder_of("turtlebot3-burger"), packets_of("dynamixel")
    units = [robot.joint[name].unit for name in ("left", "right")]
    goal = robot.profiles["xl430"].registers["goal_velocity"].address
    velocity = (100).to_bytes(4, "little")
    asked = packets.number(goal) + packets.number(4) + bytes(units)
    read = packets.build(0xFE, Instruction.FAST_SYNC_READ, asked)
    parts = build_fast_status(2, [(units[0], 0, velocity), (units[1], 7, velocity)])
    found = decoded(decoder, read, b"".join(parts))
    assert "→ left: goal_velocity " in found.what
    assert "→ right: goal_velocity " in found.what
    assert found.result == "right: error 7 (access error)"
    assert decoded(decoder, read).result == "no reply"


def test_a_hoverboard_is_decoded_as_its_firmware_mixes_the_command():
    decoder = decoder_of("hoverboard-rover")
    packet = hoverboard.build(struct.pack("<hh", 60, -30))
    assert decoded(decoder, packet[:5]).what == ""
    found = decoded(decoder, packet[5:])
    assert found.joint == "left,right"
    assert found.what == "set-points: target_left 6.28319, target_right 3.14159"
    text = (ROBOTS / "hoverboard-rover.toml").read_text("utf-8")
    text = text.replace('drive = "hoverboard"', 'drive = "hoverboard-steer"')
    robot = load_robot(ROBOTS / "hoverboard-rover.toml", text=text)
    mixed = decoded(Decoder("hoverboard", robot, "board"), packet)
    assert "target_left 0" in mixed.what
    assert "target_right " in mixed.what
    reply = hoverboard.build(bytes(hoverboard.VALUE_BYTES))
    decoded(decoder, received=reply)
    spoilt = decoded(decoder, received=reply[:-1] + bytes((reply[-1] ^ 1,)))
    assert spoilt.result.startswith("bad packet")


def test_each_sabertooth_on_a_wire_is_named_with_what_it_is_sent():
    decoder = decoder_of("sabertooth")
    packets = sabertooth.packet(128, 14, 3) + sabertooth.packet(128, 1, 127)
    found = decoded(decoder, packets)
    assert (found.joint, found.result) == ("left,right", "out")
    assert found.what == "write serial_timeout 0.3, motor_1 -1"
    assert decoded(decoder, packets[:-1] + b"\1").result.startswith("bad packet")
    assert decoded(decoder, b"", b"\1").result.startswith("not expected")


def test_a_hub_motor_is_decoded_by_its_command():
    text = (ROBOTS / "demo.toml").read_text(encoding="utf-8")
    text = text.replace('drive = "zlac8015d"', 'drive = "ddsm115"').replace("modbus-rtu", "ddsm")
    text = text.replace("channel = 1\n", "").replace("unit = 1\nchannel = 2", "unit = 2")
    robot = load_robot(ROBOTS / "demo.toml", text=text)
    decoder = Decoder("ddsm", robot, "rs485")
    query = ddsm.build_request(1, 0x74, {})
    registers = [r for r in robot.profiles["ddsm115"].registers.values() if "r" in r.access]
    fitting = [r for r in registers if ddsm.command_of(r) == 0x74]
    reply = ddsm.build_reply(1, 0x74, dict.fromkeys(fitting, 1))
    found = decoded(decoder, query, reply)
    assert (found.joint, found.result) == ("left", "ok")
    assert fitting[0].name in found.what
    assert decoded(decoder, query).result == "no reply"
    assert decoded(decoder, query, reply[:-1] + b"\0").result == "bad reply: wrong check sum"
    assert decoded(decoder, b"\1\2").result.startswith("not expected")
