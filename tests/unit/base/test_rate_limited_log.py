# SPDX-License-Identifier: Apache-2.0
"""A log that no sender on the network can fill."""

import logging

import pytest

from motord.base import rate_limited_log as limited


def test_a_thousand_equal_messages_are_one_line(caplog):
    voice = limited.RateLimitedLog(logging.getLogger("test"))
    for _ in range(1000):
        voice.say("not understood")
    assert caplog.messages == ["not understood"]


def test_the_number_of_suppressed_messages_is_logged(caplog, monkeypatch):
    voice = limited.RateLimitedLog(logging.getLogger("test"))
    for _ in range(4):
        voice.say("not understood")
    now_s = limited.time.monotonic()
    monkeypatch.setattr(limited.time, "monotonic", lambda: now_s + limited.AGAIN_S)
    voice.say("not understood")
    assert caplog.messages == ["not understood", "not understood (3 more)"]


def test_a_few_messages_are_written_at_once_before_the_rest_is_counted(caplog, monkeypatch):
    voice = limited.RateLimitedLog(logging.getLogger("test"), at_once=2)
    for number in range(5):
        voice.say(f"stop {number}")
    now_s = limited.time.monotonic()
    monkeypatch.setattr(limited.time, "monotonic", lambda: now_s + limited.AGAIN_S)
    voice.say("stop 5")
    voice.say("stop 6")
    assert caplog.messages == ["stop 0", "stop 1", "stop 5 (3 more)", "stop 6"]


@pytest.fixture
def library():
    """The log of a library that logs each message that it drops, as aiomqtt does."""
    log = logging.getLogger("test.library")
    kept = limited.RateLimitedFilter(log, "input.fleet")
    log.addFilter(kept)
    yield log
    log.removeFilter(kept)


def test_a_message_that_a_library_repeats_is_logged_once(caplog, library):
    for _ in range(1000):
        library.warning("Message queue is full. Discarding message.")
        library.warning("There are %d pending publish calls.", 7)
    assert caplog.messages == [
        "input.fleet: Message queue is full. Discarding message.",
        "input.fleet: There are 7 pending publish calls.",
    ]


def test_an_exception_of_a_library_is_reported_with_its_traceback(caplog, library):
    try:
        raise IndexError("a mistake")
    except IndexError:
        library.exception("it failed")
    (record,) = caplog.records
    assert record.exc_info is not None
