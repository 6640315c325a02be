# SPDX-License-Identifier: Apache-2.0
"""The table of a real-time line has the same result as the plan of the asyncio engine."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.shipped import NAMES, shipped_profile

from motord_hal.fieldbus.ports import Echo, JointSpec, LineSpec
from motord_hal.modbus.codec import (
    Function,
    build_request,
    frame_time_s,
    parse_request,
    reply_bytes,
    seal,
)
from motord_hal.modbus.plan import DrivePlan
from motord_hal.realtime.exchange import JointSetpoint
from motord_hal.realtime.table import FieldKind, Form
from motord_hal.rt_engine.rs485.modbus_frames import ModbusFrames
from motord_hal.rt_engine.rs485.table import drive_table, line_table

MODBUS = [name for name in NAMES if shipped_profile(name).protocol == "modbus-rtu"]
NOT_POSITIONS = [name for name in MODBUS if not shipped_profile(name).goes_to_positions]
"""Profiles of Modbus drives without positions: the asyncio engine, and so the plan, writes none."""
NUMBERS = st.one_of(
    st.floats(-500, 500),
    st.floats(-1e6, 1e6),  # more than the core ever sends: it stays within a wheel's limit
    st.sampled_from([math.nan, math.inf, -math.inf, 0.0]),
)


def joints_of(profile, unit=1, **changes):
    reverses = all(
        channel.direction is not None or profile.registers[channel.setpoint].type.signed
        for channel in profile.channels.values()
    )
    return tuple(
        JointSpec(
            index=index, name=f"wheel{channel}", profile=profile, unit=unit, channel=channel,
            gear_ratio=1.5, inverted=reverses and index % 2 == 1, **changes,
        )
        for index, channel in enumerate(sorted(profile.channels))
    )  # fmt: skip


def spec_of(joints, **changes):
    profile = joints[0].profile
    values = {
        "index": 0, "name": "bus", "kind": "modbus-rtu", "port": "", "baudrate": profile.baudrate,
        "parity": profile.parity, "stop_bits": profile.stop_bits, "cycle_hz": 100.0, "gap_s": None,
        "engine": "rt", "joints": joints, "watchdog_s": 0.5,
    }  # fmt: skip
    return LineSpec(**{**values, **changes})


def frames_of(spec):
    def wire_time_s(size):
        return frame_time_s(size, spec.baudrate, spec.parity, spec.stop_bits)

    return ModbusFrames(DrivePlan(spec.joints, 0.00175, wire_time_s))


def table_of(profile, **changes):
    spec = spec_of(joints_of(profile), **changes)
    frames = frames_of(spec)
    return frames.plan, drive_table(frames, spec)


# Set-points and fields as csrc/api/line/api_line.h defines them, here in Python.
def put(exchange, wanted):
    request = bytearray(exchange.frame.request)
    for setpoint in exchange.setpoint:
        si = wanted.get(setpoint.joint, (0.0, 0.0))[setpoint.kind]
        if not math.isfinite(si * setpoint.raw_per_si):
            si = 0.0
        scaled = si * setpoint.raw_per_si
        scaled = abs(scaled) if setpoint.magnitude else scaled
        raw = round(min(max(scaled, setpoint.raw_min), setpoint.raw_max))
        size = setpoint.form.bits // 8
        data = (raw & (1 << 8 * size) - 1).to_bytes(size, "big")
        if "LOW_FIRST" in setpoint.form.name:
            data = data[2:] + data[:2]
        request[setpoint.byte : setpoint.byte + size] = data
    return seal(bytes(request[:-2]))


def get(field, reply):
    size = field.form.bits // 8
    data = reply[field.byte : field.byte + size]
    if "LOW_FIRST" in field.form.name:
        data = data[2:] + data[:2]
    raw, bits = int.from_bytes(data, "big"), field.form.bits
    if field.mask:
        raw = (raw & field.mask) // (field.mask & -field.mask)
        bits = field.mask.bit_count()
    return raw - (1 << bits) if field.form.name[0] == "I" and raw >> (bits - 1) else raw


@pytest.mark.parametrize("name", NOT_POSITIONS)
@given(wanted=st.dictionaries(st.integers(0, 1), st.tuples(NUMBERS, NUMBERS)))
def test_what_goes_out_is_what_the_plan_writes(name, wanted):
    plan, drive = table_of(replace(shipped_profile(name), read_write_function=None))
    out = [put(exchange, wanted) for exchange in drive.cyclic if exchange.setpoint]
    raw = plan.setpoints({joint: JointSetpoint(*si) for joint, si in wanted.items()})
    assert out == [build_request(request) for request in plan.writes(raw)]


@pytest.mark.parametrize("name", MODBUS)
@given(data=st.data())
def test_what_comes_in_is_what_the_plan_reads(name, data):
    plan, drive = table_of(shipped_profile(name))
    values, fields = {}, []
    for exchange, span in _reading(plan, drive):
        size = exchange.frame.reply_bytes
        reply = data.draw(st.binary(min_size=size, max_size=size))
        words = [int.from_bytes(reply[i : i + 2], "big") for i in range(3, size - 2, 2)]
        values |= span.decode(tuple(words))
        fields += [(field, get(field, reply)) for field in exchange.field]
    for joint in plan.joints:
        expected = plan.reading(joint, values, {})
        mine = {f.kind: (raw, raw * f.si_per_raw) for f, raw in fields if f.joint == joint.index}
        channel = plan.channel(joint)
        for kind, want in (
            (FieldKind.VELOCITY, expected.velocity_rad_s),
            (FieldKind.CURRENT, expected.current_a),
            (FieldKind.VOLTAGE, expected.voltage_v),
            (FieldKind.TEMPERATURE, expected.temperature_c),
        ):
            if not math.isnan(want):
                assert mine[kind][1] == pytest.approx(want)
        if channel.position:
            assert mine[FieldKind.COUNT][0] == expected.count
        if channel.fault:
            assert mine[FieldKind.FAULT][0] == expected.fault_word


def _reading(plan, drive):
    """Yield the exchanges that read, with the range that each reads."""
    spans = {span.request(plan.unit).address: span for span in (*plan.fast, *plan.extra)}
    for exchange in (*drive.cyclic, *drive.extra):
        request = parse_request(exchange.frame.request)
        if request.function in (Function.READ_HOLDING, Function.READ_WRITE):
            yield exchange, spans[request.address]


@pytest.mark.parametrize("name", MODBUS)
def test_an_answer_is_recognized_by_its_head_or_its_echo_and_its_length(name):
    _, drive = table_of(shipped_profile(name))
    directions = [
        frame for one in drive.direction for frame in (one.rest, one.forward, one.reverse)
    ]
    frames = [exchange.frame for exchange in (*drive.cyclic, *drive.extra)]
    for frame in (*frames, *directions, *drive.quick_stop, *drive.disarm):
        request = parse_request(frame.request)
        assert frame.reply_bytes == reply_bytes(request)
        assert frame.has_exceptions
        if request.function in (Function.WRITE_SINGLE, Function.WRITE_MULTIPLE):
            assert (frame.echo_bytes, frame.match) == (6, b"")
        else:
            assert (frame.echo_bytes, frame.match[:2]) == (0, frame.request[:2])
            assert frame.match[2] == 2 * request.count


@pytest.mark.parametrize("name", NOT_POSITIONS)
def test_where_the_drive_supports_it_one_exchange_writes_and_reads(name):
    profile = replace(
        shipped_profile(name), read_write_function=23, write_function=16, max_registers=64
    )
    plan, drive = table_of(profile)
    if len(plan.writes(plan.setpoints({}))) == 1 and plan.fast:
        request = parse_request(drive.cyclic[0].frame.request)
        assert request.function is Function.READ_WRITE
        assert drive.cyclic[0].setpoint
        assert drive.cyclic[0].field
        assert len(drive.cyclic) == len(plan.fast)


def test_the_table_has_the_enabled_field_and_the_kept_registers():
    _, drive = table_of(shipped_profile("zlac8015d"))
    first = drive.extra[0].field
    assert [f.equals for f in first if f.kind is FieldKind.ENABLED] == [8]
    kept = [f for e in drive.extra for f in e.field if f.kind is FieldKind.KEPT]
    assert {f.equals for f in kept} >= {3, 500}  # the mode, and the watchdog in ms


def test_a_counter_has_no_sign_and_no_more_bits_than_the_drive_counts():
    profile = replace(shipped_profile("zlac8015d"), counter_bits=15)
    _, drive = table_of(profile)
    counts = [f for e in drive.cyclic for f in e.field if f.kind is FieldKind.COUNT]
    assert [(f.form, f.mask) for f in counts] == [(Form.U32, 0x7FFF)] * 2


def test_warning_bits_are_no_fault():
    _, drive = table_of(shipped_profile("duty-register"))
    words = [f for e in drive.cyclic for f in e.field if f.kind is FieldKind.FAULT]
    assert [(f.harmless_bits, f.is_code) for f in words] == [(1 << 3, 0)]
    _, drive = table_of(shipped_profile("bld-305s"))
    words = [f for e in drive.cyclic for f in e.field if f.kind is FieldKind.FAULT]
    assert [f.is_code for f in words] == [1]


def test_one_frame_stops_all_drives_only_where_they_are_of_one_kind():
    able = replace(shipped_profile("zlac8015d"), broadcast_stop=True)
    other = replace(shipped_profile("duty-register"), broadcast_stop=True)

    def stops(*profiles):
        specs = [spec_of(joints_of(profile, unit)) for unit, profile in enumerate(profiles, 1)]
        return line_table(specs[0], [frames_of(spec) for spec in specs]).broadcast_stop

    (frame,) = stops(able, able)
    assert parse_request(frame.request).unit == 0
    assert frame.reply_bytes == frame.echo_bytes == len(frame.match) == frame.has_exceptions == 0
    assert stops(able, other) == ()
    assert stops(shipped_profile("zlac8015d")) == ()


def test_times_come_from_the_wire_and_the_profile():
    spec = spec_of(joints_of(shipped_profile("bld-305s"), reply_timeout_s=0.04), echo=Echo.YES)
    table = line_table(spec, [frames_of(spec)])
    assert table.character_ns == pytest.approx(10e9 / 9600)
    assert table.gap_ns == pytest.approx(35e9 / 9600, abs=1)
    assert table.echo == 1
    (drive,) = table.drive
    assert (drive.turnaround_ns, drive.reply_timeout_ns) == (20_000_000, 40_000_000)
    assert (drive.period_ns, drive.watchdog_ns) == (10_000_000, 0)
