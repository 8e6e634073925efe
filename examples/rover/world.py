"""The rover's world as a machine, of one turn every 10 ms."""

from arena import BEACON as PLACE
from arena import Arena
from slots import BUMPER, PICTURE, RANGES, WHEELS, Bumper, Picture, Wheels

from llfsm.runtime import Actuator, Machine, Sensor, State


class World(Machine):
    """Move the rover; post what its sensors measure, and each tenth time a picture."""

    wheels = Sensor(WHEELS, default=Wheels(), max_age_ms=500, since_start=True)
    ranges = Actuator(RANGES)
    bumper = Actuator(BUMPER)
    picture = Actuator(PICTURE)

    arena: Arena = None  # type: ignore[assignment]  # made when the machine begins
    turns: int = 0
    touches: int = 0  # turns in which the rover touched something

    driving = State()
    over = State()

    @driving.on_entry
    def build(self) -> None:
        """Build the walls and put the rover at its start."""
        self.arena = Arena()

    @driving.internal
    def move(self) -> None:
        """Move by 10 ms."""
        self.arena.step(self.wheels, 0.01)
        pressed = self.arena.touched()
        self.touches += pressed
        self.ranges(self.arena.ranges())
        self.bumper(Bumper(pressed))
        if self.turns % 10 == 0:
            self.picture(Picture(self.turns // 10, self.arena.picture()))
        self.turns += 1

    @driving.to(over)
    def rests_at_the_beacon(self) -> bool:
        """Check that the rover has arrived and stands still."""
        distance = self.arena.body.position.get_distance(PLACE)
        return distance < 0.6 and self.arena.left == self.arena.right == 0
