# SPDX-License-Identifier: Apache-2.0
"""Drive profiles with a DBC file: its content is used, and errors name the file and the line."""

import shutil

import cantools.database
import pytest

from motord.config import load_robot
from motord.config.drives.load import find_profile, load_profile
from motord.config.problems import ConfigError
from motord_hal.base.errors import ProfileError
from motord_hal.base.paths import config_dir
from motord_hal.can.codec import build, parse
from motord_hal.drives.can_profile import Sender, signals_of

FOLDER = config_dir() / "drives"
PROFILE = (FOLDER / "dbc-example.toml").read_text(encoding="utf-8")
DBC = (FOLDER / "dbc-example.dbc").read_text(encoding="cp1252")


def written(folder, right="", wrong="", dbc_right="", dbc_wrong=""):
    """Write the example with a part of the profile or DBC file replaced; return its path."""
    assert right in PROFILE
    assert dbc_right in DBC
    path = folder / "dbc-example.toml"
    path.write_text(PROFILE.replace(right, wrong, 1) if right else PROFILE, encoding="utf-8")
    text = DBC.replace(dbc_right, dbc_wrong, 1) if dbc_right else DBC
    (folder / "dbc-example.dbc").write_text(text, encoding="cp1252")
    return path


def problems(*arguments):
    with pytest.raises(ProfileError) as error:
        load_profile(written(*arguments))
    return str(error.value)


def line_of(text, fragment):
    return next(n for n, line in enumerate(text.splitlines(), 1) if fragment in line)


def test_frames_are_those_of_the_file_for_each_node():
    table = find_profile("dbc-example").can
    assert table.frames["command"].sender is Sender.MOTORD
    assert [table.frames["command"].identifier(node) for node in (1, 7)] == [513, 519]
    status = table.frames["status"]
    assert (status.sender, status.period_s, status.size_bytes) == (Sender.DRIVE, 0.01, 8)


def test_every_signal_is_encoded_and_decoded_as_cantools_does_it():
    profile = find_profile("dbc-example")
    database = cantools.database.load_file(FOLDER / "dbc-example.dbc")
    messages = {"command": "DRV_Command", "status": "DRV_Status", "power": "DRV_Power"}
    for frame, message in messages.items():
        signals = signals_of(profile.registers, frame)
        for raw in (0, 1, 3):
            data = build(profile.can.frames[frame], signals, {one.name: raw for one in signals})
            theirs = database.decode_message(message, data, scaling=False, decode_choices=False)
            assert set(theirs.values()) == {raw}
            assert set(parse(profile.can.frames[frame], signals, data).values()) == {raw}


def test_scales_offsets_and_units_come_from_the_file():
    registers = find_profile("dbc-example").registers
    assert registers["temperature"].to_si(65) == 25.0
    assert registers["temperature"].from_si(25.0) == 65
    assert registers["temperature"].si_limits == (-40.0, 215.0)
    assert registers["supply"].to_si(2400) == pytest.approx(24.0)
    assert registers["supply"].default == 2400
    assert registers["target_speed"].from_si(1e9) == 30000
    assert registers["target_speed"].from_si(0.0) == 0


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ('file = "dbc-example.dbc"', 'file = "none.dbc"', "none.dbc: cannot be read"),
        ('drive = "DRIVE"', 'drive = "DRIV"', 'did you mean "DRIVE"?'),
        ('drive = "DRIVE"', "", "dbc.drive: is missing"),
        ('dbc = "DRV_Power"', 'dbc = "DRV_Powr"', 'did you mean "DRV_Power"?'),
        ('dbc = "Supply"', 'dbc = "Nothing"', "there are Supply, Motor_Current"),
        ('unit = "rpm"', 'unit = "turn/s"', '"turn/s" is not "rpm", as dbc-example.dbc has it'),
        ('dbc = "Actual_Speed"', 'dbc = "Actual_Speed"\nscale = 1', "1 is not 0.1"),
        ('dbc = "DRV_Power"', 'dbc = "DRV_Power"\nid = 5', "5 is not 640"),
        ('dbc = "DRV_Power"', 'dbc = "DRV_Power"\nsender = "motord"', "'motord' is not 'drive'"),
        ('dbc = "Target_Speed"', 'dbc = "Target_Speed"\nmaximum = 9999', "beyond the 3000"),
        ("bitrate = 500000", "bitrate = 500000\nnode_shift = 9", "is too small for node 1"),
        (
            '[signal.reserved]\nframe = "command"\ndbc = "Reserved"',
            "",
            "Reserved of DRV_Command has no [signal]",
        ),
        ('[dbc]\nfile = "dbc-example.dbc"', "[dbc]\nfile = 5", "dbc.file: 5 is not a string"),
        ('frame = "power"', 'frame = "pover"', '"pover" is not a frame'),
    ],
)
def test_a_mapping_that_does_not_fit_the_file_is_reported(tmp_path, right, wrong, message):
    assert message in problems(tmp_path, right, wrong)


@pytest.mark.parametrize(
    ("right", "wrong", "where", "message"),
    [
        ("BO_ 641 DRV_Power: 5", "BO_ 641 DRV_Power 5", "BO_ 641", "Invalid syntax"),
        (" SG_ Motor_Current", " SG_ Motor_Current M", "BO_ 641", "is multiplexed"),
        ("39|8@0+", "39|16@0+", "BO_ 641", "does not fit"),
        ("23|16@0-", "22|16@0-", "BO_ 641", "overlapping"),
        ("(1,-40)", "(0,-40)", "Board_Temp", "a scale of 0"),
        ("(1,-40)", "(1e999,-40)", "Board_Temp", "a scale of inf"),
        ("5 DRIVE\n SG_ Supply : 7|16@0+", "16 DRIVE\n SG_ Supply : 71|40@0+", "SG_ Su", "40 bits"),
    ],
)
def test_a_file_that_is_wrong_is_named_with_its_line(tmp_path, right, wrong, where, message):
    found = problems(tmp_path, "", "", right, wrong)
    wanted = line_of(DBC, where)
    assert message in found
    assert f"dbc-example.dbc:{wanted}: " in found


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ('"degC"', '"K"', 'signal.temperature.unit: is missing: "K"'),
        ("(0.1,0) [-3000|3000]", "(0.1,5) [-3000|3000]", "its offset and default must be 0"),
        ("(0.1,0) [-3000|3000]", "(0.1,0) [10|3000]", "has no zero in its range"),
        ("BO_ 641", "BO_ 385", "cannot be distinguished from frame status"),
        ("SG_ 641 Supply 2400", "SG_ 513 Command 1", "Command starts with 1 in dbc-example.dbc"),
        ('32|32@1- (1,0) [0|0] "counts"', '32|32@1- (1,3) [0|0] "counts"', "position.offset"),
    ],
)
def test_what_comes_from_the_file_is_checked_like_the_profile(tmp_path, right, wrong, message):
    assert message in problems(tmp_path, "", "", right, wrong)


def test_a_message_that_is_not_mapped_may_have_any_content(tmp_path):
    path = written(tmp_path, "", "", "Firmware : 0|16@1+", "Firmware m1 : 0|64@1+")
    assert load_profile(path).name == "dbc-example"


def test_signals_with_29_bits_and_can_fd_are_marked_in_their_frames(tmp_path):
    path = written(tmp_path, "", "", "BO_ 641 DRV_Power: 5", "BO_ 2147484289 DRV_Power: 12")
    frames = load_profile(path).can.frames
    assert (frames["power"].extended, frames["power"].fd) == (True, True)
    assert (frames["status"].extended, frames["status"].fd) == (False, False)


def test_a_mistake_in_a_dbc_file_is_reported_with_the_robot_file(tmp_path):
    written(tmp_path, "", "", "(1,-40)", "(0,-40)")
    robot = tmp_path / "odrive-two.toml"
    shutil.copy(config_dir() / "robots" / "odrive-two.toml", robot)
    text = robot.read_text(encoding="utf-8").replace('"odrive-0.6"', '"./dbc-example.toml"')
    robot.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as error:
        load_robot(robot)
    assert "dbc-example.dbc:28: DRV_Power.Board_Temperature" in str(error.value)
