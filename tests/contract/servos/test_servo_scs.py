# SPDX-License-Identifier: Apache-2.0
"""Feetech's SCS series, whose numbers are high byte first: the maker's SDK drives the simulated
servos, and motord's line drives servos whose packets that SDK makes."""

import dataclasses
import json
import math
import subprocess
import sys

import pytest
import scservo_sdk
from loop_side import running, until
from sdk_master import opened, patiently, wait_until
from sdk_servo import READ, SYNC_READ, SYNC_WRITE, WRITE, ScsSdk, SdkServos
from sim_bench import GEAR, simulated, spec_of
from tests.sim.daemon_stage import DEADLINE_S, ROOT

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import DriveState

PROFILE = find_profile("scs0009-position")
MIDDLE, AWAY = 614, 200
"""Counts: first position of a simulated servo, half a turn of 1229; length of the SDK's move."""
COUNTS_PER_RAD = 1229 * GEAR / math.tau
NEAR_COUNTS = 4


class ScsServos(SdkServos):
    """Servos that are at their goal at once while they have torque."""

    def _write(self, unit, first, data):
        table = self.tables[unit]
        table[first : first + len(data)] = data
        if table[self.sdk.torque]:
            table[56:58] = table[42:44]


def line_of(folder):
    spec = spec_of(PROFILE, folder)
    joints = tuple(
        dataclasses.replace(joint, zero_count=MIDDLE, position_velocity_rad_s=20.0)
        for joint in spec.joints
    )
    return dataclasses.replace(spec, joints=joints)


def test_the_makers_sdk_moves_simulated_servos(tmp_path):
    with (
        simulated(PROFILE, tmp_path) as control,
        opened(scservo_sdk.PortHandler(""), tmp_path / "bus") as port,
    ):
        servo = scservo_sdk.scscl(port)
        assert patiently(lambda: servo.ping(1))[0] == 1284
        start = patiently(lambda: servo.ReadPos(1))[0]
        goal = start + AWAY if start < MIDDLE else start - AWAY
        assert not any(joint.enabled for joint in control.truth().joints.values())
        patiently(lambda: servo.write1ByteTxRx(1, scservo_sdk.SCSCL_TORQUE_ENABLE, 1))
        patiently(lambda: servo.WritePos(1, goal, 0, 1500))
        assert patiently(lambda: servo.read2ByteTxRx(1, 42))[0] == goal
        wait_until(lambda: abs(patiently(lambda: servo.ReadPos(1))[0] - goal) <= NEAR_COUNTS)
        moved_rad = control.truth().joints["left"].position_rad
        assert moved_rad == pytest.approx((goal - start) / COUNTS_PER_RAD, abs=0.02)
        patiently(lambda: servo.write1ByteTxRx(1, scservo_sdk.SCSCL_TORQUE_ENABLE, 0))
        wait_until(lambda: control.truth().at_rest)
        read = scservo_sdk.GroupSyncRead(servo, scservo_sdk.SCSCL_PRESENT_POSITION_L, 2)
        read.addParam(1)
        assert read.txRxPacket() != 0, "the series has no sync read"


def test_a_scan_names_the_first_profile_of_the_series(tmp_path):
    words = (str(tmp_path / "bus"), "--units", "0-2", "--baudrate", "1000000", "--json")
    with simulated(PROFILE, tmp_path):
        run = subprocess.run(
            [sys.executable, "-m", "motord", "scan", *words],
            capture_output=True, text=True, timeout=DEADLINE_S, cwd=ROOT,
        )  # fmt: skip
    assert run.returncode == 0, run.stderr
    found = [(one["unit"], one["matches"][0]["profile"]) for one in json.loads(run.stdout)["found"]]
    assert found == [(1, "scs0009"), (2, "scs0009")]


async def test_the_line_moves_servos_that_the_makers_sdk_emulates(tmp_path):
    servos = ScsServos(tmp_path / "bus", ScsSdk(), (1, 2))
    for table in servos.tables.values():
        table[56:58] = MIDDLE.to_bytes(2, "big")
    try:
        async with running(line_of(tmp_path)) as rig:

            def goals():
                return [int.from_bytes(servos.tables[unit][42:44], "big") for unit in (1, 2)]

            await rig.arm()
            assert goals() == [MIDDLE, MIDDLE], "its goal is its own position"
            rig.loop.position_rad = {0: 0.5, 1: -0.5}
            far = round(0.5 * COUNTS_PER_RAD)
            await rig.drive(lambda: goals() == [MIDDLE + far, MIDDLE - far], "their goals")
            rig.loop.position_rad = {0: 9.0, 1: -9.0}
            await rig.drive(lambda: goals() == [1023, 0], "held at their ends")
            await rig.line.disarm()
            assert rig.states() == {DriveState.READY}
            assert [table[servos.sdk.torque] for table in servos.tables.values()] == [0, 0]
        assert {READ, WRITE} <= set(servos.codes)
        assert not {SYNC_READ, SYNC_WRITE} & set(servos.codes)
        assert servos.foreign == []
    finally:
        servos.close()


async def test_simulated_servos_go_to_their_targets_and_lose_their_torque_at_a_stop(tmp_path):
    with simulated(PROFILE, tmp_path) as control:
        async with running(line_of(tmp_path)) as rig:
            angles = lambda: [j.position_rad for j in control.truth().joints.values()]  # noqa: E731
            await rig.arm()
            assert max(map(abs, angles())) < 0.02, "arming moves nothing"
            rig.loop.position_rad = {0: 0.6, 1: -0.6}
            await rig.drive(
                lambda: angles() == pytest.approx([0.6, -0.6], abs=0.02), "they are there"
            )
            rig.loop.position_rad = {0: -1.0, 1: 1.0}
            await rig.drive(lambda: angles()[0] < 0.4, "they are moving")
            rig.loop.running = False
            await until(lambda: rig.states() == {DriveState.READY}, "the line has stopped them")
            await until(lambda: control.truth().at_rest, "they rest")
            for joint in ("left", "right"):
                assert await rig.line.read_register(joint, "torque_enable") == 0
