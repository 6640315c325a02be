# SPDX-License-Identifier: Apache-2.0
"""Bus servos that go to positions: against simulated ones, whose true angles are known,
and against servos whose packets their makers' SDKs make."""

import dataclasses
import math

import pytest
from loop_side import running, until
from sdk_servo import DynamixelSdk, FeetechSdk, SdkServos
from sim_bench import GEAR, simulated, spec_of, without_power

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import DriveState, EventKind

MIDDLE = 2048
COUNTS_PER_RAD = 4096 * GEAR / math.tau
SERVOS = ["sts3215-position", "xl430-position", "xm430-position"]
NEAR_COUNTS = 6


FAST_RAD_S, LIMITED_RAD_S = 20.0, 1.0


def line_of(name, folder, speed_rad_s=FAST_RAD_S):
    spec = spec_of(find_profile(name), folder)
    own = {"zero_count": MIDDLE, "position_velocity_rad_s": speed_rad_s}
    joints = tuple(dataclasses.replace(joint, **own) for joint in spec.joints)
    return dataclasses.replace(spec, joints=joints)


def counts(rig):
    """Return each joint's count within its turn: the lowest 12 bits of a counter."""
    return [rig.loop.exchange.take_feedback(n).count % 4096 for n in (0, 1)]


def angles_rad(control):
    return [joint.position_rad for joint in control.truth().joints.values()]


@pytest.mark.parametrize("name", SERVOS)
async def test_servos_go_to_their_targets_and_stay_there_without_a_target(name, tmp_path):
    with simulated(find_profile(name), tmp_path) as control:
        async with running(line_of(name, tmp_path)) as rig:

            def are_at(*wanted_rad):
                goals = (
                    MIDDLE + sign * angle * COUNTS_PER_RAD
                    for sign, angle in zip((1, -1), wanted_rad, strict=True)
                )
                return all(
                    abs(count - goal) <= NEAR_COUNTS
                    for count, goal in zip(counts(rig), goals, strict=True)
                )

            await rig.arm()
            assert max(map(abs, angles_rad(control))) < 0.01, "arming moves nothing"
            rig.loop.position_rad = {0: 0.5, 1: -0.4}
            await rig.drive(lambda: are_at(0.5, -0.4), "they are there")
            rig.loop.position_rad = {0: math.nan}
            await rig.drive(lambda: control.truth().at_rest, "they rest")
            assert are_at(0.5, -0.4)
            rig.loop.position_rad = {0: 9.0, 1: -9.0}
            await rig.drive(lambda: counts(rig)[0] > 4085 and counts(rig)[1] > 4085, "the end")
            assert max(counts(rig)) < 4096, "held at its end, not beyond"
            await rig.line.disarm()
            assert rig.states() == {DriveState.READY}


@pytest.mark.parametrize("name", SERVOS)
async def test_a_servo_whose_old_goal_is_far_away_stays_where_it_is_when_it_is_armed(
    name, tmp_path
):
    with simulated(find_profile(name), tmp_path) as control:
        async with running(line_of(name, tmp_path)) as rig:
            await rig.arm()
            rig.loop.position_rad = {0: 0.5, 1: 0.5}
            await rig.drive(lambda: abs(counts(rig)[0] - MIDDLE) > 600, "it is far from its middle")
            await rig.line.disarm()
            rig.loop.enabled, rig.loop.position_rad = False, {}
            await until(lambda: control.truth().at_rest, "they rest")
            before = angles_rad(control)
            await rig.arm()
            cycles = rig.line.stats().cycles
            await rig.drive(lambda: rig.line.stats().cycles > cycles + 30, "it could have moved")
            assert angles_rad(control) == pytest.approx(before, abs=0.01)


@pytest.mark.parametrize("name", SERVOS)
async def test_a_servo_whose_first_target_is_far_from_its_position_loses_its_power(name, tmp_path):
    with simulated(find_profile(name), tmp_path) as control:
        async with running(line_of(name, tmp_path, LIMITED_RAD_S)) as rig:
            await rig.arm()
            rig.loop.position_rad = {0: 1.5, 1: 0.0}  # as far off as with a wrong zero_count
            rig.loop.enabled = True
            await until(lambda: rig.line.drive_states["left"] is DriveState.READY, "no power")
            await until(lambda: any("check zero_count" in one.text for one in rig.events))
            await until(lambda: control.truth().at_rest, "they rest")
            assert max(map(abs, angles_rad(control))) < 0.02


@pytest.mark.parametrize("name", SERVOS)
async def test_old_set_points_take_the_torque_of_moving_servos(name, tmp_path):
    with simulated(find_profile(name), tmp_path) as control:
        async with running(line_of(name, tmp_path)) as rig:
            await rig.arm()
            rig.loop.position_rad = {0: 1.4, 1: 1.4}
            await rig.drive(lambda: angles_rad(control)[0] > 0.05, "they are moving")
            rig.loop.running = False
            await until(lambda: rig.states() == {DriveState.READY}, "the line has stopped them")
            for joint in ("left", "right"):
                assert await rig.line.read_register(joint, "torque_enable") == 0
            await until(lambda: control.truth().at_rest, "they rest")


@pytest.mark.parametrize("name", SERVOS)
async def test_a_servo_that_reboots_comes_back_disarmed_and_goes_nowhere(name, tmp_path):
    with simulated(find_profile(name), tmp_path) as control:
        async with running(line_of(name, tmp_path)) as rig:
            await rig.arm()
            rig.loop.position_rad = {0: 0.5, 1: 0.5}
            await rig.drive(lambda: abs(counts(rig)[0] - MIDDLE) > 600, "it is far from its middle")
            await until(lambda: control.truth().at_rest, "they rest")
            before = angles_rad(control)
            with without_power(control, 1):
                await until(
                    lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds(), "it is unresponsive"
                )
            rig.loop.position_rad = {0: -0.5, 1: 0.5}
            await until(lambda: EventKind.DRIVE_BACK in rig.kinds(), "it is back")
            assert rig.line.drive_states["left"] is DriveState.READY
            cycles = rig.line.stats().cycles
            await until(lambda: rig.line.stats().cycles > cycles + 30, "it could have moved")
            assert angles_rad(control) == pytest.approx(before, abs=0.01)
            assert abs(counts(rig)[0] - MIDDLE) > 600, "its place means the same as before"


@pytest.mark.parametrize(
    ("name", "sdk", "goal", "present", "size"),
    [
        ("sts3215-position", FeetechSdk, 42, 56, 2),
        ("xl430-position", DynamixelSdk, 116, 132, 4),
    ],
)
async def test_no_servo_is_powered_before_its_goal_is_its_own_position(
    name, sdk, goal, present, size, tmp_path
):
    servos = PlacedServos(tmp_path / "bus", sdk(), goal, present, size)
    try:
        async with running(line_of(name, tmp_path)) as rig:
            await rig.ready()
            assert servos.goals_while_resting == []
            await rig.arm()
            assert servos.jumps == []
            rig.loop.position_rad = {0: 0.1, 1: 0.1}
            wanted = round(MIDDLE + 0.1 * COUNTS_PER_RAD)
            await rig.drive(lambda: servos.goal_of(1) == wanted, "its goal goes out")
            rig.loop.position_rad = {}
            sent = len(servos.goals)
            cycles = rig.line.stats().cycles
            await rig.drive(lambda: rig.line.stats().cycles > cycles + 20, "it is read on")
            assert len(servos.goals) <= sent + 2, "what was in transit, and nothing more"
            await rig.line.disarm()
            assert [table[servos.sdk.torque] for table in servos.tables.values()] == [0, 0]
        assert servos.foreign == []
    finally:
        servos.close()


class PlacedServos(SdkServos):
    """SdkServos in position mode, each with an old goal far from its position. A servo with torque
    is at its goal at once."""

    HERE = 1500

    def __init__(self, path, sdk, goal, present, size):
        self.place = goal, present, size
        self.goals, self.jumps = [], []
        self.goals_while_resting = []
        super().__init__(path, sdk, (1, 2))
        for table in self.tables.values():
            table[present : present + size] = self.HERE.to_bytes(size, "little")

    def goal_of(self, unit):
        goal, _, size = self.place
        return int.from_bytes(self.tables[unit][goal : goal + size], "little")

    def _write(self, unit, first, data):
        goal, _, _ = self.place
        table, torque = self.tables[unit], self.sdk.torque
        had_torque = table[torque]
        table[first : first + len(data)] = data
        if first <= goal < first + len(data):
            self.goals.append((unit, self.goal_of(unit)))
            if not had_torque and self.goal_of(unit) != self.HERE:
                self.goals_while_resting.append(self.goals[-1])
        if table[torque] and not had_torque and self.goal_of(unit) != self.HERE:
            self.jumps.append((unit, self.goal_of(unit)))
