# SPDX-License-Identifier: Apache-2.0
"""Reading a robot file: it becomes values, and each mistake in it a line of the errors."""

import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.config import ConfigError, load_robot

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
DEMO = (ROBOTS / "demo.toml").read_text(encoding="utf-8") + '[publish.console]\nkind = "stdout"\n'
MINIMAL = """\
robot.name = "minimal"
[base]
kind = "differential"
track_m = 0.4
wheel_radius_m = 0.1
[line.bus]
kind = "modbus-rtu"
port = "/dev/ttyUSB0"
[joint.left]
line = "bus"
drive = "zlac8015d"
unit = 1
side = "left"
[joint.right]
line = "bus"
drive = "zlac8015d"
unit = 1
channel = 2
side = "right"
inverted = true
"""


UNIONS = {
    "base": ("kind", "base.kind"),
    "line.bus": ("kind", "line.bus.kind"),
    "battery": ("source", "battery.source"),
    "imu": ("source", "imu.source"),
    "input.x": ("kind", "input.x.kind"),
    "publish.x": ("kind", "publish.x.kind"),
    "joint.left.encoder": ("kind", "joint.left.encoder.kind"),
}
"""Tables whose other keys depend on one key."""


def loaded_with(tmp_path, table, text):
    """Load a robot file in which this table has only this text; return its problems."""
    rest = re.sub(rf"(?m)^\[{re.escape(table)}\]\n(?:[a-z_]+ = .*\n)*", "", MINIMAL)
    file = tmp_path / "robot.toml"
    file.write_text(f"{rest}[{table}]\n{text}", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_robot(file)
    return caught.value.problems


@pytest.mark.parametrize("table", UNIONS)
def test_a_missing_key_that_decides_is_named(tmp_path, table):
    key, path = UNIONS[table]
    wrong = "kind" if key == "source" else "type"
    rows = [row for row in loaded_with(tmp_path, table, f'{wrong} = "x"\n') if row.key == path]
    assert [row.text.partition(" (")[0] for row in rows] == ["is missing"]


@pytest.mark.parametrize(("value", "shown"), [('"x"', '"x"'), ("7", "7"), ("[]", "a list")])
@pytest.mark.parametrize("table", UNIONS)
def test_a_wrong_value_of_the_key_that_decides_is_shown(tmp_path, table, value, shown):
    key, path = UNIONS[table]
    (row,) = (row for row in loaded_with(tmp_path, table, f"{key} = {value}\n") if row.key == path)
    assert row.text.startswith(f"{shown} is ")


def test_the_mark_that_some_editors_write_first_is_accepted(tmp_path):
    file = tmp_path / "robot.toml"
    file.write_text(MINIMAL, encoding="utf-8-sig")
    assert load_robot(file).robot.name == "minimal"


@pytest.mark.parametrize(
    ("port", "words"),
    [
        ("ttyUSB0", 'write "/dev/ttyUSB0"'),
        ("serial0", 'write "/dev/serial0"'),
        ("COM3", "a port of Windows"),
        ("com12", "a port of Windows"),
    ],
)
def test_a_port_that_is_no_path_is_refused_with_the_right_form(tmp_path, port, words):
    file = tmp_path / "robot.toml"
    file.write_text(MINIMAL.replace("/dev/ttyUSB0", port), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_robot(file)
    (row,) = caught.value.problems
    assert (row.key, words in row.text) == ("line.bus.port", True)


@pytest.fixture
def problems_of(tmp_path):
    """Return a function that gives the errors of a robot file's text, without the file's name."""

    def read(text, overrides=()):
        path = tmp_path / "robot.toml"
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ConfigError) as caught:
            load_robot(path, overrides)
        return [str(row).replace(f"{path}:", "") for row in caught.value.problems]

    return read


def load(tmp_path, text, overrides=()):
    path = tmp_path / "robot.toml"
    path.write_text(text, encoding="utf-8")
    return load_robot(path, overrides)


def test_defaults_are_slow_and_careful(tmp_path):
    robot = load(tmp_path, MINIMAL)
    assert robot.limits.linear_m_s == 0.5
    assert robot.limits.linear_m_s3 == math.inf
    assert robot.safety.on_fault == "ramp"
    assert robot.joint["left"].velocity_max_rad_s is None
    assert robot.local_input.lease_s == 0.3
    assert not robot.publish
    assert robot.warnings == ()


def test_a_deceleration_that_is_not_given_is_the_acceleration(tmp_path):
    robot = load(tmp_path, MINIMAL + "[limits]\nlinear_m_s2 = 0.7\nangular_rad_s2 = 3\n")
    assert robot.limits.linear_deceleration_m_s2 == 0.7
    assert robot.limits.angular_deceleration_rad_s2 == 3.0


def test_a_robot_cannot_be_changed_after_it_was_read(tmp_path):
    robot = load(tmp_path, MINIMAL)
    with pytest.raises(ValueError, match="frozen"):
        robot.limits.linear_m_s = 9.0


def test_joints_keep_the_order_of_the_file():
    robot = load_robot(ROBOTS / "skid4.toml")
    assert list(robot.joint) == ["front_left", "front_right", "rear_left", "rear_right"]


@pytest.mark.parametrize(
    ("wrong", "row"),
    [
        ("rate_hz = 9", "6: loop.rate_hz: 9 is out of range (10 to 20000 Hz)"),
        ("rate_hz = nan", "6: loop.rate_hz: nan is out of range (10 to 20000 Hz)"),
        ("rate_hz = inf", "6: loop.rate_hz: inf is out of range (10 to 20000 Hz)"),
        (
            'rate_hz = "9"',
            '6: loop.rate_hz: "9" is not a number: write 9, without quotes (10 to 20000 Hz)',
        ),
        ("rate_hz = true", "6: loop.rate_hz: true is not a number (10 to 20000 Hz)"),
        ("rate_hz = [9]", "6: loop.rate_hz: a list is not a number (10 to 20000 Hz)"),
        ("priority = 1.5", "6: loop.priority: 1.5 is not a whole number (0 to 99)"),
        ("ratehz = 900", "6: loop.ratehz: unknown key (did you mean rate_hz?)"),
        ("lock_memory = 1", "6: loop.lock_memory: 1 is not true or false"),
        ("cpu = 3", "6: loop.cpu: 3 is not a list"),
        ("rate_hz = 2024-01-01", "6: loop.rate_hz: 2024-01-01 is not a number (10 to 20000 Hz)"),
        ("cpu = [1,\n 64]", "7: loop.cpu[1]: 64 is out of range (0 to 63)"),
    ],
)
def test_a_wrong_value_is_reported_with_its_line_and_what_is_right(problems_of, wrong, row):
    text = re.sub(r"rate_hz = 1000\npriority = 80", wrong, DEMO)
    assert problems_of(text) == [row]


@pytest.mark.parametrize(
    ("right", "wrong", "row"),
    [
        ('"modbus-rtu"', '"canopen"', 'line.rs485.kind: {} is unknown ("ascii", "can", '),
        ('"stdout"', '"stdio"', 'publish.console.kind: {} is unknown ("foxglove", '),
    ],
)
def test_an_unknown_kind_is_reported_with_the_known_ones(problems_of, right, wrong, row):
    (found,) = problems_of(DEMO.replace(right, wrong, 1))
    assert found.partition(": ")[2].startswith(row.format(wrong))


@pytest.mark.parametrize(
    ("right", "wrong", "row"),
    [
        ('"demo"', '"My Robot"', 'robot.name: "My Robot": a name is letters, digits'),
        ('"demo"', '"x"\nnamespace = "a"', "robot.namespace: unknown key (did you mean name?)"),
        ("joint.left]", 'joint."L x"]', 'joint.L x: "L x": a name is letters, digits'),
        ('"/dev/ttyUSB0"', '""', "line.rs485.port: is empty"),
        ('"/dev/ttyUSB0"', "3", 'line.rs485.port: 3 is not a string: write "3"'),
        ('name = "demo"', "colour = 1", "robot.colour: unknown key (known: name)"),
    ],
)
def test_names_and_texts_are_checked(problems_of, right, wrong, row):
    found = [problem.partition(": ")[2] for problem in problems_of(DEMO.replace(right, wrong, 1))]
    assert any(problem.startswith(row) for problem in found), found


def test_consequences_of_a_mistake_are_not_reported(problems_of):
    """A required key that is misspelt is not reported as missing too, and no key of a line of an
    unknown kind is reported as unknown."""
    text = DEMO.replace("track_m", "trak_m").replace(
        'kind = "modbus-rtu"', 'kind = "smoke"\nbits = 1'
    )
    base, line = [row.partition(":")[2] for row in problems_of(text)]
    assert base == " base.trak_m: unknown key (did you mean track_m?)"
    assert line.startswith(' line.rs485.kind: "smoke" is unknown ("')
    assert '"modbus-rtu", "modbus-tcp", ' in line


def test_a_mistake_in_a_value_does_not_hide_one_between_values(problems_of):
    text = DEMO.replace('name = "demo"', "").replace("channel = 2", "channel = 1")
    text = text.replace('side = "left"', 'side = "lft"').replace("track_m = 0.45", "track_m = -1")
    rows = "\n".join(problems_of(text))
    assert "robot.name: is missing" in rows
    assert "base.track_m: -1 is out of range (0.02 to 20 m)" in rows
    assert 'joint.left.side: "lft" is unknown ("left", "right"; did you mean "left"?)' in rows
    assert 'joint.right.channel: unit 1 on line "rs485" channel 1 is taken by joint left' in rows
    assert len(rows.splitlines()) == 4


@pytest.mark.parametrize(
    ("right", "wrong", "row"),
    [
        ("rs485", "rs/485", 'line.rs/485: "rs/485": a name is'),
        ("[joint.left]", '[joint."my left"]', 'joint.my left: "my left": a name is'),
        ("[line.", "[lines.", "lines: unknown key (did you mean line?)"),
    ],
)
def test_a_refused_table_is_not_reported_as_missing(problems_of, right, wrong, row):
    (found,) = problems_of(DEMO.replace("line.rs485", 'line."rs485"').replace(right, wrong))
    assert found.partition(": ")[2].startswith(row)


def test_a_table_with_a_wrong_name_gets_a_suggestion(problems_of):
    assert problems_of(DEMO.replace("[limits]", "[limit]")) == [
        "14: limit: unknown key (did you mean limits?)"
    ]


def test_for_an_empty_file_the_required_tables_are_named(problems_of):
    keys = [row.split(": ")[1] for row in problems_of("")]
    assert keys == ["robot", "base", "line", "joint"]


@pytest.mark.parametrize("text", ["base = 3", "joint = [1]", "line.a = 3", "publish.a = 3"])
def test_a_value_in_place_of_a_table_is_reported(problems_of, text):
    assert any(" is not a table" in row for row in problems_of(f"{text}\n"))


def test_a_syntax_error_has_its_line(problems_of):
    (row,) = problems_of('[robot]\nname = "x\n')
    assert re.fullmatch(r"2: syntax: \S.*", row)


def test_a_file_that_ends_too_early_is_reported_with_a_line(problems_of):
    (row,) = problems_of('[robot]\nname = """x\n')
    assert re.fullmatch(r"\d: syntax: \S.*", row)


def test_a_file_that_is_not_text_or_not_there_is_a_problem_and_no_traceback(tmp_path):
    path = tmp_path / "robot.toml"
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        load_robot(path)
    path.write_bytes(b'[robot]\nname = "\xff"\n')
    with pytest.raises(ConfigError, match=r"robot\.toml:2: syntax: is not UTF-8"):
        load_robot(path)


def test_an_override_replaces_a_value_and_is_read_as_toml(tmp_path):
    overrides = ["limits.linear_m_s=0.2", "line.bus.port=/dev/ttyS1", "loop.cpu=[1, 2]"]
    robot = load(tmp_path, MINIMAL, overrides)
    assert robot.limits.linear_m_s == 0.2
    assert robot.line["bus"].port == "/dev/ttyS1"
    assert robot.loop.cpu == (1, 2)


def test_a_wrong_override_is_reported_by_its_own_text(problems_of):
    assert problems_of(MINIMAL, ["base.track_m=-1"]) == [
        "--set base.track_m=-1: base.track_m: -1 is out of range (0.02 to 20 m)"
    ]
    for option in ("nonsense", "a b=3", "=3"):
        (row,) = problems_of(MINIMAL, [option])
        assert row.startswith(f"--set {option}: is not KEY=VALUE")


def test_a_profile_beside_the_robot_file_is_found_by_its_path(tmp_path):
    shipped = ROBOTS.parent / "drives/zlac8015d.toml"
    (tmp_path / "mine.toml").write_text(
        shipped.read_text(encoding="utf-8").replace('"zlac8015d"', '"mine"'), encoding="utf-8"
    )
    robot = load(tmp_path, MINIMAL.replace('"zlac8015d"', '"./mine.toml"'))
    assert robot.joint["left"].drive == "./mine.toml"


KEY_LINES = [
    number for number, line in enumerate(DEMO.splitlines(), 1) if re.match(r"\w+ = ", line)
]
JUNK = st.one_of(
    st.sampled_from(["nan", "inf", "-inf", "-1", "0", "1e300", "-0.0", "[]", "{}", '""', "true"]),
    st.floats().map(str),
    st.integers(-(2**63), 2**63 - 1).map(str),
    st.text(max_size=5).map(lambda text: "'" + re.sub(r"[\x00-\x1f\x7f']", "", text) + "'"),
)


def try_to_load(path):
    try:
        return load_robot(path), ()
    except ConfigError as error:
        return None, error.problems


def numbers(value):
    if isinstance(value, dict):
        for inner in value.values():
            yield from numbers(inner)
    elif isinstance(value, float):
        yield value


@given(line=st.sampled_from(KEY_LINES), junk=JUNK)
def test_junk_in_a_line_is_refused_in_that_line_or_is_a_finite_number(tmp_path_factory, line, junk):
    lines = DEMO.splitlines()
    name = lines[line - 1].split(" = ")[0]
    lines[line - 1] = f"{name} = {junk}"
    path = tmp_path_factory.getbasetemp() / "junk.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    robot, problems = try_to_load(path)
    assert all(row.file == str(path) and 1 <= row.line <= len(lines) for row in problems)
    if robot is None:
        between = ("safety.", "joint.", "limits", "line.")  # keys of rules between several values
        assert any(row.line == line or row.key.startswith(between) for row in problems)
        return
    assert min(robot.limits.linear_m_s3, robot.limits.angular_rad_s3) > 0
    infinite = {
        "limits": {"linear_m_s3", "angular_rad_s3", "lateral_m_s3"},
        "joint": {"__all__": {"duty_slew_per_s", "jerk_max_rad_s3"}},
    }
    assert all(math.isfinite(number) for number in numbers(robot.model_dump(exclude=infinite)))


@pytest.mark.parametrize("drive", ["./mine.toml", "mine.toml"])
def test_a_drive_file_beside_the_robot_file_is_found_from_any_folder(tmp_path, monkeypatch, drive):
    profile = (ROBOTS.parent / "drives/zlac8015d.toml").read_text(encoding="utf-8")
    own = profile.replace('name = "zlac8015d"', 'name = "mine"')
    (tmp_path / "mine.toml").write_text(own, encoding="utf-8")
    robot = tmp_path / "robot.toml"
    robot.write_text(MINIMAL.replace('"zlac8015d"', f'"{drive}"'), encoding="utf-8")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for folder, file in ((tmp_path, "robot.toml"), (elsewhere, "../robot.toml"), ("/", robot)):
        monkeypatch.chdir(folder)
        assert load_robot(file).joint["left"].drive == drive


def test_another_encoder_on_a_drive_that_counts_its_speed_in_edges_needs_no_profile(tmp_path):
    claw = (ROBOTS / "roboclaw.toml").read_text(encoding="utf-8")
    robot = load(tmp_path, claw.replace("channel =", "counts_per_turn = 2640\nchannel ="))
    shipped = load(tmp_path, claw)
    finer, usual = robot.profiles["roboclaw"], shipped.profiles["roboclaw"]
    assert usual.registers["target_velocity_1"].to_si(1320) == pytest.approx(2 * math.pi)
    assert finer.registers["target_velocity_1"].to_si(2640) == pytest.approx(2 * math.pi)


def test_two_encoders_on_one_drive_that_counts_in_edges_are_refused_with_the_cure(problems_of):
    claw = (ROBOTS / "roboclaw.toml").read_text(encoding="utf-8")
    (found,) = problems_of(claw.replace("channel = 2", "counts_per_turn = 2640\nchannel = 2"))
    assert "joint.right.counts_per_turn: 2640 differs from another joint" in found
    assert "copy the profile" in found


def test_a_text_board_needs_no_address_and_no_counts_that_it_does_not_report(tmp_path):
    text = (ROBOTS / "arduino-text.toml").read_text(encoding="utf-8")
    text = text.replace('feedback = "{left_count},{right_count}\\n"\n', "")
    robot = load(tmp_path, text.replace("counts_per_turn = 1320\n", ""))
    assert "unit" not in robot.joint["left"].model_fields_set


def test_a_drive_on_a_shared_line_needs_its_address(problems_of):
    found = problems_of(MINIMAL.replace("unit = 1\n", ""))
    assert [row.partition(" ")[2].partition(" (")[0] for row in found] == [
        "joint.left.unit: is missing: the address of its drive on this line",
        "joint.right.unit: is missing: the address of its drive on this line",
    ]


def test_the_local_socket_commands_beside_other_inputs_unless_it_is_switched_off(tmp_path):
    ros = '[input.nav]\nkind = "rt"\npriority = 50\n'
    names = [source["name"] for source in load(tmp_path, MINIMAL + ros).commanders()]
    assert names == ["local socket", "nav"]
    off = '[input.local]\nkind = "socket"\nenabled = false\n'
    robot = load(tmp_path, MINIMAL + ros + off)
    assert [source["name"] for source in robot.commanders()] == ["nav"]
    assert not robot.local_input.enabled
