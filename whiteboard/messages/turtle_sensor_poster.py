"""The turtle position service, as messages: a request slot and an answer slot.

A client posts a request whose number is one more than the latest on the slot; the server posts
an answer with that number. An answer with a number at least the client's own is an answer to
it: positions read later answer it as well, so that clients may share the two slots.
"""

from ..message import Message
from ..slots import Slot

__all__ = ["ANSWER", "REQUEST", "TurtlePositionAnswer", "TurtlePositionRequest"]


class TurtlePositionRequest(Message, type_name="turtle_sensor_poster/srv/TurtlePosition_Request"):
    """Ask where the turtle is."""

    number: int = 0


class TurtlePositionAnswer(Message, type_name="turtle_sensor_poster/srv/TurtlePosition_Response"):
    """Tell where the turtle is, in metres and radians, or in ``failure`` why that is not known."""

    number: int = 0
    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0
    failure: str = ""


REQUEST = Slot("turtle_position/request", TurtlePositionRequest)
ANSWER = Slot("turtle_position/answer", TurtlePositionAnswer)
