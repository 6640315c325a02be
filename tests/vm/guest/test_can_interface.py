# SPDX-License-Identifier: Apache-2.0
"""CAN lines of both engines on two controllers of the kernel that are cabled to each other: an
interface that goes down, one that is taken away, one whose queue is full, and how long a set-point
takes. What is said on the bus is asked by the contract suite, on vcan."""

import math
import statistics
import subprocess
import time

import pytest
from loop_side import running, until
from scripted_odrive import IDLE, Peer, living
from shell import output
from test_can_line import spec_of

from motord_hal.ports import DriveState, EventKind, LineState

TURN = 2 * math.pi
OWN, FAR = "can0", "can1"
ENGINES = {"rt": "socketcan", "asyncio": "socketcan-asyncio"}
CHANGES = 50
pytestmark = pytest.mark.skipif(
    subprocess.run(("ip", "link", "show", OWN), capture_output=True, check=False).returncode != 0,
    reason="no CAN controllers",
)


def up(interface, *more):
    output("ip", "link", "set", interface, "up", "type", "can", "bitrate", "500000", *more)


def down(interface):
    output("ip", "link", "set", interface, "down")


@pytest.fixture(scope="module", autouse=True)
def cable():
    for interface in (OWN, FAR):
        down(interface)
        up(interface, "restart-ms", "100")
    yield
    for interface in (OWN, FAR):
        down(interface)


@pytest.fixture(params=ENGINES)
async def peer(request):
    peer = Peer(ENGINES[request.param], (0, 3), f"socketcan:{OWN}", f"socketcan:{FAR}")
    async with living(peer):
        yield peer


@pytest.fixture
async def rig(peer):
    async with running(spec_of(peer, 0, 3)) as rig:
        yield rig


async def drive(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
    await until(lambda: any(peer.axes[0].velocities()), "it is told to turn")


async def back_disarmed(rig, peer):
    await rig.ready()
    mark = len(peer.axes[0].velocities())
    await until(lambda: len(peer.axes[0].velocities()) > mark + 3, "it is told something")
    assert set(peer.axes[0].velocities()[mark:]) == {0.0}
    assert peer.axes[0].state == IDLE


async def test_an_interface_that_is_set_down_is_said_and_the_drives_come_back_disarmed(rig, peer):
    await drive(rig, peer)
    down(OWN)
    try:
        await until(lambda: EventKind.LINE_LOST in rig.kinds(), "the line is lost")
        assert rig.line.state is not LineState.READY
        assert DriveState.ARMED not in rig.states()
    finally:
        up(OWN)
    await back_disarmed(rig, peer)
    assert rig.kinds().count(EventKind.LINE_OPEN) == 2


async def test_a_queue_that_is_full_loses_frames_counts_them_and_the_newest_arrives(rig, peer):
    await drive(rig, peer)
    output("tc", "qdisc", "replace", "dev", OWN, "root", "netem", "delay", "100ms", "limit", "2")
    try:
        await until(lambda: rig.line.stats().errors.get("tx_full", 0) > 20, "frames are lost")
    finally:
        output("tc", "qdisc", "del", "dev", OWN, "root")
    rig.loop.velocity_rad_s = {0: 0.5 * TURN}
    await rig.arm()
    await until(lambda: peer.axes[0].velocities()[-1] == pytest.approx(0.5), "the newest")


async def test_a_set_point_reaches_the_other_end_of_the_cable(rig, peer):
    await drive(rig, peer)
    took_ms = []
    for number in range(1, CHANGES + 1):
        turns_s = 1.0 + number / CHANGES
        began_s = time.monotonic()
        rig.loop.velocity_rad_s = {0: turns_s * TURN}
        rig.loop.put()
        await until(lambda want=turns_s: peer.axes[0].velocities()[-1] == pytest.approx(want))
        took_ms.append((time.monotonic() - began_s) * 1e3)
    print(
        f"\n{rig.line.engine}: set-point to the other end, cycle 10 ms: "
        f"{statistics.median(took_ms):.1f} ms p50, {max(took_ms):.1f} ms at most of {CHANGES}"
    )


def make(interface):
    output("ip", "link", "add", interface, "type", "vcan")
    output("ip", "link", "set", interface, "up")


@pytest.fixture
def adapter():
    """An interface that can be pulled."""
    make("gone0")
    yield "gone0"
    subprocess.run(("ip", "link", "del", "gone0"), check=False)


@pytest.mark.parametrize("kind", ENGINES.values())
async def test_an_interface_that_is_taken_away_and_comes_back_brings_its_drives_disarmed(
    kind, adapter
):
    peer = Peer(kind, (0, 3), f"socketcan:{adapter}")
    async with living(peer), running(spec_of(peer, 0, 3)) as rig:
        await drive(rig, peer)
        peer.cut()
        output("ip", "link", "del", adapter)
        await until(lambda: EventKind.LINE_LOST in rig.kinds(), "the line is lost")
        assert DriveState.ARMED not in rig.states()
        make(adapter)
        peer.reach(peer.address)
        await back_disarmed(rig, peer)
