"""The executor that serves the entities of its nodes."""

from __future__ import annotations

from collections import deque

from .world import CHANGED, ExternalShutdownException


class SingleThreadedExecutor:
    def __init__(self, *, context):
        self._context, self._nodes, self._tasks, self._over = context, [], deque(), False

    def add_node(self, node):
        with CHANGED:
            self._nodes.append(node)
            CHANGED.notify_all()
        return True

    def remove_node(self, node):
        with CHANGED:
            self._nodes.remove(node)

    def get_nodes(self):
        return self._nodes

    def create_task(self, callback, *args):
        with CHANGED:
            assert not self._over, "its guard condition is destroyed"
            self._tasks.append((callback, args))
            CHANGED.notify_all()

    def shutdown(self, timeout_sec=None):
        self._over = True
        return True

    def spin_once(self):
        """Execute one callback; whatever else wakes it, a spin waits on."""
        with CHANGED:
            CHANGED.wait_for(self._work)
            if not self._context.is_ok:
                raise ExternalShutdownException
            task = self._tasks.popleft() if self._tasks else None
            end = None if task else self._ready()[0]
        if task:
            do, what = task
            do(*what)
        else:
            self._serve(end)

    def _serve(self, end):
        """Take and execute; an entity whose take fails is not let go, nor is its group."""
        end._executor_event, end.callback_group.active = True, end
        taken = end.take()
        end._executor_event = False
        try:
            end.execute(taken)
        finally:
            end.callback_group.ending_execution(end)

    def _work(self):
        return self._tasks or self._ready() or not self._context.is_ok

    def _ready(self):
        ends = [end for node in self._nodes for end in node.ends]
        free = [end for end in ends if not end._executor_event and not end.callback_group.active]
        return [end for end in free if end.waiting]
