"""``llfsm draw FILE.toml``: which machines and slots an arrangement joins, and how."""

from __future__ import annotations

import re

import pytest

from llfsm.runtime.drawing import to_svg
from llfsm.runtime.drawing.arrange import MachineLinks, overview

from .conftest import Llfsm

PLAN = """\
[[machine]]
definition = "RosWallTurttleBot"
name = "Wall"
slots = {"turtle1/cmd_vel" = "turtle2/cmd_vel"}

[[machine]]
definition = "TurtleSuspendResume"
variables = {target = "Wall"}

[[machine]]
definition = "caller.py:Caller"
"""
CALLER = """\
from llfsm.runtime import Machine, State
class Caller(Machine):
    A = State()
    @A.on_entry
    def _(self) -> None:
        self.call_machine("Helper")
        self.restart("Wall")
        self.restart("Wall")
        name = "nobody"
        self.restart(name)
"""


def arrows(svg: str) -> set[tuple[str, str]]:
    found = re.findall(r'data-transition="([^"]*):\d+" data-target="([^"]*)"', svg)
    return {(source, target) for source, target in found}


def test_an_arrangement_is_drawn_with_its_slots_and_requests(llfsm: Llfsm) -> None:
    (llfsm.cwd / "robot.toml").write_text(PLAN)
    (llfsm.cwd / "caller.py").write_text(CALLER)
    done = llfsm.run("draw", "robot.toml")
    assert done.returncode == 0, done.stderr
    assert arrows(done.stdout) == {
        ("Wall", "turtle2/cmd_vel"),
        ("Wall", "turtle_position/request"),
        ("turtle_position/request", "Wall"),
        ("turtle_position/answer", "Wall"),
        ("TurtleSuspendResume", "Wall"),
        ("Caller", "Wall"),
        ("Caller", "Helper"),
    }
    assert re.findall(r'class="slot" data-state="([^"]*)"', done.stdout) == [
        "turtle2/cmd_vel", "turtle_position/request", "turtle_position/answer"
    ]  # fmt: skip
    assert "suspend, resume" in done.stdout
    assert 'class="start"' not in done.stdout
    assert llfsm.run("draw", "robot.toml", "-o", "robot.png").returncode == 0
    assert (llfsm.cwd / "robot.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("text", "options", "says"),
    [
        (PLAN, ["--format", "dot"], "an arrangement is drawn as svg or png, not as dot"),
        (PLAN, ["-o", "robot.mmd"], "an arrangement is drawn as svg or png, not as mermaid"),
        (
            "[[machine]]\n",
            [],
            "robot.toml:1: machine[0]: Object missing required",
        ),
        ("[[machine]]\ndefinition = 'Nothing'\n", [], "no machine 'Nothing'"),
    ],
)
def test_what_cannot_be_drawn(llfsm: Llfsm, text: str, options: list[str], says: str) -> None:
    (llfsm.cwd / "robot.toml").write_text(text)
    (llfsm.cwd / "caller.py").write_text(CALLER)
    done = llfsm.run("draw", "robot.toml", *options)
    assert done.returncode != 0
    assert says in done.stderr


def test_nothing_overlaps_in_an_overview() -> None:
    machines = {
        f"M{i}": MachineLinks(
            [f"slot/{j}" for j in range(6) if i * j % 3 == 1],
            [f"slot/{j}" for j in range(6) if (i + j) % 4 == 0],
            [("suspend", f"M{(i * 3 + 1) % 8}")],
        )
        for i in range(8)
    }
    drawn = overview("many", machines)
    assert to_svg(drawn) == to_svg(overview("many", machines))
    placed = [*drawn.boxes, *(edge.label for edge in drawn.edges)]
    for i, one in enumerate(placed):
        for other in placed[:i]:
            beside = abs(one.x - other.x) >= (one.width + other.width) / 2 - 0.01
            assert beside or abs(one.y - other.y) >= (one.height + other.height) / 2 - 0.01
