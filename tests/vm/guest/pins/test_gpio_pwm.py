# SPDX-License-Identifier: Apache-2.0
"""Motor bridges on the kernel's own GPIO and PWM: the levels of the pins when the line drives;
when it gets no set-points, is stopped or killed; and when another program has its pins."""

import asyncio
import contextlib
import itertools
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from bridge_rig import laid_out, places, spec_of
from pin_rig import LABEL, LINES, PWM, wait_until

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "contract"))
from loop_side import GENEROUS_S, PATIENT_S, running, until

from motord.config.drives.load import find_profile, list_profiles
from motord_hal.base.clock import now_ns
from motord_hal.base.errors import DriveFault, HalError, PortError
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.ports import (
    DriveState,
    EventKind,
    JointSpec,
    LineState,
    PinsSpec,
)
from motord_hal.gpio.lines import Wanted, request_outputs
from motord_hal.pwm.pins import servo_range_rad

ON_PINS = [name for name in list_profiles() if find_profile(name).bridge]
SERVOS = [name for name in ON_PINS if find_profile(name).goes_to_positions]
BRIDGES = [name for name in ON_PINS if name not in SERVOS]
FAILING = Path("/sys/module/pwm_sim/parameters/fail")
NEAR = 0.001
pytestmark = [
    pytest.mark.skipif(not list(PWM.glob("pwmchip*")), reason="no PWM chip (module pwm-sim)"),
    pytest.mark.skipif(not Path("/sys/kernel/config/gpio-sim").is_dir(), reason="no gpio-sim"),
]


def fail_with(number):
    """Make the PWM chip fail every request with errno `number`; 0: no request."""
    FAILING.write_text(str(number))


async def armed(line):
    """Arm, repeatedly if needed: a busy machine may delay set-points until they are too old."""
    async with asyncio.timeout(GENEROUS_S):
        while line.states() != {DriveState.ARMED}:
            await line.ready()
            with contextlib.suppress(HalError):
                await line.line.arm()
            await asyncio.sleep(0.01)


async def reaches(line, condition, what):
    """Keep the line armed until `condition` holds: old set-points of a slow machine stop it."""
    try:
        async with asyncio.timeout(GENEROUS_S):
            while not condition():
                await armed(line)
                await asyncio.sleep(0.01)
    except TimeoutError:
        raise AssertionError(f"never came true: {what}") from None


def places_of_all():
    return [where.values() for where in laid_out(BRIDGES).values()]


def all_bridges(rig):
    """Return the spec of a line with a joint for each kind of bridge."""
    joints = tuple(
        JointSpec(index=index, name=drive, profile=find_profile(drive), unit=index + 1, pins=where)
        for index, (drive, where) in enumerate(laid_out(BRIDGES).items())
    )
    return spec_of(rig, BRIDGES[0], joints=joints)


def are(rig, drive, mode, duty=0.0, where=None):
    """Return a check: whether all pins of a drive have the levels of a mode."""
    levels = find_profile(drive).bridge.levels

    def check():
        return all(
            abs(rig.level(place) - (levels[pin][mode][0] + levels[pin][mode][1] * duty)) < NEAR
            for pin, place in (where or places(drive)).items()
        )

    return check


def levels(rig, where):
    return {pin: rig.level(place) for pin, place in where.items()}


@pytest.mark.smoke
@pytest.mark.parametrize("drive", BRIDGES)
async def test_each_bridge_is_forward_backward_braked_and_without_power_as_the_kernel_sees_it(
    rig, drive
):
    async with running(spec_of(rig, drive)) as line:
        await line.ready()
        await until(are(rig, drive, "coast"), "no power before it is armed")
        line.loop.enabled, line.loop.duty = True, {0: 0.5}
        cycles = line.line.stats().cycles
        await until(lambda: line.line.stats().cycles > cycles + 5)
        assert are(rig, drive, "coast")()
        await reaches(line, are(rig, drive, "forward", 0.5), "forward")
        line.loop.duty = {0: -0.25}
        await reaches(line, are(rig, drive, "reverse", 0.25), "backward")
        line.loop.duty = {}
        await reaches(line, are(rig, drive, "brake"), "braked")
        line.loop.duty = {0: 1.0}
        await reaches(line, are(rig, drive, "forward", 1.0), "full")
        await line.line.disarm()
        await until(are(rig, drive, "coast"), "no power")
    for where in places(drive).values():
        assert rig.level(where) == 0.0


@pytest.mark.parametrize("drive", SERVOS)
async def test_a_servo_has_the_pulses_of_its_angle_while_it_is_armed_as_the_kernel_sees_it(
    rig, drive
):
    spec = spec_of(rig, drive)
    full_rad = servo_range_rad(spec.joints[0])
    async with running(spec) as line:
        line.loop.enabled, line.loop.position_rad = True, {0: full_rad}
        await line.ready()
        cycles = line.line.stats().cycles
        await until(lambda: line.line.stats().cycles > cycles + 5)
        assert are(rig, drive, "coast")()
        await reaches(line, are(rig, drive, "forward", 1.0), "to one end")
        line.loop.position_rad = {0: -full_rad / 2}
        await reaches(line, are(rig, drive, "reverse", 0.5), "halfway to the other end")
        line.loop.running = False
        await until(are(rig, drive, "coast"), "no pulses without a loop")
    for where in places(drive).values():
        assert rig.level(where) == 0.0


@pytest.mark.smoke
async def test_a_dead_loop_brakes_the_motor_and_then_cuts_its_power(rig):
    async with running(spec_of(rig, "bts7960")) as line:
        await armed(line)
        line.loop.enabled, line.loop.duty = True, {0: 0.5}
        await reaches(line, are(rig, "bts7960", "forward", 0.5), "forward")
        line.loop.running = False
        await until(are(rig, "bts7960", "coast"))
        assert line.states() == {DriveState.READY}
        line.loop.running = True
        cycles = line.line.stats().cycles
        await until(lambda: line.line.stats().cycles > cycles + 5)
        assert are(rig, "bts7960", "coast")()
        assert EventKind.DRIVE_WARNING in line.kinds()


@pytest.mark.smoke
async def test_cancelling_the_line_leaves_no_power_and_no_pulses(rig):
    async with running(spec_of(rig, "tb6612fng")) as line:
        await armed(line)
        line.loop.enabled, line.loop.duty = True, {0: -0.7}
        await reaches(line, are(rig, "tb6612fng", "reverse", 0.7), "backward")
    assert are(rig, "tb6612fng", "coast")()
    assert (rig.chip / "pwm0/enable").read_text().strip() == "0"


async def test_a_fault_pin_is_reported_and_prevents_arming(rig):
    rig.drive("PIN11", 1)
    async with running(spec_of(rig, "drv8871", fault=True)) as line:
        await line.ready()
        rig.drive("PIN11", 0)
        await until(lambda: EventKind.DRIVE_FAULT in line.kinds())
        await until(lambda: line.loop.exchange.take_feedback(0).drive_faults == 1)
        with pytest.raises(DriveFault):
            await line.line.arm()
        rig.drive("PIN11", 1)
        await until(lambda: EventKind.DRIVE_FAULT_GONE in line.kinds())
        await line.line.arm()


async def test_a_fault_while_arming_waits_prevents_arming(rig):
    rig.drive("PIN11", 1)
    async with running(spec_of(rig, "drv8871", fault=True)) as line:
        await line.ready()
        line.loop.running = False
        await until(lambda: now_ns() - line.loop.put_ns > PATIENT_S * 1e9)
        arming = asyncio.ensure_future(line.line.arm())
        await asyncio.sleep(0)
        rig.drive("PIN11", 0)
        await until(lambda: EventKind.DRIVE_FAULT in line.kinds() or arming.done())
        line.loop.running = True
        with pytest.raises(HalError):
            await arming
        assert line.states() == {DriveState.READY}


async def test_a_pump_pin_changes_for_as_long_as_the_motor_may_move(rig):
    where = {**places("three-wire"), "pump": "PIN10"}
    async with running(spec_of(rig, "three-wire", where=where)) as line:
        await armed(line)
        assert rig.level("PIN10") == 0.0
        line.loop.enabled, line.loop.duty = True, {0: 0.5}
        for level in (1.0, 0.0, 1.0, 0.0):
            await reaches(line, lambda level=level: rig.level("PIN10") == level, "it changes")
        await reaches(line, are(rig, "three-wire", "forward", 0.5), "and the PWM goes on")
        line.loop.running = False
        await until(lambda: line.states() == {DriveState.READY})
        cycles = line.line.stats().cycles
        await until(lambda: line.line.stats().cycles > cycles + 5)
        assert rig.level("PIN10") == 0.0


async def test_a_gpio_line_in_use_is_reported_with_joint_pin_and_owner(rig):
    fd = request_outputs(LABEL, [Wanted(line="PIN0", purpose="a test")], "coffee machine")
    try:
        async with running(spec_of(rig, "bts7960")) as line:
            await until(lambda: EventKind.LINE_LOST in line.kinds())
            text = line.events[0].text
            assert "joint left, pin r_en" in text
            assert 'in use by "coffee machine"' in text
            os.close(fd)
            fd = -1
            await until(lambda: line.line.state is LineState.READY, "it gets its pins after all")
    finally:
        if fd >= 0:
            os.close(fd)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pins": PinsSpec(pwm_chip="1f00098000.pwm", gpio_chip=LABEL)}, 'no PWM chip "1f00'),
        ({"pins": PinsSpec(pwm_chip="pwmchip0", gpio_chip="pinctrl-rp1")}, 'no GPIO chip "pinc'),
        ({"where": {"rpwm": "pwm0", "lpwm": "pwm77"}}, "joint left, pin lpwm: PWM channel 77"),
        ({"where": {"rpwm": "pwm0", "lpwm": "pwm1", "r_en": "GPIO99"}}, "pin r_en: no GPIO line"),
    ],
)
async def test_a_missing_chip_channel_or_line_is_reported_with_the_present_ones(
    rig, changes, words
):
    async with running(spec_of(rig, "bts7960", **changes)) as line:
        await until(lambda: EventKind.LINE_LOST in line.kinds())
        assert words in line.events[0].text
        with pytest.raises(PortError):
            await line.line.arm()


async def test_a_channel_left_running_is_stopped_first(rig):
    async with running(spec_of(rig, "cytron-mdd")) as line:
        await line.ready()
    folder = rig.chip / "pwm0"
    (folder / "period").write_text("1000000")
    (folder / "duty_cycle").write_text("900000")
    (folder / "enable").write_text("1")
    async with running(spec_of(rig, "cytron-mdd")) as line:
        await line.ready()
        assert (folder / "period").read_text().strip() == "62500"
        await until(are(rig, "cytron-mdd", "coast"))


@pytest.mark.skipif(not FAILING.exists(), reason="only the module pwm-sim fails on request")
async def test_a_motor_left_running_that_cannot_be_stopped_is_not_driven(rig):
    where = places("cytron-mdd")
    async with running(spec_of(rig, "cytron-mdd")) as line:
        await line.ready()
    folder = rig.chip / where["pwm"]
    (folder / "duty_cycle").write_text("50000")
    (folder / "enable").write_text("1")
    rig.drive(where["dir"], 1)
    fail_with(5)
    try:
        async with running(spec_of(rig, "cytron-mdd")) as line:
            await until(lambda: EventKind.LINE_LOST in line.kinds())
            assert "joint left, pin pwm" in line.events[0].text
            assert rig.level(where["dir"]) == 1.0
            fail_with(0)
            await until(are(rig, "cytron-mdd", "coast"))
    finally:
        fail_with(0)
        rig.drive(where["dir"], 0)


@pytest.mark.skipif(not FAILING.exists(), reason="only the module pwm-sim fails on request")
async def test_a_failing_chip_is_reported_and_the_line_returns_without_power(rig):
    async with running(spec_of(rig, "pwm-pwm")) as line:
        await armed(line)
        line.loop.enabled, line.loop.duty = True, {0: 0.5}
        await reaches(line, are(rig, "pwm-pwm", "forward", 0.5), "forward")
        fail_with(5)
        line.loop.duty = {0: 0.6}
        await until(lambda: EventKind.LINE_LOST in line.kinds())
        assert "joint left, pin forward: Input/output error" in line.events[-1].text
        fail_with(0)
        await until(lambda: line.states() == {DriveState.READY})
        await until(are(rig, "pwm-pwm", "coast"))


def all_forward(rig):
    return all(
        are(rig, drive, "forward", 0.5, where)() for drive, where in laid_out(BRIDGES).items()
    )


KILLED = """
import asyncio, sys
sys.path[:0] = {path!r}
import test_gpio_pwm as here
from bridge_rig import laid_out, places, spec_of
from pin_rig import Pins
from pathlib import Path
rig = Pins(Path({lines!r}), Path({chip!r}))
async def main():
    async with here.running(here.all_bridges(rig)) as line:
        await here.armed(line)
        line.loop.enabled, line.loop.duty = True, {{n: 0.5 for n in range(len(here.BRIDGES))}}
        for drive, where in here.laid_out(here.BRIDGES).items():
            await here.reaches(line, here.are(rig, drive, "forward", 0.5, where), drive)
        print("turning", flush=True)
        while True:
            await here.armed(line)
            await asyncio.sleep(0.01)
asyncio.run(main())
"""


def test_stop_all_ends_what_kill_9_leaves_behind_on_every_bridge(rig, capsys):
    """The pulses continue after the kill: sysfs has no watchdog. GPIO lines of this chip fall back
    to their pull, which not every chip does."""
    code = KILLED.format(path=sys.path, lines=str(rig.lines), chip=str(rig.chip))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as child:

        def held():
            """Stop the process; continue it if a bridge is off, which old set-points may cause."""
            child.send_signal(signal.SIGSTOP)
            os.waitpid(child.pid, os.WUNTRACED)
            if all_forward(rig):
                return True
            child.send_signal(signal.SIGCONT)
            return False

        assert child.stdout.readline().strip() == b"turning"
        wait_until(held, "all turn")
        before = {drive: levels(rig, where) for drive, where in laid_out(BRIDGES).items()}
        child.send_signal(signal.SIGKILL)
        child.wait()
    lines = [place for place in itertools.chain(*places_of_all()) if place in LINES]
    wait_until(lambda: not any(map(rig.level, lines)), "the lines fall back to their pull")
    for drive, where in laid_out(BRIDGES).items():
        after = levels(rig, where)
        assert after == {
            pin: 0.0 if where[pin] in LINES else level for pin, level in before[drive].items()
        }
        with capsys.disabled():
            print(f"\n{drive}: kill -9:", *(f"{pin} {level:g}" for pin, level in after.items()))

    with contextlib.closing(asyncio.new_event_loop()) as loop:
        assert loop.run_until_complete(halt_line(all_bridges(rig))) == []
    for drive, where in laid_out(BRIDGES).items():
        assert are(rig, drive, "coast", where=where)(), drive
    assert {path.read_text().strip() for path in rig.chip.glob("pwm*/enable")} == {"0"}
