# SPDX-License-Identifier: Apache-2.0
"""A board's thread in C writes and reads the same bytes as the asyncio engine."""

import json
import math
import string

import pytest
from _motord_rt import ffi, lib
from hypothesis import example, given
from hypothesis import strategies as st

from motord.config.drives.load import find_profile
from motord_hal.ascii.dialect import texts_of
from motord_hal.ascii.text import Text
from motord_hal.ascii.twist import ANGULAR, LINEAR, twist_of
from motord_hal.fieldbus.ports import JointSpec, LineSpec, TextSpec, TextWheel
from motord_hal.mcu.frames import FRAME_BYTES_MAX, Frame, FrameError, build, parse
from motord_hal.modbus.plan import DrivePlan
from motord_hal.rt_engine.boards import text as board_text
from motord_hal.rt_engine.boards.layout import layout_of
from motord_hal.rt_engine.boards.table import board_table

PAYLOADS = st.binary(max_size=FRAME_BYTES_MAX - 10)
WHEELS = {"left": TextWheel(side=-1, radius_m=0.1), "right": TextWheel(side=1, radius_m=0.08)}
FORMATS = st.from_regex(r"[+ ]?0?[0-9]?(\.[0-9])?[fg]|[+ ]?0?[0-9]?d", fullmatch=True)


# ----------------------------------------------------------------------------------------- frames
def c_build(kind, sequence, time_us, payload):
    out = ffi.new("uint8_t[]", lib.BOARD_WIRE_MAX)
    size = lib.board_frame_build(kind, sequence, time_us, payload, len(payload), out)
    return bytes(ffi.buffer(out, size))


def c_parse(stuffed):
    out = ffi.new("uint8_t[]", lib.BOARD_FRAME_MAX)
    return bytes(ffi.buffer(out, lib.board_frame_parse(stuffed, len(stuffed), out)))


@given(st.integers(0, 255), st.integers(0, 0xFFFF), st.integers(0, 0xFFFFFFFF), PAYLOADS)
@example(1, 0, 0, bytes(190))
@example(1, 0, 0, b"\1" * 190)
def test_a_frame_is_built_as_python_builds_it_and_parsed_again(kind, sequence, time_us, payload):
    raw = c_build(kind, sequence, time_us, payload)
    assert raw == build(Frame(kind, sequence, time_us, payload))
    assert c_parse(raw[1:-1])[8:] == payload


@given(st.binary(max_size=203) | PAYLOADS.map(lambda p: build(Frame(1, 2, 3, p))[1:-1]), st.data())
def test_any_bytes_are_the_same_frame_or_none_in_c_and_python(stuffed, data):
    if stuffed and data.draw(st.booleans()):
        at, flip = data.draw(st.integers(0, len(stuffed) - 1)), data.draw(st.integers(1, 255))
        stuffed = stuffed[:at] + bytes([stuffed[at] ^ flip]) + stuffed[at + 1 :]
    try:
        frame = parse(stuffed)
    except FrameError:
        assert c_parse(stuffed) == b""
    else:
        raw = c_parse(stuffed)
        assert raw[1] == frame.type
        assert int.from_bytes(raw[2:4], "little") == frame.sequence
        assert int.from_bytes(raw[4:8], "little") == frame.time_us
        assert raw[8:] == frame.payload


def test_a_payload_that_is_too_long_makes_no_frame():
    assert c_build(1, 0, 0, bytes(191)) == b""


# ------------------------------------------------------------------------------------------- text
def spec_of(setpoints, received="", drive="ascii-velocity"):
    profile = find_profile(drive)
    joints = (
        JointSpec(index=0, name="left", profile=profile, unit=1, channel=1, gear_ratio=3.0),
        JointSpec(index=1, name="right", profile=profile, unit=1, channel=2, inverted=True),
    )
    text = TextSpec(setpoints=setpoints, feedback=received, scale=2.5, wheels=WHEELS, track_m=0.5)
    return LineSpec(
        index=0, name="board", kind="ascii", port="/nowhere", baudrate=115200, parity="none",
        stop_bits=1, cycle_hz=50.0, gap_s=None, engine="rt", joints=joints, text=text,
        watchdog_s=0.2,
    )  # fmt: skip


def table_of(spec):
    plan = DrivePlan(spec.joints, 0.0, lambda _: 0.0)
    layout = layout_of(spec, plan, 0.02)
    return layout, ffi.new("board_table *", board_table(spec, plan, layout, 0.02, 0.001))


def c_write(spec, raw):
    layout, table = table_of(spec)
    payload = bytearray(lib.BOARD_PAYLOAD_MAX)
    for name, value in raw.items():
        place = layout.sent[name]
        word = value.to_bytes(place["bytes"], "little", signed=True)
        payload[place["byte"] : place["byte"] + place["bytes"]] = word
    out = ffi.new("uint8_t[]", lib.BOARD_TEXT_MAX)
    return bytes(ffi.buffer(out, lib.board_text_write(table, bytes(payload), out)))


def python_write(spec, raw):
    template, sent, _ = texts_of(spec)
    motors = {
        joint.name: joint.profile.registers[f"target_{joint.channel}"].to_si(
            raw[f"target_{joint.channel}"]
        )
        for joint in spec.joints
    }
    if set(sent.fields) == {LINEAR, ANGULAR}:
        signs = {joint.name: -1.0 if joint.inverted else 1.0 for joint in spec.joints}
        wheels = {j.name: motors[j.name] * signs[j.name] / j.gear_ratio for j in spec.joints}
        return sent.say(twist_of(template, wheels))
    return sent.say({name: value * template.scale for name, value in motors.items()})


def numbers(line):
    return [float(word) for word in line.decode().replace(";", " ").split()]


RAW = st.integers(-1_000_000, 1_000_000)


@given(FORMATS, RAW, RAW)
@example("d", 1000, 3000)
@example("+07.2f", -5, 5)
@example(".0g", 1, 380)  # 0.95 may become 0.9 or 1
def test_a_joint_s_number_is_written_as_python_writes_it(form, left, right):
    spec = spec_of(f"{{left:{form}}};{{right:{form}}}\n")
    raw = {"target_1": left, "target_2": right}
    python, c = python_write(spec, raw), c_write(spec, raw)
    tie = form[-1] == "g" and numbers(c) != numbers(python)  # may differ by a digit in length
    if not tie and 0.0 not in numbers(python):  # C has no -0
        assert len(c) == len(python)
    assert c.count(b";") == 1
    last_digit = 10.0 ** -(int(form[-2]) if form[-1] == "f" and "." in form else 0)
    for ours, theirs in zip(numbers(c), numbers(python), strict=True):
        tolerance = last_digit if form[-1] in "df" else 1e-5
        assert math.isclose(ours, theirs, rel_tol=tolerance, abs_tol=1.01 * last_digit)


@given(RAW, RAW)
def test_the_base_s_speeds_are_written_as_python_writes_them(left, right):
    spec = spec_of("{v:.6f} {w:.6f}\n")
    raw = {"target_1": left, "target_2": right}
    python, c = python_write(spec, raw), c_write(spec, raw)
    for ours, theirs in zip(numbers(c), numbers(python), strict=True):
        assert math.isclose(ours, theirs, abs_tol=2e-6)


@pytest.mark.parametrize(
    ("form", "raw", "line"),
    [
        ("d", 600, b"2,-2\n"),  # 1.5 and -1.5 are rounded to the even number
        ("d", 200, b"0,0\n"),  # and so are 0.5 and -0.5
        ("+06.1f", 600, b"+001.5,-001.5\n"),
        (" .2f", 600, b" 1.50,-1.50\n"),
        ("7.3f", 0, b"  0.000,  0.000\n"),
        (".3g", 600, b"1.5,-1.5\n"),
    ],
)
def test_formats_are_those_of_python(form, raw, line):
    spec = spec_of(f"{{left:{form}}},{{right:{form}}}\n")
    assert c_write(spec, {"target_1": raw, "target_2": -raw}) == line


def test_a_line_that_would_be_too_long_is_not_written():
    spec = spec_of("." * 220 + "{left:.1f},{right:.1f}\n")
    assert c_write(spec, {"target_1": 1_000_000, "target_2": 1_000_000})
    _, table = table_of(spec)
    table.written.part[0].width = table.written.part[1].width = 99
    out = ffi.new("uint8_t[]", lib.BOARD_TEXT_MAX)
    assert lib.board_text_write(table, bytes(lib.BOARD_PAYLOAD_MAX), out) == 0


FEEDBACK = "E {left_count} {right_count}, {left_rad_s}\tend\n"


def c_read(text, line):
    raw = ffi.new("board_text *", board_text.read(text, {}))
    payload = ffi.new("uint8_t[]", lib.BOARD_PAYLOAD_MAX)
    if not lib.board_text_read(raw, line, len(line), payload):
        return None
    words = bytes(ffi.buffer(payload))
    return {
        name: int.from_bytes(words[6 * n : 6 * n + 6], "little", signed=True)
        for n, name in enumerate(text.fields)
    }


def same(text, line):
    python, c = text.read(line), c_read(text, line)
    if python is None:
        assert c is None
        return
    assert c is not None
    for name, value in python.items():
        held = min(max(value, -(2.0**47)), 2.0**47 - 1)
        assert math.isclose(c[name], held, rel_tol=1e-12, abs_tol=0.5 + 1e-6)


@given(
    st.lists(
        st.sampled_from(["E", "end", ",", "-", "+", ".", "e", "E5", "1e3", " ", "\t", "12", "0.5"])
        | st.floats(allow_nan=False, allow_infinity=False, width=32).map(str),
        max_size=12,
    ).map("".join)
)
@example("E 1 2, 3 end")
@example("  E  -7\t12 , 1.5 end")
@example("E 1 2,3 end ")
@example("E 1 2, 3. end")
@example("E .5 2e2, +3E-1\v end")
@example("E 1e999 2, 3 end")
@example("E 1 2, 3e end")
def test_any_line_is_read_alike_in_c_and_python(line):
    same(Text(FEEDBACK, ("left_count", "right_count", "left_rad_s")), line.encode())


@given(
    st.lists(st.integers(-(2**40), 2**40), min_size=3, max_size=3),
    st.sampled_from(["", " ", "\t ", "\f"]),
)
def test_a_line_that_fits_the_template_is_read(values, white):
    left, right, speed = values
    text = Text(FEEDBACK, ("left_count", "right_count", "left_rad_s"))
    line = f"{white}E {left} {white}{right}, {speed}\tend{white}".encode()
    assert c_read(text, line) == {"left_count": left, "right_count": right, "left_rad_s": speed}


@given(st.binary(max_size=40))
def test_any_bytes_are_read_or_refused_without_harm(line):
    text = Text("{a},{b}\n", ("a", "b"))
    if all(chr(byte) in string.printable for byte in line):
        same(text, line)
    else:
        c_read(text, line)


OBJECT = Text('{{"T":1001,"L":{a},"v":{b}}}', ("a", "b"))
MEMBERS = st.sampled_from(["T", "L", "v", "LL", "", "x y"])
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**40), 2**40) | st.just(1001)
    | st.floats(-1e9, 1e9) | st.text(string.printable, max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(MEMBERS, inner, max_size=3),
    max_leaves=6,
)  # fmt: skip


@given(st.dictionaries(MEMBERS, VALUES), st.sampled_from([None, (",", ":"), (" , ", "\t: ")]))
@example({"v": 1205, "T": 1001, "o": {"L": [1, "}"]}, "L": 0.25}, None)
@example({"T": 1001, "L": 0.25}, None)
@example({"T": 1001, "L": "0.25", "v": 1}, None)
def test_an_object_is_read_alike_in_c_and_python(members, separators):
    same(OBJECT, json.dumps(members, separators=separators).encode())


@given(st.text('{}[]":,\\ TLv0123456789.e-', max_size=60))
def test_any_text_like_an_object_is_read_or_refused_without_harm(line):
    found = c_read(OBJECT, line.encode())
    assert found is None or all(abs(value) < 2**47 for value in found.values())


# ----------------------------------------------------------------------------------------- tables
def test_a_table_that_reaches_out_of_its_payload_is_refused():
    _, table = table_of(spec_of("{left:.2f},{right:.2f}\n"))
    name = ffi.new("char[]", lib.FIELD_NAME_BYTES)
    assert lib.board_table_check(table, name) == ffi.NULL
    for path, value in (
        ("payload_bytes", 191), ("payload_bytes", 0), ("setpoint_count", 9), ("field_count", 73),
        ("quick_stop_count", 9), ("period_ns", 0), ("silence_ns", 0), ("tries", 0), ("dialect", 4),
        ("disarm_count", 9), ("setpoint_timeout_ns", 0), ("watchdog_ns", -1),
        ("feedback_bytes", 191), ("answers", 1), ("rest_velocity_rad_s", 0.0),
        ("rest_velocity_rad_s", math.nan),
    ):  # fmt: skip
        before = getattr(table, path)
        setattr(table, path, value)
        assert lib.board_table_check(table, name) != ffi.NULL, path
        setattr(table, path, before)
    scale = table.setpoint[0].scale
    for one, key, value in (
        (table.setpoint[0].place, "byte", 190), (table.setpoint[0].place, "bytes", 7),
        (table.setpoint[0].place, "byte", 2**32 - 1), (scale, "joint", 8),
        (scale, "raw_per_si", math.nan), (scale, "raw_max", math.inf),
        (scale, "raw_min", 1.0), (table.disarm[0], "raw", 2**40),
        (table.written.part[0], "literal_bytes", 257), (table.written.part[0], "width", 100),
        (table.written.part[0], "form", 0), (table.written.part[0], "sign", ord("%")),
        (table.written.part[0].number_per_raw, 0, math.inf),
    ):  # fmt: skip
        before = one[key] if isinstance(key, int) else getattr(one, key)
        put(one, key, value)
        assert lib.board_table_check(table, name) != ffi.NULL, key
        put(one, key, before)
    assert lib.board_table_check(table, name) == ffi.NULL


def put(one, key, value):
    if isinstance(key, int):
        one[key] = value
    else:
        setattr(one, key, value)
