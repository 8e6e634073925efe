"""Draw docs/pictures/: terms, the tutorial's robot and the rover: `make pictures`.

The robots run in simulated time, so the pictures are the same on every computer.
"""

import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from llfsm.runtime import Arrangement, Machine, ManualClock, State, Trace
from llfsm.runtime.drawing import Stay, Timeline, arrange, timeline, to_svg
from llfsm.runtime.engine.events import RoundEnd
from llfsm.whiteboard import Whiteboard

ROOT = Path(__file__).parents[1]
FILE = re.compile(r"^```python (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SVG = "http://www.w3.org/2000/svg"
SECONDS = 12.0
LIT, PLAIN = "#bfe5d8", "#ffffff"
ET.register_namespace("", SVG)


class Ringlet(Machine):
    """One turn of one machine, drawn as a machine itself."""

    snapshot = State()
    OnEntry = State()
    transitions = State()
    Internal = State()
    OnExit = State()
    end_of_turn = State()

    @snapshot.to(OnEntry)
    def state_is_new(self) -> bool:  # noqa: D102
        return True

    @snapshot.to(transitions)
    def same_state_as_before(self) -> bool:  # noqa: D102
        return True

    OnEntry.to(transitions)

    @transitions.to(OnExit)
    def one_holds(self) -> bool:  # noqa: D102
        return True

    @transitions.to(Internal)
    def none_holds(self) -> bool:  # noqa: D102
        return True

    OnExit.to(end_of_turn)
    Internal.to(end_of_turn)


class Robot:
    """What the tutorial's robot did: its machines, their states over time, places and levels."""

    def __init__(self) -> None:
        with TemporaryDirectory() as folder:
            for page in sorted((ROOT / "docs" / "tutorial").glob("[12]-*.md")):
                for name, text in FILE.findall(page.read_text()):
                    Path(folder, name).write_text(text)
            sys.path.insert(0, folder)
            try:
                self.run(*map(import_module, ("robot", "docking", "world")))
            finally:
                sys.path.remove(folder)
                for name in ("robot", "docking", "world"):
                    sys.modules.pop(name, None)

    def run(self, robot: Any, docking: Any, world: Any) -> None:
        """Run for `SECONDS`, and draw while the sources are there."""
        trace = Trace()
        self.places: list[tuple[float, float]] = []

        def follow(event: object) -> None:
            if isinstance(event, RoundEnd):
                corridor = arrangement.machine("Corridor")
                self.places.append((corridor.metres, corridor.percent))

        arrangement = Arrangement(
            [world.Corridor, robot.Patrol, docking.Docking], whiteboard=Whiteboard.local(),
            clock=ManualClock(), period_us=20_000, observers=[trace, follow],
        )  # fmt: skip
        arrangement.run(max_rounds=int(SECONDS * 50))
        self.stays = timeline(trace)
        self.patrol = to_svg(arrange(robot.Patrol.table, title="Patrol"))
        self.docking = to_svg(arrange(docking.Docking.table, title="Docking"))


def rover() -> str:
    """Return the way of the rover of examples/rover."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "rover.svg")
        drive = ROOT / "examples" / "rover" / "drive.py"
        subprocess.run([sys.executable, drive, path], check=True, stdout=subprocess.DEVNULL)
        return path.read_text()


def animated(robot: Robot) -> str:
    """Return a picture that moves: the robot in its corridor, and the states of its machines."""
    machines = [
        lit(text, [stay for stay in robot.stays if stay.machine == name])
        for name, text in (("Patrol", robot.patrol), ("Docking", robot.docking))
    ]
    sizes = [(float(each.get("width", 0)), float(each.get("height", 0))) for each in machines]
    width, height = sum(size[0] for size in sizes) + 20, max(size[1] for size in sizes) + 110
    root = ET.Element(f"{{{SVG}}}svg", {
        "viewBox": f"0 0 {width:g} {height:g}", "width": f"{width:g}", "height": f"{height:g}",
        "role": "img", "font-family": "Helvetica, Arial, sans-serif", "font-size": "13",
    })  # fmt: skip
    part(root, "title").text = "A robot patrols, docks and charges, and its machines change state"
    part(root, "rect", width=width, height=height, fill="#fbfbf8")
    left, scale = 60.0, (width - 120) / 9
    samples = robot.places[::5]
    part(root, "line", x1=left, x2=width - 30, y1=72, y2=72, stroke="#6b7c93", stroke_width=2)
    part(root, "rect", x=left - 34, y=40, width=16, height=32, rx=3, fill="#0e7c66")
    part(root, "text", x=left - 42, y=90, fill="#2f4056").text = "dock"
    body = part(root, "g")
    part(body, "rect", x=-16, y=44, width=32, height=20, rx=6, fill="#1d5fa8")
    for wheel in (-9, 9):
        part(body, "circle", cx=wheel, cy=66, r=6, fill="#1c2733")
    moves = ";".join(f"{left + metres * scale:.1f} 0" for metres, _ in samples)
    part(body, "animateTransform", attributeName="transform", type="translate", values=moves,
         dur=f"{SECONDS:g}s", repeatCount="indefinite")  # fmt: skip
    part(root, "rect", x=width - 150, y=14, width=120, height=12, rx=3, fill="#dfe6f5")
    level = part(root, "rect", x=width - 150, y=14, width=0, height=12, rx=3, fill="#0e7c66")
    part(level, "animate", attributeName="width", dur=f"{SECONDS:g}s", repeatCount="indefinite",
         values=";".join(f"{percent * 1.2:.1f}" for _, percent in samples))  # fmt: skip
    part(root, "text", x=width - 205, y=25, fill="#2f4056").text = "battery"
    x = 0.0
    for each, size, name in zip(machines, sizes, ("Patrol", "Docking"), strict=True):
        each.set("x", f"{x:g}")
        each.set("y", "105")
        root.append(each)
        part(root, "text", x=x + 20, y=132, fill="#2f4056", font_weight="bold").text = name
        x += size[0] + 20
    return ET.tostring(root, encoding="unicode") + "\n"


def part(parent: ET.Element, tag: str, **attributes: object) -> ET.Element:
    """Append an element."""
    texts = {
        name.replace("_", "-"): f"{each:g}" if isinstance(each, int | float) else str(each)
        for name, each in attributes.items()
    }
    return ET.SubElement(parent, f"{{{SVG}}}{tag}", texts)


def lit(svg: str, stays: Sequence[Stay]) -> ET.Element:
    """Return a diagram whose states light up while the machine is in them."""
    root = ET.fromstring(svg)
    for group in root.iter(f"{{{SVG}}}g"):
        state = group.get("data-state")
        for frame in group.findall(f"{{{SVG}}}rect") if state is not None else ():
            fills, times = [PLAIN], [0.0]
            for stay in stays:
                if stay.state == state:
                    fills += [LIT, PLAIN]
                    times += [stay.begin_ns / 1e9 / SECONDS, stay.end_ns / 1e9 / SECONDS]
            part(frame, "animate", attributeName="fill", calcMode="discrete",
                 values=";".join(fills), keyTimes=";".join(f"{min(time, 1):.4f}" for time in times),
                 dur=f"{SECONDS:g}s", repeatCount="indefinite")  # fmt: skip
    return root


def pictures() -> dict[str, str]:
    """Return the text of each picture by its name."""
    robot = Robot()
    shown = Timeline(stay for stay in robot.stays if stay.machine != "Corridor")
    return {
        "arrangement.svg": shown.to_svg(),
        "patrol.svg": robot.patrol,
        "ringlet.svg": to_svg(arrange(Ringlet.table, title="A ringlet")),
        "robot.svg": animated(robot),
        "rover.svg": rover(),
    }


if __name__ == "__main__":
    folder = ROOT / "docs" / "pictures"
    folder.mkdir(exist_ok=True)
    for name, text in pictures().items():
        (folder / name).write_text(text)
