# SPDX-License-Identifier: Apache-2.0
"""Executors: threads that run the callbacks. An error in a callback ends `spin`, as in rclpy."""

import threading
from collections import deque
from concurrent.futures import ThreadPoolExecutor

from rclpy.context import default_context

LOOK_EVERY_S = 1.0


class ExternalShutdownException(Exception):
    pass


class MultiThreadedExecutor:
    def __init__(self, num_threads=None, *, context=None):
        self._context = context or default_context
        self._context.on_shutdown(self.wake)
        self._changed = threading.Condition()
        self._ready, self._error, self._ended = deque(), None, False
        self._pool = ThreadPoolExecutor(num_threads or 2)

    def add_node(self, node):
        node.executor = self
        for entity, call in node.early:
            self.queue(entity, call)
        node.early.clear()

    def wake(self):
        with self._changed:
            self._changed.notify_all()

    def queue(self, entity, call):
        with self._changed:
            self._ready.append((entity, call))
            self._changed.notify_all()

    def spin(self):
        while self._context.ok() and not self._ended:
            found = self._next()
            if found is not None:
                self._pool.submit(self._run, *found)
            if self._error is not None:
                raise self._error
        if not self._ended:
            raise ExternalShutdownException

    def _next(self):
        with self._changed:
            for item in self._ready:
                entity = item[0]
                group = entity.callback_group
                if group.can_execute(entity) and group.beginning_execution(entity):
                    self._ready.remove(item)
                    return item
            self._changed.wait(LOOK_EVERY_S)
        return None

    def _run(self, entity, call):
        try:
            call()
        except Exception as error:  # noqa: BLE001  spin raises any error
            self._error = error
        finally:
            entity.callback_group.ending_execution(entity)
            self.wake()

    def shutdown(self, timeout_sec=None):
        self._ended = True
        self.wake()
        self._pool.shutdown(wait=timeout_sec is None)


class SingleThreadedExecutor(MultiThreadedExecutor):
    def __init__(self, *, context=None):
        super().__init__(1, context=context)
