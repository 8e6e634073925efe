"""What can go wrong for those who use the ROS 2 bridge.

Ros2Error
├── RosNameError              not a name of a node, topic or service
├── RosTypeError
│   ├── UnknownTypeError      nobody defines that type
│   ├── DefinitionSyntaxError a definition breaks ROS 2's rules for them
│   ├── DefinitionPathError  where definitions were to be looked for is nothing
│   └── TypeMismatchError     a Message class with other fields than the type of its name
├── CdrError                  bytes that are no message of a type, or a message that has no bytes
└── TransportError
    ├── TransportUnavailableError  this way into ROS is not installed, or cannot be opened
    ├── DomainIdError         not a ROS domain id
    ├── TransportClosedError       the transport, node or endpoint is closed
    ├── AlreadyAnsweredError  a request was answered twice
    ├── RouterError           a router cannot be started
    └── ServiceCallError      a call ended without a response
        ├── NoServerError     nobody serves it
        ├── CallTimeoutError  no answer in time
        └── CallFailedError   the server refused, or went away while it was asked

What arrives from others raises nothing: one bad message must not end a bridge. It is told as a
notice (see :mod:`.transport`).
"""

from llfsm.errors import LlfsmError

__all__ = [
    "AlreadyAnsweredError",
    "CallFailedError",
    "CallTimeoutError",
    "CdrError",
    "DefinitionPathError",
    "DefinitionSyntaxError",
    "DomainIdError",
    "NoServerError",
    "Ros2Error",
    "RosNameError",
    "RosTypeError",
    "RouterError",
    "ServiceCallError",
    "TransportClosedError",
    "TransportError",
    "TransportUnavailableError",
    "TypeMismatchError",
    "UnknownTypeError",
]


class Ros2Error(LlfsmError):
    """Everything the ROS 2 bridge raises."""


class RosNameError(Ros2Error, ValueError):
    """A name of a node, namespace, topic or service breaks ROS 2's rules."""


class RosTypeError(Ros2Error):
    """Something about a ROS type or its definition."""


class UnknownTypeError(RosTypeError, LookupError):
    """Nobody defines that type; the message says where it was looked for and what comes near."""


class DefinitionSyntaxError(RosTypeError, ValueError):
    """A definition breaks ROS 2's rules; the message says where and which."""


class DefinitionPathError(RosTypeError, ValueError):
    """A folder or file in which to look for definitions is not there."""


class TypeMismatchError(RosTypeError, TypeError):
    """A Message class bears the name of a ROS type and has other fields; says how they differ."""


class CdrError(Ros2Error, ValueError):
    """Bytes are no message of a type, or a message cannot be bytes; the message names the field."""


class TransportError(Ros2Error):
    """Something about a way into ROS."""


class TransportUnavailableError(TransportError):
    """A way into ROS is not installed or cannot be opened; the message says how to get it."""


class DomainIdError(TransportError, ValueError):
    """A ROS domain id is a whole number from 0 to 232."""


class TransportClosedError(TransportError):
    """A transport, a node or an endpoint was used after it was closed."""


class AlreadyAnsweredError(TransportError):
    """A request has one answer, and it was given."""


class RouterError(TransportError):
    """A router cannot listen where it was told to."""


class ServiceCallError(TransportError):
    """A call of a service ended without a response."""


class NoServerError(ServiceCallError):
    """Nobody serves it, or only with another type."""


class CallTimeoutError(ServiceCallError, TimeoutError):
    """No answer came in time."""


class CallFailedError(ServiceCallError):
    """The server refused, or went away while it was asked."""
