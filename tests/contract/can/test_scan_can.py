# SPDX-License-Identifier: Apache-2.0
"""`motord scan` on a CAN bus with simulated and scripted drives; the test sees every frame."""

import contextlib
import threading
import time

import can
import pytest
from scripted_moteus import Moteus
from shared_bus import end_of, shared_bus

from motord.config.drives.load import find_profile
from motord.tools.scan_can import LISTEN_S, PROTOCOLS, Received, requests, scan_can
from motord.tools.simulator import start_simulator
from motord_hal.base.errors import PortError
from motord_hal.drives.can_profile import Sender

ROBOT = """
[robot]
name = "scanned"

[base]
kind = "differential"
track_m = 0.4
wheel_radius_m = 0.08

[limits]
linear_m_s = 0.5
linear_m_s2 = 0.5
linear_deceleration_m_s2 = 0.8
angular_rad_s = 1.0
angular_rad_s2 = 1.0
angular_deceleration_rad_s2 = 1.5

[line.bus]
kind = "can"
interface = "unix"
channel = "{channel}"
bitrate = 500000
cycle_hz = 50

[joint.left]
line = "bus"
drive = "{drive}"
unit = {nodes[0]}
side = "left"

[joint.right]
line = "bus"
drive = "{drive}"
unit = {nodes[1]}
side = "right"
"""


@contextlib.contextmanager
def simulated(folder, drive, nodes=(3, 7)):
    """Simulate a bus; yield its address and a list to which each of its frames is added."""
    file = folder / "robot.toml"
    address = f"unix:{folder}/bus"
    file.write_text(ROBOT.format(channel=f"{folder}/bus", drive=drive, nodes=nodes))
    seen, ended = [], threading.Event()
    with start_simulator(file, link_dir=folder / "ports"):
        witness = end_of(address)

        def watch():
            while not ended.is_set():
                if (message := witness.recv(timeout=0.05)) is not None:
                    seen.append(message)

        watching = threading.Thread(target=watch)
        watching.start()
        try:
            yield address, seen
        finally:
            ended.set()
            watching.join()
            witness.shutdown()


def drives_of(address, data_bitrate=None, progress=None):
    progress = [] if progress is None else progress
    found = scan_can(address, 500_000, data_bitrate, progress.append)
    return {one.unit: [match.profile for match in one.matches] for one in found}


def sent_by_us(drive, nodes, seen):
    """Return the frames that no drive of this profile sends."""
    table = find_profile(drive).can
    theirs = {frame.identifier(node) for node in nodes for frame in table.frames_from(Sender.DRIVE)}
    return [m for m in seen if m.is_remote_frame or m.arbitration_id not in theirs]


@pytest.mark.parametrize(
    ("drive", "first"),
    [("odrive-0.6", "odrive-0.6"), ("odrive-0.5", "odrive-0.5"), ("vesc", "vesc"),
     ("cia402", "cia402"), ("rmd", "rmd")],
)  # fmt: skip
def test_each_kind_of_drive_is_found_by_its_nodes(tmp_path, drive, first):
    with simulated(tmp_path, drive) as (address, _):
        found = drives_of(address)
    assert {node: profiles[0] for node, profiles in found.items()} == {3: first, 7: first}


def test_moteus_controllers_are_found_by_a_read_and_get_no_write():
    with shared_bus("unix") as address:
        drives = [Moteus(address, node) for node in (2, 9)]
        try:
            found = drives_of(address, 5_000_000)
        finally:
            for drive in drives:
                drive.close()
    assert found == {2: ["moteus"], 9: ["moteus"]}
    assert [drive.modes for drive in drives] == [[], []]


def test_drives_that_send_by_themselves_get_no_frame_of_another_protocol(tmp_path):
    with simulated(tmp_path, "odrive-0.6") as (address, seen):
        drives_of(address)
        ours = sent_by_us("odrive-0.6", (3, 7), seen)
    assert {(m.arbitration_id, m.is_remote_frame) for m in ours} == {
        (3 << 5, True), (7 << 5, True),
    }  # fmt: skip


def test_a_bus_of_an_unknown_protocol_is_sent_nothing():
    progress, seen, ended = [], [], threading.Event()
    with shared_bus("unix") as address:
        stranger, witness = end_of(address), end_of(address)

        def chatter():
            while not ended.is_set():
                stranger.send(can.Message(arbitration_id=0x123, data=b"\1\2", is_extended_id=False))
                if (message := witness.recv(timeout=0.02)) is not None:
                    seen.append(message.arbitration_id)

        chattering = threading.Thread(target=chatter)
        chattering.start()
        try:
            assert drives_of(address, progress=progress) == {}
        finally:
            ended.set()
            chattering.join()
            stranger.shutdown()
            witness.shutdown()
    assert set(seen) == {0x123}
    assert "of no protocol that the scan knows" in progress[-1]


def test_a_cancelled_scan_sends_no_more_requests():
    progress, ends_s = [], time.monotonic() + LISTEN_S + 0.05
    with shared_bus("unix") as address:
        found = scan_can(address, 500_000, None, progress.append, lambda: time.monotonic() > ends_s)
    assert found == []
    assert len(progress) < 1 + len(PROTOCOLS)


def test_a_bus_that_cannot_be_opened_is_named_with_the_remedy(tmp_path):
    with pytest.raises(PortError, match="no-bus"):
        scan_can(f"unix:{tmp_path}/no-bus", 500_000, None, print)
    with pytest.raises(PortError, match=r"no CAN interface can77 .*a serial port is a path"):
        scan_can("socketcan:can77", 500_000, None, print)
    with pytest.raises(PortError, match="ip link set lo up type can bitrate 500000"):
        scan_can("socketcan:lo", 500_000, None, print)  # it exists, and carries no CAN


# -------------------------------------------------------------------------- requests and answers
def nodes_of(*messages):
    found = Received()
    for message in messages:
        found.add(message)
    return {(one.protocol, one.node) for one in found.nodes.values()}


def standard(identifier, data):
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False)


def test_pdos_of_a_canopen_node_are_not_taken_for_an_odrive():
    pdo = standard(0x181, bytes(8))  # an ODrive's heartbeat at node 12 has this identifier, too
    heartbeat = standard(0x701, b"\x05")
    assert nodes_of(pdo) == set()
    assert nodes_of(pdo, pdo) == {("ODrive", 12)}
    assert nodes_of(heartbeat, pdo, pdo) == nodes_of(pdo, pdo, heartbeat) == {("CANopen", 1)}


def test_a_canopen_device_of_another_kind_fits_no_profile():
    answer = standard(0x585, b"\x43\x00\x10\x00\x91\x01\x07\x00")  # CiA 401: inputs and outputs
    found = Received()
    found.add(answer)
    assert found.nodes["CANopen", 5].profiles == ()
    assert "401" in found.nodes["CANopen", 5].about


@pytest.mark.parametrize(
    "message",
    [standard(0x701, b"\x33"), standard(0x123, bytes(8)), standard(0x001, b"\xff" * 8),
     standard(0x241, bytes(8)), can.Message(arbitration_id=0x55, is_extended_id=True),
     standard(0x581, b"\x80\x00\x10\x00" + bytes(4)), standard(0x700, b"\x00")],
)  # fmt: skip
def test_a_frame_that_is_no_answer_is_not_taken_for_a_drive(message):
    assert nodes_of(message) == set()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_all_requests_are_the_same_read_and_none_is_a_broadcast(protocol):
    sent = list(requests(protocol))
    assert len({message.arbitration_id for message in sent}) == len(sent) > 30
    assert len({bytes(message.data) for message in sent}) == 1
    broadcast = {"CANopen": 0x600, "RMD": 0x140, "moteus": 0x807F, "VESC": 0x11FF}[protocol]
    assert broadcast not in {message.arbitration_id for message in sent} or protocol == "moteus"


def test_a_vesc_answers_a_ping_with_its_number():
    pong = can.Message(arbitration_id=18 << 8 | 254, data=b"\x2a\x00", is_extended_id=True)
    assert nodes_of(pong) == {("VESC", 42)}
