# SPDX-License-Identifier: Apache-2.0
"""A node and its endpoints."""

import inspect
import os
import struct
import sys
import threading
import time
from concurrent.futures import Future
from types import SimpleNamespace

from standin_wire import graph

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import default_context
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, compatible, profile
from rclpy.serialization import deserialize_message, serialize_message

_NAMES = ("__node", "__name", "__ns")
_GID = struct.Struct(">QQ")


def _gid(key):
    return _GID.pack(*key)


class _Logger:
    """A logger. Like that of rclpy, it refuses two severities from one line of the source."""

    def __init__(self, name):
        self._name, self._places = name, {}

    def _log(self, severity, text):
        caller = sys._getframe(2)
        place = (caller.f_code.co_filename, caller.f_lineno)
        if self._places.setdefault(place, severity) != severity:
            raise ValueError("Logger severity cannot be changed between calls.")
        print(f"[{severity}] [{self._name}]: {text}", file=sys.stderr, flush=True)

    def info(self, text):
        self._log("INFO", text)

    def warning(self, text):
        self._log("WARN", text)

    def error(self, text):
        self._log("ERROR", text)


class Node:
    def __init__(
        self,
        node_name,
        *,
        context=None,
        namespace=None,
        start_parameter_services=True,
        allow_undeclared_parameters=False,
        automatically_declare_parameters_from_overrides=False,
    ):
        self.context = context or default_context
        assert self.context.ok(), "rclpy.init comes first"
        rules = self.context.remaps
        self._name = rules.get("__node", rules.get("__name", node_name))
        self._space = (rules.get("__ns", namespace or "/")).rstrip("/")
        self._remaps = {self._expanded(old): self._expanded(new) for old, new in rules.items()
                        if old not in _NAMES}  # fmt: skip
        self._parameters = {"use_sim_time": Parameter("use_sim_time", value=False)}
        if automatically_declare_parameters_from_overrides:
            self._parameters |= {k: Parameter(k, v) for k, v in self.context.parameters.items()}
        self._group, self._logger = MutuallyExclusiveCallbackGroup(), _Logger(self._name)
        self._endpoints, self.executor, self.early = [], None, []

    def get_name(self):
        return self._name

    def get_logger(self):
        return self._logger

    def get_parameters_by_prefix(self, prefix):
        assert prefix == ""
        return dict(self._parameters)

    def _expanded(self, name):
        if name.startswith("/"):
            return name
        if name.startswith("~"):
            return f"{self._space}/{self._name}{name[1:]}"
        return f"{self._space}/{name}"

    def resolve_topic_name(self, topic, *, only_expand=False):
        full = self._expanded(topic)
        return full if only_expand else self._remaps.get(full, full)

    resolve_service_name = resolve_topic_name

    def get_publishers_info_by_topic(self, name):
        found = graph().known("publisher", self.resolve_topic_name(name))
        return [
            SimpleNamespace(node_name=about[3][1], node_namespace=about[3][0] or "/",
                            topic_type=about[2], endpoint_gid=list(_gid(key)))
            for key, about in found
        ]  # fmt: skip

    def _made(self, endpoint, role, name, kind, quality, group=None):
        endpoint.node, endpoint.callback_group = self, group or self._group
        endpoint.callback_group.add_entity(endpoint)
        full = self.resolve_topic_name(name)
        topic = role in ("publisher", "subscription")
        if topic and self.context.topics.setdefault(full, kind) != kind:  # as in DDS
            raise RuntimeError(f"{full}: called for existing topic with incompatible type")
        about = (role, full, kind, (self._space, self._name), quality)
        graph().add(endpoint, about)
        self._endpoints.append(endpoint)
        return endpoint

    def queue(self, entity, call):
        if self.executor is None:
            self.early.append((entity, call))
        else:
            self.executor.queue(entity, call)

    def create_publisher(self, msg_type, topic, qos_profile):
        quality = profile(qos_profile)
        return self._made(_Publisher(msg_type), "publisher", topic, msg_type.KIND, quality)

    def create_subscription(
        self, msg_type, topic, callback, qos_profile, *, callback_group=None, raw=False
    ):
        quality = profile(qos_profile)
        made = _Subscription(msg_type, callback, raw)
        return self._made(made, "subscription", topic, msg_type.KIND, quality, callback_group)

    def create_service(
        self, srv_type, srv_name, callback, *, qos_profile=None, callback_group=None
    ):
        made = _Service(srv_type, callback)
        return self._made(made, "service", srv_name, srv_type.KIND, None, callback_group)

    def create_client(self, srv_type, srv_name, *, qos_profile=None):
        return self._made(_Client(srv_type), "client", srv_name, srv_type.KIND, None)

    def destroy_node(self):
        for endpoint in self._endpoints:
            graph().remove(endpoint)


class _Endpoint:
    def met(self, about):
        """Handle the discovery of another endpoint, described by `about`."""

    def take(self, *what):
        """Take a message for an endpoint of this role and name."""


class _Publisher(_Endpoint):
    def __init__(self, kind):
        self._kind, self._newest = kind, None

    def publish(self, message):
        if type(message) is not bytes:
            if not isinstance(message, self._kind):
                raise TypeError(f"expected {self._kind}, got {type(message)}")
            message = serialize_message(message)
        if not self.node.context.ok():
            raise RuntimeError("publisher's context is invalid")
        self._newest = message
        self._announce()

    def _announce(self):
        sender = (_gid(self.key), *self.about)
        graph().send("subscription", self.about[1], sender, self._newest, time.time_ns())

    def met(self, about):
        """Send the newest message again for a new subscriber, if this publisher is latched."""
        latched = self.about[4].durability == DurabilityPolicy.TRANSIENT_LOCAL
        if latched and self._newest is not None and about[:2] == ("subscription", self.about[1]):
            self._announce()

    def get_subscription_count(self):
        return len(graph().known("subscription", self.about[1]))


class _Subscription(_Endpoint):
    def __init__(self, kind, callback, raw):
        self._kind, self._callback, self._raw = kind, callback, raw
        try:  # does the callback take the message alone, or with its information?
            inspect.signature(callback).bind(object())
            self._informed = False
        except TypeError:
            self._informed = True

    def take(self, sender, raw, sent_ns):
        gid, _, _, kind, _, offered = sender
        if kind != self.about[2] or not compatible(offered, self.about[4]):
            return
        message = raw if self._raw else deserialize_message(raw, self._kind)
        info = {"source_timestamp": sent_ns, "received_timestamp": time.time_ns(),
                "publisher_gid": {"implementation_identifier": "", "data": gid}}  # fmt: skip
        sent = (message, info) if self._informed else (message,)
        self.node.queue(self, lambda: self._callback(*sent))


class _Service(_Endpoint):
    def __init__(self, kind, callback):
        self._kind, self._callback = kind, callback

    def take(self, client, number, kind, raw):
        if kind != self.about[2]:
            return

        def answer():
            request = deserialize_message(raw, self._kind.Request)
            response = self._callback(request, self._kind.Response())
            if not isinstance(response, self._kind.Response):
                raise TypeError("a service answers with its own type")
            graph().send("client", self.about[1], client, number, serialize_message(response))

        self.node.queue(self, answer)


class _Client(_Endpoint):
    def __init__(self, kind):
        self._kind, self._number, self._asked = kind, 0, {}
        self._lock = threading.Lock()

    def service_is_ready(self):
        return any(
            about[2] == self.about[2] for _, about in graph().known("service", self.about[1])
        )

    def call_async(self, request):
        with self._lock:
            self._number += 1
            future = self._asked[self._number] = Future()
            number = self._number
        who, raw = (os.getpid(), self.key), serialize_message(request)
        graph().send("service", self.about[1], who, number, self.about[2], raw)
        return future

    def take(self, client, number, raw):
        if client == (os.getpid(), self.key) and number in self._asked:
            future = self._asked.pop(number)
            message = deserialize_message(raw, self._kind.Response)
            self.node.queue(self, lambda: future.set_result(message))
