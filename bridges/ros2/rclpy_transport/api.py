# ruff: noqa: D102 (rclpy documents its methods)
"""The part of rclpy (Jazzy, 7.1) that is used, as types."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, Protocol

from llfsm.bridges.ros2.errors import TransportUnavailableError


class Context(Protocol):
    """``rclpy.context.Context``."""

    def ok(self) -> bool: ...
    def on_shutdown(self, callback: Callable[[], None]) -> None: ...
    def try_shutdown(self) -> None: ...


class PublisherApi(Protocol):
    """``rclpy.publisher.Publisher``."""

    def publish(self, msg: Any) -> None: ...


class CallbackGroup(Protocol):
    """``rclpy.callback_groups.CallbackGroup``."""

    def ending_execution(self, entity: Any) -> None: ...


class Taken(Protocol):
    """An entity from which the executor takes."""

    _executor_event: bool  # while it is about to take
    callback_group: CallbackGroup


class Future(Protocol):
    """``rclpy.task.Future``."""

    def result(self) -> Any: ...
    def add_done_callback(self, callback: Callable[[Future], None]) -> None: ...


class ClientApi(Taken, Protocol):
    """``rclpy.client.Client``."""

    def call_async(self, request: Any) -> Future: ...
    def remove_pending_request(self, future: Future) -> None: ...
    def service_is_ready(self) -> bool: ...


class Service(Taken, Protocol):
    """``rclpy.service.Service``."""

    send_response: Callable[[Any, Any], None]


class EndpointInfo(Protocol):
    """``rclpy.topic_endpoint_info.TopicEndpointInfo``."""

    node_name: str
    node_namespace: str
    topic_type: str
    topic_type_hash: Any
    qos_profile: Any


_Types = list[tuple[str, list[str]]]


class NodeApi(Protocol):
    """``rclpy.node.Node``."""

    publishers: Iterable[PublisherApi]
    subscriptions: Iterable[Taken]
    clients: Iterable[ClientApi]
    services: Iterable[Service]

    def create_publisher(
        self, msg_type: Any, topic: str, qos_profile: Any, *, event_callbacks: Any
    ) -> PublisherApi: ...
    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[[bytes, dict[str, Any]], None],
        qos_profile: Any,
        *,
        event_callbacks: Any,
        raw: bool,
    ) -> object: ...
    def create_client(self, srv_type: Any, srv_name: str, *, qos_profile: Any) -> ClientApi: ...
    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[..., Any], *, qos_profile: Any
    ) -> Service: ...
    def destroy_publisher(self, publisher: PublisherApi) -> bool: ...
    def destroy_subscription(self, subscription: Any) -> bool: ...
    def destroy_client(self, client: ClientApi) -> bool: ...
    def destroy_service(self, service: Service) -> bool: ...
    def destroy_node(self) -> None: ...
    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]: ...
    def get_topic_names_and_types(self) -> _Types: ...
    def get_publishers_info_by_topic(self, topic_name: str) -> list[EndpointInfo]: ...
    def get_subscriptions_info_by_topic(self, topic_name: str) -> list[EndpointInfo]: ...
    def get_service_names_and_types_by_node(self, name: str, namespace: str) -> _Types: ...
    def get_client_names_and_types_by_node(self, name: str, namespace: str) -> _Types: ...


class Executor(Protocol):
    """``rclpy.executors.SingleThreadedExecutor``."""

    def add_node(self, node: NodeApi) -> bool: ...
    def remove_node(self, node: NodeApi) -> None: ...
    def get_nodes(self) -> list[NodeApi]: ...
    def create_task(self, callback: Callable[..., Any], *args: Any) -> object: ...
    def spin_once(self) -> None: ...
    def shutdown(self, timeout_sec: float | None = None) -> bool: ...


class Rclpy(NamedTuple):
    """The functions, classes and errors of rclpy that are used, imported late."""

    new_context: Callable[[], Context]
    init: Callable[..., None]
    no_signal_handlers: Any
    new_node: Callable[..., NodeApi]
    new_executor: Callable[..., Executor]
    shut_down: type[Exception]
    """Raised by ``spin_once`` when other code has shut down the context."""
    destroyed: type[Exception]
    """Raised by the use of an entity that is destroyed."""
    unknown_node: type[Exception]
    """Raised by questions about a node that has gone."""
    failure: type[Exception]
    """Raised when the middleware fails."""
    parameter: Callable[..., Any]
    qos: Any
    """The module ``rclpy.qos``."""
    duration: Callable[..., Any]
    publisher_events: Callable[..., Any]
    """The callbacks for events of publishers; by default there are some that log."""
    subscription_events: Callable[..., Any]
    unsupported_event: type[Exception]
    """Raised when an end is created whose events the middleware does not report."""
    serialize: Callable[[Any], bytes]
    deserialize: Callable[[bytes, Any], Any]


def import_rclpy() -> Rclpy:
    """Import the part of rclpy that is used.

    Raise ModuleNotFoundError if rclpy is not installed, and :class:`.TransportUnavailableError` if
    something it needs is missing.
    """

    def module(name: str) -> Any:
        return _import(f"rclpy.{name}")

    events, executors = module("event_handler"), module("executors")
    implementation = module("impl.implementation_singleton").rclpy_implementation
    return Rclpy(
        module("context").Context,
        _import("rclpy").init,
        module("signals").SignalHandlerOptions.NO,
        module("node").Node,
        executors.SingleThreadedExecutor,
        executors.ExternalShutdownException,
        implementation.InvalidHandle,
        implementation.NodeNameNonExistentError,
        implementation.RCLError,
        module("parameter").Parameter,
        module("qos"),
        module("duration").Duration,
        events.PublisherEventCallbacks,
        events.SubscriptionEventCallbacks,
        events.UnsupportedEventTypeError,
        module("serialization").serialize_message,
        module("serialization").deserialize_message,
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
