"""What can go wrong for those who use the ROS 2 bridge.

Ros2Error
├── RosNameError              not a name of a node, topic or service
└── PortError
    ├── PortUnavailableError  this way into ROS is not installed, or cannot be opened
    ├── DomainIdError         not a ROS domain id
    ├── PortClosedError       the port, node or endpoint is closed
    ├── AlreadyAnsweredError  a request was answered twice
    ├── RouterError           a router cannot be started
    └── ServiceCallError      a call ended without a response
        ├── NoServerError     nobody serves it
        ├── CallTimeoutError  no answer in time
        └── CallFailedError   the server refused, or went away while it was asked

What arrives from others raises nothing: one bad message must not end a bridge. It is told as a
notice (see :mod:`.port`).
"""

__all__ = [
    "AlreadyAnsweredError",
    "CallFailedError",
    "CallTimeoutError",
    "DomainIdError",
    "NoServerError",
    "PortClosedError",
    "PortError",
    "PortUnavailableError",
    "Ros2Error",
    "RosNameError",
    "RouterError",
    "ServiceCallError",
]


class Ros2Error(Exception):
    """Everything the ROS 2 bridge raises."""


class RosNameError(Ros2Error, ValueError):
    """A name of a node, namespace, topic or service breaks ROS 2's rules."""


class PortError(Ros2Error):
    """Something about a way into ROS."""


class PortUnavailableError(PortError):
    """A way into ROS is not installed or cannot be opened; the message says how to get it."""


class DomainIdError(PortError, ValueError):
    """A ROS domain id is a whole number from 0 to 232."""


class PortClosedError(PortError):
    """A port, a node or an endpoint was used after it was closed."""


class AlreadyAnsweredError(PortError):
    """A request has one answer, and it was given."""


class RouterError(PortError):
    """A router cannot listen where it was told to."""


class ServiceCallError(PortError):
    """A call of a service ended without a response."""


class NoServerError(ServiceCallError):
    """Nobody serves it, or only with another type."""


class CallTimeoutError(ServiceCallError, TimeoutError):
    """No answer came in time."""


class CallFailedError(ServiceCallError):
    """The server refused, or went away while it was asked."""
