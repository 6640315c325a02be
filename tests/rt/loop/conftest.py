# SPDX-License-Identifier: Apache-2.0
"""The loop of a small base. Files that need other settings have a fixture of their own."""

import pytest
from tests.rt.small_base import core_config, settings

from motord.realtime import loop as rt


@pytest.fixture
def loop():
    with rt.Loop(core_config(), settings()) as running:
        yield running
