# SPDX-License-Identifier: Apache-2.0
"""The dashboard's socket, used by a program without a browser."""

import asyncio
import json
import math
import signal
import struct
import subprocess
import sys
import urllib.request

import aiohttp
import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROOT, becomes_idle
from tests.sim.web.web_page import ACKNOWLEDGE, CLOSING, DRIVE, free_port, listens, with_dashboard

from motord.bus.web.adapter import VIEWERS_MAX
from motord.bus.web.viewer import BUSY


@pytest.fixture(scope="module")
def stage(tmp_path_factory, port):
    with with_dashboard(tmp_path_factory.mktemp("web"), port) as stage:
        becomes_idle(stage)
        yield stage


def frame(one):
    """Return the number of a frame, None for another message."""
    return one if isinstance(one, int) else None


async def test_a_page_that_acknowledges_late_gets_the_newest_state(connect):
    page = await connect(acknowledges=False)
    await page.connection.send_json({"rate_hz": 50})
    newest = 0

    def dropped(one):
        nonlocal newest
        newest = one if isinstance(one, int) else newest
        return isinstance(one, dict) and one.get("dropped", 0) > 20

    await page.until(dropped)
    await page.connection.send_bytes(struct.pack("<BI", ACKNOWLEDGE, newest))
    assert await page.until(frame) > newest + 20


async def test_a_wrong_token_is_refused_with_a_reason_and_another_site_without_one(connect):
    page = await connect(token="wrong-token-0123456789")
    assert (await page.receive()).json() == {"refused": "the token is wrong"}
    assert (await page.receive()).type in CLOSING
    assert page.connection.close_code == 4401
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        await connect(Origin="https://evil.example")
    assert refused.value.status == 403


CALLS = (
    *("arm", "estop", "params.set", "params.get", "params.save", "params.diff", "reset"),
    *("record.start", "record.stop", "replay", "replay.cancel"),
    *("file.read", "file.check", "file.diff", "file.save"),
    *("commission.start", "commission.answer", "commission.stop", "commission.take"),
)


@pytest.mark.parametrize("call", CALLS)
async def test_a_page_without_the_token_can_only_look(stage, connect, call):
    page = await connect(token=None)
    assert "token" in (await page.answer(call))["error"]
    assert "result" in await page.answer("status")
    assert stage.state() not in ("armed", "moving", "estop")


PRESENT = 4
TOGETHER = 16
"""Half of what the server keeps of connections without a request."""


async def test_pages_without_the_token_leave_the_owners_places_free(stage, connect):
    refused = []
    for _ in range(VIEWERS_MAX // TOGETHER + 1):
        some = (connect(token=None) for _ in range(TOGETHER))
        found = await asyncio.gather(*some, return_exceptions=True)
        refused += [one for one in found if isinstance(one, aiohttp.WSServerHandshakeError)]
    assert {one.status for one in refused} == {503}
    owner = await connect()
    assert (await owner.answer("estop"))["result"]["state"] == "estop"
    becomes_idle(stage)


@pytest.mark.parametrize("call", ["drive", "lease", "release", "", 7, None, ["arm"]])
async def test_a_page_can_call_only_listed_methods(connect, call):
    assert "error" in await (await connect()).answer(call)


HUGE = "9" * 400
JUNK = [
    *(b"", b"\x01", b"\x03\x01", b"\xff" * 45, "[]", "{", '{"rate_hz": "x"}', "{}"),
    struct.pack("<BIddddd", DRIVE, 1, 1e308, 1e308, 0.0, 0.0, 0.0),
    struct.pack("<BIddddd", DRIVE, 1, math.nan, math.inf, 1e308, 1e308, 1e308),
    struct.pack("<Bdd", PRESENT, 1e308, -1e308),
    f'{{"rate_hz": {HUGE}}}',
    '{"rate_hz": 1e308}',
    '{"call": ["status"]}',
    '{"call": {"status": 1}, "id": [[]]}',
    f'{{"call": "status", "id": {HUGE}, "params": []}}',
]


@pytest.mark.parametrize("junk", JUNK, ids=range(len(JUNK)))
async def test_a_malformed_message_does_not_close_the_page(connect, junk):
    page = await connect()
    send = page.connection.send_bytes if isinstance(junk, bytes) else page.connection.send_str
    await send(junk)
    assert (await page.answer("status"))["result"]["state"] not in ("armed", "moving")


WRONG = [None, True, -1, 1e308, int(HUGE), "", "x" * 300, [], [[]], [None], {}, {"a": [{}]}]
NAMES = (
    *("text", "sha256", "name", "line", "procedure", "number", "value", "values", "options"),
    *("joints", "section", "reason", "file", "seconds", "joint", "register", "force"),
)


@pytest.mark.parametrize("call", [*sorted({*CALLS} - {"arm", "reset"}), "trace", "ticket"])
async def test_parameters_of_any_type_are_answered_and_logged_as_no_bug(stage, connect, call):
    page = await connect()
    for wrong in WRONG:
        answer = {"error": BUSY}
        while answer.get("error") == BUSY:
            answer = await page.answer(call, **dict.fromkeys(NAMES, wrong))
        assert answer.keys() & {"result", "error"}
    assert "Traceback" not in stage.logged()
    assert f"{call!r}: " not in stage.logged()
    becomes_idle(stage)


async def test_a_page_that_shows_an_old_state_cannot_drive_and_gets_the_reason(connect):
    page = await connect()
    await page.drive(1, 0.3, seen_s=0.0)
    why = await page.until(lambda one: isinstance(one, dict) and one.get("not_driven"))
    assert "too slow" in why


def test_the_demonstration_prints_the_address_of_its_dashboard_and_ends_with_its_signal():
    port = free_port()
    demo = subprocess.Popen(
        [sys.executable, "-m", "motord", "demo", "--web", "--port", str(port), "--json"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT,
    )  # fmt: skip
    try:
        address = json.loads(demo.stdout.readline())["address"]
        assert address == f"http://127.0.0.1:{port}"
        with urllib.request.urlopen(f"{address}/", timeout=DEADLINE_S) as page:
            assert b"<title>motord</title>" in page.read()
            assert "default-src 'none'" in page.headers["Content-Security-Policy"]
        demo.send_signal(signal.SIGTERM)
        assert demo.wait(DEADLINE_S) == 0
        assert not listens(port)
    finally:
        demo.kill()
        demo.wait()
        demo.stdout.close()
