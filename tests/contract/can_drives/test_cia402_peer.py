# SPDX-License-Identifier: Apache-2.0
"""CiA 402 over CANopen, against a second stack that others have written: node-canopen."""

import contextlib
import json
import math
import shutil
import subprocess
import threading
from pathlib import Path

import can
import pytest
from loop_side import running, until
from shared_bus import end_of

from motord.config.drives.load import load_profile
from motord_hal.base.errors import DriveFault
from motord_hal.base.paths import config_dir
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec, LineSpec

ROOT = Path(__file__).parents[3]
MODULES = ROOT / "build/node/node_modules"
PROGRAM = ROOT / "tests/peers/cia402_drive.mjs"
NODE, PRE_OPERATIONAL, OPERATIONAL = 5, 127, 5
RPM = 2 * math.pi / 60
OPERATION, QUICK_STOP, FAULT = 0x27, 0x07, 0x08
HEARTBEAT_TIME = 0x1017

pytestmark = pytest.mark.skipif(
    not (shutil.which("node") and (MODULES / "canopen").exists()),
    reason="apt install nodejs npm; npm install --prefix build/node canopen@6",
)


class Drive:
    """The other project's node in a process of its own, and its connection to the bus."""

    def __init__(self, bus):
        self.reported = {}
        self._bus, self._ended = bus, threading.Event()
        self._process = subprocess.Popen(
            ["node", str(PROGRAM), str(NODE), str(MODULES)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1,
        )  # fmt: skip
        self._threads = [
            threading.Thread(target=work) for work in (self._from_bus, self._from_node)
        ]
        for thread in self._threads:
            thread.start()

    def close(self):
        self._ended.set()
        self._threads[0].join()
        self._process.stdin.close()
        self._threads[1].join()
        self._process.stdout.close()
        self._process.wait()
        self._bus.shutdown()

    def put(self, **what):
        self._process.stdin.write(json.dumps(what) + "\n")

    def _from_bus(self):
        while not self._ended.is_set():
            frame = self._bus.recv(0.05)
            if frame is not None:
                self.put(id=frame.arbitration_id, data=frame.data.hex())

    def _from_node(self):
        for line in self._process.stdout:
            message = json.loads(line)
            if "id" not in message:
                self.reported = message
                continue
            data = bytes.fromhex(message["data"])
            frame = can.Message(arbitration_id=message["id"], data=data, is_extended_id=False)
            with contextlib.suppress(BlockingIOError):
                self._bus.send(frame)


@pytest.fixture
def drive(bus):
    drive = Drive(end_of(bus[0]))
    yield drive
    drive.close()


@pytest.fixture
def profile(tmp_path):
    """The profile with PDO type 254: of the types for events (CiA 301, 7.5.2.37) it has no 255."""
    text = (config_dir() / "drives/cia402.toml").read_text(encoding="utf-8")
    path = tmp_path / "by-event.toml"
    own = text.replace('pdo_1_type", value = 255', 'pdo_1_type", value = 254')
    own = own.replace('tpdo_2_type", value = 255', 'tpdo_2_type", value = 254')
    path.write_text(own.replace('name = "cia402"', 'name = "by-event"'), encoding="utf-8")
    return load_profile(path)


@pytest.fixture
async def rig(bus, drive, profile):
    address, engine = bus
    spec = LineSpec(
        index=0, name="can0", kind="can", port=address, baudrate=500000, parity="none",
        stop_bits=1, cycle_hz=200.0, gap_s=None, engine=engine, priority=0, watchdog_s=0.5,
        joints=(JointSpec(index=0, name="wheel", profile=profile, unit=NODE),),
    )  # fmt: skip
    async with running(spec) as rig:
        yield rig


def feedback(rig):
    return rig.loop.exchange.take_feedback(0)


async def test_it_is_set_up_by_sdo_started_by_nmt_and_not_armed(rig, drive):
    await rig.ready()
    reported = drive.reported
    assert (reported["nmt"], reported["mode"], reported["option"]) == (OPERATIONAL, 3, 2)
    assert reported["mapped"] == [2, 3, 2]
    assert reported["pdos"][str(0x1600)][:2] == [0x60400010, 0x60FF0020]
    assert reported["pdos"][str(0x1A00)][:3] == [0x60410010, 0x606C0020, 0x603F0010]
    assert reported["pdos"][str(0x1A01)][:2] == [0x60640020, 0x60770010]
    assert reported["pdos"][str(0x1400)] == [0x200 + NODE, 254, 0, 0, 500]
    assert OPERATION not in reported["statuses"]
    assert reported["wanted"] == 0


async def test_it_is_armed_edge_by_edge_and_turns_in_both_directions(rig, drive):
    await rig.arm()
    assert drive.reported["statuses"][-4:] == [0x40, 0x21, 0x23, OPERATION]
    drive.put(set=[0x6064, -1234])
    await until(lambda: feedback(rig).count == (1 << 32) - 1234)
    rig.loop.enabled = True
    for rpm in (90, -60):
        rig.loop.velocity_rad_s = {0: rpm * RPM}
        await until(lambda rpm=rpm: drive.reported["velocity"] == rpm, "it turns as commanded")
        wanted = pytest.approx(rpm * RPM)
        await until(lambda wanted=wanted: feedback(rig).velocity_rad_s == wanted, "and reports it")
    assert feedback(rig).enabled is True


async def test_old_set_points_cause_a_quick_stop_and_then_a_power_off(rig, drive):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: drive.reported["velocity"] == 60)
    rig.loop.running = False
    await until(lambda: rig.states() == {DriveState.READY}, "it is commanded to stop")
    await until(lambda: drive.reported["statuses"][-1] not in (OPERATION, QUICK_STOP), "no power")
    assert QUICK_STOP in drive.reported["statuses"]
    assert drive.reported["velocity"] == 0


async def test_a_fault_is_reported_and_reset_by_an_edge(rig, drive):
    await rig.arm()
    drive.put(fault=0x3220)
    await until(lambda: EventKind.DRIVE_FAULT in rig.kinds())
    assert rig.line.drive_faults == {"wheel": ("under-voltage",)}
    await rig.ready()
    with pytest.raises(DriveFault, match="under-voltage"):
        await rig.line.arm()
    await rig.line.clear_faults()
    assert drive.reported["status"] != FAULT
    await rig.arm()


async def test_a_heartbeat_that_ends_stops_it_and_it_comes_back_disarmed(rig, drive):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: drive.reported["velocity"] == 60)
    drive.put(set=[HEARTBEAT_TIME, 0])
    await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds(), "it is unresponsive")
    await until(lambda: QUICK_STOP in drive.reported["statuses"], "it receives, and is sent a stop")
    await rig.ready()
    assert EventKind.DRIVE_BACK in rig.kinds()
    assert drive.reported["status"] != OPERATION
    assert drive.reported["velocity"] == 0


async def test_objects_are_read_by_name(rig):
    await rig.ready()
    assert await rig.line.read_register("wheel", "bus_voltage") == pytest.approx(48.0)
    assert await rig.line.read_register("wheel", "device_type") == 0x00020192
