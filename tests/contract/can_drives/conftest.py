# SPDX-License-Identifier: Apache-2.0
"""CAN buses with room for several drives. Tests that also run in the guest of `make vm` have their
fixtures in their own files: the guest has no conftest.py of this folder."""

import pytest
from shared_bus import INTERFACE, KINDS, shared_bus


@pytest.fixture(params=KINDS, ids=" ".join)
def bus(request):
    """Address of a bus, and the engine of the line on it."""
    kind, engine = request.param
    with shared_bus(kind) as address:
        yield address, engine


@pytest.fixture
def address():
    """Address of the kernel's bus if there is one, else of one at a Unix socket."""
    with shared_bus("socketcan" if INTERFACE else "unix") as address:
        yield address
