"""The errors of the ROS 2 bridge.

Ros2Error
├── RosNameError
├── RosTypeError ── UnknownTypeError, DefinitionSyntaxError, DefinitionPathError,
│                   TypeMismatchError, KeyPathError
├── RosArgumentError ── ParameterOverrideError
├── TransformError ── FrameNameError, FrameLookupError, ConnectivityError, ExtrapolationError
├── CdrError
└── TransportError ── TransportUnavailableError, DomainIdError, TransportClosedError,
                      AlreadyAnsweredError, NoServerError, CallTimeoutError, CallFailedError

A bad message from another program raises nothing: it must not end a bridge. It is reported as a
notice (see :mod:`.transport`).
"""

from llfsm.errors import LlfsmError


class Ros2Error(LlfsmError):
    """The root of all errors of the ROS 2 bridge."""


class RosNameError(Ros2Error, ValueError):
    """A name of a node, namespace, topic or service breaks ROS 2's rules."""


class RosTypeError(Ros2Error):
    """An error in a ROS type or its definition."""


class UnknownTypeError(RosTypeError, LookupError):
    """No definition of a type is found; the message names the places searched and similar types."""


class DefinitionSyntaxError(RosTypeError, ValueError):
    """A definition breaks ROS 2's rules; the message names the place and the rule."""


class DefinitionPathError(RosTypeError, ValueError):
    """A folder or file to search for definitions is not there."""


class TypeMismatchError(RosTypeError, TypeError):
    """A Message class has the name of a ROS type and other fields; the message lists them."""


class KeyPathError(RosTypeError, LookupError):
    """``keyed_by`` is not a path to a key in the messages of its relay."""


class TransformError(Ros2Error):
    """A transform between two frames cannot be answered; the words are tf2's."""


class FrameNameError(TransformError, ValueError):
    """A frame's name is empty or begins with a slash (tf2's InvalidArgumentException)."""


class FrameLookupError(TransformError, LookupError):
    """A frame is unknown, or the frames form a loop (tf2's LookupException)."""


class ConnectivityError(TransformError):
    """Two frames are not in one tree (tf2's ConnectivityException)."""


class ExtrapolationError(TransformError):
    """A transform at that time is not known (tf2's ExtrapolationException)."""


class RosArgumentError(Ros2Error, ValueError):
    """An argument after ``--ros-args`` is wrong; the message names it."""


class ParameterOverrideError(RosArgumentError):
    """A value from outside does not fit its parameter; the message names both."""


class CdrError(Ros2Error, ValueError):
    """Bytes do not decode, or a message cannot be encoded; the message names the field."""


class TransportError(Ros2Error):
    """An error of a transport or of something on it."""


class TransportUnavailableError(TransportError):
    """A transport or a router is not installed or cannot be opened; the message explains why."""


class DomainIdError(TransportError, ValueError):
    """A ROS domain id is a whole number from 0 to 232."""


class TransportClosedError(TransportError):
    """A transport, a node or an endpoint was used after it was closed."""


class AlreadyAnsweredError(TransportError):
    """A request was answered a second time."""


class NoServerError(TransportError):
    """A service is called and no server is known, or only one with another type."""


class CallTimeoutError(TransportError, TimeoutError):
    """A service is called and no answer came in time."""


class CallFailedError(TransportError):
    """A service is called and the server refused, or went away during the call."""
