# SPDX-License-Identifier: Apache-2.0
"""Adapters of another package in motord-bus. One is an input that commands and breaks its process
by the orders in a file."""

import contextlib
from pathlib import Path

ADAPTER = """
import asyncio
import contextlib
import ctypes
import pathlib


class Planted:
    def __init__(self, name, section, runtime):
        self._source = runtime.source(name)
        self._order = pathlib.Path(section.options["order_file"])
        self._leaking, self._kept = False, []

    async def run(self):
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._source.run())
            tasks.create_task(self._obey())

    async def _obey(self):
        while True:
            await asyncio.sleep(0.01)
            word = ""
            with contextlib.suppress(FileNotFoundError):
                word = self._order.read_text(encoding="ascii")
            if word == "drive":
                self._source.drive(0.2, 0.0)
            elif word:
                self._order.unlink()
                getattr(self, word)()
            if self._leaking:
                self._source.drive(0.2, 0.0)
                self._kept.append(bytes(range(256)) * 20000)  # 512 MB a second

    def segfault(self):
        ctypes.string_at(0)

    def leak(self):
        self._leaking = True

    def loop(self):
        while True:
            pass
"""


def offered(folder, group, name, code, made_by):
    """Write a package with that code and entry point; return the environment that finds it."""
    (folder / f"{name}_kind.py").write_text(code, encoding="ascii")
    info = folder / f"{name}_kind-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Name: {name}-kind\nVersion: 1.0\n", encoding="ascii")
    points = f"[{group}]\n{name} = {name}_kind:{made_by}\n"
    (info / "entry_points.txt").write_text(points, encoding="ascii")
    return {"PYTHONPATH": str(folder)}


class Planted:
    """The adapter of [input.planted]: its package, its settings, and its orders."""

    def __init__(self, folder):
        self._order = Path(folder) / "order"
        self.environ = offered(folder, "motord.inputs", "planted", ADAPTER, "Planted")
        self.settings = (
            "input.planted.kind=other", "input.planted.adapter=planted",
            f"input.planted.options.order_file={self._order}", "input.planted.lease_s=1.0",
        )  # fmt: skip

    def order(self, word):
        """Give an order: `drive` lasts until the next one; `segfault`, `leak`, `loop` act once."""
        whole = self._order.with_suffix(".new")
        whole.write_text(word, encoding="ascii")
        whole.replace(self._order)

    def rest(self):
        """Remove the order: the input sends no more commands."""
        with contextlib.suppress(FileNotFoundError):
            self._order.unlink()
