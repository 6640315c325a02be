# SPDX-License-Identifier: Apache-2.0
"""Procedures by the dashboard's socket: which page starts, answers and stops them; their ends."""

import asyncio
import contextlib
import os
import signal
import struct
import time
from pathlib import Path

import pytest
from tests.sim.daemon_stage import becomes_idle, wait_until
from tests.sim.web.web_page import bus_children, ended, listens, pages, with_dashboard

from motord.bus.web.processes.commissioning import FAILED
from motord.client import ClientError

PRESENT = 4
SPIN = {"procedure": "spin", "options": {"seconds": 10.0}, "joints": ["left"]}
SILENT = "the connection to the page was interrupted: answer again"


@pytest.fixture(scope="module")
def stage(tmp_path_factory, port):
    with with_dashboard(tmp_path_factory.mktemp("commission"), port, "loop.rate_hz=250") as stage:
        yield stage


@pytest.fixture
async def connect(stage, port):
    becomes_idle(stage)
    wait_until(lambda: listens(port), "the dashboard listens")
    async with pages(port) as connected:
        page = await connected()
        await page.answer("commission.stop")
        await ended(page)
        yield connected


def record(one):
    return one.get("commissioning") or {} if isinstance(one, dict) else {}


async def question(page, *problems):
    """Wait for an open question, with one of `problems` if any are given; return it."""

    def asked(one):
        found = record(one).get("question")
        return found if found and (not problems or found["problem"] in problems) else None

    return await page.until(asked)


@contextlib.asynccontextmanager
async def present(page):
    """Send the signs of life of a visible page until the end of the block."""

    async def signs():
        while True:
            now_s = time.monotonic()
            await page.connection.send_bytes(struct.pack("<Bdd", PRESENT, 1e3 * now_s, now_s))
            await asyncio.sleep(0.05)

    async with asyncio.TaskGroup() as tasks:
        sending = tasks.create_task(signs())
        yield
        sending.cancel()


async def answered(page, value, enough):
    """Answer each question, also a repeated one, until `enough` is true of a message."""
    given = 0
    while True:

        def further(one, given=given):
            if enough(one):
                return "enough"
            asked = record(one).get("question")
            return asked["number"] if asked and asked["number"] > given else None

        given = await page.until(further)
        if given == "enough":
            return
        request = {"number": given, "value": value}
        await page.connection.send_json({"id": 8, "call": "commission.answer", "params": request})


async def turning(stage, page):
    """Start a spin that outlasts the test; the page then sends no more signs of life."""
    async with present(page):
        await page.answer("commission.start", **SPIN)
        await answered(page, value=True, enough=lambda _: fastest_rad_s(stage) > 0.5)


def fastest_rad_s(stage):
    return max(abs(joint.velocity_rad_s) for joint in stage.sim.truth().joints.values())


def message_pipe(stage):
    """Return the pipe of the procedure's messages to motord-bus; its stdout is its log."""
    (procedure,) = bus_children(stage, "motord.commission.page.procedure")
    read = {target for _, target in pipes(stage.robot.status()["bus"]["pid"])}
    (found,) = (one for one, target in pipes(procedure) if target in read and one.name != "0")
    return found


def pipes(pid):
    for one in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):  # the descriptor has been closed
            if (target := os.readlink(one)).startswith("pipe:"):
                yield one, target


def rests_disarmed(stage):
    def safe():
        with contextlib.suppress(ClientError):
            return stage.sim.truth().at_rest and stage.state() == "idle"
        return False

    wait_until(safe, "at rest and disarmed")


@pytest.mark.parametrize(
    ("request_", "why"),
    [
        ({"procedure": "drive"}, "no procedure"),
        ({"procedure": ["spin"]}, "no procedure"),
        ({"procedure": "spin", "options": {"wheel_rad_s": 50.0}}, "not a number from 0.1 to 5"),
        ({"procedure": "spin", "options": {"wheel_rad_s": "1"}}, "not a number from"),
        ({"procedure": "spin", "options": {"step_s": 1.0}}, "has no option"),
        ({"procedure": "spin", "joints": "left"}, "list of names"),
        ({"procedure": "spin", "joints": [1]}, "list of names"),
    ],
)
async def test_an_invalid_request_starts_no_procedure(connect, request_, why):
    page = await connect()
    assert why in (await page.answer("commission.start", **request_))["error"]


async def test_an_option_that_is_not_finite_starts_no_procedure(connect):
    page = await connect()
    for word in ("NaN", "Infinity", "1e999"):
        await page.connection.send_str(
            '{"id": 7, "call": "commission.start", "params": '
            f'{{"procedure": "spin", "options": {{"seconds": {word}}}}}}}'
        )
    await page.connection.send_json({"id": 8, "call": "status", "params": {}})
    answer = await page.until(lambda one: isinstance(one, dict) and one.get("answer") == 8 and one)
    assert answer["result"]["state"] == "idle"
    status = await page.until(lambda one: isinstance(one, dict) and one.get("status"))
    assert status["commissioning"] is None


async def test_only_the_conducting_page_answers_and_others_can_only_stop(connect):
    page, other = await connect(), await connect()
    assert "result" in await page.answer("commission.start", **SPIN)
    number = (await question(page))["number"]
    refused = await other.answer("commission.answer", number=number, value=True)
    assert refused["error"] == "this page does not run the procedure"
    for call in ("arm", "reset", "params.set", "params.save", "commission.start"):
        assert "spin is running" in (await other.answer(call, procedure="spin"))["error"], call
    assert "runs this procedure" in (await other.answer("commission.take"))["error"]
    assert "result" in await other.answer("commission.stop")
    await ended(page)


async def test_an_answer_of_a_silent_page_moves_nothing(stage, connect):
    stage.sim.reset_truth()
    page = await connect()
    await page.answer("commission.start", **SPIN)
    asked = await question(page)
    for _ in range(2):
        await page.answer("commission.answer", number=asked["number"], value=True)
        asked = await question(page, SILENT)
    assert stage.sim.truth().moved_max_m_s == 0.0
    assert stage.state() == "idle"
    await page.answer("commission.stop")
    await ended(page)


async def test_a_question_with_an_invalid_answer_is_asked_again(connect):
    page = await connect()
    await page.answer("commission.start", **SPIN)
    asked = await question(page)
    stale = {"number": asked["number"] - 1, "value": True}
    assert "not open" in (await page.answer("commission.answer", **stale))["error"]
    no_value = await page.answer("commission.answer", number=asked["number"], value=[True])
    assert "an answer is a text" in no_value["error"]
    async with present(page):
        for value in ("yes", 1, 0.0):
            await page.answer("commission.answer", number=asked["number"], value=value)
            while (asked := await question(page, SILENT, "yes or no"))["problem"] == SILENT:
                await page.answer("commission.answer", number=asked["number"], value=value)
    await page.answer("commission.stop")
    await ended(page)


async def test_a_silent_page_ends_the_procedure_at_rest_without_power(stage, connect):
    page = await connect()
    await turning(stage, page)
    end = await page.until(lambda one: record(one).get("end"))
    assert "silent" in end["text"]
    rests_disarmed(stage)


async def test_a_procedure_with_unreadable_output_ends_at_rest_without_power(stage, connect):
    page = await connect()
    await turning(stage, page)
    async with present(page):
        message_pipe(stage).write_bytes(b"no JSON\n")
        end = await page.until(lambda one: record(one).get("end"))
    assert end == {"good": False, "text": FAILED}
    rests_disarmed(stage)
    assert "result" in await page.answer("commission.start", **SPIN)


async def test_a_killed_motord_bus_leaves_the_robot_at_rest_and_disarmed(stage, connect):
    page = await connect()
    await turning(stage, page)
    os.kill(stage.robot.status()["bus"]["pid"], signal.SIGKILL)
    rests_disarmed(stage)
