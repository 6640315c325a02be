# SPDX-License-Identifier: Apache-2.0
"""The daemon supervises the second process, whatever that writes: with real children, most of which
misbehave."""

import asyncio
import contextlib
import os
import sys
import time
from pathlib import Path

import pytest

from motord.config import load_robot
from motord.daemon import bus_supervisor
from motord.daemon.bus_supervisor import BEAT_BYTES_MAX, BusSupervisor

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"
DEADLINE_S = 5.0
BEAT = b'{"inputs":{"pad":1}}\n'


@pytest.fixture(autouse=True)
def _impatient(monkeypatch):
    """Shorten the wait for a child's end: a child that floods does not read the request to end."""
    monkeypatch.setattr(bus_supervisor, "END_WITHIN_S", 0.1)


@contextlib.asynccontextmanager
async def child(code):
    """Supervise a child that runs this program, until the end of the block."""
    supervisor = BusSupervisor(load_robot(DEMO), Path("no.sock"))
    supervisor._command = [sys.executable, "-c", f"import os\n{code}"]
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(supervisor.run())
        yield supervisor
        task.cancel()


async def until(condition):
    async with asyncio.timeout(DEADLINE_S):
        while not condition():
            await asyncio.sleep(0.01)


def stand_still(for_s):
    time.sleep(for_s)


@pytest.mark.parametrize(
    "written",
    [
        b"5",
        b"null",
        b"[]",
        b'"x"',
        b"{",
        b"\xff{}",
        b"[" * 5000,
        b'{"a":NaN}',
        b'{"a":-1e999}',
        b"",
    ],
)
async def test_a_line_that_holds_no_figures_is_skipped(written, caplog):
    lines = written + b"\n" + BEAT
    async with child(f"os.write(1, {lines!r}); os.read(0, 1)") as supervisor:
        await until(lambda: "inputs" in supervisor.report())
        assert supervisor.report()["inputs"] == {"pad": 1}
    async with child(f"os.write(1, {written!r} + b'\\n'); os.read(0, 1)") as supervisor:
        await until(lambda: "not its figures" in caplog.text)
        assert set(supervisor.report()) == {"pid", "restarts"}


async def test_pid_and_restarts_come_from_the_daemon():
    written = b'{"pid":1,"restarts":-5}\n' + BEAT.replace(b"{", b'{"pid":1,"restarts":-5,', 1)
    async with child(f"os.write(1, {written!r}); os.read(0, 1)") as supervisor:
        await until(lambda: "inputs" in supervisor.report())
        report = supervisor.report()
        assert report["restarts"] == 0
        assert report["pid"] > 1


async def test_a_child_that_no_kill_ends_is_not_waited_for(monkeypatch):
    """A process that waits in the kernel survives a kill until that wait ends."""
    words = (sys.executable, "-c", "import time; time.sleep(1000)")
    process = await asyncio.create_subprocess_exec(*words, stdin=asyncio.subprocess.PIPE)
    async with asyncio.timeout(DEADLINE_S):
        with monkeypatch.context() as held:
            held.setattr(asyncio.subprocess.Process, "kill", lambda _: None)
            await bus_supervisor._end(process)
        process.kill()
        await process.wait()


@pytest.mark.parametrize("line", [b"\n", b"{\n", b"[warning] no route\n"])
async def test_a_flood_is_reported_once_and_does_not_hold_up_the_daemon(line, caplog):
    flood = f"flood = {line!r} * 3000\nwhile True: os.write(1, flood)"
    async with child(flood) as supervisor:
        await until(lambda: "not its figures" in caplog.text)
        for _ in range(100):
            assert supervisor.report()["pid"] is not None
            await asyncio.sleep(0.002)
    assert caplog.text.count("not its figures") == 1


async def test_a_long_line_of_figures_is_read_whole():
    written = f"b'{{\"inputs\":\"' + b'x' * {BEAT_BYTES_MAX // 2} + b'\"}}\\n'"
    async with child(f"os.write(1, {written}); os.read(0, 1)") as supervisor:
        await until(lambda: "inputs" in supervisor.report())
        assert len(supervisor.report()["inputs"]) == BEAT_BYTES_MAX // 2


@pytest.mark.parametrize("line", [b"noise\n", b"x"])
async def test_a_child_that_sends_much_but_no_figures_is_ended_like_one_that_hangs(
    line, caplog, monkeypatch
):
    monkeypatch.setattr(bus_supervisor, "START_WITHIN_S", 1.0)
    async with child(f"while True: os.write(1, {line!r} * 3000)") as supervisor:
        await until(lambda: supervisor.report()["restarts"] >= 1)
    assert "was silent" in caplog.text


async def test_a_start_may_take_longer_than_a_silence_later(caplog, monkeypatch):
    monkeypatch.setattr(bus_supervisor, "SILENT_S", 0.2)
    late = f"import time; time.sleep(1.0); os.write(1, {BEAT!r}); os.read(0, 1)"
    async with child(late) as supervisor:
        await until(lambda: supervisor.report()["restarts"] >= 1)
    assert "was silent for 0.2 s" in caplog.text


async def test_a_child_that_stands_still_is_ended_without_waiting_for_it(caplog, monkeypatch):
    monkeypatch.setattr(bus_supervisor, "END_WITHIN_S", 1000.0)
    async with child(f"os.write(1, {BEAT!r}); os.kill(os.getpid(), 19)") as supervisor:
        await until(lambda: supervisor.report()["restarts"] >= 1)
    assert "was silent for 2 s" in caplog.text


async def test_time_in_which_the_daemon_stands_still_is_no_silence(caplog):
    beating = f"import time\nwhile True: os.write(1, {BEAT!r}); time.sleep(0.05)"
    async with child(beating) as supervisor:
        await until(lambda: "inputs" in supervisor.report())
        pid = supervisor.report()["pid"]
        stand_still(1.5 * bus_supervisor.SILENT_S)
        await asyncio.sleep(0.5)
        assert supervisor.report()["pid"] == pid
    assert "was silent" not in caplog.text


async def test_the_child_runs_the_checked_robot_though_the_file_has_changed(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(DEMO.read_text("utf-8"), "utf-8")
    supervisor = BusSupervisor(load_robot(path), tmp_path / "no.sock")
    path.write_text("[half an edi", "utf-8")
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(supervisor.run())
        await until(lambda: supervisor.report().keys() > {"pid", "restarts"})
        assert supervisor.report()["restarts"] == 0
        task.cancel()


@pytest.mark.parametrize("turns", range(4))
async def test_a_child_that_ends_as_its_time_is_over_does_not_keep_the_daemon_from_ending(
    turns, monkeypatch
):
    """A cancelled supervisor waits for its child. The limit of this wait passes `turns` turns of
    the event loop after the child has ended."""
    monkeypatch.setattr(bus_supervisor, "END_WITHIN_S", 0.5)
    ends = f"import time; os.write(1, {BEAT!r}); os.read(0, 1); time.sleep(0.1)"
    async with asyncio.timeout(DEADLINE_S), child(ends) as supervisor:
        await until(lambda: "inputs" in supervisor.report())
        _in_turns(10, _wait_for_the_end_of, supervisor.report()["pid"], turns)


def _in_turns(turns, call, *arguments):
    """Call `call` after this many turns of the event loop."""
    if turns == 0:
        call(*arguments)
    else:
        asyncio.get_running_loop().call_soon(_in_turns, turns - 1, call, *arguments)


def _wait_for_the_end_of(pid, turns):
    ended_by_s = time.monotonic() + DEADLINE_S
    while not os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
        assert time.monotonic() < ended_by_s
        time.sleep(0.01)
    _in_turns(turns, time.sleep, bus_supervisor.END_WITHIN_S)
