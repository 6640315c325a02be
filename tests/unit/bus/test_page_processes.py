# SPDX-License-Identifier: Apache-2.0
"""Processes that pages start, and that fail: a shell script stands for each."""

import asyncio
import contextlib
import errno
import json
import os
import sys

import pytest

from motord.bus.commands.gate import NotTaken
from motord.bus.web.processes.command import answer, asked
from motord.bus.web.processes.commissioning import FAILED, Commissioning
from motord.bus.web.processes.replaying import Replays
from motord.bus.web.processes.tracing import Traces

SPIN = {"procedure": "spin"}


class Page:
    """A page that keeps the messages to it."""

    name, keeps_up = "page 1", True

    def __init__(self):
        self.sent = asyncio.Queue()

    def say(self, text):
        self.sent.put_nowait(text)


@pytest.fixture
def carried_out_by(monkeypatch, tmp_path):
    """Return a function that makes each process run a shell script instead."""

    def replace(script):
        program = tmp_path / "program"
        program.write_text(f"#!/bin/sh\nread -r request\n{script}\n", encoding="utf-8")
        program.chmod(0o700)
        monkeypatch.setattr(sys, "executable", str(program))

    return replace


@pytest.fixture
def procedure(carried_out_by, tmp_path):
    """Return a function that makes a procedure whose process runs a shell script."""

    def make(script):
        carried_out_by(script)
        published = asyncio.Event()
        commissioning = Commissioning(tmp_path / "socket", published.set, lambda _text: None)
        return commissioning, published

    return make


async def ended(commissioning, published):
    while commissioning.running is not None:
        published.clear()
        await published.wait()
    return commissioning.record["end"]


@pytest.mark.parametrize(
    "script",
    [
        """printf '{"progress": "half of a li'""",
        "echo no JSON",
        "echo '[]'",
        "head -c 3000000 /dev/zero | tr '\\\\0' x; echo",
        "kill -9 $$",
        "exit 0",
    ],
    ids=["half a line", "no JSON", "no object", "an endless line", "killed", "without an end"],
)
async def test_a_process_that_fails_ends_its_procedure_and_the_next_one_begins(procedure, script):
    commissioning, published = procedure(script)
    async with asyncio.timeout(100), asyncio.TaskGroup() as tasks:
        work = tasks.create_task(commissioning.run())
        for _ in range(2):
            commissioning.start(Page(), SPIN)
            assert await ended(commissioning, published) == {"good": False, "text": FAILED}
        work.cancel()


async def test_a_procedure_that_was_cut_off_does_not_keep_the_next_from_beginning(procedure):
    commissioning, published = procedure("""echo '{"show": "it runs"}'; cat > /dev/null""")
    async with asyncio.timeout(100), asyncio.TaskGroup() as tasks:
        work = tasks.create_task(commissioning.run())
        commissioning.start(Page(), SPIN)
        while not commissioning.record["shown"]:
            published.clear()
            await published.wait()
        work.cancel()  # as if another part of the dashboard had failed; all parts then run again
        await asyncio.wait([work])
        again = tasks.create_task(commissioning.run())
        assert await ended(commissioning, published) == {"good": False, "text": FAILED}
        commissioning.start(Page(), SPIN)
        again.cancel()


async def test_an_incomplete_answer_is_refused(carried_out_by):
    carried_out_by("""printf '{"half": '""")
    with pytest.raises(NotTaken, match="did not print its answer to the end"):
        await answer("check", within_s=100)
    with pytest.raises(NotTaken, match="did not print its answer to the end"):
        await asked("motord.config", {}, within_s=100)


async def test_an_error_that_a_command_prints_is_raised(carried_out_by):
    carried_out_by("""echo '{"error": "no daemon", "exit_status": 1}'; exit 1""")
    with pytest.raises(NotTaken, match="no daemon"):
        await answer("params", "save", within_s=100)


@pytest.mark.parametrize(
    ("script", "problem"),
    [
        ("""printf '{"result": "o'""", "motord trace failed"),
        ("""echo '{"error": "no line", "exit_status": 1}'""", "no line"),
    ],
    ids=["half a line", "an error"],
)
async def test_why_a_trace_has_ended_is_shown(carried_out_by, tmp_path, script, problem):
    carried_out_by(script)
    page = Page()
    traces = Traces(tmp_path / "socket")
    async with asyncio.timeout(100), asyncio.TaskGroup() as tasks:
        work = tasks.create_task(traces.run())
        await asyncio.sleep(0)  # the task begins
        traces.show(page, "a")
        trace = json.loads(await page.sent.get())["trace"]
        assert trace == {"line": "a", "problem": problem}
        work.cancel()


@contextlib.asynccontextmanager
async def running(part):
    """Run a part of a dashboard during the block; it must not end by itself."""
    async with asyncio.timeout(100), asyncio.TaskGroup() as tasks:
        work = tasks.create_task(part.run())
        await asyncio.sleep(0)  # the task begins
        yield
        assert not work.done()
        work.cancel()


NO_MORE = os.strerror(errno.EMFILE)


async def test_a_trace_that_cannot_start_gives_its_page_the_reason_and_stops_nothing_else(
    carried_out_by, tmp_path, no_descriptor_left
):
    traces, page = Traces(tmp_path / "socket"), Page()
    async with running(traces):
        with no_descriptor_left():
            traces.show(page, "a")
            trace = json.loads(await page.sent.get())["trace"]
        assert trace == {"line": "a", "problem": f"motord trace cannot be started: {NO_MORE}"}
        carried_out_by("""echo '{"error": "no line", "exit_status": 1}'""")
        traces.show(page, "a")  # a second try, with free descriptors
        assert json.loads(await page.sent.get())["trace"]["problem"] == "no line"


async def test_a_replay_that_cannot_be_started_is_a_problem_and_stops_nothing_else(
    tmp_path, no_descriptor_left
):
    changed, key = asyncio.Event(), ("tape", "a.mcap")
    replays = Replays(changed.set)
    async with running(replays):
        with no_descriptor_left():
            replays.start(key, tmp_path / "a.mcap")
            while "problem" not in replays.found[key]:
                changed.clear()
                await changed.wait()
        assert replays.found[key] == {"problem": f"motord replay cannot be started: {NO_MORE}"}


async def test_a_request_that_cannot_start_its_process_is_refused(no_descriptor_left):
    with no_descriptor_left():
        with pytest.raises(NotTaken, match=f"motord params cannot be started: {NO_MORE}"):
            await answer("params", "save", within_s=100)
        with pytest.raises(NotTaken, match=f"for the request cannot be started: {NO_MORE}"):
            await asked("motord.config", {}, within_s=100)


async def test_a_procedure_that_cannot_be_started_ends_and_stops_nothing_else(
    procedure, no_descriptor_left
):
    commissioning, published = procedure("exit 1")
    async with running(commissioning):
        with no_descriptor_left():
            commissioning.start(Page(), SPIN)
            end = await ended(commissioning, published)
        assert end == {"good": False, "text": f"the procedure cannot be started: {NO_MORE}"}


async def test_a_replay_that_is_cancelled_as_soon_as_it_was_requested_leaves_nothing(
    carried_out_by, tmp_path
):
    carried_out_by("""echo '{"identical": true}'""")
    changed, key = asyncio.Event(), ("tape", "a.mcap")
    replays = Replays(changed.set)
    async with running(replays):
        replays.start(key, tmp_path / "a.mcap")
        replays.cancel(key)
        async with asyncio.timeout(20):
            while key in replays.found:
                changed.clear()
                await changed.wait()
        replays.start(key, tmp_path / "a.mcap")  # a second start
        async with asyncio.timeout(20):
            while "outcome" not in replays.found[key]:
                changed.clear()
                await changed.wait()
