# SPDX-License-Identifier: Apache-2.0
"""The robot file in the editor of the dashboard: it is read, checked, compared and written."""

import hashlib
import json
import os
import stat
import subprocess
import sys
from dataclasses import asdict

import pytest
from tests.unit.bus.bus_config_rig import DEMO

from motord.commission.page.robot_file import CHANGED, ELSEWHERE, carry_out
from motord.config import ConfigError, load_robot

TEXT = DEMO.read_text(encoding="utf-8")
FASTER = TEXT.replace("linear_m_s = 1.0", "linear_m_s = 0.9")
SECRET = "password = nobody-else-knows\n"


@pytest.fixture
def file(tmp_path):
    place = tmp_path / "cart.toml"
    place.write_text(TEXT, encoding="utf-8")
    place.chmod(0o640)
    return place


def sha256(file):
    return hashlib.sha256(file.read_bytes()).hexdigest()


def carried_out(file, do, text, base=None):
    request = {"do": do, "file": str(file), "text": text, "sha256": base or sha256(file)}
    return carry_out(request)


def problems(file, text):
    return [(row["line"], row["key"]) for row in carried_out(file, "check", text)["problems"]]


def test_a_file_is_read_with_its_hash_and_with_the_problems_that_check_finds(file):
    file.write_bytes(TEXT.replace("kind =", "kid =", 1).encode())
    found = carry_out({"do": "read", "file": str(file)})
    assert found["text"].encode() == file.read_bytes()
    assert found["sha256"] == sha256(file)
    with pytest.raises(ConfigError) as caught:
        load_robot(file)
    assert found["problems"] == [asdict(problem) for problem in caught.value.problems]


def test_line_ends_of_another_system_are_kept(file):
    file.write_bytes(TEXT.replace("\n", "\r\n").encode())
    assert "\r\n" in carry_out({"do": "read", "file": str(file)})["text"]
    new = FASTER.replace("\n", "\r\n")
    assert carried_out(file, "save", new)["backup"]
    assert file.read_bytes() == new.encode()


@pytest.mark.parametrize(
    ("text", "line", "key"),
    [
        ("[robot\n", 1, "syntax"),
        ("x = 1\n\0\n", 2, "syntax"),
        ("", 1, "robot"),
        ("x = " + "[" * 5000, 1, "syntax"),
        (FASTER.replace("0.9", "-0.9"), FASTER[: FASTER.index("0.9")].count("\n") + 1,
         "limits.linear_m_s"),
    ],
    ids=["syntax", "NUL", "empty", "deep", "range"],
)  # fmt: skip
def test_every_text_is_checked_and_what_does_not_pass_is_never_written(file, text, line, key):
    assert (line, key) in problems(file, text)
    before = file.read_bytes()
    found = carried_out(file, "save", text)
    assert "backup" not in found
    assert (line, key) in [(row["line"], row["key"]) for row in found["problems"]]
    assert file.read_bytes() == before
    assert list(file.parent.iterdir()) == [file]


def test_a_valid_text_is_compared_and_written_with_a_backup_mode_and_owner(file):
    if os.geteuid() == 0:
        os.chown(file, 1234, 4321)
    before, about = file.read_bytes(), file.stat()
    shown = carried_out(file, "diff", FASTER)
    assert shown["problems"] == []
    assert "-linear_m_s = 1.0" in shown["diff"]
    assert "+linear_m_s = 0.9" in shown["diff"]
    assert file.read_bytes() == before
    found = carried_out(file, "save", FASTER)
    assert file.read_text("utf-8") == FASTER
    assert found["sha256"] == sha256(file)
    now = file.stat()
    assert (now.st_mode, now.st_uid, now.st_gid) == (about.st_mode, about.st_uid, about.st_gid)
    [backup] = file.parent.glob("*.bak")
    assert found["backup"] == str(backup)
    assert backup.read_bytes() == before
    assert stat.S_IMODE(backup.stat().st_mode) == 0o640


def test_the_same_text_is_not_written(file):
    found = carried_out(file, "save", TEXT)
    assert (found["diff"], found.get("backup")) == ("", None)
    assert list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize("do", ["diff", "save"])
def test_a_file_that_another_program_wrote_is_not_overwritten(file, do):
    base = sha256(file)
    file.write_text(TEXT + "\n# by another editor\n", encoding="utf-8")
    before = file.read_bytes()
    found = carried_out(file, do, FASTER, base)
    assert found["changed"] == CHANGED
    assert "diff" not in found
    assert file.read_bytes() == before


def test_a_file_that_cannot_be_written_is_named_with_the_reason(file):
    file = file.rename(file.with_name(f"{'x' * 240}.toml"))  # the name of its backup is too long
    found = carried_out(file, "save", FASTER)
    assert "cannot be written: File name too long" in found["unwritable"]
    assert file.read_text("utf-8") == TEXT


@pytest.mark.parametrize("raw", [b"name = '\xff'\n", b"#" * 300_000], ids=["bytes", "long"])
def test_a_file_that_is_no_text_or_too_long_is_not_read(file, raw):
    file.write_bytes(raw)
    assert str(file) in carry_out({"do": "read", "file": str(file)})["failed"]


def drive(name):
    return TEXT.replace('drive = "zlac8015d"', f'drive = "{name}"', 1)


@pytest.mark.parametrize(
    "name", ["./mqtt.secret", "../other.toml", "/etc/passwd", "link.toml", "a\\u0000.toml", "./x"]
)
def test_a_text_of_a_page_neither_reads_nor_shows_a_file_elsewhere(file, name):
    (file.parent / "mqtt.secret").write_text(SECRET, encoding="utf-8")
    outside = file.parent.parent / "other.toml"
    outside.write_text(SECRET, encoding="utf-8")
    (file.parent / "link.toml").symlink_to(outside)
    found = carried_out(file, "save", drive(name))
    assert [row["text"] for row in found["problems"]] == [ELSEWHERE]
    assert file.read_text("utf-8") == TEXT


def test_a_profile_in_the_folder_or_already_named_may_be_used(file):
    (file.parent / "mine.toml").write_text("[drive]\n", encoding="utf-8")
    [problem, *_] = carried_out(file, "check", drive("mine.toml"))["problems"]
    assert "the drive profile cannot be used" in problem["text"]
    file.write_text(drive("../mine.toml"), encoding="utf-8")
    [problem, *_] = carried_out(file, "check", drive("../mine.toml") + "# more\n")["problems"]
    assert "cannot be read" in problem["text"]


def test_the_process_answers_one_request_and_ends(file):
    request = {"do": "check", "file": str(file), "text": "nåme = 1 # \u2028"}
    ended = subprocess.run(
        [sys.executable, "-m", "motord.commission.page.robot_file"],
        input=json.dumps(request).encode(), capture_output=True, timeout=60, check=True,
        env=os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0"},
    )  # fmt: skip
    assert json.loads(ended.stdout)["problems"][0]["key"]
    assert ended.stderr == b""
