# SPDX-License-Identifier: Apache-2.0
"""The exchanges of a line on the dashboard, traced only while a page shows them."""

from collections import deque

import pytest
from tests.sim.daemon_stage import wait_until
from tests.sim.web.web_page import bus_children, with_dashboard

from motord.bus.web.processes.tracing import ROWS_MAX, chosen


@pytest.fixture(scope="module")
def stage(tmp_path_factory, port):
    with with_dashboard(tmp_path_factory.mktemp("trace"), port) as stage:
        yield stage


def tracing(stage):
    return bus_children(stage, "trace")


def trace_of(one):
    return isinstance(one, dict) and one.get("trace")


async def test_two_pages_share_one_trace_process_that_ends_with_them(stage, connect):
    first, second = await connect(), await connect(token=None)
    assert tracing(stage) == []
    for page in (first, second):
        assert (await page.answer("trace", line="rs485"))["result"] == {"line": "rs485"}
    for page in (first, second):
        found = await page.until(trace_of)
        assert found["line"] == "rs485"
        assert 0 < len(found["rows"]) <= ROWS_MAX
        row = found["rows"][-1]
        assert row["joint"] in ("left", "right", "left,right")
        assert row["what"].startswith(("read", "write"))
        assert row["sent"]
        assert row["failed"] == (row["result"] != "ok")
    assert len(tracing(stage)) == 1
    await first.answer("trace", line=None)
    assert await second.until(trace_of)
    assert len(tracing(stage)) == 1
    await second.connection.close()
    wait_until(lambda: tracing(stage) == [], "no process traces")


async def test_an_unknown_line_is_named(connect):
    page = await connect()
    assert "no line" in (await page.answer("trace", line="nothing"))["error"]
    assert "no line" in (await page.answer("trace", line=["rs485"]))["error"]


def test_failures_are_shown_first_and_the_order_is_kept():
    rows = deque({"failed": False, "number": n} for n in range(10 * ROWS_MAX))
    rows[7]["failed"] = True
    found = [row["number"] for row in chosen(rows)]
    assert len(found) == ROWS_MAX
    assert found == [7, *range(10 * ROWS_MAX - ROWS_MAX + 1, 10 * ROWS_MAX)]
    broken = deque({"failed": True, "number": n} for n in range(2 * ROWS_MAX))
    assert [row["number"] for row in chosen(broken)] == list(range(ROWS_MAX, 2 * ROWS_MAX))
