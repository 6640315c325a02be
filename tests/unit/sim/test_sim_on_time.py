# SPDX-License-Identifier: Apache-2.0
"""One simulator on a machine may keep a processor for itself; a second one would leave none."""

from motord_hal.sim import runner
from motord_hal.sim.runner import punctual


def test_only_one_simulator_at_a_time_keeps_a_processor(monkeypatch):
    monkeypatch.setattr(runner, "PUNCTUAL", "\0motord-test-on-time")
    monkeypatch.setattr(runner, "_may_be_punctual", lambda: True)
    with punctual() as first:
        with punctual() as second:
            assert (first, second) == (True, False)
        assert first
    with punctual() as next_one:
        assert next_one
