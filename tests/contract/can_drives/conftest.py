# SPDX-License-Identifier: Apache-2.0
"""CAN buses with room for several drives. Tests that run in the guest of `make vm`, too, have their
fixtures in their own files: the guest has no conftest.py of this folder."""

import pytest
from shared_bus import INTERFACE, KINDS, shared_bus


@pytest.fixture(params=KINDS, ids=" ".join)
def bus(request):
    """Its address, and the engine of the line on it."""
    kind, engine = request.param
    with shared_bus(kind) as address:
        yield address, engine


@pytest.fixture
def address():
    """The kernel's bus, where there is one. Files that need another have their own."""
    with shared_bus("socketcan" if INTERFACE else "unix") as address:
        yield address
