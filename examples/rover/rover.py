"""The rover's machines: one looks for the beacon in pictures, one drives there."""

from slots import (
    BEACON,
    BUMPER,
    COLUMNS,
    PICTURE,
    RANGES,
    ROWS,
    WHEELS,
    Beacon,
    Bumper,
    Wheels,
)

from llfsm.runtime import Actuator, Machine, Sensor, State

SPEED = 0.5  # metres per second
GAP = 0.45  # metres to the wall that it follows, ahead on the right
CLOSE = 0.35  # metres to a wall ahead, at which it turns
BESIDE = 110  # columns that show a beacon beside the rover


class Spotter(Machine):
    """Find the beacon, the only white thing, on the middle line of each picture."""

    picture = Sensor(PICTURE)
    beacon = Actuator(BEACON)
    seen: int = -1  # the number of the latest picture

    look = State()
    answer = State()

    @look.to(answer)
    def new_picture(self) -> bool:
        """Check for a picture that it has not looked at."""
        return self.picture is not None and self.picture.number != self.seen

    @answer.on_entry
    def find(self) -> None:
        """Copy one byte of each column, and no other of the 307,200."""
        assert self.picture is not None
        self.seen = self.picture.number
        line = bytes(memoryview(self.picture.data)[ROWS // 2 :: ROWS])
        columns = line.count(0xFF)
        middle = (line.find(0xFF) + line.rfind(0xFF)) / COLUMNS - 1 if columns else 0.0
        self.beacon(Beacon(columns, middle))

    answer.to(look)


class Rover(Machine):
    """Follow the wall on the right until the beacon is in sight, and drive there."""

    ranges = Sensor(RANGES, max_age_ms=200)  # an old message is as bad as none
    bumper = Sensor(BUMPER, default=Bumper())
    beacon = Sensor(BEACON, default=Beacon())
    drive = Actuator(WHEELS, at_end=Wheels())

    blind = State()
    follow = State()
    turn = State()
    approach = State()
    back_off = State()
    arrived = State()
    parked = State(suspend=True)

    def sees_nothing(self) -> bool:
        """Check that the range sensors are silent."""
        return self.ranges is None

    def bumped(self) -> bool:
        """Check that something touches it."""
        return self.bumper.pressed

    def in_sight(self) -> bool:
        """Check that the latest picture shows the beacon."""
        return self.beacon.columns > 0

    @blind.on_entry
    def stop(self) -> None:
        """Stand still while nothing is measured."""
        self.drive(Wheels())

    @blind.to(follow)
    def sees(self) -> bool:
        """Check that the range sensors work."""
        return self.ranges is not None

    follow.to(blind, when=sees_nothing)
    follow.to(back_off, when=bumped)
    follow.to(approach, when=in_sight)

    @follow.to(turn)
    def wall_ahead(self) -> bool:
        """Check for a wall, from which it must turn away to the left."""
        return self.ranges is not None and self.ranges.ahead < CLOSE

    @follow.internal
    def keep_the_gap(self) -> None:
        """Steer to the right where the wall is far, and to the left where it is near."""
        assert self.ranges is not None
        near = min(self.ranges.right_ahead, self.ranges.right + 0.2)  # not yet past a corner
        wide = max(-0.33, min(0.33, 1.5 * (near - GAP)))
        self.drive(Wheels(SPEED * (1 + wide), SPEED * (1 - wide)))

    turn.to(blind, when=sees_nothing)
    turn.to(back_off, when=bumped)
    turn.to(approach, when=in_sight)

    @turn.internal
    def turn_left(self) -> None:
        """Turn on the spot."""
        self.drive(Wheels(-0.2, 0.2))

    @turn.to(follow, after_ms=300)
    def free_ahead(self) -> bool:
        """Check that it may drive ahead."""
        return self.ranges is not None and self.ranges.ahead > 2 * CLOSE

    approach.to(blind, when=sees_nothing)
    approach.to(back_off, when=bumped)
    approach.to(follow, when=lambda self: self.beacon.columns == 0)
    approach.to(arrived, when=lambda self: self.beacon.columns > BESIDE)

    @approach.internal
    def steer(self) -> None:
        """Keep the beacon in the middle of the picture."""
        aside = 0.5 * self.beacon.middle
        self.drive(Wheels(SPEED * (1 + aside), SPEED * (1 - aside)))

    @back_off.internal
    def back(self) -> None:
        """Drive back."""
        self.drive(Wheels(-0.2, -0.2))

    back_off.to(turn, after_ms=700)
