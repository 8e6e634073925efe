"""The modules to be found instead of rclpy's."""

from __future__ import annotations

from types import ModuleType, SimpleNamespace

from .events import EventCallbacks, UnsupportedEventTypeError
from .executor import SingleThreadedExecutor
from .node import Node
from .qos import (
    DurabilityPolicy,
    Duration,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
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


def action_module(of):
    """Return the module of an action's package that has this action."""
    module = ModuleType(of.name.rpartition("/")[0].replace("/", "."))
    parts = SimpleNamespace(
        SendGoalService=service_class(of.send_goal.name, of.send_goal.type_hash),
        GetResultService=service_class(of.get_result.name, of.get_result.type_hash),
        FeedbackMessage=message_class(of.feedback_message.name, of.feedback_message.type_hash),
    )
    setattr(module, of.name.rpartition("/")[2], SimpleNamespace(Impl=parts))
    return module


MESSAGES = {
    "std_msgs": ["Int64", "String"],
    "geometry_msgs": ["Twist"],
    "turtlesim": ["Pose"],
    "rcl_interfaces": ["Log", "ParameterEvent"],
    "diagnostic_msgs": ["DiagnosticArray"],
    "lifecycle_msgs": ["TransitionEvent"],
    "rosgraph_msgs": ["Clock"],
    "action_msgs": ["GoalStatusArray"],
}
SERVICES = {
    "turtlesim": ["Spawn"],
    "std_srvs": ["Empty"],
    "action_msgs": ["CancelGoal"],
    "lifecycle_msgs": [
        "ChangeState", "GetAvailableStates", "GetAvailableTransitions", "GetState",
    ],
    "type_description_interfaces": ["GetTypeDescription"],
    "rcl_interfaces": [
        "DescribeParameters", "GetParameterTypes", "GetParameters", "ListParameters",
        "SetParameters", "SetParametersAtomically",
    ],
}  # fmt: skip


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
        **{
            c.__name__: c
            for c in (
                QoSProfile,
                ReliabilityPolicy,
                DurabilityPolicy,
                HistoryPolicy,
                LivelinessPolicy,
            )
        },
    )
    add("rclpy.duration", Duration=Duration)
    add(
        "rclpy.event_handler",
        PublisherEventCallbacks=EventCallbacks,
        SubscriptionEventCallbacks=EventCallbacks,
        UnsupportedEventTypeError=UnsupportedEventTypeError,
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
    for package, names in MESSAGES.items():
        all_of = [types.message(f"{package}/msg/{name}") for name in names]
        add(
            f"{package}.msg",
            **{of.name.rpartition("/")[2]: message_class(of.name, of.type_hash) for of in all_of},
        )
    for package, names in SERVICES.items():
        every = [types.service(f"{package}/srv/{name}") for name in names]
        add(
            f"{package}.srv",
            **{of.name.rpartition("/")[2]: service_class(of.name, of.type_hash) for of in every},
        )
    return found
