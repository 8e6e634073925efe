"""A round over waypoints, in the plane."""

from math import atan2, copysign, cos, hypot, sin

from llfsm.machines.behaviours._slots import AUTONOMY, REST
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import PoseStamped, Twist, Vector3

POSE = Slot("localization/pose", PoseStamped, 512)


class Patrol(Machine):
    """Go to one waypoint after the other, and from the last one to the first.

    At each, it rests for a second. It rests, too, while its pose has been silent for half a second,
    and then goes on to the same waypoint; so does a round that was suspended. It does not see
    obstacles: load `CollisionStop` after it.

    Args:
        waypoints: x and y of each in metres, in the frame of the pose; at least one.
        rounds: after so many it is done; 0 for rounds without an end.
        speed: m/s ahead.
        turn: rad/s on the spot.
        near_m: a waypoint is reached within so many metres.
        aligned: rad: it drives once it faces the waypoint within that, and turns anew beyond thrice
            that. With `turn` times the period of the arrangement beyond it, it turns to and fro.

    Raise :class:`ValueError`, in its first section, if there is no waypoint.

    """

    pose = Sensor(POSE, max_age_ms=500)
    velocity = Actuator(AUTONOMY, at_end=REST)
    waypoints: tuple[tuple[float, float], ...] = ()
    rounds: int = 0
    speed: float = 0.3
    turn: float = 0.8
    near_m: float = 0.1
    aligned: float = 0.1
    target: int = 0
    completed: int = 0

    LOST = State()
    TURN = State()
    DRIVE = State()
    AT_WAYPOINT = State()
    DONE = State()

    def distance_m(self) -> float:
        """Return the distance to the waypoint; without a pose, 0."""
        if self.pose is None:
            return 0.0
        at = self.pose.pose.position
        to = self.waypoints[self.target]
        return hypot(to[0] - at.x, to[1] - at.y)

    def heading_error(self) -> float:
        """Return by which angle to turn left to face the waypoint: -pi to pi; without a pose, 0."""
        if self.pose is None:
            return 0.0
        at = self.pose.pose.position
        to = self.waypoints[self.target]
        turned = self.pose.pose.orientation
        heading = atan2(
            2 * (turned.w * turned.z + turned.x * turned.y), 1 - 2 * (turned.y**2 + turned.z**2)
        )
        error = atan2(to[1] - at.y, to[0] - at.x) - heading
        return atan2(sin(error), cos(error))

    def is_lost(self) -> bool:
        """True if the pose is not known."""
        return self.pose is None

    def is_near(self) -> bool:
        """True if the waypoint is reached."""
        return self.pose is not None and self.distance_m() <= self.near_m

    def is_aligned(self) -> bool:
        """True if the robot faces the waypoint."""
        return abs(self.heading_error()) <= self.aligned

    @LOST.on_entry
    def _(self) -> None:
        if not self.waypoints:
            raise ValueError("no waypoints; give them as in Patrol(waypoints=((0, 0), (2, 0)))")
        self.velocity(REST)

    @TURN.internal
    def _(self) -> None:
        self.velocity(Twist(angular=Vector3(z=copysign(self.turn, self.heading_error()))))

    @TURN.on_exit
    def _(self) -> None:
        self.velocity(REST)

    @DRIVE.internal
    def _(self) -> None:
        steer = self.turn * self.heading_error() / (3 * self.aligned)
        self.velocity(Twist(Vector3(x=self.speed), Vector3(z=steer)))

    @DRIVE.on_exit
    def _(self) -> None:
        self.velocity(REST)

    @AT_WAYPOINT.on_entry
    def _(self) -> None:
        self.target += 1
        if self.target == len(self.waypoints):
            self.target = 0
            self.completed += 1

    LOST.to(TURN, when=lambda self: not self.is_lost())
    TURN.to(LOST, when=is_lost)
    TURN.to(AT_WAYPOINT, when=is_near)
    TURN.to(DRIVE, when=is_aligned)
    DRIVE.to(LOST, when=is_lost)
    DRIVE.to(AT_WAYPOINT, when=is_near)
    DRIVE.to(TURN, when=lambda self: abs(self.heading_error()) > 3 * self.aligned)
    AT_WAYPOINT.to(DONE, when=lambda self: 0 < self.rounds <= self.completed)
    AT_WAYPOINT.to(TURN, after_ms=1000)
