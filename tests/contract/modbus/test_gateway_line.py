# SPDX-License-Identifier: Apache-2.0
"""The line over TCP against the simulated drives behind a gateway, and behind a serial server."""

import dataclasses

import pytest
from gateway_rig import served
from loop_side import running, until
from sim_bench import line_of

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import DriveState, EventKind

KINDS = {"modbus-tcp": False, "rtu-over-tcp": True}


@pytest.fixture(params=KINDS)
def robot(request, tmp_path):
    """A client of the simulator's control socket, and the line that drives the simulated robot."""
    with served(tmp_path, raw=KINDS[request.param]) as (control, (host, port)):
        spec = line_of(find_profile("zlac8015d"), f"{host}:{port}", cycle_hz=500.0)
        yield control, dataclasses.replace(spec, kind=request.param)


def turning(control):
    return any(abs(joint.velocity_rad_s) > 1.0 for joint in control.truth().joints.values())


async def test_wheels_behind_a_gateway_turn_and_come_to_rest(robot):
    control, spec = robot
    async with running(spec) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 3.0, 1: 3.0}
        await until(lambda: turning(control))
        rig.loop.velocity_rad_s = {}
        await until(lambda: control.truth().at_rest)
        await rig.line.disarm()
        assert not any(joint.enabled for joint in control.truth().joints.values())
        assert "bad_reply" not in rig.line.stats().errors
    assert control.stats()["lines"]["bus"]["gap_violations"] == 0


@pytest.mark.parametrize("fault", ["half-open", "tcp-stall:for_s=1.0"])
async def test_a_gateway_that_falls_silent_leaves_the_wheels_at_rest_and_is_found_again(
    robot, fault, monkeypatch
):
    monkeypatch.setattr("motord_hal.modbus.tcp_guard.SILENT_S", 0.5)
    control, spec = robot
    async with running(spec, in_haste=True) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 3.0, 1: 3.0}
        await until(lambda: turning(control))
        control.inject(fault)
        await until(lambda: DriveState.ARMED not in rig.states())
        await until(lambda: control.truth().at_rest)
        await rig.ready()
        assert control.truth().at_rest
        assert EventKind.DRIVE_BACK in rig.kinds()


async def test_a_gateway_that_was_switched_off_is_opened_again_disarmed(robot):
    control, spec = robot
    async with running(spec) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 3.0, 1: 3.0}
        await until(lambda: turning(control))
        control.pull()
        await until(lambda: EventKind.LINE_LOST in rig.kinds())
        await until(lambda: control.truth().at_rest)
        control.plug()
        await rig.ready()
        assert rig.line.stats().reopened == 1
        assert control.truth().at_rest
