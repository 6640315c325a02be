# SPDX-License-Identifier: Apache-2.0
"""Drive profiles: the shipped ones are good, and every mistake in one is reported with its line."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.config.drives.load import find_profile, list_profiles, load_profile
from motord_hal.base.errors import ProfileError
from motord_hal.base.paths import config_dir
from motord_hal.drives.profile import SI_UNITS, Register, RegisterType

SHIPPED = sorted(list_profiles())
ZLAC = (config_dir() / "drives" / "zlac8015d.toml").read_text(encoding="utf-8")


def load(tmp_path, text, name="zlac8015d"):
    path = tmp_path / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return load_profile(path)


def problems(tmp_path, text, name="zlac8015d"):
    with pytest.raises(ProfileError) as error:
        load(tmp_path, text, name)
    return str(error.value).splitlines()


def line_of(text, fragment):
    return next(n for n, line in enumerate(text.splitlines(), 1) if fragment in line)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_profile_is_good_and_names_its_sources(name):
    profile = find_profile(name)
    assert profile.name == name
    assert profile.source
    assert all(register.source for register in profile.registers.values())
    assert profile.watchdog or profile.watchdog_note


def test_the_first_three_drives_are_shipped():
    assert {"duty-register", "zlac8015d", "bld-305s"} <= set(SHIPPED)


CS2RS = (config_dir() / "drives" / "cs2rs.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("pause = 0\n", "", "must lie side by side"),
        ("write_function = 16", "write_function = 6", "needs write_function = 16"),
        ("max_registers = 16", "max_registers = 4", "max_registers = 5 or more"),
        ("pause = 0\n", "pauze = 0\n", "pauze"),
        ("pause = 0\n", 'pause = "no"\n', "setpoint_with.pause"),
    ],
)
def test_what_goes_with_a_set_point_must_fit_into_its_request(tmp_path, old, new, message):
    assert CS2RS.count(old) >= 1
    before, behind = CS2RS.rsplit(old, 1)
    assert message in "\n".join(problems(tmp_path, before + new + behind, "cs2rs"))


def test_a_misspelt_name_gets_a_suggestion():
    with pytest.raises(ProfileError, match='did you mean "zlac8015d"'):
        find_profile("zlac8015")


def test_a_name_with_a_slash_is_a_path(tmp_path):
    load(tmp_path, ZLAC)
    assert find_profile(str(tmp_path / "zlac8015d.toml")).path.parent == tmp_path


def test_a_folder_of_the_user_s_outranks_the_shipped_one(tmp_path):
    load(tmp_path, ZLAC.replace("ZLTECH ZLAC8015D two", "Mine, two"))
    assert find_profile("zlac8015d", [tmp_path]).title.startswith("Mine")


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("schema = 1", "schema = 2", "schema = 2", "schema: 2 is unknown (1)"),
        ('name = "zlac8015d"', 'name = "zlac"', 'name = "zlac"', "must be the file's name"),
        (
            'protocol = "modbus-rtu"',
            'protocol = "modbus-rtv"',
            "modbus-rtv",
            'did you mean "modbus-rtu"',
        ),
        ("baudrate = 115200\n", "", "[serial]", "serial.baudrate: is missing: bits a second (300"),
        (
            "baudrate = 115200",
            "baudrat = 115200",
            "baudrat =",
            "unknown key (did you mean baudrate?)",
        ),
        ("baudrate = 115200", 'baudrate = "fast"', "baudrate =", "is not a whole number"),
        ("stop_bits = 1", "stop_bits = true", "stop_bits =", "true is not a whole number"),
        ("turnaround_s = 0.005", "turnaround_s = nan", "turnaround_s", "nan is out of range"),
        ("turnaround_s = 0.005", "turnaround_s = 60", "turnaround_s", "(1e-05 to 1 s)"),
        ("write_function = 16", "write_function = 7", "write_function", "7 is unknown (6, 16)"),
        ("counter_bits = 32", "counter_bits = 0", "[motor]", "both zero or both not"),
        (
            "address = 0x2089",
            "address = 0x2088",
            "[register.target_velocity_2]+1",
            "overlaps target_velocity_1",
        ),
        ("address = 0x20A9", "address = 0x20A8", "[register.position_2]+1", "overlaps position_1"),
        (
            "address = 0x20A9",
            "address = 0xFFFF",
            "[register.position_2]+1",
            "the second word lies beyond",
        ),
        ('type = "i32"', 'type = "i23"', "[register.position_1]+2", 'did you mean "i32"'),
        ("scale = 0.01\n", "scale = 0\n", "[register.bus_voltage]+3", "must not be zero"),
        ("mask = 0xFF00", "mask = 0xF0F0", "mask = 0xF0F0", "must be adjacent"),
        ("mask = 0x00FF", "mask = 0x01FF", "[register.temperature_2]+1", "overlaps temperature_1"),
        (
            'velocity = "velocity_1"',
            'velocity = "velocty_1"',
            "velocty_1",
            'did you mean "velocity_1"',
        ),
        (
            'velocity_setpoint = "target_velocity_1"',
            'velocity_setpoint = "velocity_1"',
            'velocity_setpoint = "velocity_1"',
            'cannot be written: its access is "r"',
        ),
        (
            'position = "position_1"',
            'position = "current_1"',
            'position = "current_1"',
            'must be "count"',
        ),
        ('velocity_setpoint = "target_velocity_2"\n', "", "[channel.2]", "exactly one of"),
        ("[channel.2]", "[channel.3]", "[channel.1]", "numbered 1, 2"),
        (
            '{ write = "control_word", value = 8 }',
            '{ write = "control_wort", value = 8 }',
            "control_wort",
            'did you mean "control_word"',
        ),
        (
            '{ write = "control_word", value = 8 }',
            '{ write = "control_word", value = 70000 }',
            "70000",
            "does not fit control_word",
        ),
        (
            '{ write = "control_word", value = 8 }',
            '{ write = "control_word", wait = "control_word" }',
            'wait = "control_word" }',
            'either "write" or "wait"',
        ),
        (
            'disarm = [{ write = "control_word", value = 7 }]',
            "disarm = []",
            "disarm = []",
            "must have a step",
        ),
        ("equals = 8\n", "equals = 65544\n", "[enabled]", "never true"),
        ("minimum_s = 0.01", "minimum_s = 40", "minimum_s = 40", "is above maximum_s"),
        ("maximum_s = 32.767", "maximum_s = 80", "maximum_s = 80", "cannot be written to"),
        (
            'register = "communication_timeout"',
            'register = "control_mode"',
            'register = "control_mode"',
            'must be "s" or "ms"',
        ),
        ("bit = 13", "bit = 11", "bit = 11+4", "listed twice"),
        ("bit = 13", "bit = 20", "bit = 20", "beyond fault_1"),
        (
            'source = "parameter table, 200Dh',
            'sourc = "parameter table, 200Dh',
            "sourc =",
            "register.control_mode.sourc: unknown key (did you mean source?)",
        ),
    ],
)
def test_a_mistake_is_reported_with_its_line(tmp_path, old, new, line, message):
    assert old in ZLAC
    text = ZLAC.replace(old, new, 1)
    fragment, _, further = line.partition("+")
    number = line_of(text, fragment) + int(further or 0)
    rows = problems(tmp_path, text)
    assert any(f"zlac8015d.toml:{number}: " in row and message in row for row in rows), rows


def test_all_mistakes_are_reported_at_once(tmp_path):
    text = ZLAC.replace("stop_bits = 1", "stop_bits = 3").replace("unit = 1\n", "unit = 300\n")
    text = text.replace('"over-current"', '""').replace('fault = "fault_2"', 'fault = "falt_2"')
    assert len(problems(tmp_path, text)) >= 4


def test_an_encoder_of_the_robot_changes_no_profile_without_a_motor_table():
    profile = find_profile("bld-305s")
    assert "[motor]" not in profile.path.read_text(encoding="utf-8")
    assert load_profile(profile.path, 1234) == profile


def test_a_profile_without_a_watchdog_needs_a_note(tmp_path):
    text = ZLAC[: ZLAC.index("[watchdog]")] + ZLAC[ZLAC.index("[[fault]]") :]
    assert any("watchdog_note" in row for row in problems(tmp_path, text))


def test_a_magnitude_with_a_sign_is_refused(tmp_path):
    text = (config_dir() / "drives" / "bld-305s.toml").read_text(encoding="utf-8")
    text = text.replace('[register.target_velocity]\naddress = 0x0056\ntype = "u16"',
                        '[register.target_velocity]\naddress = 0x0056\ntype = "i16"')  # fmt: skip
    assert any("needs no direction" in row for row in problems(tmp_path, text, "bld-305s"))
    text = text.replace("reverse = 2", "reverse = 1")
    assert any("three different" in row for row in problems(tmp_path, text, "bld-305s"))


@pytest.mark.parametrize(
    ("text", "message"),
    [("schema = ", ":1: syntax:"), ("", "name: is missing"), ("x = 1\ny = [", ":2: syntax:")],
)
def test_a_file_that_is_no_profile_is_reported(tmp_path, text, message):
    assert any(message in row for row in problems(tmp_path, text))


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ProfileError, match=r"nothing\.toml: cannot be read"):
        load_profile(tmp_path / "nothing.toml")
    (tmp_path / "latin.toml").write_bytes(b"title = '\xe4'")
    with pytest.raises(ProfileError, match="not UTF-8"):
        load_profile(tmp_path / "latin.toml")


@given(st.text(max_size=200))
def test_reading_noise_raises_nothing_but_a_profile_error(noise):
    path = Path("/dev/null")
    with pytest.raises(ProfileError):
        load_profile(path)


# -------------------------------------------------------------------------------------- registers
def register(kind, **changes):
    values = {"name": "r", "address": 0, "type": kind, "scale": 1.0, "unit": "", "access": "rw",
              "minimum": None, "maximum": None, "source": "test"}  # fmt: skip
    return Register(**{**values, **changes})


@given(st.sampled_from(list(RegisterType)), st.data())
def test_a_raw_value_survives_the_wire(kind, data):
    low, high = register(kind).raw_range
    raw = data.draw(st.integers(low, high))
    words = register(kind).encode(raw)
    assert len(words) == kind.words
    assert all(0 <= word <= 0xFFFF for word in words)
    assert register(kind).decode(words) == raw
    for outside in (low - 1, high + 1):
        with pytest.raises(ValueError, match="does not fit"):
            register(kind).encode(outside)


@given(
    st.sampled_from(list(RegisterType)),
    st.sampled_from(sorted(SI_UNITS)),
    st.floats(allow_nan=True, allow_infinity=True),
)
def test_what_is_written_always_fits_or_is_refused(kind, unit, value):
    target = register(kind, unit=unit, scale=0.1)
    if not math.isfinite(value):
        with pytest.raises(ValueError, match="cannot be written"):
            target.from_si(value)
        return
    raw = target.from_si(value)
    assert target.decode(target.encode(raw)) == raw
    low, high = target.raw_range
    if low < raw < high:
        assert target.to_si(raw) == pytest.approx(value, abs=0.051 * SI_UNITS[unit][1])


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_register_s_own_limits_hold(value):
    target = register(RegisterType.I16, minimum=-30, maximum=20)
    assert -30 <= target.from_si(value) <= 20


def test_rpm_become_radians_a_second():
    target = register(RegisterType.I16, unit="rpm", scale=0.1)
    assert target.to_si(600) == pytest.approx(2 * math.pi)
    assert target.from_si(-2 * math.pi) == -600


def test_a_mask_takes_its_bits_out_of_the_word():
    high = register(RegisterType.I16, mask=0xFF00, access="r")
    assert (high.decode((0x19F0,)), high.decode((0xF019,))) == (25, -16)


def test_low_first_swaps_words_and_nothing_else():
    assert register(RegisterType.U32_LOW_FIRST).decode((2, 1)) == 0x00010002
    assert register(RegisterType.U32).decode((2, 1)) == 0x00020001


# ------------------------------------------------------------------- keys that depend on each other
@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("zlac8015d", "unit = 1\n", 'unit = 1\ngap = "3.5char"\ngap_s = 0.001\n', "exclude"),
        (
            "bld-305s",
            "write_function = 6",
            "write_function = 6\nread_write_function = 23",
            "16 too",
        ),
        ("zlac8015d", 'type = "i32"', 'type = "u8"', "a Modbus register has 16 bits"),
        ("ddsm115", "unit = 1\n", "unit = 1\nbroadcast_stop = true\n", "has no such thing"),
        ("ddsm115", "address = 0x6406", "address = 0x6408", "outside the content"),
        ("ddsm115", "address = 0x6406", "address = 0x6405", "overlaps velocity"),
        ("ddsm115", 'access = "w"', 'access = "rw"', "in the request"),
        ("vfd-el", "pole_pairs = 2", "pole_pairs = 0", "needs motor.pole_pairs"),
        ("ddsm115", "value = 0 }", "value = 0, if_different = true }", "is for bus servos"),
        (
            "scs0009",
            'arm = [{ write = "torque_enable", value = 1 }]',
            'arm = [{ write = "torque_enable", value = 1, if_different = true }]',
            "only in configure",
        ),
        (
            "scs0009",
            'default = 20\naccess = "rw"',
            'default = 20\naccess = "w"',
            'if_different: "minimum_angle" cannot be read',
        ),
        ("scs0009", "maximum = 100\n", "maximum = 103\n", "does not fit m16-bit10-high-first"),
        ("bld-305s", 'type = "u16"', 'type = "m16-bit10-high-first"', "is for bus servos"),
    ],
)
def test_parts_that_do_not_go_together_are_reported(tmp_path, name, old, new, message):
    text = (config_dir() / "drives" / f"{name}.toml").read_text(encoding="utf-8")
    assert old in text
    rows = problems(tmp_path, text.replace(old, new, 1), name)
    assert any(message in row for row in rows), rows


def test_fifty_hertz_are_a_field_of_1500_rpm_with_two_pole_pairs():
    frequency = find_profile("vfd-el").registers["frequency"]
    assert frequency.to_si(5000) == pytest.approx(1500 * 2 * math.pi / 60)
    assert frequency.from_si(1500 * 2 * math.pi / 60) == 5000
    assert frequency.from_si(1e6) == 6000


def test_at_least_ten_drives_are_shipped():
    assert len(SHIPPED) >= 10
