"""Patrol four waypoints with Navigation2: llfsm run patrol.py:Patrol, beside the bridge.

A waypoint that cannot be reached is tried again after the robot has backed away, twice; then it is
left out. Whatever ends the machine, its goal is canceled and the robot stops.
"""

from __future__ import annotations

from math import cos, sin
from pathlib import Path

from llfsm.bridges.ros2.bridging import action_slots
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.runtime.goals import CancelGoal, GoalStanding
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Point, Pose, Quaternion, Twist, Vector3
from llfsm.whiteboard.messages.std_msgs import Header

TYPES = TypeLibrary(share=[Path(__file__).parent / "nav2_msgs"])
NAVIGATE = action_slots("navigate", TYPES.action("nav2_msgs/action/NavigateToPose"))
Goal = NAVIGATE.goal.type
PoseStamped = TYPES.message("geometry_msgs/msg/PoseStamped").message

WAYPOINTS = ((2.0, 0.0, 0.0), (2.0, 2.0, 1.571), (0.0, 2.0, 3.142), (0.0, 0.0, -1.571))
"""x and y in metres, and the heading in radians, on the map."""
TRIES = 3


class Patrol(Machine):
    """Drive to one waypoint after the other, and back to the first."""

    go = Actuator(NAVIGATE.goal)
    cancel = Actuator(NAVIGATE.cancel, at_end=CancelGoal())
    drive = Actuator(Slot("cmd_vel", Twist), at_end=Twist())
    sent = Sensor(NAVIGATE.goal, default=Goal())
    standing = Sensor(NAVIGATE.status, default=GoalStanding())
    number: int = 0
    place: int = 0
    tries: int = 0
    reached: int = 0

    sending = State()
    driving = State()
    arrived = State()
    failed = State()
    backing = State()
    choosing = State()
    done = State()

    @sending.on_entry
    def _(self) -> None:
        self.number = max(self.sent.number, self.standing.number) + 1
        self.tries += 1
        x, y, heading = WAYPOINTS[self.place]
        turned = Quaternion(z=sin(heading / 2), w=cos(heading / 2))
        pose = PoseStamped(Header(frame_id="map"), Pose(Point(x, y), turned))
        self.go(Goal(self.number, pose=pose))

    sending.to(driving)

    driving.to(done, when=lambda m: m.stopping)
    driving.to(arrived, when=lambda m: m.standing.has_succeeded(m.number))
    driving.to(failed, when=lambda m: m.standing.has_failed(m.number))

    @arrived.on_entry
    def _(self) -> None:
        self.reached += 1

    arrived.to(choosing)

    failed.to(backing, when=lambda m: m.tries < TRIES)
    failed.to(choosing)

    @backing.on_entry
    def _(self) -> None:
        self.drive(Twist(linear=Vector3(x=-0.1)))

    @backing.on_exit
    def _(self) -> None:
        self.drive(Twist())

    backing.to(done, when=lambda m: m.stopping)
    backing.to(sending, after=2)

    @choosing.on_entry
    def _(self) -> None:
        self.place = (self.place + 1) % len(WAYPOINTS)
        self.tries = 0

    choosing.to(sending)
