"""The part of rclpy (Jazzy, 7.1) that is used, imported late. Its objects have no types here."""

from __future__ import annotations

import importlib
from types import SimpleNamespace
from typing import Any

from llfsm.bridges.ros2.errors import TransportUnavailableError


def import_rclpy() -> SimpleNamespace:
    """Import the functions, classes and errors of rclpy that are used.

    Raise ModuleNotFoundError if rclpy is not installed, and :class:`.TransportUnavailableError` if
    something it needs is missing.
    """

    def module(name: str) -> Any:
        return _import(f"rclpy.{name}")

    events, executors = module("event_handler"), module("executors")
    implementation = module("impl.implementation_singleton").rclpy_implementation
    return SimpleNamespace(
        new_context=module("context").Context,
        init=_import("rclpy").init,
        no_signal_handlers=module("signals").SignalHandlerOptions.NO,
        new_node=module("node").Node,
        new_executor=executors.SingleThreadedExecutor,
        # Raised by `spin_once` when other code has shut down the context.
        shut_down=executors.ExternalShutdownException,
        destroyed=implementation.InvalidHandle,  # by the use of an entity that is destroyed
        # By questions about one that has gone.
        unknown_node=implementation.NodeNameNonExistentError,
        failure=implementation.RCLError,  # when the middleware fails
        parameter=module("parameter").Parameter,
        qos=module("qos"),
        duration=module("duration").Duration,
        publisher_events=events.PublisherEventCallbacks,  # by default there are some that log
        subscription_events=events.SubscriptionEventCallbacks,
        # When an end is created whose events the middleware does not report.
        unsupported_event=events.UnsupportedEventTypeError,
        serialize=module("serialization").serialize_message,
        deserialize=module("serialization").deserialize_message,
    )


def _import(name: str) -> Any:
    package = name.partition(".")[0]
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        missing = str(error.name).partition(".")[0]
        if missing == package:
            raise
        raise TransportUnavailableError(
            f"{package} needs {missing}, which this Python does not have; a venv must be one of "
            "the system's Python that sees its packages (--system-site-packages)"
        ) from error


_OF_ACTION = {
    "_SendGoal": "SendGoalService",
    "_GetResult": "GetResultService",
    "_FeedbackMessage": "FeedbackMessage",
}


def find_class(name: str) -> Any:
    """Import rclpy's class of a type (``package/msg/Name``; likewise ``srv`` and ``action``).

    Raise :class:`.TransportUnavailableError` if the sourced environment does not have it.
    """
    package, kind, own_name = name.split("/")
    try:
        module = _import(f"{package}.{kind}")
        for ending, of_action in _OF_ACTION.items():
            if kind == "action" and own_name.endswith(ending):
                return getattr(getattr(module, own_name.removesuffix(ending)).Impl, of_action)
        return getattr(module, own_name)
    except (ModuleNotFoundError, AttributeError) as error:
        raise TransportUnavailableError(
            f"the sourced ROS environment has no {name}; install or build {package} there, or "
            "use the transport on Zenoh"
        ) from error
