# SPDX-License-Identifier: Apache-2.0
"""A hub motor that is no Modbus drive, in the table of its line."""

import dataclasses
import math

import pytest

from motord.config.drives.load import find_profile
from motord_hal.base.errors import ProfileError
from motord_hal.ddsm.codec import Command, build_reply, build_request, pick
from motord_hal.drives.profile import Channel, Register, RegisterType, Step
from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.realtime.table import FieldKind, Form, Seal
from motord_hal.rt_engine.rs485.protocols import frames_of
from motord_hal.rt_engine.rs485.table import drive_table, line_table

RPM = 2 * math.pi / 60


def register(name, command, byte, access, kind="i16", unit="", **more):
    limits = {"minimum": more.pop("minimum", None), "maximum": more.pop("maximum", None)}
    return Register(
        name=name, address=command << 8 | byte, type=RegisterType(kind), unit=unit, access=access,
        scale=more.pop("scale", 1.0), source="the maker's table", **limits,
    )  # fmt: skip


REGISTERS = (
    register("speed_wanted", Command.SET, 2, "w", unit="rpm", minimum=-330.0, maximum=330.0),
    register("current", Command.SET, 2, "r", unit="a", scale=8 / 32767),
    register("speed", Command.SET, 4, "r", unit="rpm"),
    register("position", Command.SET, 6, "r", "u16", unit="count"),
    register("supply", Command.QUERY, 4, "r", "u16", unit="v"),
    register("mode", Command.MODE, 8, "w", "u16"),
)
PROFILE = dataclasses.replace(
    find_profile("duty-register"),
    name="hub-motor", protocol="ddsm", turnaround_s=0.002, counts_per_turn=32768, counter_bits=15,
    registers={one.name: one for one in REGISTERS},
    channels={
        1: Channel(
            velocity_setpoint="speed_wanted", position="position", velocity="speed",
            current="current",
        )
    },
    configure=(), arm=(Step(register="mode", value=2),), disarm=(Step(register="mode", value=1),),
    quick_stop=(Step(register="speed_wanted", value=0), Step(register="mode", value=1)),
    clear_fault=(), enabled=None, watchdog=None, faults=(), bus_voltage="supply",
)  # fmt: skip


def spec_of(*profiles, kind="ddsm"):
    joints = tuple(
        JointSpec(index=n, name=f"wheel{n}", profile=profile, unit=n + 1, inverted=n == 1)
        for n, profile in enumerate(profiles)
    )
    return LineSpec(
        index=0, name="bus", kind=kind, port="", baudrate=115200, parity="none", stop_bits=1,
        cycle_hz=100.0, gap_s=0.0002, engine="rt", joints=joints, watchdog_s=0.5,
    )  # fmt: skip


def drive(index=0):
    spec = spec_of(PROFILE, PROFILE)
    return drive_table(frames_of(spec)[index], spec)


def test_one_exchange_sends_the_speed_and_returns_the_feedback():
    (exchange,) = drive().cyclic
    assert exchange.frame.request == build_request(1, Command.SET, {})
    assert exchange.frame.match == b"\x01"
    assert exchange.frame.reply_bytes == 10
    assert exchange.frame.request_seal is exchange.frame.reply_seal is Seal.CRC8
    (setpoint,) = exchange.setpoint
    assert (setpoint.byte, setpoint.form) == (2, Form.I16)
    assert setpoint.raw_per_si == pytest.approx(1 / RPM)
    assert (setpoint.raw_min, setpoint.raw_max) == (-330, 330)
    places = {field.kind: field.byte for field in exchange.field}
    assert places == {FieldKind.CURRENT: 2, FieldKind.VELOCITY: 4, FieldKind.COUNT: 6}
    count = next(field for field in exchange.field if field.kind is FieldKind.COUNT)
    assert (count.form, count.mask) == (Form.U16, 0x7FFF)


def test_a_motor_mounted_in_reverse_turns_in_reverse():
    (exchange,) = drive(1).cyclic
    assert exchange.frame.request[0] == 2
    assert exchange.setpoint[0].raw_per_si == pytest.approx(-1 / RPM)


def test_slow_values_are_read_by_the_query_command():
    (exchange,) = drive().extra
    assert exchange.frame.request == build_request(1, Command.QUERY, {})
    assert [(field.kind, field.byte) for field in exchange.field] == [(FieldKind.VOLTAGE, 4)]


def test_a_stop_is_a_frame_of_its_command_and_a_mode_is_not_answered():
    speed, mode = drive().quick_stop
    assert speed.request == build_request(1, Command.SET, {})
    assert mode.request == bytes((1, Command.MODE, 0, 0, 0, 0, 0, 0, 0, 1))
    assert (mode.reply_bytes, mode.request_seal, mode.match) == (0, Seal.NONE, b"")
    assert line_table(spec_of(PROFILE), frames_of(spec_of(PROFILE))).broadcast_stop == ()


def test_a_register_is_read_by_its_command():
    (frames,) = frames_of(spec_of(PROFILE))
    assert frames.read("supply").request == build_request(1, Command.QUERY, {})
    supply = PROFILE.registers["supply"]
    reply = build_reply(1, Command.QUERY, {supply: 24})
    assert frames.raw("supply", reply) == pick(reply, supply) == 24


def test_a_drive_of_another_protocol_is_refused():
    with pytest.raises(ProfileError, match="speaks ddsm, and bus is a modbus-rtu line"):
        frames_of(spec_of(PROFILE, kind="modbus-rtu"))


def test_the_wire_carries_one_exchange_a_cycle_and_sometimes_another():
    (frames,) = frames_of(spec_of(PROFILE))
    exchange_s = 20 * 10 / 115200 + 2 * 0.0002
    assert frames.cycle_time_s() == pytest.approx(exchange_s * (1 + 1 / 4))
