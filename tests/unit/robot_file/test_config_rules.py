# SPDX-License-Identifier: Apache-2.0
"""Rules between the values of a robot file, and between the file and its drives."""

import re
from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot
from motord.config.rules.wiring.wire import cycle_limit_hz
from motord.config.wiring import line_specs

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"


def edited(tmp_path, robot, *edits):
    """Write a copy of a shipped robot file with these (old, new) pieces of text replaced, each at
    its first place; return its path."""
    text = (ROBOTS / f"{robot}.toml").read_text(encoding="utf-8")
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "robot.toml"
    path.write_text(text, encoding="utf-8")
    return path


def errors(path):
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    return [f"{row.key}: {row.text}" for row in caught.value.problems]


def warnings(path):
    return [f"{row.key}: {row.text}" for row in load_robot(path).warnings]


def line_that_says(path, text):
    lines = path.read_text(encoding="utf-8").splitlines()
    return next(number for number, line in enumerate(lines, 1) if line.startswith(text))


@pytest.mark.parametrize(
    ("robot", "edits", "row"),
    [
        (
            "demo",
            [('line = "rs485"', 'line = "rs458"')],
            'joint.left.line: there is no line "rs458" (did you mean "rs485"?)',
        ),
        (
            "demo",
            [('drive = "zlac8015d"', 'drive = "zlac"')],
            'joint.left.drive: there is no drive profile "zlac" (did you mean "zlac8030d"?)',
        ),
        (
            "demo",
            [("channel = 2", "channel = 3")],
            'joint.right.channel: drive "zlac8015d" has no channel 3 (it has 1, 2)',
        ),
        (
            "demo",
            [("channel = 2", "channel = 1")],
            'joint.right.channel: unit 1 on line "rs485" channel 1 is taken by joint left',
        ),
        (
            "two-single-drives",
            [("unit = 2", "unit = 1")],
            'joint.right.unit: unit 1 on line "rs485" channel 1 is taken by joint left',
        ),
        (
            "demo",
            [("linear_deceleration_m_s2 = 1.5", "linear_deceleration_m_s2 = 0.01")],
            (
                "limits: from full speed it takes 100 s to rest (at most 20 s): "
                "more deceleration and jerk, or less speed"
            ),
        ),
        (
            "demo",
            [("angular_rad_s3 = 30.0", "angular_rad_s3 = 0.01")],
            (
                "limits: from full speed it takes 28 s to rest (at most 20 s): "
                "more deceleration and jerk, or less speed"
            ),
        ),
        (
            "demo",
            [('side = "right"', 'side = "left"')],
            'joint: no joint is on the right (side = "right")',
        ),
        (
            "demo",
            [("velocity_max_rad_s = 15.0", "velocity_max_rad_s = 315.0")],
            (
                'joint.left.velocity_max_rad_s: 315 rad/s is more than drive "zlac8015d" can '
                "(at most 314.2 rad/s)"
            ),
        ),
        (
            "two-single-drives",
            [("gear_ratio = 20.0", 'gear_ratio = 60.0\ndiffers_in = ["gear_ratio"]')],
            (
                'joint.left.velocity_max_rad_s: 8 rad/s is more than drive "bld-305s" can '
                "(at most 6.981 rad/s)"
            ),
        ),
        (
            "cia402-torque",
            [("velocity_max_rad_s = 15.0\n", "")],
            (
                'joint.left.velocity_max_rad_s: is missing: drive "cia402-torque" takes a torque, '
                "and knows no speed at most"
            ),
        ),
        (
            "cia402-torque",
            [("torque_max_n_m = 3.0", "torque_max_n_m = 31.0")],
            (
                'joint.left.speed_loop.torque_max_n_m: is more than drive "cia402-torque" takes '
                "(at most 30 N·m at the wheel)"
            ),
        ),
        (
            "forward-only",
            [("full_duty_rad_s = 18.0\n", "")],
            (
                'joint.left.full_duty_rad_s: is missing: drive "duty-register" takes a '
                "duty, and the "
                "speed at duty 1 is not known (0.01 to 10000 rad/s)"
            ),
        ),
        (
            "forward-only",
            [
                ("duty_dead_band = 0.06", "duty_dead_band = 0.5\nduty_max = 0.5"),
                ("velocity_max_rad_s = 15.0", ""),
            ],
            "joint.left.duty_dead_band: the dead band leaves nothing below duty_max",
        ),
        (
            "forward-only",
            [("duty_slew_per_s", "reversible = true\nduty_slew_per_s")],
            'joint.left.reversible: drive "duty-register" cannot turn backward',
        ),
        (
            "forward-only",
            [("duty_slew_per_s", "inverted = true\nduty_slew_per_s")],
            'joint.left.inverted: drive "duty-register" cannot turn backward',
        ),
        (
            "forward-only",
            [("duty_slew_per_s", "counts_per_turn = 100\nduty_slew_per_s")],
            'joint.left.counts_per_turn: drive "duty-register" has no position counter',
        ),
        (
            "demo",
            [("feedback_timeout_s = 0.25", "feedback_timeout_s = 0.039")],
            (
                'safety.feedback_timeout_s: 0.039 s is shorter than three cycles of line "rs485" '
                "(at least 0.06 s): one lost reply and a late one would stop the robot"
            ),
        ),
        (
            "demo",
            [("drive_watchdog_s = 0.5", "drive_watchdog_s = 0.03")],
            (
                'safety.drive_watchdog_s: 0.03 s is shorter than three cycles of line "rs485" '
                "(at least 0.06 s): one lost reply and a late one would stop the robot"
            ),
        ),
        (
            "demo",
            [
                (
                    "[joint.left]",
                    '[line.b]\nkind = "modbus-rtu"\nport = "/dev/ttyUSB0"\n[joint.left]',
                ),
                ('line = "rs485"', 'line = "b"'),
            ],
            'line.b.port: line "rs485" has this port already',
        ),
    ],
)
def test_what_cannot_work_is_an_error_at_its_line(tmp_path, robot, edits, row):
    path = edited(tmp_path, robot, *edits)
    assert errors(path) == [row]


def test_an_error_names_the_line_of_the_later_of_two_joints(tmp_path):
    path = edited(tmp_path, "demo", ("channel = 2", "channel = 1"))
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    joint = line_that_says(path, "[joint.right]")
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[caught.value.problems[0].line - 1] == "channel = 1"
    assert caught.value.problems[0].line > joint


def test_two_kinds_of_drive_at_one_unit_are_refused(tmp_path):
    path = edited(tmp_path, "two-single-drives", ("unit = 2", "unit = 1"))
    text = path.read_text(encoding="utf-8")
    head, right = text.split("[joint.right]")
    path.write_text(f"{head}[joint.right]{right.replace('bld-305s', 'zlac8015d')}")
    row = 'joint.right.drive: unit 1 on line "rs485" is a "bld-305s" for joint left'
    assert row in errors(path)


def test_a_watchdog_time_that_the_drive_cannot_hold_is_an_error(tmp_path):
    profile = (ROBOTS.parent / "drives/zlac8015d.toml").read_text(encoding="utf-8")
    short = re.sub(r"maximum_s = [\d.]+", "maximum_s = 0.4", profile)
    (tmp_path / "dog.toml").write_text(short.replace('name = "zlac8015d"', 'name = "dog"', 1))
    path = edited(tmp_path, "demo", ('drive = "zlac8015d"', 'drive = "./dog.toml"'))
    path.write_text(path.read_text().replace('"zlac8015d"', '"./dog.toml"'))
    (row,) = errors(path)
    assert row.startswith('safety.drive_watchdog_s: 0.5 s is out of range for drive "./dog.toml" (')
    assert row.endswith(" to 0.4 s)")


def test_a_torque_drive_needs_a_speed_loop(tmp_path):
    text = (ROBOTS / "cia402-torque.toml").read_text(encoding="utf-8")
    loop = text[text.index("[joint.left.speed_loop]") : text.index("[joint.right]")]
    (row,) = errors(edited(tmp_path, "cia402-torque", (loop, "")))
    assert row.startswith("joint.left.speed_loop: is missing: drive")


def test_a_broken_profile_is_reported_with_its_own_first_problem(tmp_path):
    (tmp_path / "dog.toml").write_text("schema = 1\n", encoding="utf-8")
    path = edited(tmp_path, "demo", ('drive = "zlac8015d"', 'drive = "./dog.toml"'))
    (row,) = errors(path)
    assert row.startswith("joint.left.drive: the drive profile cannot be used: ")
    assert re.search(r"dog\.toml.* \(and \d+ more\)$", row)


@pytest.mark.parametrize("count", [1, 9])
def test_a_base_has_two_to_eight_joints(tmp_path, count):
    head, _ = (ROBOTS / "demo.toml").read_text(encoding="utf-8").split("[joint.left]")
    for index in range(count):
        side = "left" if index % 2 == 0 else "right"
        head += f'[joint.j{index}]\nline = "rs485"\ndrive = "zlac8015d"\nside = "{side}"\n'
        head += f"unit = {1 + index // 2}\nchannel = {1 + index % 2}\n"
    path = tmp_path / "robot.toml"
    path.write_text(head, encoding="utf-8")
    word = "few" if count == 1 else "many"
    assert f"joint: {count} joints are too {word} (2 to 8)" in errors(path)


@pytest.mark.parametrize(
    ("robot", "edits", "row"),
    [
        (
            "cia402-torque",
            [('drive = "cia402-torque"\nunit = 1', 'drive = "cia402"\nunit = 1')],
            'joint.left.speed_loop: is not used: drive "cia402" holds the speed by itself',
        ),
        (
            "cia402-torque",
            [("unit = 2", "unit = 2\nduty_max = 0.5")],
            'joint.right.duty_max: is not used: drive "cia402-torque" takes a torque',
        ),
        (
            "demo",
            [("linear_m_s = 1.0", "linear_m_s = 1.3")],
            "limits.linear_m_s: 1.3 m/s is never reached: the wheels do 1.238 m/s",
        ),
        (
            "demo",
            [("angular_rad_s = 2.0", "angular_rad_s = 6.0")],
            "limits.angular_rad_s: 6 rad/s is never reached on the spot: the wheels do 5.5 rad/s",
        ),
        (
            "demo",
            [("inverted = true\n", "")],
            (
                "joint.right.inverted: joint left on the other side of the same drive "
                "is not inverted "
                "too: motors that face each other need one inverted"
            ),
        ),
        (
            "skid4",
            [
                ("unit = 2\nchannel = 1\n", "unit = 2\nchannel = 1\ninverted = true\n"),
                (
                    'unit = 2\nchannel = 2\nside = "right"\ninverted = true',
                    'unit = 2\nchannel = 2\nside = "right"\ninverted = false',
                ),
            ],
            (
                "joint.rear_left.inverted: joint front_left on the same side is not "
                "inverted: do both "
                "turn alike?"
            ),
        ),
        (
            "skid4",
            [("track_slip_factor = 1.5", "")],
            (
                "base.track_slip_factor: a skid base without track_slip_factor turns "
                "less than commanded (1.5 is usual)"
            ),
        ),
        (
            "demo",
            [("baudrate = 115200", "baudrate = 57600"), ("cycle_hz = 50", "cycle_hz = 20")],
            (
                'line.rs485.baudrate: drive "zlac8015d" leaves the factory with 115200 '
                "baud, parity "
                "none, 1 stop bit(s); this line has 57600 baud, parity none, 1 stop "
                "bit(s): it answers only if you have changed the drive; else write "
                'baudrate = 115200, parity = "none", stop_bits = 1 here'
            ),
        ),
        (
            "demo",
            [("channel = 1", "channel = 1\nduty_max = 0.5")],
            'joint.left.duty_max: is not used: drive "zlac8015d" takes a velocity',
        ),
        (
            "demo",
            [("channel = 1", "channel = 1\ncounts_per_turn = 0")],
            (
                "joint.left.drive: without a position counter: odometry comes from the "
                "measured speed, "
                "and is less exact"
            ),
        ),
        (
            "demo",
            [("[joint.left]", '[line.b]\nkind = "modbus-rtu"\nport = "/dev/x"\n[joint.left]')],
            "line.b: no joint is on this line",
        ),
    ],
)
def test_a_doubtful_value_is_a_warning(tmp_path, robot, edits, row):
    assert row in warnings(edited(tmp_path, robot, *edits))


@pytest.mark.parametrize(
    ("old", "new", "row"),
    [
        (
            "angular_deceleration_rad_s2 = 4.0",
            "angular_deceleration_rad_s2 = 1.5",
            (
                "limits.angular_deceleration_rad_s2: the angular axis lengthens a stop in a "
                "curve: from full speed linear motion takes 0.85 s to rest and turning 1.38 s, "
                "and the slower one sets the time; raise angular_deceleration_rad_s2 (and "
                "angular_rad_s3, if it is limited)"
            ),
        ),
        (
            "linear_deceleration_m_s2 = 1.5",
            "linear_deceleration_m_s2 = 0.5",
            (
                "limits.linear_deceleration_m_s2: the linear axis lengthens a stop in a curve: "
                "from full speed linear motion takes 2.06 s to rest and turning 0.63 s, and the "
                "slower one sets the time; raise linear_deceleration_m_s2 (and linear_m_s3, if "
                "it is limited)"
            ),
        ),
    ],
)
def test_an_axis_that_makes_the_other_one_stop_late_is_a_warning(tmp_path, old, new, row):
    assert row in warnings(edited(tmp_path, "demo", (old, new)))


def test_axes_that_stop_in_nearly_the_same_time_are_no_warning(tmp_path):
    edits = ("angular_deceleration_rad_s2 = 4.0", "angular_deceleration_rad_s2 = 1.7")
    assert not any("lengthens" in row for row in warnings(edited(tmp_path, "demo", edits)))


@pytest.mark.parametrize("path", sorted(ROBOTS.glob("*.toml")), ids=lambda path: path.stem)
def test_no_shipped_robot_has_an_axis_that_lengthens_a_stop(path):
    assert not any("lengthens" in row for row in warnings(path))


def test_a_drive_without_a_watchdog_is_reported_once_with_what_to_do():
    rows = [row for row in warnings(ROBOTS / "two-single-drives.toml") if "watchdog" in row]
    (row,) = rows
    assert row.startswith('joint.left.drive: drive "bld-305s" without a communication watchdog: ')
    assert "e-stop" in row


def test_the_wire_carries_more_with_a_shorter_gap():
    robot = load_robot(ROBOTS / "demo.toml")
    short = load_robot(ROBOTS / "demo.toml", ["line.rs485.gap_s=0.0005"])
    profiles = {"zlac8015d": robot.profiles["zlac8015d"]}
    (long_gap,), (short_gap,) = line_specs(robot, profiles), line_specs(short, profiles)
    assert 50 < cycle_limit_hz(long_gap) < cycle_limit_hz(short_gap) < 400


BATTERY = '[battery]\nsource = "drives"\nlow_v = 22.0\ncritical_v = 20.0\n\n[line.rs485]'


@pytest.mark.parametrize(
    ("edits", "message"),
    [
        (
            [("[line.rs485]", BATTERY.replace("20.0", "22.0"))],
            "battery.critical_v: must be below low_v (22 V)",
        ),
        (
            [("[line.rs485]", BATTERY.replace("low_v", 'joints = ["lefft"]\nlow_v'))],
            'battery.joints: there is no joint "lefft"',
        ),
        (
            [("[safety]", '[safety]\non_battery_critical = "stop"')],
            "safety.on_battery_critical: there is no [battery] that could be critical",
        ),
    ],
    ids=["thresholds", "joint", "nothing to be critical"],
)
def test_a_battery_that_does_not_fit_is_named(tmp_path, edits, message):
    assert message in errors(edited(tmp_path, "demo", *edits))


@pytest.mark.parametrize(
    ("reading", "message"),
    [
        ('current_from = "lefft.current_1"', 'battery.current_from: there is no joint "lefft"'),
        ('current_from = "left"', "battery.current_from: "),
        (
            'temperature_from = "left.temperatur_1"',
            'battery.temperature_from: drive "zlac8015d" has no register "temperatur_1" to read',
        ),
        (
            'current_from = "left.bus_voltage"',
            'battery.current_from: register "bus_voltage" is in V, not in A',
        ),
        (
            'joints = ["left"]\nvoltage_from = "left.bus_voltage"',
            "battery.joints: the voltage is that of voltage_from",
        ),
        (
            'bus = "/dev/i2c-1"\nchip_at_pack = true',
            "battery.chip_at_pack: ina226 does not measure its temperature",
        ),
    ],
)
def test_a_reading_of_the_battery_that_no_drive_has_is_named(tmp_path, reading, message):
    section = BATTERY.replace("low_v", f"{reading}\nlow_v")
    if "bus" in reading.split():
        section = section.replace('"drives"', '"ina226"')
    found = errors(edited(tmp_path, "demo", ("[line.rs485]", section)))
    assert any(row.startswith(message) for row in found), found


def test_a_battery_that_fits_is_taken(tmp_path):
    path = edited(tmp_path, "demo", ("[line.rs485]", BATTERY))
    assert load_robot(path).battery.low_v == 22.0


ESTOP = '[safety.estop]\ngpio_chip = "chip"\ngpio_line = "E"\n\n'
WATCHDOG = '[safety.watchdog]\ngpio_chip = "chip"\ngpio_line = "W"\n\n'


def with_pins(tmp_path, text):
    return edited(tmp_path, "demo", ("[line.rs485]", f"{text}[line.rs485]"))


def test_a_contact_is_normally_closed_to_ground_by_default(tmp_path):
    estop = load_robot(with_pins(tmp_path, ESTOP + WATCHDOG)).safety.estop
    assert (estop.contact, estop.switches_to, estop.stop_is_high) == (
        "normally-closed",
        "ground",
        True,
    )


@pytest.mark.parametrize(
    ("contact", "switches_to", "stop_is_high"),
    [
        ("normally-closed", "supply", False),
        ("normally-open", "ground", False),
        ("normally-open", "supply", True),
    ],
)
def test_the_level_that_stops_follows_from_the_wiring(tmp_path, contact, switches_to, stop_is_high):
    more = f'contact = "{contact}"\nswitches_to = "{switches_to}"\n'
    path = with_pins(tmp_path, ESTOP.rstrip("\n") + f"\n{more}\n")
    assert load_robot(path).safety.estop.stop_is_high is stop_is_high
    message = any("a broken wire" in row for row in warnings(path))
    assert message is (contact == "normally-open")


def test_one_line_cannot_be_both_pins_of_safety(tmp_path):
    path = with_pins(tmp_path, ESTOP + WATCHDOG.replace('"W"', '"E"'))
    assert "safety.watchdog.gpio_line: E is taken already (safety.estop)" in errors(path)


@pytest.mark.parametrize("pull", ["", "pull = true\n"])
def test_a_contact_cannot_rely_on_a_pull_that_a_jetson_does_not_have(tmp_path, pull):
    estop = ESTOP.replace('"chip"', '"tegra234-gpio"').rstrip("\n")
    (row,) = errors(with_pins(tmp_path, f"{estop}\n{pull}\n"))
    assert row.startswith('safety.estop.pull: the chip "tegra234-gpio" has no pulls')
    assert load_robot(with_pins(tmp_path, f"{estop}\npull = false\n\n")).safety.estop
