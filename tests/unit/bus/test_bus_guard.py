# SPDX-License-Identifier: Apache-2.0
"""An adapter that fails runs again; each failure is counted, the first reported; no other fails."""

import asyncio
from pathlib import Path

import pytest
from tests.sim.planted import offered

from motord.bus import guard
from motord.bus.runtime import Runtime
from motord.config import load_robot

DEADLINE_S = 30.0


class Adapter:
    """An adapter that fails with each of `errors`, and then runs."""

    def __init__(self, *errors):
        self.errors = list(errors)
        self.lives = 0
        self.well = asyncio.Event()

    async def run(self):
        self.lives += 1
        if len(self.errors) == 1:
            raise self.errors.pop()
        if self.errors:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self.fail(self.errors.pop(0)))
        self.well.set()
        await asyncio.Event().wait()

    async def fail(self, error):
        raise error


@pytest.fixture(autouse=True)
def _soon(monkeypatch):
    monkeypatch.setattr(guard, "AGAIN_MIN_S", 0.01)


ERRORS = (RuntimeError("camera is gone"), OSError(5), UnicodeError("x"), asyncio.CancelledError())


async def test_a_failing_adapter_runs_again_and_failures_are_counted_but_reported_once(caplog):
    adapter, failures = Adapter(*ERRORS), {}
    async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
        task = tasks.create_task(guard.keep("publish.bad", adapter, failures))
        await adapter.well.wait()
        task.cancel()
    assert adapter.lives == len(ERRORS) + 1
    assert failures == {"publish.bad": len(ERRORS)}
    assert [row.getMessage() for row in caplog.records] == [
        (
            "publish.bad failed and starts again; more failures are counted, not logged:"
            " RuntimeError: camera is gone"
        )
    ]


async def test_a_memory_error_ends_the_whole_process():
    async with asyncio.timeout(DEADLINE_S):
        with pytest.raises(BaseExceptionGroup) as caught:
            await guard.keep("publish.bad", Adapter(MemoryError()), {})
    assert isinstance(guard.first(caught.value), MemoryError)


async def test_an_adapter_that_ends_by_itself_is_not_run_again():
    class Done:
        async def run(self):
            pass

    failures = {}
    async with asyncio.timeout(DEADLINE_S):
        await guard.keep("publish.done", Done(), failures)
    assert failures == {}


async def test_an_adapter_that_raises_when_cancelled_is_cancelled():
    class Spiteful:
        async def run(self):
            try:
                await asyncio.Event().wait()
            except asyncio.CancelledError:
                raise RuntimeError("not now") from None

    async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
        task = tasks.create_task(guard.keep("publish.bad", Spiteful(), {}))
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        task.cancel()
    assert task.cancelled()


DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"
NEVER_MADE = {
    "import": "raise NameError('pi')",
    "syntax": "class Adapter",
    "make": "class Adapter:\n    def __init__(self, name): pass",
    "open": "class Adapter:\n    def __init__(self, *_): raise RuntimeError('no camera')",
    "values": "class Adapter:\n    def __init__(self, *_): raise ValueError('no colour')",
}


@pytest.mark.parametrize("what", NEVER_MADE)
def test_an_adapter_that_cannot_be_made_is_off_and_the_others_are_made(
    tmp_path, monkeypatch, caplog, what
):
    offered(tmp_path, "motord.publishers", f"bad_{what}", NEVER_MADE[what], "Adapter")
    monkeypatch.syspath_prepend(tmp_path)
    settings = ("publish.bad.kind=other", f"publish.bad.adapter=bad_{what}",
                "publish.prom.kind=prometheus")  # fmt: skip
    runtime = Runtime(load_robot(DEMO, settings), tmp_path / "no.sock")
    assert list(runtime._adapters()) == ["publish.prom"]
    assert "publish.bad is off" in caplog.text
