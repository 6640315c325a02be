# SPDX-License-Identifier: Apache-2.0
"""The daemon's leases over the real loop: a held source that disconnects stays held."""

import pytest
from tests.rt.small_base import FOREVER_S, LIMITS, arm, core_config, settings, until

from motord.api.commands import Refusal
from motord.control.leases import LEASE_MAX_S, LEASE_MIN_S, Leases, NoLease
from motord.realtime import loop as rt


@pytest.fixture
def loop():
    with rt.Loop(core_config(), settings()) as running:
        arm(running)
        yield running


async def drive(leases, connection, linear_m_s, owner="teleop", lease_s=LEASE_MAX_S):
    return await leases.submit(
        connection=connection, owner=owner, priority=100, lease_s=lease_s,
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
