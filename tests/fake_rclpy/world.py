"""What all share: the nodes, contexts, and errors."""

from __future__ import annotations

import threading
from weakref import WeakMethod

CHANGED = threading.Condition()

NODES = []


class ExternalShutdownException(Exception):  # noqa: N818 (as in rclpy)
    pass


class InvalidHandle(Exception):  # noqa: N818
    pass


class NodeNameNonExistentError(Exception):
    pass


class RCLError(RuntimeError):
    pass


class Context:
    def __init__(self):
        self._lock = threading.Lock()
        self.is_ok = False
        self._callbacks = []

    def ok(self):
        with self._lock:
            return self.is_ok

    def on_shutdown(self, callback):
        self._callbacks.append(WeakMethod(callback))

    def try_shutdown(self):
        with self._lock:
            if self.is_ok:
                self.is_ok = False
                for weak in self._callbacks:
                    if (callback := weak()) is not None:
                        callback()
        with CHANGED:
            CHANGED.notify_all()


def init(*, args, context, domain_id, signal_handler_options):
    assert signal_handler_options == "NO"
    assert args == []
    context.domain, context.is_ok = domain_id, True


class Parameter:
    def __init__(self, name, type_=None, value=None):
        self.name, self.value = name, value
