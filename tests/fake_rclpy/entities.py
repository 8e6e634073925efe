"""Publishers, subscriptions, clients and services."""

from __future__ import annotations

import time
from collections import deque
from types import SimpleNamespace

from .qos import DurabilityPolicy, reaches
from .world import CHANGED, NODES, InvalidHandle


class CallbackGroup:
    active = None

    def ending_execution(self, entity):
        assert self.active is entity
        self.active = None


class Entity:
    def __init__(self, node, kind, cls, name, qos):
        self.node, self.kind, self.cls, self.name, self.qos = node, kind, cls, name, qos
        self.waiting = deque(maxlen=qos.depth)
        self.callback_group = node.callback_group
        self.destroyed = self._executor_event = False

    def others(self, kind):
        """Return the ends of another kind that this one reaches."""
        return [
            end
            for node in NODES
            if node.context.domain == self.node.context.domain
            for end in node.ends
            if (end.kind, end.name, end.cls) == (kind, self.name, self.cls)
        ]

    def check(self):
        if self.destroyed:
            raise InvalidHandle

    def take(self):
        return self.waiting.popleft()


class Publisher(Entity):
    def __init__(self, *place):
        super().__init__(*place)
        keeps = self.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self.past = deque(maxlen=self.qos.depth if keeps else 0)
        self.count = 0
        self.topic_name = self.name

    def get_subscription_count(self):
        with CHANGED:
            return sum(reaches(self, end) for end in self.others("subscription"))

    def publish(self, msg):
        assert isinstance(msg, bytes)
        with CHANGED:
            self.check()
            self.count += 1
            info = {
                "source_timestamp": time.time_ns(),
                "received_timestamp": time.time_ns(),
                "publication_sequence_number": self.count,
                "reception_sequence_number": None,
            }
            self.past.append((msg, info))
            for end in self.others("subscription"):
                if reaches(self, end):
                    end.waiting.append((msg, info))
            CHANGED.notify_all()


class Subscription(Entity):
    def execute(self, taken):
        self.callback(*taken)


class Future:
    def __init__(self):
        self._callbacks, self._result, self._done = [], None, False

    def result(self):
        return self._result

    def add_done_callback(self, callback):
        with CHANGED:
            if not self._done:
                self._callbacks.append(callback)
                return
        callback(self)

    def set_result(self, result):
        with CHANGED:
            self._result, self._done = result, True
        for callback in self._callbacks:
            callback(self)


class Client(Entity):
    def __init__(self, *place):
        super().__init__(*place)
        self.pending, self.count = {}, 0

    def service_is_ready(self):
        self.check()
        return bool(self.others("server"))

    def call_async(self, request):
        if not isinstance(request, self.cls.Request):
            raise TypeError
        with CHANGED:
            self.check()
            self.count += 1
            future = self.pending[self.count] = Future()
            header = SimpleNamespace(
                source_timestamp=time.time_ns(),
                request_id=SimpleNamespace(sequence_number=self.count),
                client=self,
            )
            for server in self.others("server"):
                server.waiting.append((request, header))
            CHANGED.notify_all()
        return future

    def remove_pending_request(self, future):
        with CHANGED:
            self.pending = {n: f for n, f in self.pending.items() if f is not future}

    def execute(self, taken):
        number, response = taken
        if (future := self.pending.pop(number, None)) is not None:
            future.set_result(response)


class Service(Entity):
    def send_response(self, response, header):
        if not isinstance(response, self.cls.Response):
            raise TypeError
        with CHANGED:
            self.check()
            header.client.waiting.append((header.request_id.sequence_number, response))
            CHANGED.notify_all()

    def execute(self, taken):
        request, header = taken
        self.send_response(self.callback(request, self.cls.Response(b"")), header)
