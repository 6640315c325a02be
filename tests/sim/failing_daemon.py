# SPDX-License-Identifier: Apache-2.0
"""The daemon with a task that fails while the daemon ends."""

import asyncio

from motord.__main__ import main
from motord.daemon import app


async def fails_at_the_end(_: object) -> None:
    try:
        await asyncio.Event().wait()
    finally:
        await asyncio.sleep(0.05)  # the lines are stopping their drives
        raise RuntimeError("a mistake at the end")


app.watch_battery = fails_at_the_end
main()
