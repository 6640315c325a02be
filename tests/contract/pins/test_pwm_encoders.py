# SPDX-License-Identifier: Apache-2.0
"""Encoders of motor bridges: found, set up, and counted by the line's thread, on folders like those
of the kernel's counters. GPIO lines need the kernel: tests/vm/guest/pins/test_encoders.py."""

import math
import os

import pytest
from loop_side import running, until
from pwm_rig import spec_of

from motord.config.drives.load import find_profile
from motord_hal.base.errors import PortError
from motord_hal.encoder.counter import find_counter, open_counter
from motord_hal.encoder.edges import open_edges
from motord_hal.fieldbus.ports import CounterEncoder, EdgesEncoder, EventKind, JointSpec, LineState

PER_COUNT = math.tau / 1320


class Counter:
    """Files like those of /sys/bus/counter/devices/counterN. A count is written in one piece; the
    tail of a longer one stays after the line's end."""

    def __init__(self, folder, name="104-quadrature", ceiling="65535", **files):
        self.folder = folder
        values = {"count": "65530", "function": "increase", "enable": "0", "ceiling": ceiling}
        (folder / "count0").mkdir(parents=True)
        (folder / "name").write_text(f"{name}\n")
        for file, value in (values | files).items():
            if value is not None:
                (folder / "count0" / file).write_text(f"{value}\n")

    def read(self, name):
        return (self.folder / "count0" / name).read_text().strip()

    def count(self, text):
        with (self.folder / "count0/count").open("r+b") as file:
            os.pwrite(file.fileno(), f"{text}\n".encode(), 0)


def counter_of(wanted, count=0):
    return CounterEncoder(counter=str(wanted), count=count, rad_per_count=PER_COUNT)


@pytest.fixture
def counter(tmp_path):
    return Counter(tmp_path / "counter0")


def line_with(chip, counter):
    left = JointSpec(index=0, name="left", profile=find_profile("bts7960"), unit=1,
                     pins={"rpwm": "pwm0", "lpwm": "pwm1"},
                     encoder=counter_of(counter.folder))  # fmt: skip
    right = JointSpec(index=1, name="right", profile=find_profile("bts7960"), unit=2,
                      pins={"rpwm": "pwm2", "lpwm": "pwm3"})  # fmt: skip
    return spec_of(chip, joints=(left, right))


async def test_the_count_reaches_the_core_across_the_counter_s_wrap(chip, counter):
    async with running(line_with(chip, counter)) as rig:
        await rig.ready()
        assert (counter.read("function"), counter.read("enable")) == ("quadrature x4", "1")
        await until(lambda: rig.loop.exchange.take_feedback(0).stamp_ns > 0)
        assert rig.loop.exchange.take_feedback(0).count == 0
        counter.count(4)
        await until(lambda: rig.loop.exchange.take_feedback(0).count == 10, "ten edges forward")
        counter.count(65520)
        await until(lambda: rig.loop.exchange.take_feedback(0).count == 2**64 - 10, "and back")
        assert math.isfinite(rig.loop.exchange.take_feedback(0).velocity_rad_s)
        other = rig.loop.exchange.take_feedback(1)
        assert (other.count, math.isnan(other.velocity_rad_s)) == (0, True)


async def test_a_wheel_that_turns_is_measured_and_one_that_stands_is_at_rest(chip, counter):
    counter.count(0)
    async with running(line_with(chip, counter)) as rig:
        await rig.ready()
        seen, number = [], 0

        def turning():
            nonlocal number
            number += 3
            counter.count(number)
            seen.append(rig.loop.exchange.take_feedback(0).velocity_rad_s)
            return seen[-1] > 1.0

        await until(turning, "a speed")
        await until(lambda: rig.loop.exchange.take_feedback(0).velocity_rad_s == 0.0, "rest")


async def test_a_counter_without_a_number_ends_the_line_at_rest_with_the_joint_s_name(
    chip, counter
):
    async with running(line_with(chip, counter)) as rig:
        await rig.ready()
        counter.count("lost")
        await until(lambda: EventKind.LINE_LOST in rig.kinds(), "the line is lost")
        text = next(e.text for e in rig.events if e.kind is EventKind.LINE_LOST)
        assert "the encoder of left: Input/output error" in text
        assert chip.duties() == [0, 0, 0, 0]
        counter.count(5)
        await until(lambda: rig.line.state is LineState.READY, "it is opened again")


# ---------------------------------------------------------------------------- finding the counter
def tree(tmp_path, *names):
    root = tmp_path / "devices"
    root.mkdir()
    for number, name in enumerate(names):
        made = Counter(tmp_path / f"soc/4400000{number}.timer/counter{number}", name=name)
        (root / f"counter{number}").symlink_to(made.folder)
    return root


def test_a_counter_is_found_by_number_name_or_device(tmp_path):
    root = tree(tmp_path, "left wheel", "right wheel")
    for wanted in ("counter1", "right wheel", "44000001.timer"):
        assert find_counter(wanted, root).name == "counter1"
    with pytest.raises(PortError, match='no counter "eqep"; there: counter0 "left wheel"'):
        find_counter("eqep", root)
    with pytest.raises(PortError, match="2 counters fit"):
        find_counter("timer", root)
    with pytest.raises(PortError, match=r"there: none\. The board's device tree"):
        find_counter("timer", tmp_path / "nowhere")


def test_a_missing_count_is_named(counter):
    with pytest.raises(PortError, match=r"joint left, encoder .*count3: there is no such count"):
        open_counter(counter_of(counter.folder, 3), "left")


def test_a_function_that_the_counter_does_not_take_is_reported(counter):
    file = counter.folder / "count0/function"
    file.unlink()
    os.mkfifo(file)
    file.unlink()
    file.symlink_to("/dev/null")
    with pytest.raises(PortError, match='function is "", and cannot be set to "quad'):
        open_counter(counter_of(counter.folder), "left")


def test_a_counter_that_would_never_count_is_reported(tmp_path):
    made = Counter(tmp_path / "counter0", ceiling="0")
    with pytest.raises(PortError, match="its ceiling is 0"):
        open_counter(counter_of(made.folder), "left")


@pytest.mark.parametrize("text", [None, "junk", str(2**64 - 1)])
def test_a_counter_without_a_ceiling_is_as_wide_as_it_can_be(tmp_path, text):
    made = Counter(tmp_path / "counter0", ceiling=text)
    found = open_counter(counter_of(made.folder), "left")
    os.close(found.fd)
    assert found.ceiling == 2**64 - 1


def test_gpio_lines_that_are_not_there_are_reported_with_joint_and_channel(tmp_path):
    encoder = EdgesEncoder(gpio_chip="pinctrl-rp1", a="1", b="2", pull="up", rad_per_count=1.0)
    with pytest.raises(PortError, match='no GPIO chip "pinctrl-rp1"'):
        open_edges(encoder, "left", "motord", dev=tmp_path)
