# SPDX-License-Identifier: Apache-2.0
"""Other people's Modbus masters talk to the simulator: mbpoll (libmodbus) and pymodbus, on a pty
and through TCP."""

import shutil
import subprocess
from pathlib import Path

import pytest
from pymodbus.client import ModbusSerialClient

from motord.tools.simulator import start_simulator

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"
TARGET_VELOCITY = 0x2088
DEADLINE_S = 20.0
MBPOLL = shutil.which("mbpoll")
needs_mbpoll = pytest.mark.skipif(MBPOLL is None, reason="mbpoll is not installed here")


def mbpoll(*arguments, values=()):
    """Poll holding registers once, addresses from 0; return exit status, words, and output."""
    command = [MBPOLL, "-a", "1", "-0", "-1", "-q", "-t", "4", *arguments, *map(str, values)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    words = [
        int(line.split(":")[1].split()[0]) for line in done.stdout.splitlines() if line[:1] == "["
    ]
    return done.returncode, words, done.stdout + done.stderr


def on_pty(sim):
    return ["-m", "rtu", "-b", "115200", "-P", "none", sim.ports["rs485"]]


def on_tcp(sim):
    host, _, port = sim.ports["rs485"].rpartition(":")
    return ["-m", "tcp", "-p", port, host]


@needs_mbpoll
@pytest.mark.parametrize(("options", "where"), [((), on_pty), (("--tcp", "0"), on_tcp)])
def test_mbpoll_writes_reads_and_is_refused(tmp_path, options, where):
    with start_simulator(DEMO, link_dir=tmp_path, options=options) as sim:
        target = ["-r", str(TARGET_VELOCITY), *where(sim)]
        status, _, output = mbpoll(*target, values=(12, 34))
        assert status == 0, output
        status, words, output = mbpoll("-c", "2", *target)
        assert (status, words) == (0, [12, 34]), output
        status, _, output = mbpoll("-c", "1", "-r", str(0x7777), *where(sim))
        assert status != 0
        assert "Illegal data address" in output


@needs_mbpoll
def test_mbpoll_at_another_baud_rate_receives_nothing(tmp_path):
    with start_simulator(DEMO, link_dir=tmp_path) as sim:
        settings = ["-m", "rtu", "-b", "9600", "-P", "none", "-o", "0.3", sim.ports["rs485"]]
        status, words, output = mbpoll("-c", "1", "-r", str(TARGET_VELOCITY), *settings)
        assert status != 0
        assert words == []
        assert "timed out" in output
        assert sim.control.stats()["lines"]["rs485"]["bad_crc"] >= 1


def test_pymodbus_reads_and_writes_on_a_pty(tmp_path):
    with start_simulator(DEMO, link_dir=tmp_path) as sim:
        client = ModbusSerialClient(sim.ports["rs485"], baudrate=115200, timeout=DEADLINE_S)
        try:
            assert client.connect()
            assert not client.write_registers(TARGET_VELOCITY, [5, 6], device_id=1).isError()
            read = client.read_holding_registers(TARGET_VELOCITY, count=2, device_id=1)
            assert read.registers == [5, 6]
        finally:
            client.close()
