# SPDX-License-Identifier: Apache-2.0
"""A serial port is found, opened exclusively and set up; the structs that the kernel reads."""

import fcntl
import math
import os
import struct
import termios

import pytest
from hypothesis import given
from hypothesis import strategies as st
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from motord_hal.base.errors import PortError
from motord_hal.fieldbus.ports import DirectionKind, DirectionSpec, LineSpec
from motord_hal.serial.counters import Counters, Traffic, read_counters, unresponsive_hint
from motord_hal.serial.direction import kept_problem, pack_rs485
from motord_hal.serial.gpio import request_line
from motord_hal.serial.latency import ask_low_latency, shorten_latency_timer
from motord_hal.serial.port import open_port
from motord_hal.serial.sysfs import device_file, holders


def spec_of(port, *, baudrate=115200, direction=None):
    return LineSpec(
        index=0,
        name="bus",
        kind="modbus-rtu",
        port=str(port),
        baudrate=baudrate,
        parity="none",
        stop_bits=1,
        cycle_hz=50.0,
        gap_s=None,
        engine="rt",
        direction=direction or DirectionSpec(),
        joints=(),
        watchdog_s=0.5,
    )


@pytest.fixture
def pty_path():
    master_fd, slave_fd = os.openpty()
    yield os.ttyname(slave_fd)
    os.close(slave_fd)
    os.close(master_fd)


@pytest.fixture
def plug(monkeypatch):
    """Return a function that adds an adapter to pyserial's list and returns its removal."""
    there = []
    monkeypatch.setattr(list_ports, "comports", lambda: [ListPortInfo("/dev/ttyS0"), *there])

    def plug(tty, serial):
        port = ListPortInfo(f"/dev/{tty}")
        port.vid, port.pid, port.serial_number = 0x0403, 0x6001, serial
        there.append(port)
        return lambda: there.remove(port)

    return plug


def test_an_adapter_is_found_by_its_serial_number_also_under_a_new_name(plug):
    plug("ttyUSB0", "A1")
    unplug = plug("ttyUSB1", "B2")
    assert device_file("usb:B2") == "/dev/ttyUSB1"
    unplug()
    plug("ttyUSB7", "B2")
    assert device_file("usb:B2") == "/dev/ttyUSB7"


@pytest.mark.parametrize("wanted", ["usb:none", "usb:"])
def test_an_absent_adapter_is_named_with_those_that_are_there(plug, wanted):
    plug("ttyUSB0", "A1")
    with pytest.raises(PortError, match=r'there: ttyUSB0 is "A1" \(0403:6001\)$'):
        device_file(wanted)


def test_two_adapters_with_one_serial_number_are_refused(plug):
    plug("ttyUSB0", "A1")
    plug("ttyUSB1", "A1")
    with pytest.raises(PortError, match="not one port but 2"):
        device_file("usb:A1")


def test_an_adapter_that_is_unplugged_while_the_ports_are_listed_is_absent(monkeypatch):
    monkeypatch.setattr(list_ports, "comports", lambda: [int(None, 16)])
    with pytest.raises(PortError, match="there: none"):
        device_file("usb:A1")


@pytest.mark.parametrize("baudrate", [9600, 115200, 250000, 4000000])
def test_a_port_takes_the_speed_that_was_requested(pty_path, baudrate):
    port = open_port(spec_of(pty_path, baudrate=baudrate))
    try:
        modes = termios.tcgetattr(port.fd)
        assert not modes[3] & (termios.ICANON | termios.ECHO)
        assert modes[6][termios.VMIN] in (0, b"\0")
        raw = bytearray(44)
        fcntl.ioctl(port.fd, 0x802C542A, raw)
        assert struct.unpack_from("=I", raw, 40)[0] == baudrate
    finally:
        port.close()


def test_a_port_is_opened_once_and_again_after_it_was_closed(pty_path):
    first = open_port(spec_of(pty_path))
    with pytest.raises(PortError, match="another program has it open"):
        open_port(spec_of(pty_path))
    first.close()
    open_port(spec_of(pty_path)).close()


def test_a_port_that_is_not_there_is_reported(tmp_path):
    with pytest.raises(PortError, match="there is no such port"):
        open_port(spec_of(tmp_path / "nothing"))


def test_a_refused_direction_reports_what_to_do_and_leaves_the_port_free(pty_path):
    kernel = DirectionSpec(kind=DirectionKind.KERNEL)
    with pytest.raises(PortError, match=r'overlay.*"auto".*"gpio"'):
        open_port(spec_of(pty_path, direction=kernel))
    open_port(spec_of(pty_path)).close()


def test_the_holder_of_a_file_is_named(tmp_path):
    process = tmp_path / "proc" / "4711"
    (process / "fd").mkdir(parents=True)
    (process / "comm").write_text("minicom\n")
    (process / "fd" / "3").symlink_to("/dev/some-port")
    assert holders("/dev/some-port", tmp_path / "proc") == ("minicom (pid 4711)",)


def test_rs485_requests_are_packed_as_the_kernel_reads_them():
    spec = DirectionSpec(kind=DirectionKind.KERNEL, before_s=0.001, after_s=0.0015)
    assert struct.unpack("=8I", pack_rs485(spec)) == (1 | 2, 1, 2, 0, 0, 0, 0, 0)
    low = DirectionSpec(kind=DirectionKind.KERNEL, active_high=False)
    assert struct.unpack_from("=I", pack_rs485(low))[0] == 1 | 4


@given(st.floats().filter(lambda delay_s: not 0.0 <= delay_s <= 0.1) | st.just(math.nan))
def test_a_delay_that_no_driver_takes_is_refused(delay_s):
    with pytest.raises(ValueError, match="delay"):
        pack_rs485(DirectionSpec(before_s=delay_s))


def test_a_setting_that_the_driver_changes_is_reported():
    asked = pack_rs485(DirectionSpec(before_s=0.002))
    assert kept_problem(asked, asked) == ""
    assert "switch" in kept_problem(asked, bytes(32))
    assert "polarity" in kept_problem(asked, struct.pack("=3I20x", 1 | 4, 2, 0))
    assert "receiving" in kept_problem(asked, struct.pack("=3I20x", 1 | 2 | 16, 2, 0))
    assert "delays" in kept_problem(asked, struct.pack("=3I20x", 1 | 2, 0, 0))


def test_an_absent_gpio_chip_is_reported(tmp_path):
    spec = DirectionSpec(kind=DirectionKind.GPIO, gpio_chip="pinctrl", gpio_line="17")
    with pytest.raises(PortError, match="there: none"):
        request_line(spec, "bus", tmp_path)


def test_the_latency_timer_is_set_and_another_chip_left_alone(tmp_path):
    device = tmp_path / "class/tty/ttyUSB0/device"
    device.mkdir(parents=True)
    assert shorten_latency_timer("/dev/ttyUSB0", tmp_path) == ""
    timer = device / "latency_timer"
    timer.write_text("16\n")
    assert shorten_latency_timer("/dev/ttyUSB0", tmp_path) == ""
    assert timer.read_text() == "1\n"


def test_a_port_without_counters_or_low_latency_is_no_error(pty_path):
    port = open_port(spec_of(pty_path))
    assert read_counters(port.fd) is None
    assert ask_low_latency(port.fd) is False
    port.close()


@pytest.mark.parametrize(
    ("after", "now", "message"),
    [
        (Counters(9, 0, 0, 12), Traffic(), "12 parity errors: parity"),
        (Counters(9, 1, 0, 0), Traffic(), "1 framing error: baud rate"),
        (Counters(9, 0, 2, 0), Traffic(), "2 overrun errors"),
        (Counters(9, 0, 0, 0), Traffic(noise_bytes=5), "bytes came, but no frame"),
        (None, Traffic(noise_bytes=5), "bytes came, but no frame"),
        (None, Traffic(noise_bytes=5, frames=1), "torn or damaged replies came among good ones"),
        (None, Traffic(noise_bytes=5, late=1), "replies come after their time"),
        (None, Traffic(frames=9), ""),
    ],
)
def test_a_hint_follows_from_the_errors_counted(after, now, message):
    hint = unresponsive_hint(Counters(0, 0, 0, 0), after, Traffic(), now)
    assert hint.startswith(message)
    assert bool(hint) == bool(message)


def test_without_new_errors_there_is_no_hint():
    assert unresponsive_hint(Counters(0, 3, 3, 3), Counters(9, 3, 3, 3)) == ""
