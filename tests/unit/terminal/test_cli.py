# SPDX-License-Identifier: Apache-2.0
"""The command line: features of every command, and the commands that need no robot."""

import json
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from motord.cli import COMMANDS, cli
from motord.cli.common import Exit, Failure, load_or_exit, print_json

ROOT = Path(__file__).resolve().parents[3]
DEMO = ROOT / "config/robots/demo.toml"


@pytest.fixture
def motord():
    def run(*arguments):
        return CliRunner().invoke(cli, [str(argument) for argument in arguments])

    return run


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself_with_an_example(motord, name):
    result = motord(name, "--help")
    assert result.exit_code == 0, result.output
    assert "Example: motord " in result.output


@pytest.mark.parametrize("name", COMMANDS)
def test_the_table_of_commands_has_the_name_of_each_command(name):
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    assert command.name == name


def test_help_and_version_load_none_of_the_heavy_parts():
    heavy = {"pydantic", "pymodbus", "asyncio", "_motord_rt", "motord.config", "serial"}
    code = (
        "import sys, contextlib\n"
        "from motord.__main__ import main\n"
        "for argument in ('--help', '--version'):\n"
        "    sys.argv = ['motord', argument]\n"
        "    with contextlib.suppress(SystemExit): main()\n"
        f"print(sorted({heavy} & set(sys.modules)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60,
        env={"PYTHONPATH": f"{ROOT / 'daemon'}:{ROOT / 'hal'}"},
    )  # fmt: skip
    assert done.stdout.splitlines()[-1] == "[]"
    assert done.stdout.splitlines()[-2].startswith("motord ")


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [(["chek"], "Did you mean 'check'?"), (["check", "--jsn"], "'--json'")],
)
def test_a_misspelt_command_or_option_is_wrong_usage_with_a_suggestion(motord, arguments, hint):
    result = motord(*arguments)
    assert result.exit_code == Exit.USAGE
    assert hint in result.stderr


def test_check_of_a_good_file_succeeds(motord):
    result = motord("check", DEMO)
    assert result.exit_code == Exit.DONE
    rows = result.stdout.splitlines()
    assert rows[0] == f"{DEMO}: ok: demo, differential base, joints left, right"
    assert "may command     local socket (socket, priority 100)" in rows


def test_check_with_a_warning_succeeds_and_reports_it(motord):
    result = motord("check", DEMO, "--set", "limits.linear_m_s=1.3")
    assert result.exit_code == Exit.DONE
    assert "limits.linear_m_s: warning: 1.3 m/s is never reached" in result.stdout


def test_check_as_json_is_a_single_object_with_every_problem(motord):
    result = motord("check", DEMO, "--json", "--set", "limits.linear_m_s=nan")
    assert result.exit_code == Exit.USAGE
    report = json.loads(result.stdout)
    assert report["ok"] is False
    (problem,) = report["problems"]
    assert problem["key"] == "limits.linear_m_s"
    good = json.loads(motord("check", DEMO, "--json").stdout)
    assert (good["ok"], good["robot"], good["problems"]) == (True, "demo", [])


def test_a_file_that_is_not_there_is_a_problem_like_any_other(motord, tmp_path):
    result = motord("check", tmp_path / "no.toml")
    assert result.exit_code == Exit.USAGE
    assert result.stdout.endswith(
        "no.toml: cannot be read: No such file or directory: motord init writes a robot file, "
        "motord robots prints examples\n"
    )
    (tmp_path / "my-robot.toml").touch()
    result = motord("check", tmp_path / "my_robot.toml")
    assert result.stdout.endswith('No such file or directory (did you mean "my-robot.toml"?)\n')


def test_drives_lists_every_profile_with_its_watchdog(motord):
    result = motord("drives")
    assert result.exit_code == Exit.DONE
    for path in (ROOT / "config/drives").glob("*.toml"):
        assert path.stem in result.stdout
    listed = json.loads(motord("drives", "--json").stdout)["drives"]
    watchdogs = {drive["name"]: drive["watchdog"] for drive in listed}
    assert watchdogs["bld-305s"] is None
    assert watchdogs["zlac8015d"]["action"]


def test_drives_shows_registers_in_si_with_their_sources(motord):
    result = motord("drives", "zlac8015d")
    assert result.exit_code == Exit.DONE
    assert "0x2088  target_velocity_1: i16 rw, 1 is 0.1047 rad/s" in result.stdout
    assert "2088h" in result.stdout
    shown = json.loads(motord("drives", "zlac8015d", "--json").stdout)
    assert shown["registers"]["target_velocity_1"]["address"] == 0x2088


def test_drives_refuses_an_unknown_name_with_the_known_ones(motord):
    result = motord("drives", "zlac8015")
    assert result.exit_code == Exit.USAGE
    assert '"zlac8015d"' in result.stderr


def test_drives_checks_a_file_of_your_own(motord, tmp_path):
    good = ROOT / "config/drives/zlac8015d.toml"
    assert motord("drives", "--check", good).exit_code == Exit.DONE
    bad = tmp_path / "bad.toml"
    bad.write_text(good.read_text(encoding="utf-8").replace("counter_bits", "counter_bit"))
    result = motord("drives", "--check", bad)
    assert result.exit_code == Exit.USAGE
    assert "counter_bit: unknown key" in result.stdout
    report = json.loads(motord("drives", "--check", bad, "--json").stdout)
    assert report["ok"] is False
    assert report["problems"]
    assert motord("drives", "x", "--check", bad).exit_code == Exit.USAGE


@pytest.mark.parametrize(
    ("verbs", "short"),
    [
        (("list",), ()),
        (("list", "--json"), ("--json",)),
        (("show", "zlac8015d"), ("zlac8015d",)),
        (("check", ROOT / "config/drives/zlac8015d.toml"),
         ("--check", ROOT / "config/drives/zlac8015d.toml")),
    ],
)  # fmt: skip
def test_drives_has_verbs_and_short_forms_of_them(motord, verbs, short):
    long = motord("drives", *verbs)
    assert long.exit_code == Exit.DONE
    assert long.output == motord("drives", *short).output


@pytest.mark.parametrize(
    "words",
    [("show",), ("check",), ("new",), ("list", "x"), ("show", "x", "--answers", "y"),
     ("check", "x", "--check", "y"), ("zlac8015d", "x")],
)  # fmt: skip
def test_a_verb_of_drives_without_what_it_needs_is_answered_with_its_usage(motord, words):
    result = motord("drives", *words)
    assert result.exit_code == Exit.USAGE
    assert f"motord drives {words[0] if words[0] in ('show', 'check', 'new') else 'list'}" in (
        result.output
    )


def test_schema_on_one_line_is_the_same(motord):
    short, long = motord("schema", "--json"), motord("schema")
    assert short.stdout.count("\n") == 1
    assert json.loads(short.stdout) == json.loads(long.stdout)


def test_schema_is_json_for_an_editor(motord):
    schema = json.loads(motord("schema").stdout)
    assert schema["properties"]["limits"]
    assert schema["$defs"]["Limits"]["properties"]["linear_m_s"]["unit"] == "m/s"


def test_a_failure_ends_a_command_with_its_status(motord):
    @click.command
    def broken():
        raise Failure("the drive is hot", Exit.FAULT)

    result = CliRunner().invoke(broken)
    assert (result.exit_code, result.stderr) == (Exit.FAULT, "Error: the drive is hot\n")


def test_a_command_that_needs_a_robot_reports_problems_and_warnings_on_stderr(capsys):
    with pytest.raises(Failure, match=r"base.track_m: -1 is out of range") as caught:
        load_or_exit(DEMO, ["base.track_m=-1"])
    assert caught.value.exit_code == Exit.USAGE
    assert load_or_exit(DEMO, ["limits.linear_m_s=1.3"]).limits.linear_m_s == 1.3
    assert "limits.linear_m_s: warning: " in capsys.readouterr().err


def test_printed_json_is_valid_or_an_error(capsys):
    print_json({"a": 1.5, "text": "é"})
    assert json.loads(capsys.readouterr().out) == {"a": 1.5, "text": "é"}
    with pytest.raises(ValueError, match="not JSON compliant"):
        print_json({"a": float("nan")})


def test_a_shipped_robot_file_is_printed_ready_to_be_saved_anywhere(motord, tmp_path):
    names = [row["name"] for row in json.loads(motord("robots", "--json").stdout)["robots"]]
    assert "demo" in names
    for name in names:
        text = motord("robots", name).stdout
        reference, _, rest = text.partition("\n")
        assert Path(reference.removeprefix("#:schema file://")).is_file()
        assert "stdout" not in rest
        robot = tmp_path / f"{name}.toml"
        robot.write_text(text, encoding="utf-8")
        assert motord("check", robot).exit_code == 0


def test_a_robot_that_motord_does_not_ship_is_refused_with_those_it_does(motord):
    result = motord("robots", "demoo")
    assert result.exit_code == Exit.USAGE
    assert "did you mean" in result.stderr
    assert "skid4" in result.stderr


def test_a_drive_file_in_the_working_folder_is_shown(motord, tmp_path, monkeypatch):
    profile = (ROOT / "config/drives/zlac8015d.toml").read_text(encoding="utf-8")
    own = profile.replace('name = "zlac8015d"', 'name = "mine"')
    (tmp_path / "mine.toml").write_text(own, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    result = motord("drives", "mine.toml")
    assert result.exit_code == 0, result.output
    assert "file      mine.toml" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words", "status"),
    [
        (
            ["simulate", ROOT / "tests/golden/six-mistakes.toml", "--json"],
            "rate_hz: 50000 is",
            Exit.USAGE,
        ),
        (["status", "--json", "--socket", "/no.sock"], "no daemon has this socket", Exit.FAILED),
        (["drive", "nan", "0", "--json"], "'nan' is not a finite number", Exit.USAGE),
        (["move", "1", "--tolerance-m", "0", "--json"], "'0' has to be more than 0", Exit.USAGE),
        (["params", "set", "limits.linear_m_s=fast", "--json", "--socket", "/no.sock"],
         "no daemon has this socket", Exit.FAILED),
    ],
)  # fmt: skip
def test_an_error_under_json_is_a_single_object_with_its_exit_status(
    motord, arguments, words, status
):
    result = motord(*arguments)
    assert result.exit_code == status
    found = json.loads(result.stdout)
    assert words in found["error"]
    assert found["exit_status"] == status


def test_after_an_interrupt_a_command_ends_with_130_and_prints_nothing():
    code = (
        "import signal, sys\n"
        "from motord.__main__ import main\n"
        "import motord.cli.files.check\n"
        "signal.signal(signal.SIGALRM, signal.default_int_handler)\n"
        "motord.cli.files.check.load_robot = lambda *_: signal.raise_signal(signal.SIGALRM)\n"
        f"sys.argv = ['motord', 'check', {str(DEMO)!r}]\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.returncode, done.stdout, done.stderr.strip()) == (130, "", "")
