# SPDX-License-Identifier: Apache-2.0
"""A node of an installed ROS 2 with the interface of motord.bus.ros2.nodes.Node, so that the same
code serves on it. This is the only file that uses rclpy.

rclpy has its own threads; the code that serves runs in one event loop. Messages pass between them
as the bytes of ROS 2's encoding, so that no field is copied by hand. A thread of rclpy waits for
the answer to a call. Each service has its own thread: no emergency stop waits behind an arming.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections.abc import Iterator
from functools import partial
from importlib import import_module
from typing import Any

import rclpy
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions

from motord.base.rate_limited_log import RateLimitedLog
from motord.bus.commands.delay import Delays
from motord.bus.commands.gate import NotTaken
from motord.bus.commands.senders import Sender
from motord.bus.inbox import Inbox, ThreadBridge
from motord.bus.messages.cdr import decode, encode
from motord.bus.ros2.quality import Answer, Quality, Take
from motord.bus.ros2.senders import unnamed
from motord_hal.base.tasks import TaskGroup

ANSWER_WITHIN_S = 30.0
"""Deadline for the answer to a call; the daemon's own deadlines are shorter."""
RESULT_WITHIN_S = 3660.0
"""Deadline for the result of an action's goal, whose own time-out is an hour at most."""
NAMES_EVERY_S = 1.0
WRITERS_MAX = 32
"""Number of new writers on a topic whose names are read at once, in each NAMES_EVERY_S."""
_UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""Name that the ROS middleware interface (rmw) reports for a node whose name is not known yet."""
_OWN = "motord_msgs"
_PARTS = {"SendGoal": "SendGoalService", "GetResult": "GetResultService"}
"""Part of an action's type → name of its service type in Python."""

_log = logging.getLogger(__name__)


@contextlib.contextmanager
def opened(name: str, arguments: list[str]) -> Iterator[Node]:
    """Open a node of that name with ROS 2's arguments. Log lines of motord also go to its log. Its
    parameters are those that it was started with; its parameter services are those of the robot."""
    context = Context()
    rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node(
            name,
            context=context,
            start_parameter_services=False,
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
        )
        handler = _ToRos(node.get_logger())
        logging.getLogger().addHandler(handler)
        try:
            yield node
        finally:
            logging.getLogger().removeHandler(handler)
            node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


def parameters_of(node: Node) -> dict[str, Any]:
    """Return the parameters that the node was started with: name → value."""
    return {name: given.value for name, given in node.get_parameters_by_prefix("").items()}


class Ended(Exception):
    """ROS 2 has shut the node's context down."""


class RclpyNode:
    """Implements motord.bus.ros2.nodes.Node. Make topics and services before `run`."""

    def __init__(self, node: Node) -> None:
        self.remap: dict[str, str] = {}
        """Not used: ROS 2 applies its own remapping."""
        self._node = node
        self._thread_bridge = ThreadBridge()
        self._inboxes: list[Inbox[Any]] = []
        self._threads = 1
        self._missing: set[str] = set()

    def full(self, name: str) -> str:
        """Return a name with its namespace, after ROS 2's remapping."""
        return str(self._node.resolve_topic_name(name.rstrip("/")))

    def publisher(self, name: str, kind: str, quality: Quality | None = None) -> Publisher:
        """Implement `Node.publisher`."""
        made = None
        if (found := self._type(kind)) is not None:
            made = self._node.create_publisher(found, name, _profile(quality or Quality()))
        return Publisher(made, kind)

    def subscribe(self, name: str, kind: str, take: Take, quality: Quality | None = None) -> None:
        """Implement `Node.subscribe`."""
        quality = quality or Quality()
        ear = _Ear(self._node, name, kind, take)
        inbox: Inbox[tuple[bytes, Any]] = Inbox(quality.depth, ear.receive)
        self._inboxes.append(inbox)
        self._threads += 1

        def taken(raw: bytes, info: Any) -> None:
            inbox.put((raw, info))

        self._node.create_subscription(
            self._type(kind), name, taken, _profile(quality),
            callback_group=MutuallyExclusiveCallbackGroup(), raw=True,
        )  # fmt: skip

    def serve(
        self, name: str, kind: str, answer: Answer, depth: int = 10, together: int = 1
    ) -> None:
        """Implement `Node.serve`."""
        found = self._type(kind)
        if found is None:
            return
        within_s = ANSWER_WITHIN_S if together == 1 else RESULT_WITHIN_S
        self._threads += together
        self._node.create_service(
            found, name, partial(self._answer, name, kind, answer, within_s),
            qos_profile=_profile(Quality(depth=depth)), callback_group=Several(together),
        )  # fmt: skip

    def _answer(
        self, name: str, kind: str, answer: Answer, within_s: float, asked: Any, response: Any
    ) -> Any:
        """Answer a call, in a thread of rclpy. A failure is logged and, if the response has a
        message field, reported in it."""
        try:
            request = decode(f"{kind}_Request", serialize_message(asked))
            sent = self._thread_bridge.ask(lambda: answer(request), within_s)
            return deserialize_message(bytes(encode(f"{kind}_Response", sent)), type(response))
        except (NotTaken, RuntimeError, ValueError) as error:
            _log.warning("%s: not answered: %s", name, error)
            if hasattr(response, "message"):
                response.message = str(error)
            return response

    def _type(self, kind: str) -> Any:
        """Return the Python class of a message type. For a type of motord_msgs that was not built
        log a warning and return None. Raise ImportError for any other missing type."""
        package, group, short = kind.split("/")
        try:
            module = import_module(f"{package}.{group}")
        except ImportError:
            if package != _OWN:
                raise
            if _OWN not in self._missing:
                self._missing.add(_OWN)
                _log.warning(
                    "there is no %s in this ROS 2, so there are no actions: motord ros2-msgs WS/src"
                    " writes it, colcon builds it (docs/ros2.md)", _OWN,
                )  # fmt: skip
            return None
        if group != "action":
            return getattr(module, short)
        action, _, part = short.partition("_")
        return getattr(getattr(module, action).Impl, _PARTS.get(part, part))

    async def run(self) -> None:
        """Run until cancelled. Raise Ended when ROS 2 shuts down."""
        executor = MultiThreadedExecutor(num_threads=self._threads, context=self._node.context)
        executor.add_node(self._node)
        for inbox in self._inboxes:
            inbox.open()
        async with TaskGroup() as tasks:
            thread_bridge = tasks.create_task(self._thread_bridge.run())
            try:
                await asyncio.to_thread(_spin, executor)
                raise Ended("ROS 2 is shutting down")
            finally:
                rclpy.try_shutdown(
                    context=self._node.context
                )  # wakes the executor: its thread ends
                thread_bridge.cancel()


class Publisher:
    """Publishes a topic; `made` None (its type is missing): publishes nothing."""

    def __init__(self, made: Any, kind: str) -> None:
        self._made, self._kind = made, kind
        self._voice = RateLimitedLog(_log)

    def publish(self, message: Any) -> None:
        """Publish a message. Never wait: a message that is not taken is lost."""
        if self._made is None:
            return
        try:
            self._made.publish(bytes(encode(self._kind, message)))
        except (RuntimeError, ValueError) as error:  # rclpy raises RuntimeErrors
            self._voice.say(f"{self._kind}: not published: {error}")


class Several(CallbackGroup):  # type: ignore[misc]  # rclpy is not there when types are checked
    """Limits the number of callbacks that run at the same time."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self._most, self._active = most, 0
        self._lock = threading.Lock()

    def can_execute(self, entity: Any) -> bool:  # noqa: ARG002  CallbackGroup's own
        """Whether one more callback may begin."""
        with self._lock:
            return self._active < self._most

    def beginning_execution(self, entity: Any) -> bool:  # noqa: ARG002
        """Count one more callback that begins; return False if it may not."""
        with self._lock:
            if self._active == self._most:
                return False
            self._active += 1
            return True

    def ending_execution(self, entity: Any) -> None:  # noqa: ARG002
        """Count one callback that has ended."""
        with self._lock:
            self._active -= 1


class _ToRos(logging.Handler):
    """Passes log records to the log of ROS 2. rclpy allows one severity for each line of source, so
    each severity has its own line here."""

    def __init__(self, logger: Any) -> None:
        super().__init__(logging.INFO)
        self._logger = logger

    def emit(self, record: logging.LogRecord) -> None:
        """Implement `logging.Handler.emit`."""
        text = record.getMessage()
        if record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        else:
            self._logger.info(text)


class _Ear:
    """Receives the messages of a topic, in the event loop."""

    def __init__(self, node: Node, name: str, kind: str, take: Take) -> None:
        self._node, self._name, self._kind, self._take = node, name, kind, take
        self._delays, self._voice = Delays(), RateLimitedLog(_log)
        self._names: dict[bytes, str] = {}
        self._looked_for: set[bytes] = set()
        self._named_s = -NAMES_EVERY_S

    def receive(self, item: tuple[bytes, Any]) -> None:
        raw, info = item
        try:
            message = decode(self._kind, raw)
        except ValueError as error:
            self._voice.say(f"{self._name}: not understood: {error}")
            return
        # Only newer versions of rclpy report which writer sent the message.
        gid = bytes((info.get("publisher_gid") or {}).get("data", b""))[:16]
        waited_s = self._delays.waited_s(gid, info["source_timestamp"])
        self._take(message, waited_s, Sender(self._sender(gid), gid or None))

    def _sender(self, gid: bytes) -> str:
        """Return the name of the node of this writer; without `gid`, the names of all nodes that
        publish the topic. The names are read again at once for a new writer, else each second."""
        now_s = time.monotonic()
        if now_s - self._named_s >= NAMES_EVERY_S:
            self._named_s = now_s
            self._looked_for.clear()
            self._names = self._publishers()
        new = gid and gid not in self._names and gid not in self._looked_for
        if new and len(self._looked_for) < WRITERS_MAX:
            self._looked_for.add(gid)
            self._names = self._publishers()
        if gid:
            return self._names.get(gid) or unnamed(gid)
        found = sorted(set(self._names.values()))
        return found[0] if len(found) == 1 else f"one of {', '.join(found) or 'those that left'}"

    def _publishers(self) -> dict[bytes, str]:
        """Return writer → node for the nodes that publish the topic. A new writer may be missing,
        because ROS 2 does not know its node yet."""
        return {
            bytes(found.endpoint_gid)[:16]: f"{found.node_namespace.rstrip('/')}/{found.node_name}"
            for found in self._node.get_publishers_info_by_topic(self._name)
            if found.node_name != _UNKNOWN
        }


def _profile(quality: Quality) -> QoSProfile:
    reliability, durability = ReliabilityPolicy, DurabilityPolicy
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=quality.depth,
        reliability=reliability.RELIABLE if quality.reliable else reliability.BEST_EFFORT,
        durability=durability.TRANSIENT_LOCAL if quality.latched else durability.VOLATILE,
    )


def _spin(executor: MultiThreadedExecutor) -> None:
    """Run the executor, in its own thread, until the context ends."""
    try:
        executor.spin()
    except ExternalShutdownException:
        pass
    finally:
        executor.shutdown(timeout_sec=0)
