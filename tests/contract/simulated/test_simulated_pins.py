# SPDX-License-Identifier: Apache-2.0
"""Simulated motor bridges: how they follow the files of a PWM chip, on a clock that the test
advances, and with the shipped line on them."""

import math
import os
import select
import signal
import time
from pathlib import Path

import pytest
from loop_side import running, until
from pwm_rig import armed
from tests.shipped import NAMES, shipped_profile

from motord.config import load_robot
from motord.config.wiring import line_specs
from motord.tools.simulator import start_simulator
from motord_hal.fieldbus.ports import CounterEncoder, DriveState, JointSpec, LineSpec, PinsSpec
from motord_hal.pwm.pins import servo_range_rad
from motord_hal.sim.rig import Rig, RigSpec, WheelSpec
from motord_hal.sim.runner import HELD_UP_S, PausingClock

ROOT = Path(__file__).resolve().parents[3]
ROBOT = ROOT / "config/robots/pi5-bts7960.toml"
PERIOD_NS = 20_000_000
FULL_RAD_S = 18.0
PER_COUNT = math.tau / 1320
ON_PINS = [name for name in NAMES if shipped_profile(name).bridge is not None]
SERVOS = [name for name in ON_PINS if shipped_profile(name).goes_to_positions]
BRIDGES = [name for name in ON_PINS if name not in SERVOS]


class Bench:
    """Two bridges of one kind, every pin on a channel of its own, and methods that set the pins as
    a program sets them through the kernel."""

    def __init__(self, folder, drive="bts7960", **left):
        self.profile = shipped_profile(drive)
        pins = list(self.profile.bridge.levels)
        at = iter(range(100))
        joints = [
            JointSpec(index=n, name=name, profile=self.profile, unit=n + 1,
                      **{"pins": {pin: f"pwm{next(at)}" for pin in pins}, **more})
            for n, (name, more) in enumerate((("left", left), ("right", {})))
        ]  # fmt: skip
        self.line = LineSpec(
            index=0, name="pins", kind="pwm", port="", baudrate=115200, parity="none", stop_bits=1,
            cycle_hz=200.0, gap_s=None, engine="auto", joints=tuple(joints), watchdog_s=0.5,
            priority=0, pins=PinsSpec(pwm_chip="somewhere"),
        )  # fmt: skip
        wheels = {
            name: WheelSpec(side=name, wheel_radius_m=0.05, full_duty_rad_s=FULL_RAD_S)
            for name in ("left", "right")
        }
        spec = RigSpec(robot="bench", track_m=0.3, lines=(self.line,), wheels=wheels)
        self.rig = Rig(spec, link_dir=folder)
        self.folder = folder / "pins"
        self.wheel = self.rig.plant.wheels["left"]
        self.now_s = 0.0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.rig.close()

    def go_on(self, seconds):
        for _ in range(round(seconds * 1000)):
            self.now_s += 0.001
            self.rig.work(self.now_s)

    def put(self, name, value):
        (self.folder / name).write_text(f"{value}\n")

    def set_level(self, level, channel=0, enable=1):
        self.put(f"pwm{channel}/period", PERIOD_NS)
        self.put(f"pwm{channel}/duty_cycle", round(PERIOD_NS * level))
        self.put(f"pwm{channel}/enable", enable)

    def mode(self, mode, duty=0.0):
        """Set the left bridge's pins to the levels that the profile has for a mode."""
        for channel, levels in enumerate(self.profile.bridge.levels.values()):
            base, slope = levels[mode]
            self.set_level(base + slope * duty, channel)

    def count(self):
        return int((self.folder / "count0/count").read_text())

    def enabled(self):
        return self.rig.truth()["joints"]["left"]["enabled"]


def counted(rad_per_count=PER_COUNT):
    return CounterEncoder(counter="somewhere", count=0, rad_per_count=rad_per_count)


# ------------------------------------------------------------------------------------ the bridges
@pytest.mark.parametrize("drive", BRIDGES)
@pytest.mark.parametrize(("mode", "sign"), [("forward", 1.0), ("reverse", -1.0)])
def test_every_bridge_turns_its_motor_in_proportion_to_its_duty(tmp_path, drive, mode, sign):
    with Bench(tmp_path, drive) as bench:
        bench.mode(mode, 0.5)
        bench.go_on(2.0)
        # friction makes the speed a little less than half of that at full duty
        assert 0.8 < bench.wheel.velocity_rad_s * sign / (FULL_RAD_S * 0.5) < 1.0
        assert bench.rig.plant.wheels["right"].velocity_rad_s == 0.0
        assert bench.enabled()


@pytest.mark.parametrize("drive", [name for name in BRIDGES if name != "cytron-mdd"])
def test_a_bridge_that_brakes_stops_its_motor_and_one_that_coasts_lets_it_turn(tmp_path, drive):
    levels = shipped_profile(drive).bridge.levels.values()
    same = all(modes["brake"] == modes["coast"] for modes in levels)
    with Bench(tmp_path, drive) as bench:
        for rest, turns_on in (("brake", False), ("coast", not same)):
            bench.mode("forward", 1.0)
            bench.go_on(1.5)
            bench.mode(rest)
            bench.go_on(0.5)
            assert (bench.wheel.velocity_rad_s > 0.5 * FULL_RAD_S) == turns_on
            assert bench.enabled() != turns_on


@pytest.mark.parametrize("drive", SERVOS)
def test_a_servo_goes_to_the_angle_of_its_pulses_and_without_pulses_has_no_power(tmp_path, drive):
    with Bench(tmp_path, drive, gear_ratio=2.0) as bench:
        full_rad = servo_range_rad(bench.line.joints[0])
        for mode, part, goal_rad in (
            ("forward", 1.0, full_rad), ("reverse", 0.5, -full_rad / 2), ("forward", 0.0, 0.0),
        ):  # fmt: skip
            bench.mode(mode, part)
            bench.go_on(1.0)
            assert bench.wheel.position_rad == pytest.approx(goal_rad, abs=0.01)
            assert bench.enabled()
        bench.mode("forward", 1.0)
        bench.go_on(0.05)
        bench.mode("coast")
        bench.go_on(3.0)
        assert bench.wheel.velocity_rad_s == 0.0
        assert not bench.enabled()


def test_nothing_turns_before_the_pins_are_driven(tmp_path):
    with Bench(tmp_path) as bench:
        bench.go_on(0.5)
        assert bench.rig.plant.truth.moved_max_m_s == 0.0
        assert not bench.enabled()


def test_a_channel_that_is_disabled_gives_no_power(tmp_path):
    with Bench(tmp_path, pins={"rpwm": "pwm0", "lpwm": "pwm1"}) as bench:
        bench.set_level(1.0, 0)
        bench.set_level(0.0, 1)
        bench.go_on(1.0)
        fast_rad_s = bench.wheel.velocity_rad_s
        assert fast_rad_s > 0.8 * FULL_RAD_S
        bench.put("pwm0/enable", 0)
        bench.go_on(0.3)
        assert not bench.enabled()
        assert bench.wheel.torque_n_m == 0.0
        assert 0.5 * fast_rad_s < bench.wheel.velocity_rad_s < fast_rad_s


def test_enable_pins_that_are_left_out_are_wired_high(tmp_path):
    with Bench(tmp_path, pins={"rpwm": "pwm0", "lpwm": "pwm1"}) as bench:
        bench.set_level(0.0, 0)
        bench.set_level(0.0, 1)
        bench.go_on(0.01)
        assert bench.enabled()  # both pins low brake; only enable pins would take the power
        bench.set_level(0.5, 1)
        bench.go_on(1.0)
        assert bench.wheel.velocity_rad_s < -0.3 * FULL_RAD_S


def test_active_low_pins_and_inverted_motors_are_simulated(tmp_path):
    pins = {"rpwm": "!pwm0", "lpwm": "pwm1"}
    with Bench(tmp_path, pins=pins, inverted=True) as bench:
        bench.set_level(0.25, 0)
        bench.set_level(0.0, 1)
        bench.go_on(2.0)
        assert -0.75 < bench.wheel.velocity_rad_s / FULL_RAD_S < -0.6


def test_levels_of_no_mode_give_no_power_and_are_counted(tmp_path):
    with Bench(tmp_path, pins={"rpwm": "pwm0", "lpwm": "pwm1"}) as bench:
        bench.set_level(0.5, 0)
        bench.set_level(0.5, 1)
        bench.go_on(0.1)
        assert bench.wheel.velocity_rad_s == 0.0
        assert not bench.enabled()
        assert bench.rig.stats()["lines"]["pins"]["no_mode"] == 100


def test_a_file_that_is_being_written_keeps_its_previous_value(tmp_path):
    with Bench(tmp_path, pins={"rpwm": "pwm0", "lpwm": "pwm1"}) as bench:
        bench.set_level(0.5, 0)
        bench.set_level(0.0, 1)
        bench.go_on(1.0)
        for text in ("", "x", "-"):
            (bench.folder / "pwm0/duty_cycle").write_text(text)
            bench.go_on(0.2)
            assert bench.wheel.velocity_rad_s > 0.3 * FULL_RAD_S
        (bench.folder / "pwm0/duty_cycle").write_text("0\n0000\n")  # a longer one's tail
        bench.go_on(1.0)
        assert bench.wheel.velocity_rad_s == 0.0


# ----------------------------------------------------------------------------------- the counters
@pytest.mark.parametrize("rad_per_count", [PER_COUNT, -PER_COUNT, PER_COUNT / 30])
def test_the_counter_follows_the_wheel_across_its_wrap(tmp_path, rad_per_count):
    with Bench(tmp_path, encoder=counted(rad_per_count)) as bench:
        bench.mode("forward", 1.0)
        bench.go_on(3.0)
        bench.rig.lines["pins"].work(bench.now_s)
        turned = math.floor(bench.wheel.position_rad / rad_per_count)
        assert abs(turned) > 5000
        assert bench.count() == turned % 65536
        assert (bench.folder / "count0/ceiling").read_text() == "65535\n"
        assert not (bench.folder / "count1").exists()


def test_a_count_is_always_written_whole(tmp_path):
    with Bench(tmp_path, encoder=counted()) as bench:
        bench.mode("reverse", 0.2)
        for _ in range(300):
            bench.go_on(0.001)
            text = (bench.folder / "count0/count").read_text()
            assert len(text) == 8
            assert text.endswith("\n")


# ------------------------------------------------------------------------------------- the faults
def test_without_its_plug_a_bridge_has_no_power_and_its_wheel_is_counted(tmp_path):
    with Bench(tmp_path, encoder=counted()) as bench:
        bench.mode("forward", 1.0)
        bench.go_on(1.0)
        before = bench.count()
        bench.rig.pull("pins")
        bench.go_on(0.2)
        assert not bench.enabled()
        assert bench.count() > before
        bench.rig.plug("pins")
        bench.go_on(0.1)
        assert bench.enabled()


def test_a_brown_out_takes_a_bridge_s_power_for_its_time_and_keeps_the_count(tmp_path):
    with Bench(tmp_path, encoder=counted()) as bench:
        bench.mode("forward", 1.0)
        bench.go_on(1.0)
        before = bench.count()
        bench.rig.inject("brown-out:unit=1,at_s=0.01,for_s=0.1,keep=0")
        bench.go_on(0.05)
        assert not bench.enabled()
        bench.go_on(0.2)
        assert bench.enabled()
        assert bench.count() > before


@pytest.mark.parametrize("rad_per_count", [PER_COUNT, -PER_COUNT])
def test_a_quarter_turn_wraps_a_counter_that_is_near_its_wrap(tmp_path, rad_per_count):
    with Bench(tmp_path, encoder=counted(rad_per_count)) as bench:
        bench.rig.inject("encoder-wrap:at_s=0")
        bench.go_on(0.01)
        assert bench.count() == (65206 if rad_per_count > 0 else 330)
        bench.mode("forward", 0.5)
        while bench.wheel.position_rad < math.tau / 4 + 0.05:
            bench.go_on(0.001)
        assert (bench.count() < 330) == (rad_per_count > 0)


def test_faults_that_pins_cannot_have_do_nothing(tmp_path):
    with Bench(tmp_path) as bench:
        for spec in ("bus-off:at_s=0,for_s=1", "tcp-stall:at_s=0,for_s=1", "half-open:at_s=0"):
            bench.rig.inject(spec)
        bench.mode("forward", 0.5)
        bench.go_on(1.0)
        assert bench.wheel.velocity_rad_s > 0.3 * FULL_RAD_S


def test_the_files_are_gone_when_it_ends(tmp_path):
    with Bench(tmp_path) as bench:
        assert sorted(path.name for path in (bench.folder / "pwm3").iterdir()) == [
            "duty_cycle", "enable", "period", "polarity",
        ]  # fmt: skip
    assert not bench.folder.exists()


# --------------------------------------------------------------- a simulator that is held up
def test_its_clock_skips_the_time_in_which_the_simulator_was_held_up():
    now_s = 100.0
    clock = PausingClock(99.0, lambda: now_s)
    assert clock() == pytest.approx(1.0)
    now_s += 0.001
    assert clock() == pytest.approx(1.001)
    now_s += 30.0
    assert clock() == pytest.approx(1.001 + HELD_UP_S)
    now_s += 0.001
    assert clock() == pytest.approx(1.002 + HELD_UP_S)


def test_wheels_on_pins_do_not_jump_after_the_simulator_was_held_up(simulator):
    held_s = 0.5
    sim_s, real_s = simulator.control.truth().time_s, time.monotonic()
    os.kill(simulator.process.pid, signal.SIGSTOP)
    try:
        while time.monotonic() < real_s + held_s:
            select.select([], [], [], held_s / 10)
    finally:
        os.kill(simulator.process.pid, signal.SIGCONT)
    sim_s = simulator.control.truth().time_s - sim_s
    assert sim_s < time.monotonic() - real_s - 0.9 * held_s
    assert simulator.control.stats()["held_up_max_s"] > 0.9 * held_s


# ------------------------------------------------------------------------------- the robot's file
def test_gpio_lines_that_select_the_direction_become_channels_of_their_own(tmp_path):
    robot = tmp_path / "robot.toml"
    text = (ROOT / "config/robots/pi4-encoders.toml").read_text(encoding="utf-8")
    assert 'in2 = "GPIO6"' in text
    robot.write_text(text.replace('in2 = "GPIO6"', 'in2 = "!GPIO6"'), encoding="utf-8")
    with start_simulator(robot, link_dir=tmp_path / "sim") as simulator:
        spec = spec_of(simulator, robot)
        assert [dict(joint.pins) for joint in spec.joints] == [
            {"pwm": "pwm0", "in1": "pwm2", "in2": "!pwm3"},
            {"pwm": "pwm1", "in1": "pwm4", "in2": "pwm5"},
        ]
        folders = {path.name for path in Path(simulator.ports["pins"]).iterdir()}
        assert {f"pwm{channel}" for channel in range(6)} < folders


async def test_the_line_reverses_a_simulated_bridge_by_its_direction_pins(tmp_path):
    robot = ROOT / "config/robots/pi4-encoders.toml"
    with start_simulator(robot, link_dir=tmp_path / "sim") as simulator:
        async with running(spec_of(simulator, robot)) as rig:
            await rig.ready()
            await armed(rig)
            for sign in (1.0, -1.0):
                rig.loop.enabled, rig.loop.duty = True, {0: 0.5 * sign}
                await until(
                    lambda sign=sign: (
                        simulator.control.truth().joints["left"].velocity_rad_s * sign > 3.0
                    ),
                    f"the left wheel turns {sign:+g}",
                )


@pytest.fixture(scope="module")
def simulator(tmp_path_factory):
    folder = tmp_path_factory.mktemp("a b")  # the printed path has to be quoted
    with start_simulator(ROBOT, link_dir=folder) as simulator:
        yield simulator


def spec_of(simulator, path=ROBOT):
    robot = load_robot(path, simulator.settings)
    profiles = robot.profiles
    return line_specs(robot, profiles)[0]


def test_its_settings_make_the_robot_file_find_pins_and_counters(simulator):
    spec = spec_of(simulator)
    assert spec.pins.pwm_chip == simulator.ports["pins"]
    assert [dict(joint.pins) for joint in spec.joints] == [
        {"rpwm": "pwm0", "lpwm": "pwm1"},
        {"rpwm": "pwm2", "lpwm": "pwm3"},
    ]
    encoders = [joint.encoder for joint in spec.joints]
    assert [(each.counter, each.count) for each in encoders] == [
        (simulator.ports["pins"], 0),
        (simulator.ports["pins"], 1),
    ]
    assert encoders[0].rad_per_count == pytest.approx(PER_COUNT)
    assert encoders[1].rad_per_count == pytest.approx(-PER_COUNT)  # its motor is in reverse


def test_a_reversed_encoder_stays_reversed(tmp_path):
    robot = tmp_path / "robot.toml"
    text = ROBOT.read_text(encoding="utf-8")
    robot.write_text(text.replace('b = "GPIO24"', 'b = "GPIO24"\nreversed = true'), "utf-8")
    with start_simulator(robot, link_dir=tmp_path / "sim") as simulator:
        found = load_robot(robot, simulator.settings)
        assert [found.joint[name].encoder.reversed for name in found.joint] == [False, True]


async def test_the_line_drives_the_simulated_wheels_and_counts_them(simulator):
    async with running(spec_of(simulator)) as rig:
        await rig.ready()
        await armed(rig)
        rig.loop.enabled, rig.loop.duty = True, {0: 0.5, 1: -0.25}

        def turning():
            joints = simulator.control.truth().joints
            return joints["left"].velocity_rad_s > 3.0 and joints["right"].velocity_rad_s < -1.0

        await until(turning, "left forward, right backward")
        await until(lambda: rig.loop.exchange.take_feedback(0).velocity_rad_s > 3.0, "it is seen")
        await until(lambda: rig.loop.exchange.take_feedback(1).velocity_rad_s < -1.0, "and that")
        rig.loop.duty = {}
        await until(lambda: simulator.control.truth().at_rest, "rest")
        await rig.line.disarm()
        assert set(rig.line.drive_states.values()) == {DriveState.READY}
        for joint in spec_of(simulator).joints:
            position_rad = simulator.control.truth().joints[joint.name].position_rad

            def counted_rad(joint=joint):
                count = rig.loop.exchange.take_feedback(joint.index).count
                return (count - (1 << 64) if count >> 63 else count) * joint.encoder.rad_per_count

            await until(lambda at_rad=position_rad: abs(counted_rad() - at_rad) < 1.01 * PER_COUNT)
    assert not any(joint.enabled for joint in simulator.control.truth().joints.values())
