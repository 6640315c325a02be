# SPDX-License-Identifier: Apache-2.0
"""The simulator behind TCP: as a Modbus TCP gateway and as raw RTU frames, in real time."""

import contextlib
import select
import socket
import struct
import time

import pytest
from gateway_rig import served
from pymodbus.client import ModbusTcpClient
from pymodbus.framer import FramerType
from sim_bench import ARRIVAL_DEADLINE_S, rig_of

from motord.config.drives.load import find_profile
from motord_hal.modbus.codec import (
    Function,
    Request,
    build_exception,
    build_reply,
    build_request,
)
from motord_hal.sim.rig import PortSpec
from motord_hal.sim.rs485.gateway import REPLY_TIMEOUT_S, TARGET_SILENT

POSITIONS = Request(1, Function.READ_HOLDING, 0x20A7, 4)
FRAME = build_request(POSITIONS)
REPLY = build_reply(POSITIONS, (0, 0, 0, 0))
ABSENT = build_request(Request(9, Function.READ_HOLDING, 0x20A7, 4))
TARGET_VELOCITY = 0x2088


def dial(address):
    return socket.create_connection(address, ARRIVAL_DEADLINE_S)


def receive(connection, size):
    data = b""
    while len(data) < size:
        piece = connection.recv(size - len(data))
        assert piece, data.hex(" ")
        data += piece
    return data


def mbap(frame, transaction):
    """Return an RTU frame in the form that the gateway's clients send."""
    return struct.pack(">HHH", transaction, 0, len(frame) - 2) + frame[:-2]


def ask(connection, frame, transaction):
    """Send a request; return the transaction of the next ADU, and its unit and PDU."""
    connection.sendall(mbap(frame, transaction))
    return next_adu(connection)


def next_adu(connection):
    transaction, protocol, length = struct.unpack(">HHH", receive(connection, 6))
    assert protocol == 0
    return transaction, receive(connection, length)


# -------------------------------------------------------------------------------------- the gateway
def test_a_gateway_answers_with_the_transaction_of_the_request(tmp_path):
    with served(tmp_path, raw=False) as (_, address), dial(address) as connection:
        assert ask(connection, FRAME, 0x1234) == (0x1234, REPLY[:-2])
        assert ask(connection, FRAME, 7) == (7, REPLY[:-2])


def test_a_gateway_reports_that_an_absent_unit_did_not_respond(tmp_path):
    with served(tmp_path, raw=False) as (_, address), dial(address) as connection:
        refusal = build_exception(9, Function.READ_HOLDING, TARGET_SILENT)
        assert ask(connection, ABSENT, 1) == (1, refusal[:-2])
        assert ask(connection, FRAME, 2) == (2, REPLY[:-2])


def test_a_gateway_has_one_request_at_a_time_on_its_wire_with_the_silence_between(tmp_path):
    with served(tmp_path, raw=False) as (control, address):
        connections = [dial(address) for _ in range(3)]
        for place, connection in enumerate(connections):
            connection.sendall(mbap(FRAME, place) + mbap(FRAME, place + 10))
        for place, connection in enumerate(connections):
            assert next_adu(connection) == (place, REPLY[:-2])
            assert next_adu(connection) == (place + 10, REPLY[:-2])
            connection.close()
        bus = control.stats()["lines"]["bus"]
        assert (bus["frames"], bus["bad_crc"], bus["gap_violations"]) == (6, 0, 0)


def test_a_gateway_takes_as_long_as_its_wire(tmp_path):
    with served(tmp_path, raw=False) as (_, address), dial(address) as connection:
        began_s = time.monotonic()
        ask(connection, FRAME, 1)
        assert time.monotonic() - began_s > (len(FRAME) + len(REPLY)) * 10 / 115200


def test_a_broadcast_through_a_gateway_is_carried_out_and_not_answered(tmp_path):
    to_all = build_request(Request(0, Function.WRITE_SINGLE, TARGET_VELOCITY, values=(5,)))
    with served(tmp_path, raw=False) as (_, address), dial(address) as connection:
        connection.sendall(mbap(to_all, 1))
        back = Request(1, Function.READ_HOLDING, TARGET_VELOCITY, 1)
        assert ask(connection, build_request(back), 2) == (2, build_reply(back, (5,))[:-2])


def test_a_simulator_that_was_held_up_does_not_blame_the_drive(tmp_path):
    ports = {"bus": PortSpec(raw=False)}
    with rig_of(find_profile("zlac8015d"), tmp_path, ports=ports) as rig:
        host, _, port = rig.ports()["bus"].rpartition(":")
        with dial((host, int(port))) as connection:
            connection.sendall(mbap(FRAME, 1))
            now_s = 0.0
            while rig.lines["bus"].counters.frames == 0:
                now_s += 0.0001
                rig.work(now_s)
            for _ in range(3):
                rig.work(now_s + 10 * REPLY_TIMEOUT_S)
            assert next_adu(connection) == (1, REPLY[:-2])


@pytest.mark.parametrize("head", [b"\0\1\0\5\0\6", b"\0\1\0\0\0\1", b"\0\1\0\0\xff\xff"])
def test_data_that_is_not_modbus_tcp_ends_the_connection(tmp_path, head):
    with served(tmp_path, raw=False) as (_, address):
        with dial(address) as connection:
            connection.sendall(head + b"\1\3\0\0\0\1")
            with contextlib.suppress(ConnectionResetError):
                assert connection.recv(10) == b""
        with dial(address) as connection:
            assert ask(connection, FRAME, 1) == (1, REPLY[:-2])


def test_a_late_reply_comes_with_its_old_transaction(tmp_path):
    with served(tmp_path, raw=False) as (control, address), dial(address) as connection:
        control.inject("late:nth=1,for_s=1000")
        connection.sendall(mbap(FRAME, 1))
        until(lambda: control.stats()["lines"]["bus"]["replies"] == 1)
        control.clear_faults_script()
        connection.sendall(mbap(FRAME, 2))
        assert next_adu(connection) == (1, REPLY[:-2])
        assert next_adu(connection) == (2, REPLY[:-2])


@pytest.mark.parametrize("fault", ["drop", "corrupt", "tear:after_bytes=4", "wrong-unit"])
def test_a_gateway_does_not_forward_a_broken_reply(tmp_path, fault):
    with served(tmp_path, raw=False, faults=(fault,)) as (_, address), dial(address) as connection:
        refusal = build_exception(1, Function.READ_HOLDING, TARGET_SILENT)
        assert ask(connection, FRAME, 1) == (1, refusal[:-2])


# ------------------------------------------------------------------------------------------ raw RTU
def test_raw_frames_pass_as_they_are(tmp_path):
    with served(tmp_path, raw=True) as (_, address), dial(address) as connection:
        connection.sendall(FRAME)
        assert receive(connection, len(REPLY)) == REPLY


def test_an_absent_unit_is_silence_on_a_raw_connection(tmp_path):
    with served(tmp_path, raw=True) as (control, address), dial(address) as connection:
        connection.sendall(ABSENT)
        until(lambda: control.stats()["lines"]["bus"]["unanswered"] == 1)
        connection.sendall(FRAME)
        assert receive(connection, len(REPLY)) == REPLY


def test_the_newest_raw_connection_has_the_line(tmp_path):
    with served(tmp_path, raw=True) as (_, address), dial(address) as old, dial(address) as new:
        assert old.recv(1) == b""
        new.sendall(FRAME)
        assert receive(new, len(REPLY)) == REPLY


# -------------------------------------------------------------------------------- faults of sockets
def until(condition):
    deadline_s = time.monotonic() + ARRIVAL_DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline_s
        select.select([], [], [], 0.005)


def request_and_reply(raw):
    if raw:
        return FRAME, REPLY
    return mbap(FRAME, 5), mbap(REPLY, 5)


@pytest.mark.parametrize("raw", [False, True])
def test_a_reply_in_pieces_is_the_same_reply(tmp_path, raw):
    question, answer = request_and_reply(raw)
    faults = ("segments:ms=20",)
    with served(tmp_path, raw=raw, faults=faults) as (_, address), dial(address) as connection:
        connection.sendall(question)
        first = connection.recv(100)
        assert 0 < len(first) < len(answer)
        assert first + receive(connection, len(answer) - len(first)) == answer


@pytest.mark.parametrize("raw", [False, True])
def test_a_pulled_plug_closes_the_connections_and_a_new_plug_takes_new_ones(tmp_path, raw):
    question, answer = request_and_reply(raw)
    with served(tmp_path, raw=raw) as (control, address):
        with dial(address) as connection:
            connection.sendall(question)
            receive(connection, len(answer))
            control.pull()
            with contextlib.suppress(ConnectionResetError):
                assert connection.recv(1) == b""
        with pytest.raises(ConnectionRefusedError):
            dial(address)
        control.plug()
        with dial(address) as connection:
            connection.sendall(question)
            assert receive(connection, len(answer)) == answer


def test_a_gateway_whose_port_was_taken_meanwhile_comes_back_when_it_is_free(tmp_path):
    with served(tmp_path, raw=False) as (control, address):
        control.inject("unplug:for_s=1")
        plugged_s = control.truth().time_s + 1.0
        until(lambda: refuses(address))
        with socket.create_server(address):
            until(lambda: control.truth().time_s > plugged_s + 0.2)
        until(lambda: not refuses(address))
        with dial(address) as connection:
            assert ask(connection, FRAME, 1) == (1, REPLY[:-2])


def refuses(address):
    try:
        dial(address).close()
    except ConnectionRefusedError:
        return True
    return False


@pytest.mark.parametrize("raw", [False, True])
def test_a_stalled_connection_delivers_everything_afterwards(tmp_path, raw):
    question, answer = request_and_reply(raw)
    with served(tmp_path, raw=raw) as (control, address), dial(address) as connection:
        connection.sendall(question)
        receive(connection, len(answer))
        control.inject("tcp-stall:for_s=0.4")
        until(lambda: control.stats()["faults"][0]["fired"])
        connection.sendall(question)
        assert not select.select([connection], [], [], 0.1)[0]
        assert receive(connection, len(answer)) == answer


@pytest.mark.parametrize("raw", [False, True])
def test_a_half_open_connection_is_silent_and_a_new_one_is_served(tmp_path, raw):
    question, answer = request_and_reply(raw)
    with served(tmp_path, raw=raw) as (control, address), dial(address) as connection:
        connection.sendall(question)
        receive(connection, len(answer))
        control.inject("half-open")
        until(lambda: control.stats()["faults"][0]["fired"])
        connection.sendall(question)
        with dial(address) as fresh:
            fresh.sendall(question)
            assert receive(fresh, len(answer)) == answer
        assert not select.select([connection], [], [], 0.0)[0]


# ---------------------------------------------------------------------------------- foreign masters
@pytest.mark.parametrize(("raw", "framer"), [(False, FramerType.SOCKET), (True, FramerType.RTU)])
def test_pymodbus_reads_and_writes_through_tcp(tmp_path, raw, framer):
    with served(tmp_path, raw=raw) as (_, (host, port)):
        client = ModbusTcpClient(host, port=port, framer=framer, timeout=ARRIVAL_DEADLINE_S)
        try:
            assert client.connect()
            assert not client.write_register(TARGET_VELOCITY, 12, device_id=1).isError()
            read = client.read_holding_registers(TARGET_VELOCITY, count=2, device_id=1)
            assert read.registers == [12, 0]
            assert client.read_holding_registers(0x7777, count=1, device_id=1).exception_code == 2
        finally:
            client.close()
