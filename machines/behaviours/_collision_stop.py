"""A stop before obstacles: slower in a first zone, at rest in a second one."""

from math import isnan

from llfsm.machines.behaviours._slots import CMD_VEL, INPUT, REST
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.sensor_msgs import LaserScan, Range

RANGE, SCAN = Slot("range", Range), Slot("scan", LaserScan, 64 << 10)


class _Zones(Machine):
    """Pass velocities on, but ahead only as far as the way is free. A subclass measures that."""

    input = Sensor(INPUT, default=REST, max_age_ms=500)
    cmd_vel = Actuator(CMD_VEL, at_end=REST)
    slow_m: float = 1.0
    stop_m: float = 0.4
    hysteresis_m: float = 0.1
    slow_factor: float = 0.3

    STOP = State()
    SLOW = State()
    CLEAR = State()

    def free_m(self) -> float:
        """Return how far the way ahead is free; 0 if that is not known."""
        raise NotImplementedError  # each sensor has its own

    def drive(self, factor: float) -> None:
        """Pass the velocity on, ahead multiplied by a factor; back and turns as they are."""
        ahead = self.input.linear.x
        if ahead > 0:
            ahead *= factor
        self.cmd_vel(Twist(Vector3(x=ahead), Vector3(z=self.input.angular.z)))

    @STOP.on_entry
    def _(self) -> None:
        self.drive(0.0)

    @STOP.internal
    def _(self) -> None:
        self.drive(0.0)

    @SLOW.internal
    def _(self) -> None:
        self.drive(self.slow_factor)

    @SLOW.on_exit
    def _(self) -> None:
        self.brake()

    @CLEAR.internal
    def _(self) -> None:
        self.drive(1.0)

    @CLEAR.on_exit
    def _(self) -> None:
        self.brake()

    def brake(self) -> None:
        """Stop in the very turn in which the way is not free any more."""
        self.drive(0.0 if self.free_m() < self.stop_m else self.slow_factor)

    STOP.to(SLOW, when=lambda self: self.free_m() > self.stop_m + self.hysteresis_m)
    SLOW.to(STOP, when=lambda self: self.free_m() < self.stop_m)
    SLOW.to(CLEAR, when=lambda self: self.free_m() > self.slow_m + self.hysteresis_m)
    CLEAR.to(SLOW, when=lambda self: self.free_m() < self.slow_m)


class CollisionStop(_Zones):
    """Pass velocities on, but ahead only as far as a range sensor finds the way free.

    Turns and the way back stay free. A sensor that has been silent for half a second sees nothing
    free.

    Args:
        slow_m: nearer than so many metres, it drives ahead slower,
        slow_factor: times this.
        stop_m: nearer than this, not at all.
        hysteresis_m: so much farther, a zone is left.

    """

    range = Sensor(RANGE, max_age_ms=500)

    def free_m(self) -> float:
        """Measure how far the way is free; what the sensor cannot see is beyond its reach."""
        if self.range is None or isnan(self.range.range):
            return 0.0
        return self.range.range


class ScanCollisionStop(_Zones):
    """Pass velocities on, but ahead only as far as a laser finds the way free, as `CollisionStop`.

    Args:
        slow_m: as of `CollisionStop`, like `slow_factor`, `stop_m` and `hysteresis_m`.
        half_angle: radians to each side of straight ahead in which an obstacle counts.

    """

    scan = Sensor(SCAN, max_age_ms=500)
    half_angle: float = 0.5

    def free_m(self) -> float:
        """Return the least distance ahead; a beam that is not in the laser's range does not count.

        A scan without a beam ahead sees nothing free.
        """
        if self.scan is None:
            return 0.0
        return min(
            (self.seen_m(beam) for beam in range(len(self.scan.ranges)) if self.is_ahead(beam)),
            default=0.0,
        )

    def is_ahead(self, beam: int) -> bool:
        """True if a beam is ahead of the robot."""
        if self.scan is None:
            return False
        return abs(self.scan.angle_min + beam * self.scan.angle_increment) <= self.half_angle

    def seen_m(self, beam: int) -> float:
        """Return how far a beam is free: if it hits nothing, as far as the laser can tell."""
        if self.scan is None:
            return 0.0
        metres = self.scan.ranges[beam]
        if self.scan.range_min <= metres <= self.scan.range_max:
            return metres
        return self.scan.range_max
