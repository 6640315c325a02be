# SPDX-License-Identifier: Apache-2.0
"""A dashboard's port and its pages. Each file has a `stage` of its own, the daemon behind them."""

import pytest
from tests.sim.web.web_page import free_port, pages


@pytest.fixture(scope="module")
def port():
    return free_port()


@pytest.fixture
async def connect(stage, port):
    """Opens pages; a file that prepares its robot first has its own."""
    async with pages(port) as connected:
        yield connected
