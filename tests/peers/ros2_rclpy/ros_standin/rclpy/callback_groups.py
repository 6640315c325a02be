# SPDX-License-Identifier: Apache-2.0
"""Groups, which determine whether callbacks may run at the same time."""

import threading


class CallbackGroup:
    def __init__(self):
        self.entities = set()

    def add_entity(self, entity):
        self.entities.add(entity)


class ReentrantCallbackGroup(CallbackGroup):
    def can_execute(self, entity):
        return True

    def beginning_execution(self, entity):
        return True

    def ending_execution(self, entity):
        pass


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    def __init__(self):
        super().__init__()
        self._lock, self._active = threading.Lock(), None

    def can_execute(self, entity):
        assert entity in self.entities
        return self._active is None

    def beginning_execution(self, entity):
        with self._lock:
            if self._active is not None:
                return False
            self._active = entity
            return True

    def ending_execution(self, entity):
        assert self._active is entity
        self._active = None
