"""A differential-drive rover between walls, in two dimensions: what pymunk calculates."""

from math import atan2, cos, pi, sin

import pymunk
from slots import COLUMNS, ROWS, Ranges, Wheels

WIDTH, HEIGHT = 8.0, 5.0
WALLS = (
    ((0, 0), (WIDTH, 0)),
    ((WIDTH, 0), (WIDTH, HEIGHT)),
    ((WIDTH, HEIGHT), (0, HEIGHT)),
    ((0, HEIGHT), (0, 0)),
    ((2.5, 0), (2.5, 3.2)),
    ((5.2, HEIGHT), (5.2, 1.8)),
)
START, BEACON = (1.9, 0.8), (7.0, 1.0)
RADIUS, TRACK, THICKNESS = 0.18, 0.3, 0.04  # of the rover, between its wheels, of a wall
GRIP = 2.0  # metres per second squared, of a wheel
REACH = 3.0  # of a range sensor
SIDES = (-pi / 2, -pi / 4, 0.0, pi / 4, pi / 2)  # where they look
FOCUS = COLUMNS / 2  # of the camera, in pixels: it sees 90 degrees
TALL = 0.3  # of a wall above and below the camera, in metres
SKY, FLOOR, LIGHT = b"\x18", b"\x30", b"\xff"


class Arena:
    """The walls, the beacon and the rover, which obeys `step`."""

    def __init__(self) -> None:
        self.space = pymunk.Space()
        ground = self.space.static_body
        for begin, end in WALLS:
            self.space.add(pymunk.Segment(ground, begin, end, THICKNESS))
        self.beacon = pymunk.Circle(ground, 0.1, BEACON)
        self.body = pymunk.Body(5.0, 0.1)
        self.body.position, self.body.angle = START, pi / 2
        self.rover = pymunk.Circle(self.body, RADIUS)
        self.rover.filter = pymunk.ShapeFilter(group=1)  # its sensors do not see the rover itself
        self.space.add(self.beacon, self.body, self.rover)
        self.left = self.right = 0.0

    def step(self, command: Wheels, seconds: float) -> None:
        """Turn the wheels as commanded, as far as their grip allows, and move."""
        most = GRIP * seconds
        self.left += max(-most, min(most, command.left - self.left))
        self.right += max(-most, min(most, command.right - self.right))
        speed, angle = (self.left + self.right) / 2, self.body.angle
        self.body.velocity = (speed * cos(angle), speed * sin(angle))
        self.body.angular_velocity = (self.right - self.left) / TRACK
        self.space.step(seconds)

    def touched(self) -> bool:
        """Check that the rover touches something."""
        return bool(self.space.shape_query(self.rover))

    def ranges(self) -> Ranges:
        """Measure the distances of the five range sensors."""
        rays = (self.look(self.body.angle + side, REACH + RADIUS) for side in SIDES)
        return Ranges(*(distance - RADIUS for distance, _ in rays))

    def picture(self) -> bytes:
        """Make the picture of the camera: the nearer a wall, the taller and the brighter."""
        columns = []
        for column in range(COLUMNS):
            side = atan2(FOCUS - column, FOCUS)
            distance, is_beacon = self.look(self.body.angle + side, 20.0)
            half = min(ROWS // 2, int(FOCUS * TALL / max(distance * cos(side), 0.01)))
            grey = LIGHT if is_beacon else bytes((max(60, 200 - int(25 * distance)),))
            edge = ROWS // 2 - half
            columns.append(SKY * edge + grey * (2 * half) + FLOOR * edge)
        return b"".join(columns)

    def look(self, angle: float, reach: float) -> tuple[float, bool]:
        """Return the metres to the first thing that a ray hits, and True if that is the beacon."""
        begin = self.body.position
        end = begin + pymunk.Vec2d(reach * cos(angle), reach * sin(angle))
        hit = self.space.segment_query_first(begin, end, 0, self.rover.filter)
        return (reach, False) if hit is None else (reach * hit.alpha, hit.shape is self.beacon)
