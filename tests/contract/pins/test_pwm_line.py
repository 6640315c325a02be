# SPDX-License-Identifier: Apache-2.0
"""The thread of motor bridges on descriptors of plain files: what it writes, and when. On kernel
drivers: tests/vm/guest/pins/test_gpio_pwm.py."""

import asyncio
import errno
import fcntl
import os
import subprocess
import sys
from pathlib import Path

import gpiod
import pytest
from loop_side import PATIENT_S, running, until
from pwm_rig import PERIOD_NS, Chip, armed, spec_of

import motord_hal.pwm
import motord_hal.rt_engine
from motord.config.drives.load import find_profile
from motord_hal.base.clock import now_ns
from motord_hal.base.errors import HalError, PortError
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import (
    DriveState,
    EventKind,
    JointSpec,
    LineState,
    PinsSpec,
)
from motord_hal.gpio.pinmux import not_muxed
from motord_hal.pwm.line import WATCH_EVERY_S
from motord_hal.realtime.exchange import Exchange

COMM = Path("/proc/self/comm").read_text().strip()


async def half_forward(rig, chip):
    """Arm the line, and drive the left motor forward with half duty."""
    await armed(rig)
    rig.loop.enabled, rig.loop.duty = True, {0: 0.5}
    await until(lambda: chip.duties()[0] == 25_000)


REST = [0, 0, 0, PERIOD_NS]
ON_AT_REST = [0, 0, 0, 1]
"""`enable` at rest: a disabled channel is low on most chips, so the active-low one stays at 1."""


async def test_bridges_are_set_up_at_rest_and_move_only_when_armed_and_enabled(chip):
    async with running(spec_of(chip)) as rig:
        await rig.ready()
        assert rig.line.engine == "rt"
        assert rig.kinds() == [EventKind.LINE_OPEN, EventKind.DRIVE_READY]
        assert chip.read(0, "period") == PERIOD_NS
        assert chip.read(0, "enable") == 1
        rig.loop.enabled, rig.loop.duty = True, {0: 0.5, 1: 0.25}
        cycles = rig.line.stats().cycles
        await until(lambda: rig.line.stats().cycles > cycles + 10)
        assert chip.duties() == REST
        await rig.line.arm()
        await until(lambda: chip.duties() == [25_000, 0, 0, PERIOD_NS - 12_500])
        rig.loop.duty = {0: -1.0, 1: -0.1}
        await until(lambda: chip.duties() == [0, PERIOD_NS, 5_000, PERIOD_NS])
        await rig.line.disarm()
        await until(lambda: chip.duties() == REST)
        await rig.ready()


async def test_a_loop_that_dies_stops_the_bridges_until_they_are_armed_again(chip):
    async with running(spec_of(chip)) as rig:
        await half_forward(rig, chip)
        rig.loop.running = False
        await until(lambda: chip.duties() == REST)
        await until(lambda: rig.states() == {DriveState.READY})
        rig.loop.running = True
        cycles = rig.line.stats().cycles
        await until(lambda: rig.line.stats().cycles > cycles + 10)
        assert chip.duties() == REST
        await until(lambda: EventKind.DRIVE_WARNING in rig.kinds())
        await rig.arm()
        await until(lambda: chip.duties()[0] == 25_000)


async def test_set_points_that_were_enabled_only_for_a_moment_take_the_power_off(chip):
    async with running(spec_of(chip)) as rig:
        await armed(rig)
        rig.loop.put_for_a_moment()
        await until(lambda: rig.states() == {DriveState.READY})


async def test_set_points_that_are_no_longer_enabled_take_the_power(chip):
    async with running(spec_of(chip)) as rig:
        await half_forward(rig, chip)
        rig.loop.enabled = False
        await until(lambda: rig.states() == {DriveState.READY})
        await until(lambda: chip.duties() == REST)


async def test_it_cannot_be_armed_without_fresh_set_points(chip):
    async with running(spec_of(chip)) as rig:
        await rig.ready()
        rig.loop.running = False
        await until(lambda: now_ns() - rig.loop.put_ns > PATIENT_S * 1e9)
        with pytest.raises(HalError, match="no fresh set-points"):
            await rig.line.arm()


async def test_arming_waits_for_a_delayed_loop(chip):
    async with running(spec_of(chip)) as rig:
        await rig.ready()
        rig.loop.running = False
        await until(lambda: now_ns() - rig.loop.put_ns > PATIENT_S * 1e9)
        arming = asyncio.ensure_future(rig.line.arm())
        looks = rig.line.stats().cycles + 2 * WATCH_EVERY_S * rig.line.spec.cycle_hz
        await until(lambda: rig.line.stats().cycles > looks)
        assert not arming.done()
        rig.loop.running = True
        await arming
        assert rig.states() == {DriveState.ARMED}


async def test_a_line_that_could_not_be_armed_does_not_report_that_it_was_stopped(chip):
    async with running(spec_of(chip)) as rig:
        await rig.ready()
        rig.loop.running = False
        await until(lambda: now_ns() - rig.loop.put_ns > PATIENT_S * 1e9)
        with pytest.raises(HalError, match="no fresh set-points"):
            await rig.line.arm()
        looks = rig.line.stats().cycles + 2 * WATCH_EVERY_S * rig.line.spec.cycle_hz
        await until(lambda: rig.line.stats().cycles > looks)
    assert EventKind.DRIVE_WARNING not in rig.kinds()


def test_set_points_that_a_thread_in_c_reads_have_no_second_reader():
    """The mailbox allows one reader: what a second one reads could be overwritten meanwhile."""
    for package in (motord_hal.pwm, motord_hal.rt_engine):
        for path in Path(package.__path__[0]).glob("*.py"):
            assert "take_setpoints" not in path.read_text("utf-8"), path


async def test_cancelling_the_line_leaves_no_pulses(chip):
    async with running(spec_of(chip)) as rig:
        await armed(rig)
        rig.loop.enabled, rig.loop.duty = True, {0: 0.5, 1: 0.5}
        await until(lambda: chip.duties()[0] == 25_000)
    assert chip.duties() == REST
    assert [chip.read(number, "enable") for number in range(4)] == ON_AT_REST


def broken(chip, number):
    """Make the kernel refuse every further duty of an open channel: no space left on the device.
    Return a descriptor of the file, which the caller has to close."""
    path = (chip.folder / f"pwm{number}/duty_cycle").resolve()
    links = [Path("/proc/self/fd", name) for name in os.listdir("/proc/self/fd")]
    (fd,) = (int(link.name) for link in links if os.path.realpath(link) == str(path))
    kept = os.dup(fd)
    full = os.open("/dev/full", os.O_WRONLY | os.O_CLOEXEC)
    os.dup2(full, fd, inheritable=False)
    os.close(full)
    return kept


async def test_disarming_fails_when_a_pin_keeps_its_duty(chip):
    async with running(spec_of(chip)) as rig:
        await half_forward(rig, chip)
        kept = broken(chip, 0)
        try:
            with pytest.raises(PortError):
                await rig.line.disarm()
            assert chip.duties()[0] == 25_000
            await until(lambda: EventKind.LINE_LOST in rig.kinds())
        finally:
            os.close(kept)
    (text,) = (event.text for event in rig.events if "not brought to rest" in event.text)
    assert "joint left, pin rpwm: No space left on device" in text


async def test_a_line_that_ends_with_a_duty_on_a_pin_reports_it(chip):
    async with running(spec_of(chip)) as rig:
        await half_forward(rig, chip)
        kept = broken(chip, 0)
    os.close(kept)
    warnings = [event for event in rig.events if "not brought to rest" in event.text]
    assert [event.kind for event in warnings] == [EventKind.DRIVE_WARNING]
    assert "joint left, pin rpwm: No space left on device" in warnings[0].text


async def test_pulses_that_cannot_be_ended_are_reported_by_the_line_that_ends(chip):
    enable = chip.folder / "pwm2/enable"
    async with running(spec_of(chip)) as rig:
        await rig.ready()
        enable.unlink()
        enable.mkdir()
    warnings = [event.text for event in rig.events if "not brought to rest" in event.text]
    assert warnings == [
        f"pins: not brought to rest: joint right, pin rpwm: {enable.parent}: enable: Is a directory"
    ]
    assert chip.duties() == REST


async def test_a_channel_that_is_gone_at_the_end_causes_no_warning(chip):
    async with running(spec_of(chip)) as rig:
        await rig.ready()
        (chip.folder / "pwm2/enable").unlink()
    assert EventKind.DRIVE_WARNING not in rig.kinds()


async def test_feedback_is_fresh_even_though_a_bridge_reports_nothing(chip):
    async with running(spec_of(chip)) as rig:
        await until(lambda: rig.loop.exchange.take_feedback(0).stamp_ns > 0)
        first = rig.loop.exchange.take_feedback(0)
        assert first.enabled is None
        assert first.velocity_rad_s != first.velocity_rad_s
        await until(lambda: rig.loop.exchange.take_feedback(0).stamp_ns > first.stamp_ns)
        with pytest.raises(LookupError):
            await rig.line.read_register("left", "duty")


async def test_missing_pins_are_reported_once_and_found_later(tmp_path):
    spec = spec_of(Chip(tmp_path / "other"), pins=PinsSpec(pwm_chip=str(tmp_path / "chip")))
    async with running(spec) as rig:
        await until(lambda: EventKind.LINE_LOST in rig.kinds())
        assert "joint left, pin rpwm: PWM channel 0" in rig.events[0].text
        with pytest.raises(PortError):
            await rig.line.arm()
        Chip(tmp_path / "new")
        os.rename(tmp_path / "new", tmp_path / "chip")
        await until(lambda: rig.line.state is LineState.READY)
        assert rig.kinds().count(EventKind.LINE_LOST) == 1


def as_software(chip):
    """Give the chip the entry that a chip of the driver pwm-gpio has in the kernel's tree."""
    driver = chip.folder.parent / "drivers/pwm-gpio"
    driver.mkdir(parents=True)
    (chip.folder / "device").mkdir()
    (chip.folder / "device/driver").symlink_to(driver)


@pytest.mark.parametrize(
    ("asked", "warnings"),
    [
        ({}, "software_pwm = true in the line's section allows them"),
        ({"software_pwm": True}, "pwm_hz must be at most 1000"),
        ({"software_pwm": True, "pwm_hz": 2000.0}, "pwm_hz must be at most 1000"),
    ],
)
async def test_pulses_made_by_software_are_refused_unless_configured(chip, asked, warnings):
    as_software(chip)
    spec = spec_of(chip, pins=PinsSpec(pwm_chip=str(chip.folder), **asked))
    async with running(spec) as rig:
        await until(lambda: EventKind.LINE_LOST in rig.kinds())
        assert warnings in rig.events[0].text
        assert [chip.read(number, "enable") for number in range(4)] == ON_AT_REST
        assert [duty > 0 for duty in chip.duties()] == [False, False, False, True]


async def test_pulses_made_by_software_turn_motors_where_configured(chip):
    as_software(chip)
    pins = PinsSpec(pwm_chip=str(chip.folder), software_pwm=True, pwm_hz=500.0)
    async with running(spec_of(chip, pins=pins)) as rig:
        await armed(rig)
        rig.loop.enabled, rig.loop.duty = True, {0: 0.5}
        await until(lambda: chip.read(0, "duty_cycle") == 1_000_000)
        assert chip.read(0, "period") == 2_000_000
    assert chip.read(0, "duty_cycle") == 0


async def test_pulses_made_by_software_are_ended_even_where_not_configured(chip):
    as_software(chip)
    (chip.folder / "pwm0/duty_cycle").write_text("30000\n")
    assert await halt_line(spec_of(chip)) == []
    assert chip.read(0, "duty_cycle") == 0


async def test_pins_that_a_dead_program_left_driven_are_brought_to_rest(chip):
    spec = spec_of(chip)
    async with running(spec) as rig:
        await rig.ready()
    for number in (0, 3):
        (chip.folder / f"pwm{number}/duty_cycle").write_text("30000\n")
        (chip.folder / f"pwm{number}/enable").write_text("1\n")
    assert await halt_line(spec) == []
    assert chip.duties() == REST
    assert [chip.read(number, "enable") for number in range(4)] == ON_AT_REST


async def test_a_channel_that_another_program_drives_is_not_touched_and_its_owner_is_named(chip):
    async with running(spec_of(chip)) as rig:
        await half_forward(rig, chip)
        problems = await halt_line(spec_of(chip))
        assert chip.duties()[0] == 25_000
        assert [chip.read(number, "enable") for number in range(4)] == [1] * 4
    assert len(problems) == 4
    assert problems[0] == (
        f"joint left, pin rpwm: PWM channel 0 of {chip.folder} (device): "
        f"{COMM} (pid {os.getpid()}) drives it: end that first"
    )
    assert await halt_line(spec_of(chip)) == []


def test_a_channel_whose_owner_was_killed_is_available(chip):
    duty = chip.folder / "pwm0/duty_cycle"
    hold = "import fcntl, sys; f = open(sys.argv[1], 'r+'); fcntl.flock(f, fcntl.LOCK_EX); "
    hold += "f.write('30000\\n'); f.flush(); "
    hold += "print('driven', flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", hold, str(duty)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == b"driven\n"
        (problem,) = asyncio.run(halt_line(spec_of(chip)))
        assert f"(pid {owner.pid}) drives it" in problem
        assert chip.duties()[1:] == REST[1:]
        assert chip.duties()[0] == 30_000
        owner.kill()
    assert asyncio.run(halt_line(spec_of(chip))) == []
    assert chip.duties() == REST


async def test_a_line_whose_channel_is_taken_reports_it_and_waits(chip):
    with (chip.folder / "pwm2/duty_cycle").open("r+") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        async with running(spec_of(chip)) as rig:
            await until(lambda: EventKind.LINE_LOST in rig.kinds())
            assert "joint right, pin rpwm: PWM channel 2" in rig.events[0].text
            assert "drives it: end that first" in rig.events[0].text
            fcntl.flock(other, fcntl.LOCK_UN)
            await until(lambda: rig.line.state is LineState.READY)


async def test_pulses_that_reach_no_pin_are_reported_when_the_line_opens(
    chip, tmp_path, monkeypatch
):
    """The files are as root sees them on a Pi 5 that has no overlay."""
    (tmp_path / "1f00098000.pwm").mkdir()
    (chip.folder / "device").symlink_to(tmp_path / "1f00098000.pwm")
    (tmp_path / "compatible").write_text("raspberrypi,5-model-b\0brcm,bcm2712\0")
    pinctrl = tmp_path / "debug/pinctrl/1f000d0000.gpio-pinctrl-rp1"
    pinctrl.mkdir(parents=True)
    rows = [f"pin {pin} (gpio{pin}): (MUX UNCLAIMED) (GPIO UNCLAIMED)" for pin in (12, 13, 18, 19)]
    (pinctrl / "pinmux-pins").write_text("\n".join(rows) + "\n")
    monkeypatch.setattr(not_muxed, "__defaults__", (tmp_path, tmp_path / "debug"))
    async with running(spec_of(chip)) as rig:
        await rig.ready()
        await until(lambda: EventKind.DRIVE_WARNING in rig.kinds())
        assert "no pin to pwm0, pwm1, pwm2, pwm3 of 1f00098000.pwm" in rig.events[-1].text


async def test_an_unavailable_pin_does_not_keep_the_others_from_resting(chip):
    (chip.folder / "pwm0/period").unlink()
    (chip.folder / "pwm2/duty_cycle").write_text("30000\n")
    (problem,) = await halt_line(spec_of(chip))
    assert "joint left, pin rpwm" in problem
    assert chip.duties() == REST


@pytest.mark.parametrize(
    ("drive", "pins", "touched"),
    [
        ("cytron-mdd", {"pwm": "pwm0", "dir": "GPIO5"}, False),
        ("tb6612fng", {"pwm": "pwm0", "in1": "GPIO5", "in2": "GPIO6", "stby": "GPIO7"}, True),
    ],
)
async def test_only_the_power_lines_of_a_motor_whose_pulses_go_on_are_touched(
    chip, drive, pins, touched
):
    (chip.folder / "pwm0/period").unlink()
    joint = JointSpec(index=0, name="left", profile=find_profile(drive), unit=1, pins=pins)
    nowhere = PinsSpec(pwm_chip=str(chip.folder), gpio_chip="nowhere")
    problems = await halt_line(spec_of(chip, joints=(joint,), pins=nowhere))
    assert "joint left, pin pwm" in problems[0]
    assert [text for text in problems if 'no GPIO chip "nowhere"' in text] == problems[1:]
    assert len(problems) == 1 + touched


async def test_channels_are_brought_to_rest_independently(chip):
    period = chip.folder / "pwm0/period"
    period.unlink()
    (chip.folder / "pwm2/duty_cycle").write_text("30000\n")
    async with asyncio.TaskGroup() as tasks:
        halt = tasks.create_task(halt_line(spec_of(chip)))
        await until(lambda: chip.duties() == REST)
        assert not halt.done()
        period.write_text("0\n")
    assert halt.result() == []


async def test_lines_are_brought_to_rest_even_when_the_wait_for_a_channel_is_cancelled(
    chip, monkeypatch
):
    (chip.folder / "pwm0/period").unlink()
    opened = []

    def no_such_chip(path):
        opened.append(path)
        raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    monkeypatch.setattr(gpiod, "Chip", no_such_chip)
    pins = {"rpwm": "pwm0", "lpwm": "pwm2", "r_en": "1", "l_en": "2", "pump": "3"}
    joint = JointSpec(index=0, name="left", profile=find_profile("bts7960"), unit=1, pins=pins)
    where = PinsSpec(pwm_chip=str(chip.folder), gpio_chip="/dev/gpiochip0")
    async with asyncio.TaskGroup() as tasks:
        halt = tasks.create_task(halt_line(spec_of(chip, joints=(joint,), pins=where)))
        await until(lambda: chip.read(2, "period") == PERIOD_NS)
        assert not opened
        halt.cancel()
    assert halt.cancelled()
    assert opened


async def test_a_line_that_cannot_be_opened_brings_the_pins_that_it_can_to_rest(chip):
    (chip.folder / "pwm0/period").unlink()
    (chip.folder / "pwm2/duty_cycle").write_text("30000\n")
    async with running(spec_of(chip)) as rig:
        await until(lambda: EventKind.LINE_LOST in rig.kinds())
        assert "joint left, pin rpwm" in rig.events[0].text
        assert chip.duties() == REST


async def test_a_line_that_cannot_be_opened_names_the_pins_that_it_could_not_bring_to_rest(chip):
    for number in (0, 2):
        (chip.folder / f"pwm{number}/period").unlink()
    async with running(spec_of(chip)) as rig:
        await until(lambda: EventKind.LINE_LOST in rig.kinds())
    first, _, more = rig.events[0].text.partition("; not brought to rest: ")
    assert "joint left, pin rpwm: PWM channel 0" in first
    assert more.startswith("joint right, pin rpwm: PWM channel 2")
    assert "joint left" not in more


def test_a_bridge_without_its_pins_is_refused(chip):
    joint = JointSpec(index=0, name="left", profile=find_profile("bts7960"), unit=1)
    with pytest.raises(HalError, match="joint left: pin rpwm of bts7960 is not given"):
        open_line(spec_of(chip, joints=(joint,)), Exchange.private(), print)
