# SPDX-License-Identifier: Apache-2.0
"""What tests/conftest.py does for tests that run side by side."""

import os

import pytest


@pytest.fixture(scope="module")
def shared():
    """As a daemon or a browser that a whole file uses."""


def test_tests_that_share_a_fixture_of_their_file_stay_in_one_process(shared, request):
    if not request.config.getoption("loadgroup", default=False):
        pytest.skip("only one process, or another --dist than loadgroup")
    assert request.node.nodeid.endswith(f"@tests/unit/{os.path.basename(__file__)}")
