# SPDX-License-Identifier: Apache-2.0
"""What a drive gets that turns when motord meets it: every profile, after the program that drove it
was killed at speed. Wheels that lose their power roll on for a minute here."""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from left_running import left_spec
from loop_side import running, until
from sim_bench import RT, simulated, with_rt
from tests.long_cases import long_but
from tests.shipped import NAMES, shipped_profile

from motord_hal.fieldbus.ports import REST_VELOCITY_RAD_S
from motord_hal.sim.plant import WheelModel

ROLLING = WheelModel(inertia_kg_m2=0.15, coulomb_n_m=0.01, viscous_n_m_s_rad=0.001)
NEVER_S = 100.0
"""Time of the drives' watchdogs: they stop no wheel here."""
TURNING_RAD_S = 1.0
BRAKED_UNSEEN = 0.3
"""Part of its speed that a wheel may still have if its drive reports no speed."""
HERE = Path(__file__).parent
LINES = [name for name in NAMES if shipped_profile(name).protocol != "pwm"]


def brakes(name):
    """Whether the drive has a stop that is not its power-off."""
    profile = shipped_profile(name)
    writes = [
        [(step.register, step.value) for step in steps if step.value is not None]
        for steps in (profile.quick_stop, profile.disarm)
    ]
    return writes[0] != writes[1]


def variants(name):
    """Return the variants of a profile; positions are for the engine "rt" alone."""
    return [name + RT] if shipped_profile(name).goes_to_positions else with_rt([name])


BRAKING = [one for name in LINES if brakes(name) for one in variants(name)]
FEW = with_rt(["odrive-0.6", "vesc", "rmd", "moteus", "cia402", "zlac8015d", "sts3215"])


@contextlib.contextmanager
def another_program(variant, folder, port):
    """Another program that turns both wheels; it is killed at the end of the block."""
    program = [sys.executable, str(HERE / "left_running.py")]
    command = [*program, variant, str(folder), port, str(NEVER_S)]
    paths = [str(HERE), str(HERE.parent), str(HERE.parents[2])]
    environ = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    with subprocess.Popen(command, env=environ, stdout=subprocess.PIPE, text=True) as program:
        try:
            yield program
        finally:
            program.send_signal(signal.SIGKILL)


def wheels_rad_s(sim):
    return [abs(joint.velocity_rad_s) for joint in sim.truth().joints.values()]


def sees_speed(profile):
    return all(channel.velocity is not None for channel in profile.channels.values())


def logged(rig):
    return " ".join(event.text for event in rig.events)


@pytest.fixture
def sim(profile, folder):
    watchdog_s = 0.0 if profile.watchdog else NEVER_S
    with simulated(profile, folder, model=ROLLING, watchdog_s=watchdog_s) as control:
        yield control


@pytest.mark.parametrize("variant", long_but(FEW, BRAKING), indirect=True)
async def test_a_drive_that_turns_is_braked_before_it_is_released(variant, profile, sim, folder):
    spec = left_spec(profile, folder)
    with another_program(variant, folder, spec.port) as program:

        def turning():
            assert program.poll() is None, "the other program has ended"
            return min(wheels_rad_s(sim)) > TURNING_RAD_S

        await until(turning, "both wheels turn")
    turned_rad_s = min(wheels_rad_s(sim))
    assert turned_rad_s > TURNING_RAD_S
    async with running(spec) as rig:
        await rig.ready()
        if sees_speed(profile):
            assert max(wheels_rad_s(sim)) < REST_VELOCITY_RAD_S
            assert "braked until it was at rest" in logged(rig)
        else:
            assert max(wheels_rad_s(sim)) < BRAKED_UNSEEN * turned_rad_s
            assert "cannot see whether it turns" in logged(rig)
        released = [not joint.enabled for joint in sim.truth().joints.values()]
        assert all(released) or profile.enabled is None
