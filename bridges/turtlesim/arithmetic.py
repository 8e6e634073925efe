"""turtlesim's numbers, on which bit-exact poses hang.

A turtle's state is double precision. What crosses a message or service is float32, and so is the
size of the field. The order of every operation in `turtle` is that of turtlesim's turtle.cpp:
double-precision addition is not associative, so regrouping a term changes poses.
"""

from array import array
from math import floor

__all__ = ["DT", "FIELD", "METER", "PI", "float32", "normalize"]

PI = 3.14159265
"""turtlesim's pi, short as it is: with math.pi headings drift from the recorded ones."""
_TWO_PI = 2.0 * PI

METER = 45.0
"""Pixels in a metre: the height of turtlesim's turtle images."""

DT = 0.016
"""Seconds of simulated time in a step."""


def float32(value: float) -> float:
    """Round to the nearest float32; beyond its range to an infinity, as C's conversion does."""
    return array("f", (value,))[0]


FIELD = float32(499 / METER)
"""Width and height of the field in metres: from the first to the last of its 500 pixels."""


def normalize(angle: float) -> float:
    """Wrap a finite angle into [-PI, PI), up to a rounding of the last digit."""
    return angle - _TWO_PI * floor((angle + PI) / _TWO_PI)
