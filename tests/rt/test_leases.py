# SPDX-License-Identifier: Apache-2.0
"""The daemon's leases over the real loop: who was held when he left is held where he goes on."""

import pytest
from small_base import FOREVER_S, LIMITS, arm, core_config, settings, until

from motord import rt
from motord.leases import LEASE_MAX_S, LEASE_MIN_S, Leases


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
    """A stop that is over; somebody else may move."""
    loop.put_control(rt.Control(armed=True, stop=True, limits=LIMITS))
    until(lambda: leases.commander().held)
    loop.put_control(rt.Control(armed=True, limits=LIMITS))
    until(lambda: "stop_requested" not in loop.read_state().reasons)
    assert not (await drive(leases, 9, 0.1, owner="somebody else")).held


async def test_who_was_held_stays_so_on_his_next_connection(loop):
    leases = Leases(loop)
    assert not (await drive(leases, 1, 0.3)).held
    await stop_and_go(loop, leases)
    leases.disconnect(1)
    assert (await drive(leases, 2, 0.3)).held
    assert not (await drive(leases, 2, 0.0)).held
    assert not (await drive(leases, 2, 0.3)).held


async def test_who_was_held_stays_so_on_the_connection_that_he_has_already(loop):
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
