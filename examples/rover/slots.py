"""The messages between the rover and its world: 100 times a second, and pictures ten times."""

from llfsm.whiteboard import Message, Slot

COLUMNS, ROWS = 640, 480  # of a picture


class Ranges(Message):
    """Metres from the rover's rim to the next wall in five directions; at most 3."""

    right: float = 3.0
    right_ahead: float = 3.0
    ahead: float = 3.0
    left_ahead: float = 3.0
    left: float = 3.0


class Bumper(Message):
    """The bumper, pressed while something touches the rover."""

    pressed: bool = False


class Picture(Message):
    """A grey picture, a byte for each pixel, column by column from the left; each from the top."""

    number: int
    data: bytes


class Beacon(Message):
    """The place of the beacon in the latest picture."""

    columns: int = 0  # that show it; 0: it is not in the picture
    middle: float = 0.0  # of them: -1 on the left edge of the picture, 1 on the right one


class Wheels(Message):
    """Commanded speeds in metres per second."""

    left: float = 0.0
    right: float = 0.0


RANGES = Slot("rover/ranges", Ranges)
BUMPER = Slot("rover/bumper", Bumper)
PICTURE = Slot("rover/picture", Picture, capacity=COLUMNS * ROWS + 64)
BEACON = Slot("rover/beacon", Beacon)
WHEELS = Slot("rover/wheels", Wheels)
