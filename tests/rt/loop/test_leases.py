# SPDX-License-Identifier: Apache-2.0
"""The daemon's leases over the real loop: a held source that disconnects stays held."""

import contextlib
import os
import signal
import subprocess

import pytest
from tests.rt.small_base import FOREVER_S, LIMITS, arm, core_config, settings, until

from motord.api.commands import Refusal
from motord.control.holds import OWNERS_MAX, SILENT_NS, Holds, Left
from motord.control.leases import LEASE_MAX_S, LEASE_MIN_S, Leases, NoLease
from motord.local_socket.peer_process import Process, process_of
from motord.realtime import loop as rt


@pytest.fixture
def loop():
    with rt.Loop(core_config(), settings()) as running:
        arm(running)
        yield running


async def drive(leases, connection, linear_m_s, owner="teleop", lease_s=LEASE_MAX_S, process=None):
    return await leases.submit(
        connection=connection, owner=owner, priority=100, lease_s=lease_s, process=process,
        linear_m_s=linear_m_s, angular_rad_s=0.0,
    )  # fmt: skip


async def stop_and_go(loop, leases):
    """Begin and end a stop; check that another source may move."""
    loop.put_control(rt.Control(armed=True, stop=True, limits=LIMITS))
    until(lambda: leases.commander().held)
    loop.put_control(rt.Control(armed=True, limits=LIMITS))
    until(lambda: "stop_requested" not in loop.read_state().reasons)
    assert not (await drive(leases, 9, 0.1, owner="another")).held


async def test_a_held_source_stays_held_on_its_next_connection(loop):
    leases = Leases(loop)
    assert not (await drive(leases, 1, 0.3)).held
    await stop_and_go(loop, leases)
    leases.disconnect(1)
    assert (await drive(leases, 2, 0.3)).held
    assert not (await drive(leases, 2, 0.0)).held
    assert not (await drive(leases, 2, 0.3)).held


async def test_a_held_source_stays_held_on_its_other_connection(loop):
    leases = Leases(loop)
    await drive(leases, 2, 0.0, lease_s=LEASE_MIN_S)
    until(lambda: not leases.fresh())
    await drive(leases, 1, 0.3)
    await stop_and_go(loop, leases)
    leases.disconnect(1)
    assert (await drive(leases, 2, 0.3)).held


async def test_a_source_that_was_silent_during_the_stop_is_held(loop):
    leases = Leases(loop)
    await drive(leases, 1, 0.3, lease_s=LEASE_MIN_S)
    until(lambda: not leases.fresh())
    loop.put_control(rt.Control(armed=True, stop=True, limits=LIMITS))
    until(leases.held)
    loop.put_control(rt.Control(armed=True, limits=LIMITS))
    until(lambda: "stop_requested" not in loop.read_state().reasons)
    assert [one.owner for one in leases.held()] == ["teleop"]
    assert (await drive(leases, 1, 0.3)).held
    assert not (await drive(leases, 1, 0.0)).held
    assert not leases.held()
    assert not (await drive(leases, 1, 0.3)).held


async def test_no_silence_lets_a_source_that_has_left_move_again(loop):
    leases = Leases(loop)
    await drive(leases, 1, 0.3, lease_s=LEASE_MIN_S)
    leases.disconnect(1)  # its last word is motion, and no stop has come yet
    assert not leases.held()
    leases.follow(may_move=False)
    leases.follow(may_move=True)
    assert [one.owner for one in leases.held()] == ["teleop"]
    assert (await drive(leases, 2, 0.3)).held
    assert (await drive(leases, 3, 0.3)).held  # each of its connections


async def test_a_source_that_comes_back_without_a_stop_is_not_held(loop):
    leases = Leases(loop)
    await drive(leases, 1, 0.3)
    leases.disconnect(1)
    assert not (await drive(leases, 2, 0.3)).held


async def test_a_source_that_ended_its_lease_is_not_held(loop):
    leases = Leases(loop)
    await drive(leases, 1, 0.3)
    leases.release(1, "teleop")
    leases.disconnect(1)
    leases.follow(may_move=False)
    assert not leases.held()


@contextlib.contextmanager
def program():
    """Start a process that does nothing; return it as a source's."""
    with subprocess.Popen(["sleep", "600"]) as running:
        try:
            found = process_of(running.pid)
            assert found is not None
            yield found
        finally:
            running.kill()


def processes():
    """Return a process that was started before a stop, one that was started after it, and the time
    of the stop."""
    before, after = Process(pid=1, started_ns=1), Process(pid=2, started_ns=1 << 62)
    return before, after, 10 * SILENT_NS


def test_a_program_that_was_started_anew_may_move_after_a_silence_and_an_older_one_may_not():
    first, second, stopped_ns = processes()
    holds = Holds()
    holds.note("teleop", Left(since_ns=stopped_ns, newest_ns=stopped_ns, process=first))
    for process, silent_ns, held in (
        (second, SILENT_NS - 1, True), (second, SILENT_NS, False),
        (first, 100 * SILENT_NS, True), (None, 100 * SILENT_NS, True),
    ):  # fmt: skip
        since_ns = holds.since_ns("teleop", process, stopped_ns + silent_ns)
        assert since_ns == (stopped_ns if held else 0), (process, silent_ns)


async def test_a_program_that_is_started_anew_for_each_command_stays_held(loop):
    leases = Leases(loop)
    for connection in range(1, 5):
        with program() as one:
            held = (await drive(leases, connection, 0.3, process=one)).held
            assert held == (connection > 1)
            if connection == 1:
                await stop_and_go(loop, leases)
            leases.disconnect(connection)


@pytest.mark.parametrize("started_before", [1, 2])
async def test_programs_that_follow_each_other_and_each_end_their_request_are_held(
    loop, started_before
):
    """One program before the stop may be a person's; a second one within 5 s is a series."""
    leases = Leases(loop)
    for connection in range(1, started_before + 1):
        with program() as one:
            assert not (await drive(leases, connection, 0.3, process=one)).held
            leases.release(connection, "teleop")
    leases.follow(may_move=False)
    leases.follow(may_move=True)
    for connection in (5, 6):
        with program() as one:
            held = (await drive(leases, connection, 0.3, process=one)).held
            assert held == (started_before == 2)
            leases.release(connection, "teleop")
        if started_before == 1:  # as a script does that stops after each command
            leases.follow(may_move=False)
            leases.follow(may_move=True)


async def test_another_program_s_end_does_not_end_the_hold_of_one_that_has_gone(loop):
    leases = Leases(loop)
    with program() as first, program() as second:
        await drive(leases, 1, 0.3, process=first)
        await stop_and_go(loop, leases)
        leases.disconnect(1)
        assert (await drive(leases, 2, 0.3, process=second)).held
        leases.release(2, "teleop")
        assert (await drive(leases, 3, 0.3, process=first)).held


def test_a_source_whose_program_has_ended_is_named_until_it_has_been_silent_for_long():
    _, _, stopped_ns = processes()
    with program() as source:
        for lives in (True, False):
            holds = Holds()
            holds.note("teleop", Left(since_ns=stopped_ns, newest_ns=stopped_ns, process=source))
            for silent_ns in (SILENT_NS - 1, SILENT_NS):
                named = [owner for owner, _ in holds.held(stopped_ns + silent_ns)]
                assert named == (["teleop"] if lives or silent_ns < SILENT_NS else [])
            if lives:
                os.kill(source.pid, signal.SIGKILL)
                os.waitpid(source.pid, 0)


async def test_a_person_lets_all_go_on(loop):
    leases = Leases(loop)
    await drive(leases, 1, 0.3)
    await drive(leases, 2, 0.3, owner="gone")
    await stop_and_go(loop, leases)
    leases.disconnect(2)
    assert sorted(leases.release_held()) == ["gone", "teleop"]
    until(lambda: not leases.held())
    assert not (await drive(leases, 1, 0.3)).held
    assert not (await drive(leases, 3, 0.3, owner="gone")).held
    assert leases.release_held() == ()


def left_behind(silent_ns):
    """Return the holds of one owner that has left, whose newest command is this old."""
    holds, now = Holds(), 10 * SILENT_NS
    holds.note("teleop", Left(since_ns=now, newest_ns=now - silent_ns, process=None))
    holds.arm(now)
    return [owner for owner, _ in holds.held(now)]


def test_arming_lets_an_owner_that_has_left_go_on_only_after_a_long_silence():
    assert left_behind(SILENT_NS - 1) == ["teleop"]
    assert left_behind(SILENT_NS) == []


async def test_more_owners_than_are_kept_by_name_are_all_held(loop):
    leases = Leases(loop)
    await drive(leases, 1, 0.3)
    await stop_and_go(loop, leases)
    for number in range(OWNERS_MAX + 1):
        await drive(leases, 2, 0.3, owner=f"owner-{number}")
        leases.disconnect(2)
    leases.follow(may_move=False)
    leases.follow(may_move=True)
    for number in range(OWNERS_MAX + 1):
        assert (await drive(leases, 3, 0.3, owner=f"owner-{number}")).held
        leases.release(3, f"owner-{number}")


async def test_a_source_that_sends_less_often_than_its_lease_is_named(loop):
    leases = Leases(loop)
    for _ in range(4):
        assert not leases.sparse()
        await drive(leases, 1, 0.3, lease_s=LEASE_MIN_S)
        until(lambda: not leases.fresh())
    (words,) = leases.sparse().values()
    assert words.startswith("teleop sends a command every ")
    assert "each one ends after 0.02 s" in words
    await drive(leases, 1, 0.3)
    await drive(leases, 1, 0.3)
    assert not leases.sparse()


async def test_a_lifetime_out_of_bounds_is_refused_and_grants_nothing(loop):
    leases = Leases(loop)
    for lease_s in (0.0, LEASE_MIN_S / 2, LEASE_MAX_S * 2, FOREVER_S, float("nan")):
        with pytest.raises(ValueError, match="lease_s"):
            await drive(leases, 1, 0.3, lease_s=lease_s)
    assert not leases.fresh()


async def test_a_connection_is_held_by_a_lease_that_was_given_out_or_by_a_living_command(loop):
    leases = Leases(loop)
    leases.grant(1, "autopilot", 50, LEASE_MAX_S, kept=True)
    await drive(leases, 2, 0.1)
    await drive(leases, 3, 0.1, owner="brief", lease_s=LEASE_MIN_S)
    until(lambda: not leases.holds(3))
    assert [leases.holds(number) for number in (1, 2, 3, 4)] == [True, True, False, False]
    leases.disconnect(1)
    leases.release(2, "teleop")
    assert not any(leases.holds(number) for number in (1, 2))


async def test_more_than_ten_times_the_limit_is_refused_by_name_and_commands_zero(loop):
    leases = Leases(loop)
    await drive(leases, 1, 0.1)
    with pytest.raises(NoLease, match="ten times the limit"):
        await drive(leases, 1, 1e308)
    assert leases.commander().linear_m_s == 0.0
    assert loop.commands().refused[Refusal.OUT_OF_RANGE] == 1
    assert (await drive(leases, 1, 9.9 * LIMITS["linear"]["velocity_u_s"])).wants_motion
