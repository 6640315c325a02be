# SPDX-License-Identifier: Apache-2.0
"""Another drive answers than the one that the robot file names: it is refused, by both names, and
nothing is written to it."""

import dataclasses

import pytest
from loop_side import running, until
from sim_bench import simulated, spec_of, with_rt
from tests.long_cases import long_but
from tests.shipped import NAMES, shipped_profile

from motord_hal.base.errors import HalError
from motord_hal.fieldbus.ports import DriveState, EventKind

KNOWN = [name for name in NAMES if shipped_profile(name).identity]
BY_SPEED = with_rt([name for name in KNOWN if not shipped_profile(name).goes_to_positions])
FEW = with_rt(["sts3215", "odrive-0.6", "cia402"])
ANOTHER = 12345


@pytest.fixture
def sim(profile, folder, answers):
    """The simulated drives: of the profile, but they report another number."""
    with simulated(answers(profile), folder) as control:
        yield control


def another(profile):
    name = profile.identity[0].register
    register = dataclasses.replace(profile.registers[name], default=ANOTHER & 0xFF)
    return dataclasses.replace(profile, registers={**profile.registers, name: register})


def an_scs0009(_profile):
    return shipped_profile("scs0009")


def itself(profile):
    return profile


async def refusal(rig):
    """Return what the log says of the drives, when both are refused."""

    def texts():
        kind = EventKind.DRIVE_UNRESPONSIVE
        return [event.text for event in rig.events if event.kind is kind]

    await until(lambda: len(texts()) == 2, "both drives are refused")
    assert rig.states() == {DriveState.UNRESPONSIVE}
    with pytest.raises(HalError, match="cannot be armed"):
        await rig.line.arm()
    return texts()[0]


@pytest.mark.parametrize("variant", long_but(FEW, BY_SPEED), indirect=True)
@pytest.mark.parametrize("answers", [another])
async def test_a_drive_that_reports_another_model_is_refused(variant, sim, profile, folder):
    async with running(spec_of(profile, folder)) as rig:
        text = await refusal(rig)
        assert f"is refused: another drive answers, not {profile.title}" in text
        assert f"{profile.identity[0].register} is {ANOTHER & 0xFF}" in text
        assert not any(joint.enabled for joint in sim.truth().joints.values())


@pytest.mark.parametrize("variant", ["sts3215"], indirect=True)
@pytest.mark.parametrize("answers", [an_scs0009])
async def test_a_servo_of_another_series_is_refused_by_its_name(variant, sim, profile, folder):
    async with running(spec_of(profile, folder)) as rig:
        assert f"is refused: a Feetech SCS0009 answers, not {profile.title}" in await refusal(rig)


@pytest.mark.parametrize("variant", ["cia402 rt", "sts3215"], indirect=True)
@pytest.mark.parametrize("answers", [itself])
async def test_a_number_of_the_robot_file_is_compared(variant, sim, profile, folder):
    """In place of the profile's: a serial number, or a model that its profile does not know."""
    name = "serial_number" if profile.can else "model_number"
    for value, fits in ((profile.registers[name].default, True), (ANOTHER, False)):
        spec = spec_of(profile, folder)
        joints = (dataclasses.replace(one, identity={name: value}) for one in spec.joints)
        async with running(dataclasses.replace(spec, joints=tuple(joints))) as rig:
            if fits:
                await rig.ready()
            else:
                assert f"{name} is" in await refusal(rig)


def keeps_its_middle(profile):
    """A servo whose own limits were set, as its maker's tool does it."""
    channel = profile.channels[1]
    ends = {channel.position_least: 1500, channel.position_greatest: 2500}
    registers = {
        name: dataclasses.replace(register, default=ends.get(name, register.default))
        for name, register in profile.registers.items()
    }
    return dataclasses.replace(profile, registers=registers)


@pytest.mark.parametrize("variant", ["sts3215-position", "xm430-position"], indirect=True)
@pytest.mark.parametrize("answers", [keeps_its_middle])
async def test_a_servo_that_keeps_a_narrower_range_than_its_joint_is_refused(
    variant, sim, profile, folder
):
    for wide_rad, fits in ((0.25, True), (0.5, False)):
        spec = spec_of(profile, folder)
        own = {"position_min_rad": -wide_rad, "position_max_rad": wide_rad, "zero_count": 2000}
        own["position_velocity_rad_s"] = 1.0
        joints = [dataclasses.replace(one, **own) for one in spec.joints]
        async with running(dataclasses.replace(spec, joints=tuple(joints))) as rig:
            if fits:
                await rig.ready()
            else:
                text = await refusal(rig)
                assert "the drive itself keeps 1500 to 2500" in text
                assert "-0.5 to 0.5 rad are 1348 to 2652" in text
