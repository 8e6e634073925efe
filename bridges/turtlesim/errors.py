"""The error of the simulator as a library.

Bad messages from outside (an illegal name, a number that is not finite) raise nothing, because one
of them must not end the simulation. They are refused, and the reason is logged.
"""

from llfsm.errors import LlfsmError


class TurtlesimError(LlfsmError, ValueError):
    """An argument is wrong: an unknown turtle, a pen, a parameter, or a picture's file name."""
