# SPDX-License-Identifier: Apache-2.0
"""A log that nobody on the network can fill."""

import logging

from motord import sparing


def test_a_thousand_of_one_matter_are_one_line(caplog):
    voice = sparing.Sparing(logging.getLogger("test"))
    for _ in range(1000):
        voice.say("not understood")
    assert caplog.messages == ["not understood"]


def test_how_many_were_not_said_is_said(caplog, monkeypatch):
    voice = sparing.Sparing(logging.getLogger("test"))
    for _ in range(4):
        voice.say("not understood")
    now_s = sparing.time.monotonic()
    monkeypatch.setattr(sparing.time, "monotonic", lambda: now_s + sparing.AGAIN_S)
    voice.say("not understood")
    assert caplog.messages == ["not understood", "not understood (3 more)"]
