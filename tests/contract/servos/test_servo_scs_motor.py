# SPDX-License-Identifier: Apache-2.0
"""Feetech's SCS series as wheel motors: the maker's SDK drives the simulated servos in motor mode,
and motord's line drives servos whose packets that SDK makes."""

import math

import pytest
import scservo_sdk
from loop_side import running, until
from sdk_master import opened, patiently, wait_until
from sdk_servo import READ, SYNC_READ, SYNC_WRITE, WRITE, CapturedPort, ScsSdk, SdkServos
from sim_bench import simulated, spec_of, without_power

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import DriveState
from motord_hal.servo.packets import decode, encode

PROFILE = find_profile("scs0009")
UNITS = (1, 2)
LIMITS, TORQUE, DUTY, LOCK = slice(9, 13), 40, 44, 48
AS_DELIVERED = bytes((0, 20, 3, 235))
"""Both angle limits of a new servo, 20 and 1003: it goes to positions."""


class MotorServos(SdkServos):
    """New servos that record what they are sent, in order. `duties`: (unit, torque, raw)."""

    def __init__(self, path, limits=AS_DELIVERED):
        super().__init__(path, ScsSdk(), UNITS)
        self.limit_writes = []
        self.moved_by_limits = False
        self.duties = []
        for table in self.tables.values():
            table[LIMITS], table[TORQUE], table[LOCK] = limits, 1, 0

    def _write(self, unit, first, data):
        table = self.tables[unit]
        if first < LIMITS.stop and first + len(data) > LIMITS.start:
            self.limit_writes.append((unit, first, bytes(data), table[LOCK]))
            self.moved_by_limits |= bool(table[TORQUE])
        table[first : first + len(data)] = data
        if first == DUTY:
            self.duties.append((unit, table[TORQUE], bytes(data)))
        # a servo that has torque when it is found may turn: it gets a duty of zero
        rests = first == DUTY and bytes(data) == sdk_duty(0)
        self.powered_in_other_modes += bool(table[TORQUE] and any(table[LIMITS]) and not rests)

    def duty(self, unit):
        return bytes(self.tables[unit][DUTY : DUTY + 2])


def sdk_duty(raw):
    """Return a duty in the bytes that the SDK's WritePWM sends."""
    handler = scservo_sdk.scscl(CapturedPort())
    word = handler.scs_toscs(raw, 10)
    return bytes((handler.scs_lobyte(word), handler.scs_hibyte(word)))


def test_every_duty_is_encoded_as_the_makers_sdk_encodes_it():
    register = PROFILE.registers["goal_duty"]
    for raw in range(-1000, 1001):
        assert encode(register, raw) == sdk_duty(raw)
        assert decode(register, sdk_duty(raw)) == raw
    assert register.from_si(-1.0) == -1000
    for nothing in (math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match="cannot be written"):
            register.from_si(nothing)


# ---------------------------------------------------------------- the SDK, simulated servos
def test_the_makers_sdk_turns_simulated_servos_only_in_motor_mode(tmp_path):
    with (
        simulated(PROFILE, tmp_path) as control,
        opened(scservo_sdk.PortHandler(""), tmp_path / "bus") as port,
    ):
        servo = scservo_sdk.scscl(port)

        def speed_rad_s():
            return control.truth().joints["left"].velocity_rad_s

        def torque(on):
            patiently(lambda: servo.write1ByteTxRx(1, scservo_sdk.SCSCL_TORQUE_ENABLE, on))

        def limits():
            return [patiently(lambda at=at: servo.read2ByteTxRx(1, at))[0] for at in (9, 11)]

        torque(1)
        patiently(lambda: servo.WritePWM(1, 500))
        assert limits() == [20, 1003]
        assert control.truth().moved_max_m_s == 0.0, "with limits it goes to positions"
        patiently(lambda: servo.PWMMode(1))
        assert limits() == [0, 0]
        wait_until(lambda: speed_rad_s() > 3.0)
        patiently(lambda: servo.WritePWM(1, -500))
        wait_until(lambda: speed_rad_s() < -3.0)
        patiently(lambda: servo.WritePWM(1, 0))
        wait_until(lambda: control.truth().at_rest)
        patiently(lambda: servo.WritePWM(1, 1000))
        wait_until(lambda: speed_rad_s() > 3.0)
        torque(0)
        wait_until(lambda: control.truth().at_rest)
        assert control.stats()["lines"]["bus"]["bad_crc"] == 0


@pytest.mark.parametrize("locked", [True, False])
def test_a_simulated_servo_keeps_its_mode_without_power_where_its_lock_was_open(tmp_path, locked):
    with (
        simulated(PROFILE, tmp_path) as control,
        opened(scservo_sdk.PortHandler(""), tmp_path / "bus") as port,
    ):
        servo = scservo_sdk.scscl(port)
        patiently(lambda: (servo.LockEprom if locked else servo.unLockEprom)(1))
        patiently(lambda: servo.PWMMode(1))
        with without_power(control, 1):
            pass
        found = [patiently(lambda at=at: servo.read2ByteTxRx(1, at))[0] for at in (9, 11)]
        assert found == ([20, 1003] if locked else [0, 0])


# ------------------------------------------------------------- motord's line, the SDK's packets
async def test_the_line_drives_servos_that_the_makers_sdk_emulates(tmp_path):
    servos = MotorServos(tmp_path / "bus")
    try:
        async with running(spec_of(PROFILE, tmp_path)) as rig:

            def duties_are(left, right):
                wanted = [sdk_duty(left), sdk_duty(right)]
                return lambda: [servos.duty(unit) for unit in UNITS] == wanted

            rig.loop.duty = {0: 0.7, 1: 0.7}
            await rig.ready()
            assert [table[TORQUE] for table in servos.tables.values()] == [0, 0]
            await rig.arm()
            assert {raw for _, _, raw in servos.duties} == {sdk_duty(0)}, "zero until it may move"
            rig.loop.duty = {0: 0.5, 1: 0.25}
            await rig.drive(duties_are(500, -250), "the right one is mounted mirrored")
            rig.loop.duty = {0: -0.5, 1: -0.001}
            await rig.drive(duties_are(-500, 1), "and back")
            rig.loop.duty = {0: 9.0, 1: 9.0}
            await rig.drive(duties_are(1000, -1000), "held at what it can")
            for nothing in (math.nan, math.inf, -math.inf):
                rig.loop.duty = {0: 0.5, 1: 0.5}
                await rig.drive(duties_are(500, -500), "on again")
                rig.loop.duty = {0: nothing, 1: nothing}
                await rig.drive(duties_are(0, 0), f"{nothing} is rest")
            measured = rig.loop.exchange.take_feedback(0)
            assert measured.stamp_ns > 0, "it answers"
            assert math.isnan(measured.velocity_rad_s), "and measures no motion"
            rig.loop.duty = {0: 0.5, 1: 0.5}
            await rig.drive(duties_are(500, -500), "on again")
            await rig.line.disarm()
            assert rig.states() == {DriveState.READY}
            assert duties_are(0, 0)()
            assert [table[TORQUE] for table in servos.tables.values()] == [0, 0]
        assert {READ, WRITE} <= set(servos.codes)
        assert not {SYNC_READ, SYNC_WRITE} & set(servos.codes)
        assert servos.foreign == []
        assert servos.powered_in_other_modes == 0
        assert all(raw == sdk_duty(0) for _, torque, raw in servos.duties if not torque)
    finally:
        servos.close()


async def test_the_limits_are_written_once_without_torque_and_with_the_lock_closed(tmp_path):
    servos = MotorServos(tmp_path / "bus")
    try:
        async with running(spec_of(PROFILE, tmp_path)) as rig:
            await rig.ready()
            await rig.arm()
            await rig.line.disarm()
        assert sorted(servos.limit_writes) == [
            (unit, first, bytes(2), 1) for unit in UNITS for first in (9, 11)
        ]
        assert not servos.moved_by_limits
    finally:
        servos.close()


async def test_the_memory_of_servos_already_in_motor_mode_is_not_written(tmp_path):
    servos = MotorServos(tmp_path / "bus", limits=bytes(4))
    try:
        async with running(spec_of(PROFILE, tmp_path)) as rig:
            await rig.ready()
            await rig.arm()
        assert servos.limit_writes == []
    finally:
        servos.close()


async def test_a_servo_that_lost_its_mode_with_its_power_is_disarmed_and_set_up_again(tmp_path):
    servos = MotorServos(tmp_path / "bus")
    try:
        async with running(spec_of(PROFILE, tmp_path)) as rig:
            await rig.arm()
            rig.loop.duty = {0: 0.5, 1: 0.5}
            await rig.drive(lambda: servos.duty(1) == sdk_duty(500), "they turn")
            servos.tables[1][LIMITS] = AS_DELIVERED  # its power failed for a moment
            await until(lambda: rig.line.drive_states["left"] is not DriveState.ARMED)
            rig.loop.enabled = False
            await rig.ready()
            assert servos.tables[1][LIMITS] == bytes(4)
            assert servos.tables[1][TORQUE] == 0
            assert servos.duty(1) == sdk_duty(0)
            assert any("lost its set-up" in event.text for event in rig.events)
    finally:
        servos.close()
