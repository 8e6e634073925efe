"""The turtle position service, as messages: a request slot and an answer slot.

A client posts a request whose number is one more than that of the latest request on the slot. The
server posts an answer with that number. An answer whose number is at least the client's own answers
its request, too, because it holds a later position; so clients may share the two slots.
"""

from llfsm.whiteboard.message import Message
from llfsm.whiteboard.slots import Slot


class TurtlePositionRequest(Message, type_name="turtle_sensor_poster/srv/TurtlePosition_Request"):
    """Requests the turtle's position."""

    number: int = 0


class TurtlePositionAnswer(Message, type_name="turtle_sensor_poster/srv/TurtlePosition_Response"):
    """The turtle's position, in metres and radians; ``failure`` says why it is unknown, if so."""

    number: int = 0
    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0
    failure: str = ""


REQUEST = Slot("turtle_position/request", TurtlePositionRequest)
ANSWER = Slot("turtle_position/answer", TurtlePositionAnswer)
