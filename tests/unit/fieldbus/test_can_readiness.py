# SPDX-License-Identifier: Apache-2.0
"""Checks of a CAN interface before its bus is opened: the kernel's state, from files and by
netlink."""

import struct
from collections import Counter

import pytest

from motord_hal.base.errors import PortError
from motord_hal.can import interface
from motord_hal.can.interface import BusOffWatch, make_ready
from motord_hal.can.netlink import BUS_OFF, can_state, state_in, state_request

ERROR_ACTIVE = 0
CLASSIC_MTU, FD_MTU = 16, 72


def attribute(kind, payload):
    size = 4 + len(payload)
    return struct.pack("=HH", size, kind) + payload + bytes(-size % 4)


def link_of(kind, *data):
    """Return RTM_NEWLINK as the kernel sends it: name, MTU and `data` of a link of that kind."""
    info = attribute(1, kind + b"\x00") + attribute(2 | 0x8000, b"".join(data))
    body = attribute(3, b"can0\x00") + attribute(4, struct.pack("=I", 16)) + attribute(18, info)
    head = struct.pack("=BxHiII", 0, 280, 7, 1, 0)
    return struct.pack("=IHHII", 16 + len(head) + len(body), 16, 0, 1, 0) + head + body


def can_data(state):
    return attribute(1, bytes(32)), attribute(4, struct.pack("=I", state)), attribute(6, bytes(4))


def test_the_state_request_needs_no_privilege():
    message = state_request(7, 1)
    assert struct.unpack_from("=IHHII", message) == (32, 18, 1, 1, 0)
    assert struct.unpack_from("=i", message, 20) == (7,)


@pytest.mark.parametrize("state", [ERROR_ACTIVE, BUS_OFF])
def test_the_state_is_read_from_what_the_kernel_answers(state):
    assert state_in(link_of(b"can", *can_data(state))) == state


def test_an_interface_without_a_controller_has_no_state():
    assert state_in(link_of(b"vcan")) is None
    assert state_in(link_of(b"bond", attribute(4, struct.pack("=I", BUS_OFF)))) is None
    assert can_state("lo") is None


def test_an_answer_that_is_cut_off_or_foreign_gives_no_state():
    whole = link_of(b"can", *can_data(BUS_OFF))
    for size in range(32, len(whole) - 8):
        assert state_in(whole[:size]) is None
    with pytest.raises(ValueError, match="no interface"):
        state_in(whole[:20])
    with pytest.raises(ValueError, match="message 2"):
        state_in(struct.pack("=IHHIIi12x", 36, 2, 0, 1, 0, -19))


def test_an_interface_that_is_not_there_is_an_error_of_the_system():
    with pytest.raises(OSError, match=r"nothing0|No such device|no interface"):
        can_state("nothing0")


@pytest.fixture
def net(tmp_path, monkeypatch):
    """Make a /sys/class/net with the loopback, which exists for netlink too; return its writer."""
    monkeypatch.setattr(interface, "NET", tmp_path)
    (tmp_path / "lo").mkdir()

    def write(*, flags=0x1, mtu=CLASSIC_MTU, carrier=1):
        for name, value in (("flags", hex(flags)), ("mtu", mtu), ("carrier", carrier)):
            (tmp_path / "lo" / name).write_text(f"{value}\n")

    write()
    return write


async def ready(errors=None, *, fd=False):
    await make_ready("socketcan:lo", Counter() if errors is None else errors, fd_frames=fd)


async def test_an_interface_that_is_down_or_missing_is_refused_with_what_to_do(net):
    net(flags=0)
    with pytest.raises(PortError, match="lo is down: ip link set lo up type can"):
        await ready()
    with pytest.raises(PortError, match="nothing0: there is no CAN interface nothing0"):
        await make_ready("socketcan:nothing0", Counter(), fd_frames=False)


@pytest.mark.parametrize(
    ("kernel_has_can", "interfaces", "words"),
    [
        (True, {"can1": "280", "can0": "280", "eth0": "1"}, "those here: can0, can1"),
        (True, {"eth0": "1"}, "this machine has none"),
        (False, {"eth0": "1"}, "this kernel has no CAN yet: `modprobe can_raw`"),
    ],
)
def test_a_missing_interface_and_a_kernel_without_can_have_different_texts(
    tmp_path, monkeypatch, kernel_has_can, interfaces, words
):
    monkeypatch.setattr(interface, "NET", tmp_path / "net")
    monkeypatch.setattr(interface, "CAN_TABLES", tmp_path / "can")
    for name, kind in interfaces.items():
        (tmp_path / "net" / name).mkdir(parents=True)
        (tmp_path / "net" / name / "type").write_text(f"{kind}\n", encoding="ascii")
    if kernel_has_can:
        (tmp_path / "can").mkdir()
    assert words in interface.missing("can7")


async def test_can_fd_is_refused_where_the_interface_does_not_carry_it(net):
    await ready()
    with pytest.raises(PortError, match=r"carries no CAN FD.*ip link set lo type can .*fd on"):
        await ready(fd=True)
    net(mtu=FD_MTU)
    await ready(fd=True)


async def test_bus_off_that_cannot_be_restarted_is_an_error(net, monkeypatch):
    monkeypatch.setattr(interface, "can_state", lambda channel: BUS_OFF)
    errors = Counter()
    for refused in (1, 2):  # again each time: only a person can restart the interface
        with pytest.raises(PortError, match=r"bus-off.*not restarted.*type can restart"):
            await ready(errors)
        assert errors == {"restart_refused": refused}
    monkeypatch.setattr(interface, "can_state", lambda channel: ERROR_ACTIVE)
    await ready(errors)


async def test_other_adapters_are_not_checked(net):
    for address in ("virtual:lo", "unix:/nowhere", "slcan:/dev/null"):
        await make_ready(address, Counter(), fd_frames=True)
        assert BusOffWatch(address).is_off() is False


def test_bus_off_is_seen_by_the_carrier_and_the_kernel_s_state(net, monkeypatch):
    monkeypatch.setattr(interface, "LOOK_EVERY_S", 0.0)
    watch = BusOffWatch("socketcan:lo")
    assert watch.is_off() is False
    net(carrier=0)
    assert watch.is_off() is False  # the loopback has no controller
    monkeypatch.setattr(interface, "can_state", lambda channel: BUS_OFF)
    assert watch.is_off() is True
    net(carrier=1)
    assert watch.is_off() is False
