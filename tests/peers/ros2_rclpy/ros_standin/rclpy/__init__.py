# SPDX-License-Identifier: Apache-2.0
"""A stand-in of rclpy, for machines without ROS 2: the part of its API that the bridge and its
tests use, written from rclpy's documentation. It passes messages on as bytes, without a change."""

import os

import standin_types

from rclpy.context import Context, default_context
from rclpy.signals import SignalHandlerOptions

standin_types.install(without=os.environ.get("ROS_STANDIN_WITHOUT", "").split())


def init(*, args=None, context=None, signal_handler_options=None):
    (context or default_context).init(args or [])


def ok(*, context=None):
    return (context or default_context).ok()


def shutdown(*, context=None):
    (context or default_context).shutdown()


def try_shutdown(*, context=None):
    (context or default_context).try_shutdown()


__all__ = ["Context", "SignalHandlerOptions", "init", "ok", "shutdown", "try_shutdown"]
