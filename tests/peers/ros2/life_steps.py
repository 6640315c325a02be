# SPDX-License-Identifier: Apache-2.0
"""Calls that lead a node through its life cycle, each made at once after the answer before. Each
answer has to know what the call before did."""

CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4


def never_old(name):
    """Return settings with which no call of the input counts as old because a busy machine held up
    the server."""
    return f"input.{name}.lease_s=5.0", "safety.command_timeout_s=5.0"


def _change(number, *, success=True):
    return ("change_state", {"transition": {"id": number}}, success)


def _trigger(method):
    return (method, {}, True)


STEPS = (
    _change(CONFIGURE),
    _change(ACTIVATE),
    _change(DEACTIVATE),
    _change(CLEANUP),
    _change(ACTIVATE, success=False),
    _change(CONFIGURE),
    _change(CLEANUP),
    _change(CONFIGURE),
    _change(ACTIVATE),
    _trigger("estop"),
    _change(DEACTIVATE, success=False),
    _trigger("reset"),
    _change(ACTIVATE),
    _trigger("disarm"),
    _change(DEACTIVATE, success=False),
    _trigger("arm"),
    _change(DEACTIVATE),
    _trigger("arm"),
    _change(CLEANUP, success=False),
    _trigger("stop"),
    _change(DEACTIVATE),
)
"""Service, values of the request, and the `success` that its answer has to have. They begin and end
inactive."""
