# SPDX-License-Identifier: Apache-2.0
import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord_hal.base.retry import Backoff


@given(st.floats(1e-6, 10), st.floats(1, 1000), st.integers(1, 60))
def test_waits_double_up_to_the_limit(first_s, factor, tries):
    backoff = Backoff(first_s, first_s * factor)
    waits = [backoff.next_s() for _ in range(tries)]
    assert waits[0] == first_s
    assert all(later == min(2 * sooner, first_s * factor) for sooner, later in pairwise(waits))
    backoff.reset()
    assert backoff.next_s() == first_s


@pytest.mark.parametrize("times", [(0, 1), (-1, 1), (2, 1), (math.nan, 1), (1, math.inf)])
def test_times_that_make_no_sense_are_refused(times):
    with pytest.raises(ValueError, match="first"):
        Backoff(*times)
