# SPDX-License-Identifier: Apache-2.0
"""The command gate, whose rules the C receiver follows."""

import pytest
from tests.unit.bus.gate_rig import gate


@pytest.fixture(scope="module")
def stamped(tmp_path_factory):
    return gate(tmp_path_factory)
