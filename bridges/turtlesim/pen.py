"""Colours and pens, as turtlesim's messages have them: every field a uint8."""

from typing import NamedTuple

from .errors import PenError

__all__ = ["Pen", "Rgb"]


class Rgb(NamedTuple):
    """An opaque colour, as in turtlesim/msg/Color; each part 0 to 255."""

    r: int
    g: int
    b: int

    @property
    def hex(self) -> str:
        """The colour as "#rrggbb"."""
        return "#{:02x}{:02x}{:02x}".format(*self)


class Pen(NamedTuple):
    """What a turtle draws with: a colour, and a width in pixels (1 to 255)."""

    color: Rgb = Rgb(0xB3, 0xB8, 0xFF)
    width: int = 3

    @classmethod
    def of(cls, r: int, g: int, b: int, width: int) -> "Pen":
        """Make the pen that SetPen asks for; width 0 is 1, as Qt's default is."""
        for name, value in (("r", r), ("g", g), ("b", b), ("width", width)):
            if not 0 <= value <= 255:
                raise PenError(f"a pen's {name} is from 0 to 255, not {value}")
        return cls(Rgb(r, g, b), width or 1)
