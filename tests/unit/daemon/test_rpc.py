# SPDX-License-Identifier: Apache-2.0
"""The local socket, over real sockets: its answers, and what it prevents peers from doing."""

import asyncio
import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motord.client import Client, ClientError
from motord.local_socket import server as rpc
from motord.local_socket.params import Params, number
from motord.local_socket.server import Method, Refused, listening, serve

DEADLINE_S = 20.0


@dataclass(frozen=True, kw_only=True)
class Sum(Params):
    a: float = number()
    b: float = number(-10, 10, default=0.0)


class Host:
    """A server with methods of every kind, and a record of their calls."""

    def __init__(self):
        self.gate = asyncio.Event()
        self.closed = []
        self.done = []
        self.callers = []
        self.methods = {
            "add": Method(lambda caller, sum_: sum_.a + sum_.b, Sum),
            "who": Method(self.who, commands=False),
            "wait": Method(self.wait),
            "no": Method(self.refuse),
            "big": Method(lambda caller, _: "x" * 100_000),
            "move": Method(lambda caller, _: "moved"),
            "huge": Method(lambda caller, _: "x" * (1 << 62), commands=False),
            "huge act": Method(lambda caller, _: "x" * (1 << 62)),
            "nan": Method(lambda caller, _: float("nan")),
            "estop": Method(lambda caller, _: {"state": "estop"}),
        }

    def who(self, caller, _):
        self.callers.append(caller)
        return {"connection": caller.connection, "pid": caller.pid, "uid": caller.uid}

    async def wait(self, caller, _):
        await self.gate.wait()
        self.done.append(caller.connection)
        return "waited"

    def refuse(self, caller, _):
        raise Refused("not today")


@contextlib.asynccontextmanager
async def hosted(path):
    host = Host()
    with listening(path) as listener:
        async with asyncio.TaskGroup() as tasks:
            server = tasks.create_task(serve(listener, host.methods, host.closed.append))
            async with asyncio.timeout(DEADLINE_S):
                yield host
            server.cancel()


class Peer:
    """A plain client, which writes and reads lines of the socket."""

    def __init__(self, reader, writer):
        self.reader, self.writer = reader, writer

    @classmethod
    async def at(cls, path):
        return cls(*await asyncio.open_unix_connection(str(path), limit=1 << 22))

    def send(self, raw):
        self.writer.write(raw if isinstance(raw, bytes) else json.dumps(raw).encode() + b"\n")

    def ask(self, method, number=1, **params):
        self.send({"jsonrpc": "2.0", "id": number, "method": method, "params": params})

    async def receive(self):
        return json.loads(await self.reader.readline())

    async def call(self, method, **params):
        self.ask(method, **params)
        return await self.receive()

    async def error(self, raw):
        self.send(raw)
        return (await self.receive())["error"]["code"]

    def close(self):
        self.writer.close()


async def until(condition):
    async with asyncio.timeout(DEADLINE_S):
        while not condition():
            await asyncio.sleep(0.001)


async def test_a_call_is_answered_with_its_id(path):
    async with hosted(path):
        peer = await Peer.at(path)
        for number in (7, "seven", 0, -1):
            peer.ask("add", number, a=1.5, b=2)
            assert await peer.receive() == {"jsonrpc": "2.0", "id": number, "result": 3.5}
        peer.close()


async def test_a_refusal_carries_its_reason(path):
    async with hosted(path):
        peer = await Peer.at(path)
        answer = await peer.call("no")
        assert answer["error"] == {"code": -32000, "message": "not today"}
        peer.close()


@pytest.mark.parametrize(
    ("raw", "code"),
    [
        (b"\n", -32700),
        (b"{\n", -32700),
        (b"\xff\xfe\n", -32700),
        (b"[" * 10000 + b"\n", -32700),
        (b'{"jsonrpc":"2.0","id":1,"method":"add","params":{"a":NaN}}\n', -32700),
        (b'{"jsonrpc":"2.0","id":1,"method":"add","params":{"a":-Infinity}}\n', -32700),
        (b'{"id":1,"method":"add"}\n', -32600),
        (b"[]\n", -32600),
        (b'{"jsonrpc":"2.0","id":1e999,"method":"add"}\n', -32600),
        (b'{"jsonrpc":"2.0","id":[],"method":"add"}\n', -32600),
        (b'{"jsonrpc":"2.0","id":1,"method":5}\n', -32600),
        (b'{"jsonrpc":"2.0","id":1}\n', -32600),
        (b'{"jsonrpc":"2.0","id":1,"method":"fly"}\n', -32601),
        (b'{"jsonrpc":"2.0","id":1,"method":"\\ud800"}\n', -32601),
        (b'{"jsonrpc":"2.0","id":1,"method":"add","params":[1,2]}\n', -32602),
        (b'{"jsonrpc":"2.0","id":1,"method":"add","params":{}}\n', -32602),
        (b'{"jsonrpc":"2.0","id":1,"method":"add","params":{"a":1,"c":1}}\n', -32602),
        (b'{"jsonrpc":"2.0","id":1,"method":"add","params":{"a":"1"}}\n', -32602),
        (b'{"jsonrpc":"2.0","id":1,"method":"add","params":{"a":true}}\n', -32602),
        (b'{"jsonrpc":"2.0","id":1,"method":"add","params":{"a":1e999}}\n', -32602),
        (b'{"jsonrpc":"2.0","id":1,"method":"add","params":{"a":1,"b":11}}\n', -32602),
    ],
)
async def test_an_invalid_request_is_an_error_and_the_connection_stays(path, raw, code):
    async with hosted(path):
        peer = await Peer.at(path)
        assert await peer.error(raw) == code
        assert (await peer.call("add", a=1))["result"] == 1
        peer.close()


async def test_the_message_names_the_parameter_and_its_range(path):
    async with hosted(path):
        peer = await Peer.at(path)
        message = (await peer.call("add", a=1, b=11))["error"]["message"]
        assert "b: " in message
        assert "10" in message
        peer.close()


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(line=st.binary(max_size=300).filter(lambda line: b"\n" not in line))
def test_no_line_brings_the_server_down(tmp_path, line):
    async def talk():
        async with hosted(tmp_path / "robot.sock"):
            peer = await Peer.at(tmp_path / "robot.sock")
            assert await peer.error(line + b"\n") < 0
            assert (await peer.call("add", a=2))["result"] == 2
            peer.close()

    asyncio.run(talk())


async def test_a_notification_is_done_and_not_answered(path):
    async with hosted(path) as host:
        peer = await Peer.at(path)
        for name in ("who", "no", "fly"):
            peer.send({"jsonrpc": "2.0", "method": name})
        assert (await peer.call("add", a=1))["result"] == 1
        assert len(host.callers) == 1
        peer.close()


async def test_a_call_that_waits_does_not_hold_up_the_next(path):
    async with hosted(path) as host:
        peer = await Peer.at(path)
        peer.ask("wait", 1)
        peer.ask("add", 2, a=1)
        assert (await peer.receive())["id"] == 2
        host.gate.set()
        assert await peer.receive() == {"jsonrpc": "2.0", "id": 1, "result": "waited"}
        peer.close()


async def test_open_calls_are_bounded(path):
    async with hosted(path) as host:
        peer = await Peer.at(path)
        for number in range(rpc.CALLS_MAX + 1):
            peer.ask("wait", number)
        answer = await peer.receive()
        assert (answer["id"], answer["error"]["code"]) == (rpc.CALLS_MAX, -32000)
        host.gate.set()
        received = [(await peer.receive())["id"] for _ in range(rpc.CALLS_MAX)]
        assert sorted(received) == list(range(rpc.CALLS_MAX))
        peer.close()


async def test_calls_of_connections_that_have_ended_are_bounded_and_an_urgent_one_gets_through(
    path,
):
    async with hosted(path) as host:
        host.methods["halt"] = Method(host.wait, urgent=True)
        connections = rpc.CALLS_IN_ALL_MAX // rpc.CALLS_MAX
        for _ in range(connections):
            peer = await Peer.at(path)
            for number in range(rpc.CALLS_MAX):
                peer.ask("wait", number)
            await peer.call("add", a=1)
            peer.close()
        late = await Peer.at(path)
        assert "calls of all programs are running" in (await late.call("wait"))["error"]["message"]
        assert (await late.call("add", a=1))["result"] == 1
        late.ask("halt")
        host.gate.set()
        assert (await late.receive())["result"] == "waited"
        await until(lambda: len(host.done) == rpc.CALLS_IN_ALL_MAX + 1)
        assert (await late.call("wait"))["result"] == "waited"
        late.close()


async def test_the_end_of_a_connection_is_reported_at_once_while_its_call_goes_on(path):
    async with hosted(path) as host:
        peer = await Peer.at(path)
        number = (await peer.call("who"))["result"]["connection"]
        peer.ask("wait")
        peer.close()
        await until(lambda: number in host.closed)
        assert host.done == []
        host.gate.set()
        await until(lambda: host.done == [number])


async def test_a_line_without_end_costs_the_connection_and_no_memory(path):
    async with hosted(path) as host:
        peer = await Peer.at(path)
        peer.send(b"x" * (rpc.LINE_BYTES_MAX + 1))
        assert (await peer.receive())["error"]["code"] == -32600
        await until(lambda: len(host.closed) > 0)
        peer.close()


async def test_a_client_that_does_not_read_is_dropped(path):
    async with hosted(path) as host:
        other = await Peer.at(path)
        with socket.socket(socket.AF_UNIX) as unread:
            unread.settimeout(0)
            unread.connect(str(path))
            request = b'{"jsonrpc":"2.0","id":1,"method":"big"}\n'
            loop = asyncio.get_running_loop()
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                for _ in range(200):
                    await loop.sock_sendall(unread, request)
                    assert (await other.call("add", a=1))["result"] == 1
            await until(lambda: len(host.closed) > 0)
        other.close()


async def test_the_longest_silent_connection_makes_room(path):
    async with hosted(path) as host:
        first = await Peer.at(path)
        second = await Peer.at(path)
        for peer in (first, second, first):
            await peer.call("add", a=1)
        crowd = [await Peer.at(path) for _ in range(rpc.CONNECTIONS_MAX - 2)]
        for peer in crowd:
            await peer.call("add", a=1)
        late = await Peer.at(path)
        assert (await late.call("add", a=1))["result"] == 1
        assert await second.reader.read() == b""
        assert (await first.call("add", a=1))["result"] == 1
        assert len(set(host.closed)) == 1
        for peer in (first, second, late, *crowd):
            peer.close()


async def test_a_connection_that_is_to_stay_never_makes_room(path):
    staying = set()
    with listening(path) as listener:
        host = Host()
        async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
            server = tasks.create_task(
                serve(listener, host.methods, host.closed.append, staying.__contains__)
            )
            source = await Peer.at(path)
            staying.add((await source.call("who"))["result"]["connection"])
            crowd = [await Peer.at(path) for _ in range(2 * rpc.CONNECTIONS_MAX)]
            for peer in crowd:
                peer.ask("add", a=1)
            await until(lambda: len(host.closed) >= rpc.CONNECTIONS_MAX)
            assert (await source.call("add", a=1))["result"] == 1
            for peer in (source, *crowd):
                peer.close()
            server.cancel()


async def test_connections_are_bounded_though_calls_of_dropped_ones_go_on(path):
    async with hosted(path) as host:
        waiting = [await Peer.at(path) for _ in range(3)]
        for peer in waiting:
            peer.ask("wait")
        assert (await waiting[-1].call("add", a=1))["result"] == 1
        crowd = [await Peer.at(path) for _ in range(3 * rpc.CONNECTIONS_MAX)]
        assert (await crowd[-1].call("add", a=1))["result"] == 1
        both = (*waiting, *crowd)
        await until(lambda: sum(not one.reader.at_eof() for one in both) <= rpc.CONNECTIONS_MAX)
        assert all(one.reader.at_eof() for one in waiting)
        host.gate.set()
        await until(lambda: len(host.done) == len(waiting))
        for peer in both:
            peer.close()


async def test_an_emergency_stop_gets_through_though_its_connection_was_dropped(path):
    async with hosted(path):
        panel = await asyncio.to_thread(Client, path)
        crowd = [await Peer.at(path) for _ in range(rpc.CONNECTIONS_MAX)]
        for peer in crowd:
            await peer.call("add", a=1)
        await until(lambda: not panel.connected)
        with pytest.raises(ClientError):
            await asyncio.to_thread(panel.call, "add", a=1)
        assert await asyncio.to_thread(panel.estop) == "estop"
        panel.close()
        for peer in crowd:
            peer.close()


async def test_an_answer_that_is_no_json_is_an_error_and_does_not_end_the_server(path, caplog):
    async with hosted(path):
        peer = await Peer.at(path)
        answer = await peer.call("nan")
        assert answer["error"]["code"] == rpc.INTERNAL_ERROR
        assert (await peer.call("add", a=1))["result"] == 1
        peer.close()
    assert "an answer to process" in caplog.text


async def test_without_a_free_file_descriptor_it_tries_again(path, caplog, no_descriptor_left):
    async with hosted(path):
        with socket.socket(socket.AF_UNIX) as late:
            late.settimeout(0)
            with no_descriptor_left():
                late.connect(str(path))
                await until(lambda: "no new connection" in caplog.text)
            loop = asyncio.get_running_loop()
            await loop.sock_sendall(late, b'{"jsonrpc":"2.0","id":1,"method":"who"}\n')
            assert json.loads(await loop.sock_recv(late, 1000))["id"] == 1


async def test_without_a_descriptor_the_longest_silent_connection_makes_room(
    path, no_descriptor_left
):
    async with hosted(path):
        silent, busy = await Peer.at(path), await Peer.at(path)
        for peer in (silent, busy):
            await peer.call("add", a=1)
        with socket.socket(socket.AF_UNIX) as late:
            late.settimeout(0)
            with no_descriptor_left():
                late.connect(str(path))
                loop = asyncio.get_running_loop()
                await loop.sock_sendall(late, b'{"jsonrpc":"2.0","id":1,"method":"who"}\n')
                assert json.loads(await loop.sock_recv(late, 1000))["id"] == 1
        assert await silent.reader.read() == b""
        assert (await busy.call("add", a=1))["result"] == 1
        for peer in (silent, busy):
            peer.close()


async def test_the_caller_is_the_process_that_the_kernel_reports(path):
    async with hosted(path) as host:
        peer = await Peer.at(path)
        await peer.call("who")
        caller = host.callers[0]
        assert (caller.pid, caller.uid, caller.may_command) == (os.getpid(), os.geteuid(), True)
        peer.close()


@pytest.fixture
def public_folder():
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        os.chmod(folder, 0o755)
        yield Path(folder)


STRANGER = """
import json, os, socket, sys
os.setgroups(json.loads(sys.argv[2])); os.setgid(65534); os.setuid(65534)
with socket.socket(socket.AF_UNIX) as peer:
    peer.connect(sys.argv[1])
    for method in ("who", "move"):
        request = {"jsonrpc": "2.0", "id": 1, "method": method}
        peer.sendall(json.dumps(request).encode() + b"\\n")
        print(peer.makefile().readline(), end="")
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="becoming another user takes root")
@pytest.mark.parametrize(("groups", "may_command"), [([], False), ([4321], True)])
async def test_other_users_may_read_and_members_of_the_sockets_group_may_command(
    public_folder, groups, may_command
):
    path = public_folder / "robot.sock"
    async with hosted(path):
        os.chown(path, 0, 4321)
        path.chmod(0o666)
        stranger = await asyncio.create_subprocess_exec(
            sys.executable, "-I", "-c", STRANGER, str(path), json.dumps(groups),
            stdout=subprocess.PIPE,
        )  # fmt: skip
        output, _ = await stranger.communicate()
        who, move = map(json.loads, output.splitlines())
        assert who["result"]["uid"] == 65534
        if may_command:
            assert move["result"] == "moved"
        else:
            assert move["error"]["code"] == -32001


async def test_a_request_for_which_no_memory_is_left_ends_its_connection_alone(path):
    async with hosted(path):
        peer, other = await Peer.at(path), await Peer.at(path)
        peer.ask("huge")
        assert await peer.reader.read() == b""
        assert (await other.call("add", a=1.0))["result"] == 1.0
        peer.close()
        other.close()


async def test_an_act_that_runs_out_of_memory_ends_the_server(path):
    """It may be half done, so the daemon has to end, which takes the power off."""
    peers = []
    with pytest.RaisesGroup(MemoryError, flatten_subgroups=True):
        async with hosted(path) as host:
            peers.append(await Peer.at(path))
            peers[0].ask("huge act")
            await until(lambda: host.closed)
            await asyncio.sleep(DEADLINE_S)
    peers[0].close()
    await peers[0].writer.wait_closed()
