# SPDX-License-Identifier: Apache-2.0
"""The serial port of the Modbus line on asyncio: full, closed, unplugged, opened exclusively."""

import asyncio
import contextlib
import os
import select
import subprocess
import sys
import tty

import pytest
from loop_side import GENEROUS_S, until
from scripted_slave import ScriptedSlave, Unit
from serial import SerialException
from serial_asyncio_fast import SerialTransport

from motord_hal.base.errors import NoReply, PortError
from motord_hal.modbus.codec import Function, Request, build_request
from motord_hal.modbus.guard import GuardedClient

WRITE = Request(1, Function.WRITE_SINGLE, 0x10, values=(0x77,))
READ = Request(1, Function.READ_HOLDING, 0x10, count=1)
SHORT_S = 0.02
NOISE = b"\xff"
FULL_FOR_S = 0.1


@pytest.fixture
def ends(tmp_path):
    """A pty that no program reads: its master, and another descriptor of the port."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    os.set_blocking(slave, False)
    (tmp_path / "port").symlink_to(os.ttyname(slave))
    yield master, slave
    os.close(master)
    os.close(slave)


def client_on(tmp_path):
    return GuardedClient(str(tmp_path / "port"), 115200, "none", 1, None)


async def test_a_parity_that_the_driver_refuses_later_is_a_port_error(tmp_path, ends):
    """A pty has no parity: the port opens, and fails when it is configured once more."""
    descriptors = len(os.listdir("/proc/self/fd"))
    client = GuardedClient(str(tmp_path / "port"), 19200, "even", 1, None)
    with pytest.raises(PortError, match="port"):
        await client.open()
    assert len(os.listdir("/proc/self/fd")) == descriptors


async def test_an_adapter_that_disappears_while_it_is_opened_is_a_port_error(
    tmp_path, ends, monkeypatch
):
    def gone(*_):
        raise SerialException(5, "Input/output error")

    monkeypatch.setattr("motord_hal.serial.loop_port.SerialTransport", gone)
    with pytest.raises(PortError, match="cannot be opened"):
        await client_on(tmp_path).open()


def fill(slave):
    """Fill the port until it takes no more bytes, even after the kernel has passed some on."""
    room = True
    while room:
        for size in (4096, 1):  # a pty may have room for a byte and not report it
            with contextlib.suppress(BlockingIOError):
                while os.write(slave, NOISE * size):
                    pass
        room = select.select([], [slave], [], FULL_FOR_S)[1]


def all_of(master):
    came = b""
    while True:
        try:
            came += os.read(master, 65536)
        except BlockingIOError:
            return came


@pytest.mark.timeout(30)  # a failure here may be an event loop that never ends
@pytest.mark.parametrize("by", ["its deadline", "a cancellation"])
async def test_a_full_port_blocks_nothing_and_sends_nothing_old_later(by, tmp_path, ends):
    master, slave = ends
    client = client_on(tmp_path)
    await client.open()
    fill(slave)
    if by == "a cancellation":
        exchange = asyncio.ensure_future(client.exchange(WRITE, GENEROUS_S))
        await until(client._port.transport.get_write_buffer_size)
        exchange.cancel()
        with pytest.raises(asyncio.CancelledError):
            await exchange
    else:
        with pytest.raises(PortError, match="takes no bytes"):
            await client.exchange(WRITE, SHORT_S)
    assert not client.connected
    all_of(master)  # the port has room again
    for _ in range(5):
        await asyncio.sleep(0)  # a writer that waits for room is notified
    await client.open()
    with pytest.raises(NoReply):
        await client.exchange(READ, SHORT_S)
    came = all_of(master)
    assert build_request(WRITE) not in came
    assert build_request(READ) in came
    client.close()


async def test_a_closed_port_is_free_before_the_event_loop_turns(tmp_path, ends):
    for _ in range(3):
        client = client_on(tmp_path)
        await client.open()
        client.close()
        client.close()
    before = asyncio.all_tasks()
    await until(lambda: asyncio.all_tasks() == {asyncio.current_task()}, f"all end: {before}")


async def test_the_port_is_under_the_transport_of_pyserial_asyncio_fast(tmp_path):
    peer = ScriptedSlave(tmp_path / "port")
    peer.units = {1: Unit({0x10: 7})}
    client = client_on(tmp_path)
    await client.open()
    assert type(client._port.transport) is SerialTransport
    assert (await client.exchange(READ, GENEROUS_S)).values == (7,)
    client.close()
    peer.pull()


async def test_an_unplugged_port_is_not_logged_as_a_bug(tmp_path, caplog):
    peer = ScriptedSlave(tmp_path / "port")
    client = client_on(tmp_path)
    await client.open()
    port = client._port
    peer.pull()
    assert port.write(b"\x01") == 1  # the reader has not noticed it yet
    assert not client.connected
    with pytest.raises(PortError):
        await client.exchange(READ, SHORT_S)
    client.close()
    await until(lambda: asyncio.all_tasks() == {asyncio.current_task()})
    assert [record for record in caplog.records if record.name != "motord"] == []


def test_a_program_without_asyncio_ports_or_plots_loads_neither_transport_nor_numpy():
    program = (
        "import sys, motord.daemon.app, motord.bus.__main__, motord.cli.latency\n"
        "import motord_hal.fieldbus.open_line, motord_hal.rt_engine.rs485.line\n"
        "import motord_hal.modbus.guard\n"
        "print({'numpy', 'serial_asyncio_fast'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout == "set()\n"
