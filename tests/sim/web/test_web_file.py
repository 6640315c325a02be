# SPDX-License-Identifier: Apache-2.0
"""The robot file by the dashboard's socket: which page reads and writes it, what is refused."""

import contextlib
import hashlib
import os
import signal

import aiohttp
import pytest
from tests.sim.daemon_stage import SLOW, becomes_idle
from tests.sim.person_stage import copied
from tests.sim.web.web_page import (
    CLOSING,
    bus_children,
    ended,
    free_port,
    pages,
    with_dashboard,
)

from motord.config import load_robot
from motord_hal.base.bounded import TOML_BYTES_MAX

MODULE = "motord.commission.page.robot_file"


@pytest.fixture(scope="module")
def stage(tmp_path_factory, port):
    folder = tmp_path_factory.mktemp("file")
    file = copied(folder)
    with with_dashboard(folder, port, *SLOW, robot=file) as stage:
        stage.file = file
        yield stage


@pytest.fixture
async def connect(stage, port):
    becomes_idle(stage)
    before = stage.file.read_bytes()
    async with pages(port) as connected:
        yield connected
    stage.file.write_bytes(before)


def sha256(stage):
    return hashlib.sha256(stage.file.read_bytes()).hexdigest()


async def test_a_page_with_the_token_reads_checks_compares_and_writes_the_file(stage, connect):
    page = await connect()
    read = (await page.answer("file.read"))["result"]
    assert read["text"].encode() == stage.file.read_bytes()
    assert read["sha256"] == sha256(stage)
    assert read["problems"] == []
    assert "a-token" not in read["text"]
    new = read["text"].replace("linear_m_s = 1.0", "linear_m_s = 0.9")
    assert (await page.answer("file.check", text=new))["result"]["problems"] == []
    shown = (await page.answer("file.diff", text=new, sha256=read["sha256"]))["result"]
    assert "+linear_m_s = 0.9" in shown["diff"]
    assert stage.file.read_text("utf-8") == read["text"]
    saved = (await page.answer("file.save", text=new, sha256=read["sha256"]))["result"]
    assert stage.file.read_text("utf-8") == new
    assert saved["sha256"] == sha256(stage)
    assert load_robot(stage.file).limits.linear_m_s == 0.9
    again = (await page.answer("file.save", text=read["text"], sha256=read["sha256"]))["result"]
    assert "another program wrote it" in again["changed"]
    assert stage.file.read_text("utf-8") == new


@pytest.mark.parametrize("headers", [{"token": "wrong-token-0123456789"}, {"token": None}])
async def test_a_page_without_the_right_token_gets_and_writes_nothing(stage, connect, headers):
    before = stage.file.read_bytes()
    page = await connect(**headers)
    if headers["token"] is None:
        for call in ("file.read", "file.check", "file.diff", "file.save"):
            found = await page.answer(call, text="", sha256=sha256(stage))
            assert "token" in found["error"]
    else:
        assert (await page.receive()).json() == {"refused": "the token is wrong"}
    assert stage.file.read_bytes() == before


async def test_a_page_trusted_without_the_token_checks_and_writes_nothing(tmp_path):
    port, file = free_port(), copied(tmp_path)
    trusted = (*SLOW, "input.web.trust_loopback=true")
    with with_dashboard(tmp_path, port, *trusted, robot=file):
        async with pages(port) as connected:
            page = await connected(token=None)
            read = (await page.answer("file.read"))["result"]
            new = {"text": f"{read['text']}\n#\n", "sha256": read["sha256"]}
            assert (await page.answer("file.diff", **new))["result"]["diff"]
            assert "the token" in (await page.answer("file.save", **new))["error"]
    assert file.read_text("utf-8") == read["text"]


async def test_a_page_of_another_site_gets_no_connection_though_it_has_the_token(connect):
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        await connect(Origin="https://evil.example")
    assert refused.value.status == 403


BASE = "0" * 64
BAD = [
    ("file.check", {}, "text is"),
    ("file.check", {"text": 7}, "text is"),
    ("file.check", {"text": "#" * (TOML_BYTES_MAX + 1)}, "at most"),
    ("file.check", {"text": "é" * (TOML_BYTES_MAX // 2 + 1)}, "at most"),
    ("file.diff", {"text": ""}, "sha256 is"),
    ("file.save", {"text": "", "sha256": 7}, "sha256 is"),
    ("file.save", {"text": "", "sha256": ""}, "sha256 is"),
]


@pytest.mark.parametrize(("call", "params", "why"), BAD)
async def test_a_malformed_request_is_refused_with_the_reason(connect, call, params, why):
    assert why in (await (await connect()).answer(call, **params))["error"]


@pytest.mark.parametrize("text", ["\0", "[", "x = " + "[" * 5000, "", "[robot]\nname = 1\n"])
async def test_a_text_that_fails_the_check_is_never_written(stage, connect, text):
    before = stage.file.read_bytes()
    found = await (await connect()).answer("file.save", text=text, sha256=sha256(stage))
    assert found["result"]["problems"]
    assert stage.file.read_bytes() == before


async def test_half_a_surrogate_pair_is_refused_and_the_page_keeps_working(connect):
    page = await connect()
    await page.connection.send_str('{"id": 7, "call": "file.check", "params": {"text": "\\ud800"}}')
    assert await page.until(lambda one: isinstance(one, dict) and one.get("problem"))
    assert "result" in await page.answer("status")


async def test_a_text_of_maximum_length_is_checked(connect):
    text = '"\n' * (TOML_BYTES_MAX // 2)
    assert (await (await connect()).answer("file.check", text=text))["result"]["problems"]


async def test_an_oversized_message_closes_only_its_own_page(connect):
    other, page = await connect(), await connect()
    await page.connection.send_str('"' + "x" * (4 * TOML_BYTES_MAX) + '"')
    while (await page.receive()).type not in CLOSING:
        pass
    assert page.connection.close_code == aiohttp.WSCloseCode.MESSAGE_TOO_BIG
    assert "result" in await other.answer("status")


async def test_checks_run_one_at_a_time_and_too_many_are_refused(stage, connect):
    several = [await connect() for _ in range(3)]
    for page in several:
        for number in range(4):
            await page.connection.send_json(
                {"id": number, "call": "file.check", "params": {"text": "["}}
            )
    most = 0

    def answered(one):
        nonlocal most
        most = max(most, len(bus_children(stage, MODULE)))
        return isinstance(one, dict) and "answer" in one and one

    found = [await page.until(answered) for page in several for _ in range(4)]
    assert most <= 1
    assert any("result" in one for one in found)
    assert any("too many pages" in one.get("error", "") for one in found)


async def test_a_file_that_is_missing_or_not_text_is_reported(stage, connect):
    page = await connect()
    stage.file.write_bytes(b"# \xff\n")
    assert "is not UTF-8" in (await page.answer("file.read"))["error"]
    stage.file.unlink()
    assert "cannot be read" in (await page.answer("file.read"))["error"]


async def test_the_file_is_not_written_while_a_procedure_runs(stage, connect):
    page = await connect()
    text = stage.file.read_text("utf-8")
    assert "error" not in await page.answer("commission.start", procedure="spin", joints=["left"])
    found = await page.answer("file.save", text=f"{text}\n#\n", sha256=sha256(stage))
    assert "spin is running" in found["error"]
    assert "result" in await page.answer("file.check", text=text)
    await page.answer("commission.stop")
    await ended(page)
    assert stage.file.read_text("utf-8") == text


async def test_a_killed_check_is_reported_and_the_next_one_answers(stage, connect):
    page = await connect()
    await page.connection.send_json({"id": 7, "call": "file.check", "params": {"text": "["}})

    def killed(one):
        for child in bus_children(stage, MODULE):
            with contextlib.suppress(ProcessLookupError):  # it has ended
                os.kill(int(child), signal.SIGKILL)
        return isinstance(one, dict) and one.get("answer") == 7 and one

    found = await page.until(killed)
    assert "failed" in found.get("error", "failed")  # the check may have ended before the kill
    assert "result" in await page.answer("file.check", text="[")
