"""The modules to be found instead of rclpy's."""

from __future__ import annotations

from types import ModuleType, SimpleNamespace

from .executor import SingleThreadedExecutor
from .node import Node
from .qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from .world import (
    Context,
    ExternalShutdownException,
    InvalidHandle,
    NodeNameNonExistentError,
    Parameter,
    RCLError,
    init,
)


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
