"""A turtle of a fleet: it goes where the fleet's orders want it, and reports when it is there."""

from math import atan2, cos, hypot, pi, sin
from typing import Literal

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.turtlesim import Pose

SIZE = 10  # turtles
CENTRE = 5.5  # metres, of the field
NEAR = 0.1  # metres from its place, at which a turtle has arrived
Shape = Literal["row", "circle", "end"]


class Order(Message):
    """The shape that the fleet is to form; "end" ends all machines."""

    number: int = 0
    shape: Shape = "row"


class Report(Message):
    """The number of the latest order that a turtle has carried out."""

    number: int = 0


ORDER = Slot("fleet/order", Order)
REPORT = Slot("turtle1/report", Report)  # as the two below, replaced for each turtle
POSE = Slot("turtle1/pose", Pose)
CMD_VEL = Slot("turtle1/cmd_vel", Twist)


def place(shape: Shape, number: int) -> tuple[float, float]:
    """Return the place of a turtle, 1 to `SIZE`, in metres."""
    if shape == "row":
        return float(number), 1.0
    angle = 2 * pi * number / SIZE
    return CENTRE + 3.5 * cos(angle), CENTRE + 3.5 * sin(angle)


class Member(Machine):
    """Go to the place of the latest order; report; wait for the next."""

    order = Sensor(ORDER, default=Order())
    pose = Sensor(POSE)
    drive = Actuator(CMD_VEL, at_end=Twist())
    report = Actuator(REPORT)

    number: int = 1  # of this turtle
    obeyed: int = 0  # the number of the latest order that it has carried out

    wait = State()
    travel = State()
    settle = State()
    arrived = State()
    end = State()

    def way(self) -> tuple[float, float]:
        """Return the metres to its place, and the angle to the left in radians."""
        assert self.pose is not None
        x, y = place(self.order.shape, self.number)
        angle = atan2(y - self.pose.y, x - self.pose.x) - self.pose.theta
        return hypot(x - self.pose.x, y - self.pose.y), atan2(sin(angle), cos(angle))

    wait.to(end, when=lambda self: self.order.shape == "end")

    @wait.to(travel)
    def new_order(self) -> bool:
        """Check for an order that it has not carried out."""
        return self.pose is not None and self.order.number > self.obeyed

    @travel.internal
    def steer(self) -> None:
        """Turn to the place, and drive there as far as it lies ahead: slowly, at its end."""
        distance, angle = self.way()
        speed = min(2.0, 1.5 * distance) * max(0.0, cos(angle))
        self.drive(Twist(Vector3(x=speed), Vector3(z=1.5 * angle)))

    travel.to(settle, when=lambda self: self.way()[0] < NEAR)

    @travel.on_exit
    def stop(self) -> None:
        """Stand still, for whatever reason it no longer travels."""
        self.drive(Twist())

    def rests(self) -> bool:
        """Check that it stands still, by its pose, which is of a moment ago."""
        return self.pose is not None and self.pose.linear_velocity == 0

    @settle.to(travel)
    def has_rolled_on(self) -> bool:
        """Check that it stopped too late: the network may be slow."""
        return self.rests() and self.way()[0] > 2 * NEAR

    settle.to(arrived, when=rests)

    @arrived.on_entry
    def report_arrival(self) -> None:
        """Report that it is there."""
        self.obeyed = self.order.number
        self.report(Report(self.obeyed))

    arrived.to(wait)
