# SPDX-License-Identifier: Apache-2.0
"""The command gate, which the C receiver has its rules from."""

import pytest
from tests.unit.bus.gate_rig import gate


@pytest.fixture(scope="module")
def stamped(tmp_path_factory):
    return gate(tmp_path_factory)
