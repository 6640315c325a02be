# SPDX-License-Identifier: Apache-2.0
"""What tests of whole robots share. Each file has a `stage` of its own."""

import pytest
from tests.sim.daemon_stage import armed


@pytest.fixture(name="armed")
def _armed(stage):
    with armed(stage):
        yield stage
