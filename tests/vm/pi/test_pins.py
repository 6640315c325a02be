# SPDX-License-Identifier: Apache-2.0
"""A BTS7960 on pins of a Raspberry Pi with its kernel drivers: driven, stopped and killed."""

import asyncio
import signal
import subprocess
import sys

import pytest
from loop_side import GENEROUS_S, running, until
from rig import BRIDGE, NEAR, are, level, spec_of

from motord_hal.base.errors import HalError
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.ports import EventKind


async def reaches(line, condition, what):
    """Keep the line armed until `condition` holds: old set-points of a slow machine stop it."""
    try:
        async with asyncio.timeout(3 * GENEROUS_S):
            while not condition():
                try:
                    await line.line.arm()
                except HalError as error:
                    print(f"not armed: {error}")
                await asyncio.sleep(0.05)
    except TimeoutError:
        raise AssertionError(f"never came true: {what}") from None


async def test_the_bridge_is_forward_backward_braked_and_without_power():
    async with running(spec_of()) as line:
        await line.ready()
        await until(are("coast"), "no power before it is armed")
        line.loop.enabled, line.loop.duty = True, {0: 0.5}
        await reaches(line, are("forward", 0.5), "forward")
        line.loop.duty = {0: -0.25}
        await reaches(line, are("reverse", 0.25), "backward")
        line.loop.duty = {}
        await reaches(line, are("brake"), "braked")
        await line.line.disarm()
        await until(are("coast"), "no power")
    assert are("coast")()
    assert level("pwm0") == level("pwm1") == 0.0


async def test_a_dead_loop_stops_the_motor():
    async with running(spec_of()) as line:
        line.loop.enabled, line.loop.duty = True, {0: 0.5}
        await reaches(line, are("forward", 0.5), "forward")
        line.loop.running = False
        await until(are("coast"), "no power")
        assert EventKind.DRIVE_WARNING in line.kinds()


async def turn():
    """Turn the motor: the work of the process that the test kills."""
    async with running(spec_of()) as line:
        line.loop.enabled, line.loop.duty = True, {0: 0.5}
        await reaches(line, are("forward", 0.5), "forward")
        print("turning", flush=True)
        await asyncio.sleep(600)


@pytest.fixture
def killed():
    """A process that turned the motor, and was killed with it turning."""
    code = "import asyncio, test_pins; asyncio.run(test_pins.turn())"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as child:
        lines = iter(child.stdout.readline, b"")
        assert any(line.strip() == b"turning" for line in lines)
        child.send_signal(signal.SIGKILL)
        child.wait()


@pytest.mark.usefixtures("killed")
async def test_after_kill_9_the_pulses_and_the_enables_stay_until_stop_all_ends_them():
    """This chip leaves a released line at its level: only stop-all stops the motor."""
    assert level("pwm0") == pytest.approx(0.5, abs=NEAR)
    assert await halt_line(spec_of()) == []
    assert are("coast")(), BRIDGE
