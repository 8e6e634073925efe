"""What of rclpy (Jazzy) the transport uses, without ROS: as strict as the original about its use.

Its messages are their bytes; the newest of them wait, as many as the depth says. A subscription is
served by the one who spins its node's executor, a destroyed entity raises InvalidHandle, the
response of a service must be of its class, and the context calls who waits for its shutdown while
it holds its lock.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from enum import IntEnum
from types import ModuleType, SimpleNamespace
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
        self._ok = False
        self._callbacks = []

    def ok(self):
        with self._lock:
            return self._ok

    def on_shutdown(self, callback):
        self._callbacks.append(WeakMethod(callback))

    def try_shutdown(self):
        with self._lock:
            if self._ok:
                self._ok = False
                for weak in self._callbacks:
                    if (callback := weak()) is not None:
                        callback()
        with CHANGED:
            CHANGED.notify_all()


def init(*, args, context, domain_id, signal_handler_options):
    assert signal_handler_options == "NO"
    assert args == []
    context.domain, context._ok = domain_id, True


class Parameter:
    def __init__(self, name, type_=None, value=None):
        self.name, self.value = name, value


class ReliabilityPolicy(IntEnum):
    SYSTEM_DEFAULT, RELIABLE, BEST_EFFORT = range(3)


class DurabilityPolicy(IntEnum):
    SYSTEM_DEFAULT, TRANSIENT_LOCAL, VOLATILE = range(3)


class HistoryPolicy(IntEnum):
    SYSTEM_DEFAULT, KEEP_LAST, KEEP_ALL = range(3)


class QoSProfile(SimpleNamespace):
    pass


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


def reaches(publisher, subscription):
    offered, asked = publisher.qos, subscription.qos
    return offered.reliability <= asked.reliability and offered.durability <= asked.durability


class Publisher(Entity):
    def __init__(self, *place):
        super().__init__(*place)
        keeps = self.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self.past = deque(maxlen=self.qos.depth if keeps else 0)
        self.count = 0

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


class Node:
    def __init__(self, name, *, namespace, context, parameter_overrides, **options):
        assert options == {
            "use_global_arguments": False,
            "enable_rosout": False,
            "start_parameter_services": False,
        }
        assert [(p.name, p.value) for p in parameter_overrides] == [
            ("start_type_description_service", False)
        ]
        self.name, self.namespace, self.context, self.ends = name, namespace, context, []
        self.callback_group = CallbackGroup()
        with CHANGED:
            NODES.append(self)
        events = SimpleNamespace(ros_name="rcl_interfaces/msg/ParameterEvent")
        self._make(Publisher, "publisher", events, "/parameter_events", profile())

    def _make(self, of, *what):
        end = of(self, *what)
        with CHANGED:
            self.ends.append(end)
            CHANGED.notify_all()
        return end

    def create_publisher(self, msg_type, topic, qos_profile, *, event_callbacks):
        assert event_callbacks == "PublisherEventCallbacks"
        return self._make(Publisher, "publisher", msg_type, topic, qos_profile)

    def create_subscription(self, msg_type, topic, callback, qos_profile, *, event_callbacks, raw):
        assert event_callbacks == "SubscriptionEventCallbacks"
        assert raw
        with CHANGED:
            end = self._make(Subscription, "subscription", msg_type, topic, qos_profile)
            end.callback = callback
            if qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
                for publisher in end.others("publisher"):
                    end.waiting.extend(publisher.past if reaches(publisher, end) else ())
        return end

    def create_client(self, srv_type, srv_name, *, qos_profile):
        return self._make(Client, "client", srv_type, srv_name, qos_profile)

    def create_service(self, srv_type, srv_name, callback, *, qos_profile):
        end = self._make(Service, "server", srv_type, srv_name, qos_profile)
        end.callback = callback
        return end

    def _destroy(self, end):
        with CHANGED:
            there, end.destroyed = not end.destroyed, True
            if there:
                self.ends.remove(end)
            return there

    destroy_publisher = destroy_subscription = destroy_client = destroy_service = _destroy

    def destroy_node(self):
        with CHANGED:
            NODES.remove(self)

    def _nodes(self):
        return [node for node in NODES if node.context.domain == self.context.domain]

    subscriptions = property(lambda self: self._of_kind("subscription"))
    clients = property(lambda self: self._of_kind("client"))
    services = property(lambda self: self._of_kind("server"))

    def _of_kind(self, kind):
        return [end for end in self.ends if end.kind == kind]

    def get_node_names_and_namespaces(self):
        return [(node.name, node.namespace) for node in self._nodes()]

    def get_topic_names_and_types(self):
        kinds = ("publisher", "subscription")
        ends = [end for node in self._nodes() for end in node.ends if end.kind in kinds]
        return [(name, []) for name in {end.name for end in ends}]

    def _infos(self, kind, topic):
        return [
            SimpleNamespace(
                node_name=node.name,
                node_namespace=node.namespace,
                topic_type=end.cls.ros_name,
                topic_type_hash=getattr(end.cls, "type_hash", "INVALID"),
                qos_profile=end.qos,
            )
            for node in self._nodes()
            for end in node.ends
            if (end.kind, end.name) == (kind, topic)
        ]

    def get_publishers_info_by_topic(self, topic_name):
        return self._infos("publisher", topic_name)

    def get_subscriptions_info_by_topic(self, topic_name):
        return self._infos("subscription", topic_name)

    def _of_node(self, kind, name, namespace):
        for node in self._nodes():
            if (node.name, node.namespace) == (name, namespace):
                return [(end.name, [end.cls.ros_name]) for end in node.ends if end.kind == kind]
        raise NodeNameNonExistentError

    def get_service_names_and_types_by_node(self, name, namespace):
        return self._of_node("server", name, namespace)

    def get_client_names_and_types_by_node(self, name, namespace):
        return self._of_node("client", name, namespace)


def profile():
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
        history=HistoryPolicy.KEEP_LAST,
        depth=1000,
    )


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
            if not self._context._ok:
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
        return self._tasks or self._ready() or not self._context._ok

    def _ready(self):
        ends = [end for node in self._nodes for end in node.ends]
        free = [end for end in ends if not end._executor_event and not end.callback_group.active]
        return [end for end in free if end.waiting]


def message_class(name, type_hash):
    def init_with(self, data):
        self.data = data

    return type("M", (), {"__init__": init_with, "ros_name": name, "type_hash": type_hash})


def service_class(name, type_hash):
    parts = {part: message_class(f"{name}_{part}", None) for part in ("Request", "Response")}
    return type("S", (), {**parts, "ros_name": name, "type_hash": type_hash})


def modules(types):
    """Return the modules to be found instead of rclpy's, and those of the tests' messages."""
    found = {}

    def add(name, **content):
        module = found[name] = ModuleType(name)
        vars(module).update(content)

    add("rclpy", init=init)
    add("rclpy.context", Context=Context)
    add("rclpy.signals", SignalHandlerOptions=SimpleNamespace(NO="NO"))
    add("rclpy.node", Node=Node)
    add(
        "rclpy.executors",
        SingleThreadedExecutor=SingleThreadedExecutor,
        ExternalShutdownException=ExternalShutdownException,
    )
    add("rclpy.parameter", Parameter=Parameter)
    add(
        "rclpy.qos",
        **{c.__name__: c for c in (QoSProfile, ReliabilityPolicy, DurabilityPolicy, HistoryPolicy)},
    )
    add(
        "rclpy.event_handler",
        PublisherEventCallbacks=lambda use_default_callbacks: "PublisherEventCallbacks",
        SubscriptionEventCallbacks=lambda use_default_callbacks: "SubscriptionEventCallbacks",
    )
    add(
        "rclpy.impl.implementation_singleton",
        rclpy_implementation=SimpleNamespace(
            InvalidHandle=InvalidHandle,
            NodeNameNonExistentError=NodeNameNonExistentError,
            RCLError=RCLError,
        ),
    )
    add(
        "rclpy.serialization",
        serialize_message=lambda message: message.data,
        deserialize_message=lambda data, of: of(data),
    )
    messages = {"std_msgs": ["Int64", "String"], "turtlesim": ["Pose"]}
    for package, names in messages.items():
        all_of = [types.message(f"{package}/msg/{name}") for name in names]
        add(
            f"{package}.msg",
            **{of.name.rpartition("/")[2]: message_class(of.name, of.type_hash) for of in all_of},
        )
    for package, name in (("turtlesim", "Spawn"), ("std_srvs", "Empty")):
        of = types.service(f"{package}/srv/{name}")
        add(f"{package}.srv", **{name: service_class(of.name, of.type_hash)})
    return found
