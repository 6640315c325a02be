# SPDX-License-Identifier: Apache-2.0
"""The makers' SDKs against motord: their masters drive the simulated servos, and motord's line
drives servos whose packets they make."""

import dataclasses
import math

import dynamixel_sdk
import pytest
import scservo_sdk
from loop_side import running, until
from sdk_master import BAUDRATE, OK, opened, patiently, wait_until
from sdk_servo import (
    FAST_SYNC_READ,
    SYNC_READ,
    SYNC_WRITE,
    DynamixelSdk,
    FeetechSdk,
    SdkServos,
)
from sim_bench import simulated, spec_of

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import DriveState

STEPS = 1000
"""Goal velocity of a Feetech servo in steps per second; a turn has 4096 steps."""
UNITS = 100
"""Goal velocity of a Dynamixel in units of 0.229 rpm."""


def truth_rad_s(control):
    return [joint.velocity_rad_s for joint in control.truth().joints.values()]


# -------------------------------------------------------------- their masters, simulated servos
def test_feetech_s_sdk_drives_simulated_servos(tmp_path):
    profile = dataclasses.replace(find_profile("sts3215"), baudrate=BAUDRATE)
    with (
        simulated(profile, tmp_path) as control,
        opened(scservo_sdk.PortHandler(""), tmp_path / "bus") as port,
    ):
        servo = scservo_sdk.sms_sts(port)
        write = scservo_sdk.GroupSyncWrite(servo, scservo_sdk.SMS_STS_GOAL_SPEED_L, 2)
        read = scservo_sdk.GroupSyncRead(servo, scservo_sdk.SMS_STS_PRESENT_POSITION_L, 15)
        for unit in (1, 2):
            assert patiently(lambda unit=unit: servo.ping(unit))[0] == 777
            for address, value in ((40, 0), (41, 0), (33, 1), (40, 1)):
                patiently(lambda u=unit, a=address, v=value: servo.write1ByteTxRx(u, a, v))
            goal = servo.scs_toscs(-STEPS if unit == 2 else STEPS, 15)
            write.addParam(unit, [servo.scs_lobyte(goal), servo.scs_hibyte(goal)])
            read.addParam(unit)
        assert write.txPacket() == OK

        def speeds():
            if read.txRxPacket() != OK:
                return []
            return [servo.scs_tohost(read.getData(unit, 58, 2), 15) for unit in (1, 2)]

        wait_until(lambda: [abs(speed) > 0.95 * STEPS for speed in speeds()] == [True, True])
        left, right = truth_rad_s(control)
        assert left == pytest.approx(STEPS / 4096 * math.tau / 2, rel=0.1)  # with a gear of 2
        assert right == pytest.approx(left, rel=0.1)  # mounted in reverse
        assert read.getData(1, 62, 1) in range(100, 130)
        assert read.getData(1, 56, 2) in range(4096)
        for unit in (1, 2):
            patiently(lambda unit=unit: servo.write1ByteTxRx(unit, 40, 0))
        wait_until(lambda: control.truth().at_rest)
        stats = control.stats()["lines"]["bus"]
        assert stats["bad_crc"] == 0


@pytest.mark.parametrize("fast", [False, True])
def test_robotis_sdk_drives_simulated_servos(fast, tmp_path):
    profile = dataclasses.replace(find_profile("xl430"), baudrate=BAUDRATE)
    handler = dynamixel_sdk.PacketHandler(2.0)
    with (
        simulated(profile, tmp_path) as control,
        opened(dynamixel_sdk.PortHandler(""), tmp_path / "bus") as port,
    ):
        write = dynamixel_sdk.GroupSyncWrite(port, handler, 104, 4)
        read = dynamixel_sdk.GroupSyncRead(port, handler, 126, 21)
        for unit in (1, 2):
            assert patiently(lambda unit=unit: handler.ping(port, unit))[0] == 1060
            for address, value in ((64, 0), (11, 1), (64, 1)):
                patiently(lambda u=unit, a=address, v=value: handler.write1ByteTxRx(port, u, a, v))
            goal = -UNITS if unit == 2 else UNITS
            write.addParam(unit, goal.to_bytes(4, "little", signed=True))
            read.addParam(unit)
        assert write.txPacket() == OK

        def speeds():
            if (read.fastSyncRead() if fast else read.txRxPacket()) != OK:
                return []
            raw = [read.getData(unit, 128, 4) for unit in (1, 2)]
            return [one - (1 << 32) if one >> 31 else one for one in raw]

        wait_until(lambda: [abs(speed) > 0.95 * UNITS for speed in speeds()] == [True, True])
        left, right = truth_rad_s(control)
        assert left == pytest.approx(UNITS * 0.229 / 60 * math.tau / 2, rel=0.1)
        assert right == pytest.approx(left, rel=0.1)
        locked = patiently(lambda: handler.write1ByteTxRx(port, 1, 11, 3))
        assert handler.getRxPacketError(locked[-1]) != ""  # torque locks its EEPROM
        too_fast = patiently(lambda: handler.write4ByteTxRx(port, 1, 104, 1000))
        assert too_fast[-1] == 4
        for unit in (1, 2):
            patiently(lambda unit=unit: handler.write1ByteTxRx(port, unit, 64, 0))
        wait_until(lambda: control.truth().at_rest)
        assert control.stats()["lines"]["bus"]["bad_crc"] == 0


def test_robotis_sdk_sees_the_watchdog_trip_and_clears_it(tmp_path):
    profile = dataclasses.replace(find_profile("xl430"), baudrate=BAUDRATE)
    handler = dynamixel_sdk.PacketHandler(2.0)
    with (
        simulated(profile, tmp_path) as control,
        opened(dynamixel_sdk.PortHandler(""), tmp_path / "bus") as port,
    ):
        for address, value in ((11, 1), (64, 1), (98, 5)):
            patiently(lambda a=address, v=value: handler.write1ByteTxRx(port, 1, a, v))
        patiently(lambda: handler.write4ByteTxRx(port, 1, 104, UNITS))
        units = lambda: control.stats()["lines"]["bus"]["units"]["1"]  # noqa: E731
        wait_until(lambda: units()["watchdog_bites"] == 1)
        wait_until(lambda: control.truth().at_rest)
        assert patiently(lambda: handler.read1ByteTxRx(port, 1, 98))[0] == 0xFF
        assert patiently(lambda: handler.read1ByteTxRx(port, 1, 64))[0] == 1
        assert patiently(lambda: handler.write4ByteTxRx(port, 1, 104, UNITS))[-1] == 4
        patiently(lambda: handler.write1ByteTxRx(port, 1, 98, 0))
        assert patiently(lambda: handler.write4ByteTxRx(port, 1, 104, UNITS))[-1] == 0


# ---------------------------------------------------------------- motord's line, their packets
async def test_a_servo_whose_watchdog_tripped_is_disarmed_and_set_up_again(tmp_path):
    servos = SdkServos(tmp_path / "bus", DynamixelSdk(), (1, 2))
    try:
        async with running(spec_of(find_profile("xl430"), tmp_path)) as rig:
            await rig.arm()
            given = servos.tables[1][98]
            assert given * 0.02 == rig.line.spec.watchdog_s
            rig.loop.velocity_rad_s = {0: 0.5, 1: 0.5}
            await rig.drive(lambda: servos.goal(1) != 0, "they turn")
            servos.tables[1][98] = 0xFF  # it has tripped
            left = rig.line.drive_states
            await until(lambda: rig.line.drive_states["left"] is not DriveState.ARMED, str(left))
            rig.loop.enabled = False
            await rig.ready()
            assert servos.tables[1][98] == given
            assert servos.tables[1][servos.sdk.torque] == 0
            assert any("lost its set-up" in event.text for event in rig.events)
            await rig.arm()  # it is armed by request alone
    finally:
        servos.close()


@pytest.mark.parametrize(("name", "sdk"), [("sts3215", FeetechSdk), ("xl430", DynamixelSdk)])
async def test_the_line_drives_servos_that_the_makers_sdk_emulates(name, sdk, tmp_path):
    profile = find_profile(name)
    servos = SdkServos(tmp_path / "bus", sdk(), (1, 2))
    try:
        async with running(spec_of(profile, tmp_path)) as rig:

            def speeds_are(wanted_rad_s):
                measured = [rig.loop.exchange.take_feedback(n).velocity_rad_s for n in (0, 1)]
                return all(abs(speed - wanted_rad_s) < 0.05 for speed in measured)

            await rig.arm()
            assert servos.powered_in_other_modes == 0
            for wanted_rad_s in (0.7, -0.7):
                rig.loop.velocity_rad_s = {0: wanted_rad_s, 1: wanted_rad_s}
                await rig.drive(lambda: speeds_are(wanted_rad_s), "as sent")  # noqa: B023
            await rig.line.disarm()
            assert rig.states() == {DriveState.READY}
            await until(lambda: speeds_are(0.0), "they rest")
            assert [table[servos.sdk.torque] for table in servos.tables.values()] == [0, 0]
            assert [servos.goal(unit) for unit in (1, 2)] == [0, 0]
        assert {SYNC_READ, SYNC_WRITE} <= set(servos.codes)
        assert servos.foreign == []
    finally:
        servos.close()


async def test_the_line_reads_all_servos_in_one_packet_and_each_alone_while_one_is_missing(
    tmp_path,
):
    servos = SdkServos(tmp_path / "bus", DynamixelSdk(), (1, 2))
    spec = dataclasses.replace(spec_of(find_profile("xl430"), tmp_path), fast_sync_read=True)
    try:
        async with running(spec) as rig:

            def speed_rad_s(joint):
                return rig.loop.exchange.take_feedback(joint).velocity_rad_s

            def read_by(code):
                del servos.codes[:]
                return lambda: code in servos.codes

            await rig.arm()
            rig.loop.velocity_rad_s = {0: 0.7, 1: 0.7}
            await rig.drive(
                lambda: all(abs(speed_rad_s(n) - 0.7) < 0.05 for n in (0, 1)), "as sent"
            )
            await until(read_by(FAST_SYNC_READ), "in one packet")
            servos.silent.add(2)
            await until(read_by(SYNC_READ), "each alone")
            await until(lambda: rig.line.drive_states["right"] is DriveState.UNRESPONSIVE)
            assert rig.line.drive_states["left"] is not DriveState.UNRESPONSIVE
            await until(read_by(FAST_SYNC_READ), "the missing one is no longer read")
            servos.silent.clear()
            rig.loop.enabled = False
            await rig.ready()
            await rig.arm()
            await until(read_by(FAST_SYNC_READ), "both in one packet")
        assert servos.foreign == []
    finally:
        servos.close()
