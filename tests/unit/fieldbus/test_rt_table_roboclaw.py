# SPDX-License-Identifier: Apache-2.0
"""A RoboClaw in the table of its line: packets, and the form of their answers."""

import pytest

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.open_line import engine_of
from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.realtime.line import check_table
from motord_hal.realtime.table import FieldKind, Form, Seal
from motord_hal.roboclaw import codec
from motord_hal.rt_engine.rs485.protocols import frames_of
from motord_hal.rt_engine.rs485.table import line_table


def spec_of(*channels, unit=128):
    profile = find_profile("roboclaw")
    joints = tuple(
        JointSpec(index=n, name=f"j{n}", profile=profile, unit=unit, channel=channel)
        for n, channel in enumerate(channels)
    )
    return LineSpec(
        index=0, name="claw", kind="roboclaw", port="/nowhere", baudrate=115200, parity="none",
        stop_bits=1, cycle_hz=50.0, gap_s=None, engine="auto", joints=joints, watchdog_s=0.5,
    )  # fmt: skip


@pytest.fixture
def drive():
    spec = spec_of(1, 2)
    table = line_table(spec, frames_of(spec))
    check_table(spec.name, table)
    return table.drive[0]


def test_a_roboclaw_line_runs_in_c_by_default():
    assert engine_of(spec_of(1)) == "rt"


def test_speeds_go_out_first_and_duties_of_zero_while_it_is_idle(drive):
    speeds, (idle,) = drive.cyclic[0], drive.idle
    assert speeds.frame.request[:2] == bytes((128, codec.SPEEDS))
    assert [one.byte for one in speeds.setpoint] == [2, 6]
    assert idle.request[:6] == bytes((128, codec.DUTIES, 0, 0, 0, 0))
    for frame in (speeds.frame, idle):
        assert (frame.request_seal, frame.match) == (Seal.XMODEM, codec.ACKNOWLEDGED)
        assert (frame.reply_bytes, frame.exact) == (1, 1)


def test_a_reply_to_a_read_is_checked_against_its_request(drive):
    for exchange in (*drive.cyclic[1:], *drive.extra):
        frame = exchange.frame
        assert len(frame.request) == 2
        assert (frame.request_seal, frame.reply_seal) == (Seal.NONE, Seal.WITH_REQUEST)
        assert frame.exact == 1
        assert frame.reply_bytes == codec.READ_BYTES[frame.request[1]] + codec.CRC_BYTES


def test_a_content_of_one_byte_is_a_byte(drive):
    kept = [one for each in drive.extra for one in each.field if one.kind is FieldKind.KEPT]
    assert [(one.byte, one.form, one.equals) for one in kept] == [(0, Form.U8, 5)]


def test_one_motor_leaves_the_other_at_zero():
    spec = spec_of(2)
    table = line_table(spec, frames_of(spec))
    check_table(spec.name, table)
    first = table.drive[0].cyclic[0]
    assert [one.byte for one in first.setpoint] == [6]
    assert first.frame.request[2:10] == bytes(8)
    assert len(table.drive[0].idle) == 1
