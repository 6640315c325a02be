# SPDX-License-Identifier: Apache-2.0
"""Packets of bus servos, compared with the manual's examples, and the time of a cycle of servos."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.config.drives.load import find_profile
from motord_hal.drives.profile import Register, RegisterType
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.rt_engine.rs485.servo_frames import ServoFrames, cycle_of_all_s, group_of
from motord_hal.servo.packets import (
    Packet,
    PacketError,
    decode,
    encode,
    is_whole,
    packets_of,
    take_all,
)

KINDS = ["feetech", "dynamixel"]
FEETECH, DYNAMIXEL = (packets_of(kind) for kind in KINDS)


def test_the_manual_s_examples_are_built():
    # examples of the ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0: ping, read of a position, write
    assert DYNAMIXEL.build(1, 1).hex() == "fffffd0001030001194e"
    assert DYNAMIXEL.build(1, 2, bytes((0x84, 0, 4, 0))).hex() == "fffffd0001070002840004001d15"
    goal = DYNAMIXEL.build(1, 3, bytes((0x74, 0, 0, 2, 0, 0)))
    assert goal.hex() == "fffffd0001090003740000020000ca89"
    assert FEETECH.build(1, 1).hex() == "ffff010201fb"


@pytest.mark.parametrize("packets", [FEETECH, DYNAMIXEL], ids=KINDS)
@given(
    unit=st.integers(0, 252),
    code=st.sampled_from([1, 2, 3, 0x82, 0x83]),
    parameters=st.binary(max_size=60) | st.lists(st.sampled_from([0xFF, 0xFD, 0])).map(bytes),
)
def test_two_packets_in_a_row_are_both_read_whole(packets, unit, code, parameters):
    packet = packets.build(unit, code, parameters[:200])
    assert list(take_all(packets, packet + packet)) == [Packet(unit, code, parameters[:200])] * 2
    assert is_whole(packets, packet)
    assert not is_whole(packets, packet[:-1])
    assert packets.take(packet[:-1])[0] is None


@pytest.mark.parametrize("packets", [FEETECH, DYNAMIXEL], ids=KINDS)
def test_a_damaged_packet_is_detected(packets):
    packet = bytearray(packets.build(7, 3, b"\x2e\x01\x02"))
    packet[-3] ^= 4
    with pytest.raises(PacketError):
        packets.take(bytes(packet))
    assert list(take_all(packets, bytes(packet))) == [None]


def register(kind, **more):
    return Register(
        name="value", address=46, type=RegisterType(kind), scale=1.0, unit="", access="rw",
        minimum=None, maximum=None, source="", **more,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "raw", "wire"),
    [
        ("u8", 200, "c8"), ("i8", -1, "ff"), ("u16", 0x1234, "3412"), ("i32", -2, "feffffff"),
        ("m16", 1000, "e803"), ("m16", -1000, "e883"), ("u16-high-first", 0x1234, "1234"),
        ("m16-bit10-high-first", 1000, "03e8"), ("m16-bit10-high-first", -1000, "07e8"),
        ("m16-bit10-high-first", -1, "0401"), ("m16-bit10-high-first", 0, "0000"),
    ],
)  # fmt: skip
def test_values_stand_low_byte_first_but_those_of_one_series(kind, raw, wire):
    assert encode(register(kind), raw).hex() == wire
    assert decode(register(kind), bytes.fromhex(wire)) == raw


@pytest.mark.parametrize(("kind", "most"), [("m16", 32767), ("m16-bit10-high-first", 1023)])
def test_a_magnitude_ends_below_its_sign(kind, most):
    assert register(kind).raw_range == (-most, most)
    for raw in (-most - 1, most + 1):
        with pytest.raises(ValueError, match=f"does not fit {kind}"):
            encode(register(kind), raw)
    for raw in (-most, most):
        assert decode(register(kind), encode(register(kind), raw)) == raw


@pytest.mark.parametrize(("wire", "raw"), [("0400", 0), ("0800", 0x800), ("0c01", -0x801)])
def test_bits_beyond_a_magnitude_are_not_lost(wire, raw):
    assert decode(register("m16-bit10-high-first"), bytes.fromhex(wire)) == raw


# ------------------------------------------------------------------------------------- the cycle
def servos(*names, baudrate=1_000_000):
    joints = [
        JointSpec(index=index, name=f"wheel{index}", profile=find_profile(name), unit=index + 1)
        for index, name in enumerate(names)
    ]
    return [ServoFrames([joint], 0.0, lambda count: 10 * count / baudrate) for joint in joints]


def test_the_cycle_of_three_feetech_servos_is_two_heads_and_three_shares():
    # bytes: sync write 8 + 3 x 3, sync read 8 + 3, three statuses of 6 + 15; an extra read in each
    # eighth cycle
    extra = (8 + 6 + 9) / 8
    bytes_a_cycle = 8 + 9 + 8 + 3 + 3 * (21 + extra)
    assert cycle_of_all_s(servos(*["sts3215"] * 3)) == pytest.approx(bytes_a_cycle * 1e-5)


def test_servos_of_one_kind_share_their_cycle_and_others_do_not():
    assert group_of(servos("xl430", "xl430")) is not None
    assert group_of(servos("xl430", "xm430")) is None
    write = group_of(servos("sts3215")).write
    assert write == bytes((0xFF, 0xFF, 0xFE, 4, 0x83, 46, 2))


def test_extra_exchanges_read_torque_watchdog_and_mode():
    (servo,) = servos("xl430")
    read = [name for planned in servo.extra() for name in planned.reads]
    assert {"torque_enable", "bus_watchdog", "operating_mode", "drive_mode"} <= set(read)
    assert set(servo.cyclic()[1].reads) == {"velocity", "position"}


def test_an_instruction_is_written_as_a_register():
    (servo,) = servos("xl430")
    (frame,) = servo.writes({"reboot": 0})
    assert frame.request == DYNAMIXEL.build(1, 8)
