# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 node on Zenoh, tested by another session through a router in another process. The other
session encodes and decodes with rosbags, and takes keys and tokens from rmw_zenoh's design
document."""

import asyncio
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import zenoh
import zenoh.ext
from tests.peers.ros2_zenoh.zenoh_rig import (
    GID,
    REQUEST,
    STORE,
    Tokens,
    ask,
    attached,
    peer,
    running,
    until,
)
from tests.peers.ros2_zenoh.zenoh_router import endpoint, free_port, router

from motord.bus.ros2.quality import Quality
from motord.bus.ros2.zenoh.names import Attachment, gid
from motord.bus.ros2.zenoh.node import Router, ZenohNode

TWIST = "geometry_msgs/msg/Twist"
STRING = "std_msgs/msg/String"
TWIST_KEY = (
    "3/r2/cmd_vel/geometry_msgs::msg::dds_::Twist_/"
    "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
)
STRING_KEY = (
    "3/r2/text/std_msgs::msg::dds_::String_/"
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
)
STOP_KEY = (
    "3/r2/stop/std_srvs::srv::dds_::Trigger_/"
    "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
)
LONG_BYTES = 20_000


def sockets_hold_bytes():
    """Return the largest number of bytes that a TCP connection buffers in its two sockets."""
    names = ("tcp_wmem", "tcp_rmem")
    return sum(int(Path("/proc/sys/net/ipv4", name).read_text().split()[2]) for name in names)


SENT_IN_VAIN = 2 * sockets_hold_bytes() // LONG_BYTES


class Robot:
    """A node that publishes one topic, subscribes to one, and counts the calls of a service."""

    def __init__(self, port, quality=None, distribution="jazzy"):
        where = Router(endpoint=endpoint(port))
        self.node = ZenohNode("base", "/r2", 3, where, distribution)
        self.text = self.node.publisher("text", STRING, quality)
        self.received = []
        self.stops = 0
        self.node.subscribe("cmd_vel", TWIST, lambda message, *_: self.received.append(message))
        self.node.serve("stop", "std_srvs/srv/Trigger", self.stop)

    async def stop(self, _):
        self.stops += 1
        return SimpleNamespace(success=True, message=f"stopped {self.stops} times")


def twist(linear_m_s):
    zero = STORE.types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    ahead = STORE.types["geometry_msgs/msg/Vector3"](x=linear_m_s, y=0.0, z=0.0)
    message = STORE.types[TWIST](linear=ahead, angular=zero)
    return bytes(STORE.serialize_cdr(message, TWIST))


async def test_a_humble_peer_subscribes_and_calls_by_keys_without_hashes():
    port, unhashed = free_port(), "TypeHashNotSupported"
    async with router(port):
        robot = Robot(port, distribution="humble")
        with peer(port) as session:
            tokens, received = Tokens(session), []
            key = f"{STRING_KEY.rpartition('/')[0]}/{unhashed}"
            kept = session.declare_subscriber(key, received.append)
            async with running(robot.node):
                await until(lambda: len(tokens.alive) == 4)
                endpoints = [token for what in ("MP", "MS", "SS") for token in tokens.of(what)]
                assert all(f"/{unhashed}/" in token for token in endpoints)
                robot.text.publish(SimpleNamespace(data="here"))
                await until(lambda: received)
                stop = f"{STOP_KEY.rpartition('/')[0]}/{unhashed}"
                replies = await asyncio.to_thread(
                    ask, session, stop, payload=REQUEST, attachment=attached()
                )
                assert [reply.ok is not None for reply in replies] == [True]
            kept.undeclare()


async def test_other_nodes_see_the_node_its_topics_and_its_service():
    port = free_port()
    async with router(port):
        robot = Robot(port)
        with peer(port) as session:
            tokens = Tokens(session)
            async with running(robot.node):
                await until(lambda: len(tokens.alive) == 4)
                (node,) = tokens.of("NN")
                assert node.endswith("/0/0/NN/%/%r2/base")
                (publisher,) = tokens.of("MP")
                assert publisher.endswith(f"/%r2%text/{STRING_KEY.split('/', 3)[3]}/::,10:,:,:,,")
                (server,) = tokens.of("SS")
                assert f"/%r2%stop/{STOP_KEY.split('/', 3)[3]}/" in server
                assert len({token.split("/")[2] for token in tokens.alive}) == 1
                assert len({token.split("/")[4] for token in tokens.alive}) == 4
            await until(lambda: not tokens.alive)


async def test_another_decoder_reads_a_message_and_its_publishers_gid():
    port = free_port()
    async with router(port):
        robot = Robot(port)
        with peer(port) as session:
            samples = []
            kept = session.declare_subscriber(STRING_KEY, samples.append)
            tokens = Tokens(session)
            async with running(robot.node):
                await until(lambda: tokens.of("MP"))

                def sent():
                    robot.text.publish(SimpleNamespace(data="Grüße"))
                    return samples

                await until(sent)
                sample, (token,) = samples[0], tokens.of("MP")
                message = STORE.deserialize_cdr(sample.payload.to_bytes(), STRING)
                assert message.data == "Grüße"
                assert Attachment.decode(sample.attachment.to_bytes()).gid == gid(token)
            kept.undeclare()


async def test_the_age_of_a_message_is_measured_by_its_senders_clock():
    port, waited_s = free_port(), []
    async with router(port):
        node = ZenohNode("base", "/r2", 3, Router(endpoint=endpoint(port)))
        node.subscribe("cmd_vel", TWIST, lambda _, age_s, sender: waited_s.append(age_s))
        with peer(port) as session:
            tokens = Tokens(session)
            async with running(node):
                await until(lambda: tokens.of("MS"))
                for number, late_s in enumerate((0, 0, 30), 1):
                    sent_ns = time.time_ns() - (3600 + late_s) * 10**9
                    attachment = Attachment(number, sent_ns, GID).encode()
                    session.put(TWIST_KEY, twist(0.1), attachment=attachment)
                    await until(lambda number=number: len(waited_s) >= number)
                session.put(TWIST_KEY, twist(0.1))
                await until(lambda: len(waited_s) == 4)
    assert waited_s[0] == waited_s[3] == 0.0
    assert waited_s[2] > 20.0


async def test_a_message_arrives_with_the_name_of_its_node():
    port, senders = free_port(), []
    async with router(port):
        ear = ZenohNode("base", "/r2", 3, Router(endpoint=endpoint(port)))
        mouth = ZenohNode("teleop", "/fleet", 3, Router(endpoint=endpoint(port)))
        ear.subscribe("/cmd_vel", TWIST, lambda _, age_s, sender: senders.append(sender))
        sender = mouth.publisher("/cmd_vel", TWIST)
        three = SimpleNamespace(x=0.0, y=0.0, z=0.0)
        async with running(ear), running(mouth):

            def named():
                sender.publish(SimpleNamespace(linear=three, angular=three))
                return "/fleet/teleop" in [one.name for one in senders]

            await until(named)


async def test_a_twist_of_another_node_arrives_and_a_malformed_one_does_not():
    port = free_port()
    async with router(port):
        robot = Robot(port)
        with peer(port) as session:
            tokens = Tokens(session)
            async with running(robot.node):
                await until(lambda: tokens.of("MS"))
                session.put(TWIST_KEY, b"\x00\x01\x00\x00too short", attachment=attached())
                session.delete(TWIST_KEY)
                session.put(TWIST_KEY, twist(0.25), attachment=attached())
                await until(lambda: robot.received)
                assert [message.linear.x for message in robot.received] == [0.25]


async def test_a_service_answers_with_the_number_and_gid_of_the_request():
    port = free_port()
    async with router(port):
        robot = Robot(port)
        with peer(port) as session:
            tokens = Tokens(session)
            async with running(robot.node):
                await until(lambda: tokens.of("SS"))
                (reply,) = await asyncio.to_thread(
                    ask, session, STOP_KEY, payload=REQUEST, attachment=attached(77)
                )
                answer = STORE.deserialize_cdr(reply.ok.payload.to_bytes(), "peer/msg/Answer")
                assert (answer.success, answer.message) == (True, "stopped 1 times")
                text = Attachment.decode(reply.ok.attachment.to_bytes())
                assert (text.sequence, text.gid) == (77, GID)


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("3/**", {"payload": REQUEST, "attachment": attached()}),
        ("**", {}),
        (STOP_KEY, {}),
        (STOP_KEY, {"payload": REQUEST}),
        (STOP_KEY, {"payload": REQUEST, "attachment": b"short"}),
        (STOP_KEY, {"payload": b"\x00\x01\x00\x00", "attachment": attached()}),
    ],
)
async def test_a_malformed_request_calls_nothing_and_is_refused(key, text):
    port = free_port()
    async with router(port):
        robot = Robot(port)
        with peer(port) as session:
            tokens = Tokens(session)
            async with running(robot.node):
                await until(lambda: tokens.of("SS"))
                everybody = zenoh.QueryTarget.ALL
                replies = await asyncio.to_thread(ask, session, key, everybody, **text)
                assert len(replies) == 1
                assert replies[0].err is not None
                assert robot.stops == 0


async def test_a_late_subscriber_gets_the_latched_message():
    port = free_port()
    async with router(port):
        robot = Robot(port, Quality(depth=1, latched=True))
        robot.text.publish(SimpleNamespace(data="before there was a session"))
        with peer(port) as session:
            tokens = Tokens(session)
            async with running(robot.node):
                await until(lambda: tokens.of("MP"))
                received = []
                kept = zenoh.ext.declare_advanced_subscriber(
                    session,
                    STRING_KEY,
                    lambda sample: received.append(sample.payload.to_bytes()),
                    history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
                )
                await until(lambda: received)
                assert (
                    STORE.deserialize_cdr(received[0], STRING).data == "before there was a session"
                )
                kept.undeclare()


async def test_a_router_that_starts_late_or_restarts_finds_the_node():
    port = free_port()
    robot = Robot(port)
    async with running(robot.node):
        for _ in range(2):
            async with router(port):
                with peer(port) as session:
                    tokens = Tokens(session)
                    await until(lambda: len(tokens.alive) == 4)  # noqa: B023
                    before = robot.stops
                    (reply,) = await asyncio.to_thread(
                        ask, session, STOP_KEY, payload=REQUEST, attachment=attached()
                    )
                    assert reply.ok is not None
                    assert robot.stops == before + 1


async def test_a_router_that_hangs_loses_samples_but_not_the_connection():
    port = free_port()
    async with router(port) as process:
        robot = Robot(port)
        with peer(port) as session:
            received = []
            kept = session.declare_subscriber(STRING_KEY, received.append)
            tokens = Tokens(session)
            async with running(robot.node):
                await until(lambda: tokens.of("MP"))

                def sent():
                    robot.text.publish(SimpleNamespace(data="x"))
                    return received

                await until(sent)
                process.send_signal(signal.SIGSTOP)
                for _ in range(SENT_IN_VAIN):  # more bytes than the sockets hold
                    robot.text.publish(SimpleNamespace(data="x" * LONG_BYTES))
                process.send_signal(signal.SIGCONT)

                def last():
                    robot.text.publish(SimpleNamespace(data="last"))
                    return any(b"last" in sample.payload.to_bytes() for sample in list(received))

                await until(last)
                lengths = [len(sample.payload.to_bytes()) for sample in list(received)]
                assert sum(length > LONG_BYTES for length in lengths) < SENT_IN_VAIN
                assert tokens.gone == []
            kept.undeclare()
