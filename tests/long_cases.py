# SPDX-License-Identifier: Apache-2.0
"""Cases of a parametrized test, of which `make test` runs few and `make test-all` runs all."""

import pytest


def long_but(few, cases):
    """Return `cases`, with the mark `long` on each that is not among `few`."""
    return [pytest.param(case, marks=() if case in few else pytest.mark.long) for case in cases]
