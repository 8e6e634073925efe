"""Let the rover drive to its beacon in simulated time, and draw its way: drive.py way.svg."""

import sys
from itertools import groupby
from pathlib import Path

from arena import BEACON, HEIGHT, RADIUS, THICKNESS, WALLS, WIDTH
from rover import Rover, Spotter
from world import World

from llfsm.runtime import Arrangement, ManualClock
from llfsm.runtime.drawing.shapes import Ellipse, Line, Picture, Shape, Text
from llfsm.runtime.drawing.svg import write_svg
from llfsm.whiteboard import Whiteboard

LIMIT_S = 120.0
SCALE, MARGIN, LEGEND = 80, 20, 40  # pixels: a metre; around the walls; below them
COLORS = {
    "follow": "#1d5fa8",
    "turn": "#d1730f",
    "approach": "#0e7c66",
    "back_off": "#b3261e",
    "arrived": "#0e7c66",
}


def drive() -> tuple[World, float, list[tuple[str, float, float]]]:
    """Return the world, the seconds it took, and the rover's state and place every 50 ms."""
    clock, way = ManualClock(), []
    arrangement = Arrangement([World, Rover, Spotter], whiteboard=Whiteboard.local(), clock=clock)
    world, rover = (arrangement.machine(name) for name in ("World", "Rover"))
    while world.state_name != "over" and clock.now_ns() < LIMIT_S * 1e9:
        arrangement.round()
        clock.advance(ms=10)
        if world.turns % 5 == 1:
            way.append((rover.state_name, *world.arena.body.position))
    return world, clock.now_ns() / 1e9, way


def draw(way: list[tuple[str, float, float]]) -> str:
    """Return a picture of the walls, the beacon and the way, in a colour for each state."""

    def pixel(x: float, y: float) -> tuple[float, float]:
        return x * SCALE, (HEIGHT - y) * SCALE

    walls = [Line([pixel(*a), pixel(*b)], "#2f4056", 2 * THICKNESS * SCALE) for a, b in WALLS]
    shapes: list[Shape] = [*walls]
    before = way[0]
    for state, places in groupby(way, key=lambda place: place[0]):
        part = [before, *places]
        shapes.append(Line([pixel(x, y) for _, x, y in part], COLORS.get(state, "#2f4056"), 3))
        before = part[-1]
    radius = RADIUS * SCALE
    shapes.append(Ellipse(*pixel(*BEACON), 8, 8, "#e0a800"))
    shapes.append(Ellipse(*pixel(*way[0][1:]), radius, radius, "#9aa7b8"))
    shapes.append(Ellipse(*pixel(*way[-1][1:]), radius, radius, "#2f4056"))
    for number, state in enumerate(["follow", "turn", "approach"]):
        x, y = 120 * number, HEIGHT * SCALE + LEGEND - 5
        shapes.append(Line([(x, y - 5), (x + 24, y - 5)], COLORS[state], 3))
        shapes.append(Text(x + 34, y, state, 14, "#2f4056", centred=False))
    width, height = WIDTH * SCALE + 2 * MARGIN, HEIGHT * SCALE + 2 * MARGIN + LEGEND
    title = "The way of the rover to its beacon"
    return write_svg(Picture(title, width, height, "#fbfbf8", shapes, -MARGIN, -MARGIN))


def main() -> None:
    """Run until the rover has arrived; report how, and draw."""
    world, seconds, way = drive()
    print(f"the rover: {way[-1][0]} after {seconds:.2f} s, {world.touches} touches of a wall")
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(draw(way))
        print(f"drawn: {sys.argv[1]}")
    sys.exit(0 if world.state_name == "over" and not world.touches else 1)


if __name__ == "__main__":
    main()
