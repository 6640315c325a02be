# SPDX-License-Identifier: Apache-2.0
"""Fixtures that tests of whole robots share. Each file defines its own `stage`."""

import pytest
from tests.sim.daemon_stage import armed


@pytest.fixture(name="armed")
def _armed(stage):
    with armed(stage):
        yield stage
