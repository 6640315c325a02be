# SPDX-License-Identifier: Apache-2.0
"""A dashboard's port and its pages. Each file has its own `stage`, the daemon behind the pages."""

import pytest
from tests.sim.web.web_page import free_port, pages


@pytest.fixture(scope="module")
def port():
    return free_port()


@pytest.fixture
async def connect(stage, port):
    """Function that opens pages; a file that first prepares its robot has its own fixture."""
    async with pages(port) as connected:
        yield connected
