"""An industrial press: a two-hand control, and the ram that it permits to close.

The two-hand control follows what ISO 13851 asks of type III C: both buttons must be pressed within
half a second, both held while the ram closes, and both released before the next stroke, so that a
button that is tied down does not help.
"""

from enum import Enum
from itertools import product

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot

__all__ = [
    "ALL_HANDS",
    "HANDS",
    "PERMIT",
    "POSITIONS",
    "RAM",
    "RAM_POSITION",
    "Hands",
    "Permit",
    "Position",
    "PressHands",
    "PressRam",
    "Ram",
    "RamPosition",
    "Way",
]


class Position(Enum):
    """The position of the ram."""

    TOP = "top"
    BETWEEN = "between"
    BOTTOM = "bottom"


class Way(Enum):
    """The direction in which the ram is to move."""

    REST = "rest"
    DOWN = "down"
    UP = "up"


class Hands(Message):
    """The two buttons, each pressed or not."""

    left: bool = False
    right: bool = False


class RamPosition(Message):
    """The ram's position, as its two end switches sense it."""

    position: Position = Position.BETWEEN


class Permit(Message):
    """The control's permit to the ram: it may close."""

    close: bool = False


class Ram(Message):
    """A command to the ram's drive."""

    way: Way = Way.REST


HANDS, RAM_POSITION = Slot("press/hands", Hands), Slot("press/ram_position", RamPosition)
PERMIT, RAM = Slot("press/permit", Permit), Slot("press/ram", Ram)
ALL_HANDS = tuple(Hands(*each) for each in product((False, True), repeat=2))
POSITIONS = tuple(map(RamPosition, Position))
"""The domains: all messages that the sensors can read."""


class PressHands(Machine):
    """The two-hand control: permit a stroke while both buttons are held, pressed together."""

    hands = Sensor(HANDS, default=Hands(), domain=ALL_HANDS)
    permit = Actuator(PERMIT, at_end=Permit())

    BLOCKED = State()
    RELEASED = State()
    ONE = State()
    BOTH = State()

    def both(self) -> bool:
        """True if both buttons are pressed."""
        return self.hands.left and self.hands.right

    def none(self) -> bool:
        """True if no button is pressed."""
        return not self.hands.left and not self.hands.right

    @BLOCKED.on_entry
    def _(self) -> None:
        self.permit(Permit(close=False))

    @BOTH.on_entry
    def _(self) -> None:
        self.permit(Permit(close=True))

    @BOTH.on_exit
    def _(self) -> None:
        self.permit(Permit(close=False))

    BLOCKED.to(RELEASED, when=lambda self: self.none())
    RELEASED.to(BOTH, when=lambda self: self.both())
    RELEASED.to(ONE, when=lambda self: not self.none())
    ONE.to(BLOCKED, after_ms=500)
    ONE.to(RELEASED, when=lambda self: self.none())
    ONE.to(BOTH, when=lambda self: self.both())
    BOTH.to(BLOCKED, when=lambda self: not self.both())


class PressRam(Machine):
    """Close while that is permitted, open at the bottom or as soon as it is not."""

    permit = Sensor(PERMIT, default=Permit())
    at = Sensor(RAM_POSITION, default=RamPosition(), domain=POSITIONS)
    ram = Actuator(RAM, at_end=Ram())

    OPENING = State()
    OPEN = State()
    CLOSING = State()

    @OPENING.on_entry
    def _(self) -> None:
        self.ram(Ram(Way.UP))

    @OPEN.on_entry
    def _(self) -> None:
        self.ram(Ram(Way.REST))

    @CLOSING.on_entry
    def _(self) -> None:
        self.ram(Ram(Way.DOWN))

    @CLOSING.on_exit
    def _(self) -> None:
        self.ram(Ram(Way.UP))

    OPENING.to(OPEN, when=lambda self: self.at.position is Position.TOP)
    OPEN.to(CLOSING, when=lambda self: self.permit.close)
    CLOSING.to(OPENING, when=lambda self: not self.permit.close)
    CLOSING.to(OPENING, when=lambda self: self.at.position is Position.BOTTOM)
