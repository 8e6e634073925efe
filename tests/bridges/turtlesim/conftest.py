import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from llfsm.bridges.turtlesim.simulator import Simulator
from llfsm.bridges.turtlesim.turtle import Level

# How long an example takes says how busy the machine is, and nothing of the code.
settings.register_profile("turtlesim", deadline=None)
settings.load_profile("turtlesim")

DATA = Path(__file__).parents[2] / "data" / "turtlesim"


@pytest.fixture
def recorded() -> Callable[[str], Any]:
    """Load a file that was recorded from turtlesim 1.8.2."""
    return lambda name: json.loads((DATA / name).read_text())


@pytest.fixture
def log() -> list[tuple[Level, str]]:
    return []


@pytest.fixture
def simulator(log: list[tuple[Level, str]]) -> Simulator:
    """A simulator as it starts, its log emptied after the spawning of turtle1."""
    simulator = Simulator(log=lambda level, text: log.append((level, text)))
    log.clear()
    return simulator
