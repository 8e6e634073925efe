"""The machine of README.md keeps its turtle away from the walls."""

from __future__ import annotations

import importlib
import re
import sys
from itertools import product
from math import pi
from pathlib import Path
from types import ModuleType

import pytest

from llfsm.bridges.turtlesim.node import TurtlesimNode
from llfsm.bridges.turtlesim.simulator import STEP_NS, Simulator
from llfsm.bridges.turtlesim.turtle import FIELD, Level
from llfsm.runtime import Arrangement, ManualClock
from llfsm.whiteboard import Whiteboard

README = Path(__file__).parents[2] / "README.md"
PLACES = (0.05, FIELD / 2, FIELD - 0.05)  # metres
HEADINGS = (-3 * pi / 4, -0.1, pi / 2, pi)  # rad
DURATION_NS = 60_000_000_000
ROUND_NS = 10_000_000  # the idle sleep of `llfsm run`


@pytest.fixture
def patrol(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    found = re.search(r"^```python patrol\.py\n(.*?)^```$", README.read_text(), re.M | re.S)
    assert found, "README.md has a block patrol.py"
    (tmp_path / "readme_patrol.py").write_text(found[1])
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "readme_patrol", raising=False)
    return importlib.import_module("readme_patrol")


@pytest.mark.parametrize("heading", HEADINGS)
def test_no_turtle_hits_a_wall(patrol: ModuleType, heading: float) -> None:
    """One turtle and one machine for each place; all run for a minute of simulated time."""
    hits: list[str] = []

    def log(level: Level, text: str) -> None:
        if level >= Level.WARN:
            hits.append(f"{clock.now_ns() / 1e9} s: {text}")

    board, clock = Whiteboard.local(), ManualClock()
    simulator = Simulator(log)
    node = TurtlesimNode(simulator, board)
    arrangement = Arrangement(whiteboard=board, clock=clock)
    simulator.kill("turtle1")
    for x, y in product(PLACES, PLACES):
        name = simulator.spawn(x, y, heading)
        simulator.turtle(name).pen_down = False
        arrangement.load(
            patrol.Patrol,
            name=name,
            variables={"turns": 1_000},
            slots={patrol.POSE.name: f"{name}/pose", patrol.CMD_VEL.name: f"{name}/cmd_vel"},
        )
    next_step = 0
    while clock.now_ns() < DURATION_NS:
        while next_step <= clock.now_ns():
            node.step()
            next_step += STEP_NS
        arrangement.round()
        clock.advance(ns=ROUND_NS)

    assert not hits
    for name in simulator.turtles:
        assert arrangement.machine(name).turns < 990, f"{name} stands still"
