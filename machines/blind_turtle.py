"""A machine without sensors: it drives a turtle in triangles."""

from llfsm.machines.common import CMD_VEL, stopping, twist
from llfsm.runtime import Actuator, Machine, State
from llfsm.whiteboard.messages.geometry_msgs import Twist

__all__ = ["RosBlindTurttleBot"]


class RosBlindTurttleBot(Machine):
    """Drive ahead for a second, turn right for a second, and repeat."""

    drive = Actuator(CMD_VEL, at_end=Twist())
    linear_x: float = 0.0  # m/s
    angular_z: float = 0.0  # rad/s

    INITIAL = State()
    STRAIGHT = State()
    TURN_RIGHT = State()
    END = State()

    @INITIAL.on_entry
    def _(self) -> None:
        self.linear_x = self.angular_z = 0.0

    @STRAIGHT.on_entry
    def _(self) -> None:
        self.linear_x, self.angular_z = 2.0, 0.0
        self.drive(twist(self.linear_x, self.angular_z))

    @TURN_RIGHT.on_entry
    def _(self) -> None:
        self.linear_x, self.angular_z = 0.0, -2.0
        self.drive(twist(self.linear_x, self.angular_z))

    INITIAL.to(STRAIGHT, after_ms=1000)
    STRAIGHT.to(TURN_RIGHT, after_ms=1000)
    TURN_RIGHT.to(STRAIGHT, after_ms=1000)

    INITIAL.to(END, when=stopping)
    STRAIGHT.to(END, when=stopping)
    TURN_RIGHT.to(END, when=stopping)
