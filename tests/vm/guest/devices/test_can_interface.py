# SPDX-License-Identifier: Apache-2.0
"""CAN lines of both engines on interfaces of the kernel: two controllers that are cabled to each
other, an interface that goes down, one that is removed, one with a full queue, and how long a
set-point takes. The contract tests check the frames on vcan.

The ODrives here are at the other end of a vxcan, which is a cable without controllers: motord sends
remote frames to ODrives, and QEMU's SJA1000 corrupts what follows a remote frame.
"""

import math
import statistics
import subprocess
import time
from types import SimpleNamespace

import pytest
import scripted_odrive
from can_rig import spec_of
from cia402_node import OPERATION, Cia402Node
from loop_side import running, until
from scripted_odrive import IDLE, Peer, living, open_bus
from shell import output

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec, LineState

TURN = 2 * math.pi
NODE = 5
OWN, FAR = "vxcan0", "vxcan1"
CONTROLLERS = ("can0", "can1")
ENGINES = {"rt": "socketcan", "asyncio": "socketcan-asyncio"}
CHANGES = 50
CYCLE_HZ = 20.0
"""Rate of the lines: low, because an emulated machine is slow."""


def ip(*words):
    output("ip", "link", *words)


@pytest.fixture(scope="module", autouse=True)
def cable():
    ip("add", OWN, "type", "vxcan", "peer", "name", FAR)
    for interface in (OWN, FAR):
        ip("set", interface, "up")
    yield
    ip("del", OWN)


@pytest.fixture
def controllers():
    for interface in CONTROLLERS:
        ip("set", interface, "down")
        ip("set", interface, "up", "type", "can", "bitrate", "500000", "restart-ms", "100")
    yield CONTROLLERS
    for interface in CONTROLLERS:
        ip("set", interface, "down")


@pytest.fixture(params=ENGINES)
async def peer(request, monkeypatch):
    monkeypatch.setattr(scripted_odrive, "ESTIMATES_S", 1.0 / CYCLE_HZ)
    peer = Peer(ENGINES[request.param], (0, 3), f"socketcan:{OWN}", f"socketcan:{FAR}")
    async with living(peer):
        yield peer


@pytest.fixture
async def rig(peer):
    async with running(spec_of(peer, 0, 3, cycle_hz=CYCLE_HZ)) as rig:
        yield rig


async def drive(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
    await until(lambda: any(peer.axes[0].velocities()), "it is sent motion")


async def back_disarmed(rig, peer):
    await rig.ready()
    mark = len(peer.axes[0].velocities())
    await until(lambda: len(peer.axes[0].velocities()) > mark + 3, "a frame is sent")
    assert set(peer.axes[0].velocities()[mark:]) == {0.0}
    assert peer.axes[0].state == IDLE


async def test_an_interface_set_down_is_reported_and_its_drives_return_disarmed(rig, peer):
    await drive(rig, peer)
    ip("set", OWN, "down")
    try:
        await until(lambda: EventKind.LINE_LOST in rig.kinds(), "the line is lost")
        assert rig.line.state is not LineState.READY
        assert DriveState.ARMED not in rig.states()
    finally:
        ip("set", OWN, "up")
    await back_disarmed(rig, peer)
    assert rig.kinds().count(EventKind.LINE_OPEN) == 2


async def test_a_full_queue_counts_its_lost_frames_and_the_newest_arrives(rig, peer):
    await drive(rig, peer)
    output("tc", "qdisc", "replace", "dev", OWN, "root", "netem", "delay", "100ms", "limit", "2")
    try:
        await until(lambda: rig.line.stats().errors.get("tx_full", 0) > 20, "frames are lost")
    finally:
        output("tc", "qdisc", "del", "dev", OWN, "root")
    rig.loop.velocity_rad_s = {0: 0.5 * TURN}
    if rig.states() != {DriveState.ARMED}:  # a queue that was full too long disarms it
        await rig.arm()
    await until(lambda: peer.axes[0].velocities()[-1] == pytest.approx(0.5), "the newest")


async def test_a_set_point_reaches_the_other_end_of_the_cable(rig, peer, capsys):
    await drive(rig, peer)
    took_ms = []
    for number in range(1, CHANGES + 1):
        turns_s = 1.0 + number / CHANGES
        began_s = time.monotonic()
        rig.loop.velocity_rad_s = {0: turns_s * TURN}
        rig.loop.put()
        await until(lambda want=turns_s: peer.axes[0].velocities()[-1] == pytest.approx(want))
        took_ms.append((time.monotonic() - began_s) * 1e3)
    with capsys.disabled():
        print(
            f"\n{rig.line.engine}: set-point to the other end, cycle 50 ms: "
            f"{statistics.median(took_ms):.1f} ms p50, {max(took_ms):.1f} ms at most of {CHANGES}"
        )


def make(interface):
    ip("add", interface, "type", "vcan")
    ip("set", interface, "up")


@pytest.fixture
def adapter():
    """An interface that a test can remove, like an adapter that is unplugged."""
    make("gone0")
    yield "gone0"
    subprocess.run(("ip", "link", "del", "gone0"), check=False)


@pytest.mark.parametrize("kind", ENGINES.values())
async def test_an_interface_removed_and_added_again_has_its_drives_disarmed(kind, adapter):
    peer = Peer(kind, (0, 3), f"socketcan:{adapter}")
    async with living(peer), running(spec_of(peer, 0, 3)) as rig:
        await drive(rig, peer)
        peer.cut()
        ip("del", adapter)
        await until(lambda: EventKind.LINE_LOST in rig.kinds(), "the line is lost")
        assert DriveState.ARMED not in rig.states()
        make(adapter)
        peer.reach(peer.address)
        await back_disarmed(rig, peer)


@pytest.mark.parametrize("kind", ENGINES.values())
async def test_can_fd_on_an_interface_without_it_is_refused_with_the_reason(kind):
    ip("add", "classic0", "type", "vcan")
    ip("set", "classic0", "mtu", "16")
    ip("set", "classic0", "up")
    try:
        peer = Peer(kind, (0,), "socketcan:classic0")
        spec = spec_of(peer, 0, data_baudrate=2_000_000)
        async with living(peer), running(spec) as rig:
            await until(lambda: rig.events != [], "an event of the line")
            assert rig.kinds() == [EventKind.LINE_LOST]
            assert "carries no CAN FD" in rig.events[0].text
    finally:
        ip("del", "classic0")


@pytest.mark.smoke
@pytest.mark.parametrize("engine", ENGINES)
async def test_a_cia_402_drive_is_driven_by_controllers_on_a_cable(controllers, engine):
    own, far = controllers
    node = Cia402Node(open_bus(f"socketcan:{far}"), NODE)
    joint = JointSpec(index=0, name="wheel0", profile=find_profile("cia402"), unit=NODE)
    peer = SimpleNamespace(address=f"socketcan:{own}", engine=engine, axes={})
    try:
        async with running(spec_of(peer, joints=(joint,), cycle_hz=CYCLE_HZ)) as rig:
            await rig.arm()
            assert node.status == OPERATION
            rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
            node.position = -1234
            await until(lambda: node.velocity == 60, "a turn a second")
            await until(
                lambda: rig.loop.exchange.take_feedback(0).count == (1 << 32) - 1234, "counts"
            )
            await rig.line.disarm()
            await until(lambda: node.status != OPERATION, "no power")
    finally:
        node.close()
