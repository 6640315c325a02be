# SPDX-License-Identifier: Apache-2.0
"""A new drive profile made from a person's answers, as docs/drives/your-own-drive.md describes."""

import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

from motord.cli.files.check_text import understood_rows
from motord.cli.files.drives import drives
from motord.config import load_robot
from motord.config.drives.load import load_profile
from motord.config.problems import ConfigError
from motord_hal.base.errors import ProfileError
from motord_hal.base.paths import config_dir

PAGE = (Path(__file__).parents[3] / "docs/drives/your-own-drive.md").read_text(encoding="utf-8")


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def invoke(*args, typed=None):
        return CliRunner().invoke(drives, args, input=typed)

    return invoke


def test_the_page_s_commands_work_as_written(run):
    answers = re.search(r"```toml\n(.*?)```", PAGE, re.DOTALL).group(1)
    Path("answers.toml").write_text(answers, encoding="utf-8")
    commands = re.findall(r"```sh\n(.*?)\n```", PAGE, re.DOTALL)
    assert len(commands) == 3
    for command in commands:
        motord, verb, *rest = shlex.split(command)
        assert (motord, verb) == ("motord", "drives")
        result = run(*rest)
        assert result.exit_code == 0, result.output
    assert load_profile(Path("example42.toml")).watchdog is not None


ANSWERS = {
    "title": "Example", "source": "Example manual, page 12", "baudrate": 115200, "parity": "none",
    "stop_bits": 1, "unit": 1, "write_function": 6, "speed_address": 0x0200, "speed_bits": 16,
    "speed_sign": "signed", "example_value": 1000, "example_bytes": "03 E8", "speed_rpm_per_1": 1,
    "speed_maximum_rpm": 3000, "velocity_address": 0x0210, "velocity_bits": 16,
    "velocity_sign": "signed", "velocity_rpm_per_1": 0.1, "starts_by_speed": "no",
    "enable_address": 0x0201, "enable_on": 1, "enable_off": 0, "watchdog_address": 0x0300,
    "watchdog_ms_per_1": 1, "watchdog_minimum_s": 0.02, "watchdog_maximum_s": 10,
    "watchdog_action": "stops the motor",
}  # fmt: skip
MAGNITUDE = {
    "speed_sign": "magnitude", "direction_address": 0x0205, "direction_forward": 1,
    "direction_reverse": 2, "direction_rest": 0, "velocity_sign": "magnitude",
}  # fmt: skip
WIDE = {
    "speed_bits": 32, "write_function": 16, "example_value": 1000, "enable_address": 0x0240,
}  # fmt: skip


@pytest.fixture
def made(run):
    """Make mine.toml from ANSWERS with other ones, without those that are None."""

    def make(**changes):
        answers = {key: one for key, one in (ANSWERS | changes).items() if one is not None}
        text = "".join(f"{key} = {json.dumps(value)}\n" for key, value in answers.items())
        Path("answers.toml").write_text(text, encoding="utf-8")
        return run("new", "mine.toml", "--answers", "answers.toml")

    return make


def profile():
    return load_profile(Path("mine.toml"))


def text():
    return Path("mine.toml").read_text(encoding="utf-8")


def test_answers_to_all_questions_make_a_good_profile(made):
    result = made()
    assert result.exit_code == 0, result.output
    assert "unknown" not in result.output
    found = profile()
    assert found.unknown == ()
    assert found.registers["target_velocity"].si_limits == pytest.approx((-314.159, 314.159))
    assert found.registers["velocity"].scale == 0.1
    assert found.registers["enable"].address == 0x0201


def test_what_is_not_answered_is_left_out_and_listed_as_unknown(run):
    Path("answers.toml").write_text('title = "A"\nsource = "p. 1"\nspeed_address = 0x0200\n')
    result = run("new", "mine.toml", "--answers", "answers.toml")
    assert result.exit_code == 0, result.output
    facts = ("serial", "sign", "order", "scale", "range", "start", "enable", "velocity", "watchdog")
    for fact in facts:
        assert f"unknown: {fact}: " in result.output
    data = tomllib.loads(text())
    assert data["unknown"] == list(facts)
    assert list(data["register"]) == ["target_velocity"]
    assert data["register"]["target_velocity"] == {
        "address": 0x0200, "access": "rw", "source": "p. 1", "unit": "rpm",
    }  # fmt: skip
    assert "velocity" not in data["channel"]["1"]
    assert "watchdog" not in data
    assert "is unknown" in data["watchdog_note"]
    check = run("--check", "mine.toml")
    assert check.exit_code != 0
    assert '"enable" is unknown' in check.output
    assert '"range" is unknown' in check.output


@pytest.mark.parametrize(
    ("keys", "fact"),
    [
        (["speed_maximum_rpm"], "range"),
        (["enable_address", "enable_on", "enable_off"], "enable"),
        (["enable_off"], "enable"),
        (["speed_sign"], "sign"),
        (["example_bytes"], "order"),
        (["speed_bits"], "order"),
        (["speed_rpm_per_1"], "scale"),
        (["starts_by_speed"], "start"),
        (["unit"], "serial"),
    ],
)
def test_a_robot_does_not_pass_before_what_is_dangerous_is_known(made, tmp_path, keys, fact):
    assert made(**dict.fromkeys(keys)).exit_code == 0
    with pytest.raises(ConfigError) as error:
        load_robot(robot_of(tmp_path))
    assert "the drive profile cannot be used" in str(error.value)
    with pytest.raises(ProfileError, match=f'"{fact}" is unknown|is missing'):
        profile()


def robot_of(folder):
    demo = (config_dir() / "robots" / "two-single-drives.toml").read_text("utf-8")
    demo = re.sub(r'drive = ".*"', 'drive = "./mine.toml"', demo)
    (folder / "robot.toml").write_text(demo, encoding="utf-8")
    return folder / "robot.toml"


@pytest.mark.parametrize(
    ("keys", "fact"),
    [
        (["velocity_address", "velocity_bits", "velocity_sign", "velocity_rpm_per_1"], "velocity"),
        (["velocity_rpm_per_1"], "velocity"),
        (["watchdog_address"], "watchdog"),
        (["watchdog_maximum_s"], "watchdog"),
        (["watchdog_action"], "watchdog"),
        (["source"], "source"),
    ],
)
def test_what_is_only_missing_is_listed_and_not_invented(made, run, keys, fact):
    changes = dict.fromkeys(keys)
    if "watchdog_address" in keys:
        changes = dict.fromkeys(key for key in ANSWERS if key.startswith("watchdog"))
    if "velocity_address" in keys:
        changes = dict.fromkeys(key for key in ANSWERS if key.startswith("velocity"))
    result = made(**changes)
    assert result.exit_code == 0, result.output
    assert f"unknown: {fact}: " in result.output
    assert profile().unknown == (fact,)
    assert fact not in ("velocity", "watchdog") or fact not in tomllib.loads(text())["register"]
    assert profile().watchdog is None or fact != "watchdog"
    assert f"unknown: {fact}: " in run("--check", "mine.toml").output


def test_check_reports_an_unknown_watchdog_as_unknown_and_not_as_missing(made, tmp_path):
    assert made(**dict.fromkeys(k for k in ANSWERS if k.startswith("watchdog"))).exit_code == 0
    robot = load_robot(robot_of(tmp_path))
    warnings = " ".join(warning.text for warning in robot.warnings)
    assert "whose communication watchdog is unknown" in warnings
    assert "without a communication watchdog" not in warnings
    assert "UNKNOWN whether ./mine.toml stops" in "\n".join(understood_rows(robot))


def test_a_drive_without_a_watchdog_is_known_to_have_none(made):
    rest = [key for key in ANSWERS if key.startswith("watchdog_") and key != "watchdog_address"]
    assert made(**dict.fromkeys(rest), watchdog_address="none").exit_code == 0
    assert profile().unknown == ()
    assert profile().watchdog_note.startswith("it has none")


def test_a_magnitude_has_its_direction_in_another_register(made):
    assert made(**MAGNITUDE).exit_code == 0
    direction = profile().channels[1].direction
    assert (direction.forward, direction.reverse, direction.rest) == (1, 2, 0)
    assert profile().registers["target_velocity"].si_limits[0] == 0.0


@pytest.mark.parametrize(
    ("shown", "kind"),
    [("00 00 03 E8", "i32"), ("03 E8 00 00", "i32-low-first"), ("0x03E8, 0x0000", "i32-low-first")],
)
def test_the_order_of_words_follows_from_the_example(made, shown, kind):
    result = made(**WIDE, example_bytes=shown)
    assert result.exit_code == 0, result.output
    assert profile().registers["target_velocity"].type == kind


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"example_bytes": "E8 03"}, "swaps the two bytes of a word"),
        ({**WIDE, "example_bytes": "E8 03 00 00"}, "swaps the two bytes of a word"),
        ({**WIDE, "example_bytes": "00 00 E8 03"}, "swaps the two bytes of a word"),
        ({"example_bytes": "03 E9"}, "is 1000 in no order"),
        ({"example_bytes": "03"}, "'03' is not 1000 in 2 bytes"),
        ({"example_bytes": "many"}, "'many' is not 1000 in 2 bytes"),
        ({"example_value": 257, "example_bytes": "01 01"}, "choose another"),
        ({**WIDE, "example_value": 0x00010001, "example_bytes": "00 01 00 01"}, "choose another"),
        ({"speed_bits": 32}, "a speed of 32 bits needs 16"),
        ({"velocity_sign": "magnitude"}, "a measured speed without sign beside a signed"),
        (
            {"enable_address": "none", "enable_on": None, "enable_off": None},
            "the speed does not start the motor, and there is no register that does",
        ),
        ({"direction_address": 1}, "direction_address: does not fit the other answers"),
        ({"speed_address": None}, "without the speed set-point there is no profile"),
    ],
)
def test_what_a_profile_cannot_express_is_refused_in_words(made, changes, message):
    result = made(**changes)
    assert result.exit_code != 0
    assert message in result.output
    assert not Path("mine.toml").exists()


def test_a_person_without_answers_gets_no_profile(run):
    result = run("new", "mine", typed="\n" * 40)
    assert result.exit_code != 0
    assert not Path("mine.toml").exists()


def test_a_person_is_asked_again_and_only_what_follows_from_the_answers(run):
    typed = [
        "A", "p. 1", "fast", "115200", "none", "1", "1", "6", "0x200", "16", "both", "signed",
        "1000", "03 E8", "1", "3000", "none", "no", "0x201", "1", "0", "none",
    ]  # fmt: skip
    result = run("new", "mine", typed="\n".join(typed) + "\n")
    assert result.exit_code == 0, result.output
    assert "'fast' is not a whole number from 300" in result.output
    assert "'both' is not signed or magnitude" in result.output
    assert "Address of the direction" not in result.output
    assert "time-out in s" not in result.output
    assert profile().unknown == ()


def test_an_existing_file_is_never_written_over(run):
    Path("mine.toml").write_text("precious", encoding="utf-8")
    assert run("new", "mine.toml", typed="\n" * 20).exit_code != 0
    assert Path("mine.toml").read_text(encoding="utf-8") == "precious"


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        ("speed_adress = 1", "speed_adress"),
        ("baudrate = true", "True is not a whole number"),
        ("speed_address = 0x10000", "65536 is not a whole number from 0 to 65535"),
        ('parity = "both"', "'both' is not none or even or odd"),
        ("stop_bits = 3", "3 is not 1 or 2"),
        ("speed_rpm_per_1 = 0", "0 is not a number"),
        ('enable_address = "no"', "'no' is not none or a whole number"),
        ("title = 'a \"b'", "no quotes"),
        ("title = ", "answers.toml"),
    ],
)
def test_bad_answers_are_named_and_leave_no_file(run, answers, message):
    Path("answers.toml").write_text(answers, encoding="utf-8")
    result = run("new", "mine.toml", "--answers", "answers.toml")
    assert result.exit_code != 0
    assert message in result.output
    assert not Path("mine.toml").exists()


def test_registers_at_one_address_are_named_and_leave_no_file(made):
    result = made(velocity_address=0x0200)
    assert result.exit_code != 0
    assert "overlaps" in result.output
    assert not Path("mine.toml").exists()
