"""Errors of the simulator as a library.

    TurtlesimError
    ├── UnknownTurtleError   no turtle has that name
    ├── PenError             a pen's colour or width is outside 0 to 255
    ├── ParameterError       a parameter is unknown, or the value is not one for it
    └── PictureFormatError   a picture's file ending is neither .svg nor .png

Bad messages from outside (an illegal name, a number that is not finite) raise nothing, because one
of them must not end the simulation. They are refused, and the reason is logged.
"""

from llfsm.errors import LlfsmError


class TurtlesimError(LlfsmError):
    """Everything the turtle simulator raises."""


class UnknownTurtleError(TurtlesimError, LookupError):
    """No turtle has that name; the message lists those that exist."""


class PenError(TurtlesimError, ValueError):
    """A pen's colour or width does not fit its message's uint8."""


class ParameterError(TurtlesimError, ValueError):
    """A parameter was refused; the message is the reason that rclcpp gives."""


class PictureFormatError(TurtlesimError, ValueError):
    """A picture's file name ends in neither .svg nor .png, or there is none."""
